"""Metrics and plots of recorded runs.

:func:`~ik_node.report.reported_run.read_reported_runs` reads recordings; each becomes a ``ReportedRun``: the arrays of
the run (``recording.run.Run``), its ``RunMetrics`` and a colour. :func:`compute_metrics` compares the measured tool
pose with a ``GroundTruth`` (the sampled trajectory stored beside the recording, or else the recorded targets) and
derives all scalar metrics.

The metrics are printed as text (``text``: one run, ``table``: several) or JSON. The pages (``summary_page`` or
``overlay``, ``joints_page``, ``solver_page``, ``states_page``) are drawn with matplotlib and written by ``document`` as
PNG, PDF or SVG, or by ``html`` as one self-contained HTML file. ``quantities`` holds the names, units and factors with
which all of these, and the viewer, display a quantity.
"""

from ik_node.report.ground_truth import (
    GROUND_TRUTH_FILE,
    GroundTruth,
    ground_truth_from_targets,
    ground_truth_from_trajectory,
    read_ground_truth,
    write_ground_truth,
)
from ik_node.report.metrics import RunMetrics, compute_metrics
from ik_node.report.text import as_json, as_plain, as_text

__all__ = [
    "GROUND_TRUTH_FILE",
    "GroundTruth",
    "RunMetrics",
    "as_json",
    "as_plain",
    "as_text",
    "compute_metrics",
    "ground_truth_from_targets",
    "ground_truth_from_trajectory",
    "read_ground_truth",
    "write_ground_truth",
]
