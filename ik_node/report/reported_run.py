"""A recording with its metrics, its name and colour in the report, and its offset on the common time axis."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ik_node.collision.scene import Obstacle
from ik_node.errors import IkNodeError, RecordingError, TrajectoryFileError
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.report.ground_truth import GROUND_TRUTH_FILE, GroundTruth, read_ground_truth
from ik_node.report.metrics import RunMetrics, compute_metrics
from ik_node.report.recorded_scene import read_obstacles
from ik_node.report.style import RUN_COLOURS
from ik_node.report.text import title
from ik_node.trajectory.pose_file_format import PoseFileFormat

USUAL_NAME = "bag"
"""Folder name of every recording of ``ik_demo``; the parent's name is more specific."""


class ReportedRun(NamedTuple):
    """One of the recordings of a report."""

    name: str
    run: Run
    metrics: RunMetrics
    colour: str
    zero_s: float = 0.0
    """Time on the axis of ``Run.times_s`` that is 0 in the plots."""
    obstacles: tuple[Obstacle, ...] = ()
    """Recorded obstacles at the start of the run."""

    @property
    def times_s(self) -> Array:
        """Times of all control steps, (k,), on the plots' axis."""
        result: Array = self.run.times_s - self.zero_s
        return result

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last control step on the plots' axis."""
        times = self.times_s
        return (float(times[0]), float(times[-1])) if len(times) else (0.0, 0.0)


def report_run(run: Run, metrics: RunMetrics) -> ReportedRun:
    """A report of a single run."""
    return ReportedRun(title(metrics), run, metrics, RUN_COLOURS[0])


def read_reported_runs(
    bags: Sequence[Path], truth: Path | None = None, truth_format: PoseFileFormat | None = None
) -> tuple[ReportedRun, ...]:
    """Reads recordings and computes their metrics.

    If all of several recordings have targets, their time axes are aligned at the first target of each.

    Args:
        bags: Folders or MCAP files of recordings.
        truth: Ground truth of all; otherwise the file beside each recording, or else its targets.
        truth_format: Format of ``truth``; default: detected.

    Raises:
        IkNodeError: A recording, robot or ground truth cannot be read; the message names the recording.
    """
    read = []
    given = None if truth is None else read_ground_truth(truth, truth_format)
    for bag in bags:
        try:
            run = load_run(bag)
            if given is not None:
                _check_overlap(given, run, bag)
            obstacles = read_obstacles(bag)
            metrics = compute_metrics(run, given or stored_truth(bag), obstacles=obstacles)
            read.append((run, metrics, obstacles.at_start))
        except IkNodeError as error:
            raise error if str(bag) in str(error) else RecordingError(f"'{bag}': {error}") from error
    aligned = len(read) > 1 and all(len(run.targets.times_s) for run, _, _ in read)
    return tuple(
        ReportedRun(
            name,
            run,
            metrics,
            RUN_COLOURS[index % len(RUN_COLOURS)],
            float(run.targets.times_s[0]) if aligned else 0.0,
            obstacles,
        )
        for index, (name, (run, metrics, obstacles)) in enumerate(zip(names_of(bags), read, strict=True))
    )


def names_of(bags: Sequence[Path]) -> tuple[str, ...]:
    """The shortest distinct ends of the paths; the same path given twice is numbered."""
    places = [bag.resolve() for bag in bags]
    parts = [(place.with_suffix("") if place.suffix == ".mcap" else place).parts for place in places]
    lengths = [2 if path[-1] == USUAL_NAME and len(path) > 1 else 1 for path in parts]
    paths = Counter(map(tuple, parts))

    def name(index: int) -> str:
        end = parts[index][-lengths[index] :]
        return "/".join(end[:-1] if end[-1] == USUAL_NAME and len(end) > 1 else end)

    while True:
        names = [name(index) for index in range(len(parts))]
        alike = Counter(names)
        short = [
            index
            for index, path in enumerate(parts)
            if alike[names[index]] > paths[tuple(path)] and lengths[index] < len(path)
        ]
        if not short:
            break
        for index in short:
            lengths[index] += 1
    seen: Counter[str] = Counter()
    for index, given in enumerate(names):
        seen[given] += 1
        names[index] = f"{given} ({seen[given]})" if seen[given] > 1 else given
    return tuple(names)


def span_of(reported_runs: Sequence[ReportedRun]) -> tuple[float, float]:
    """From the first control step of all runs to the last, on the plots' axis."""
    spans = [reported.span_s for reported in reported_runs]
    return min(begin for begin, _ in spans), max(end for _, end in spans)


def time_label(reported_runs: Sequence[ReportedRun]) -> str:
    """Label of the time axis."""
    aligned = any(reported.zero_s for reported in reported_runs)
    return "time since the first target [s]" if aligned else "time [s]"


def all_joints(reported_runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    """The joint names of all runs without duplicates, in order of first appearance."""
    return tuple(dict.fromkeys(joint for reported in reported_runs for joint in reported.run.joints))


def methods_of(reported: ReportedRun) -> tuple[str, ...]:
    """The method at the start, then those set later."""
    changes = (changed["method"] for _, changed in reported.run.setting_changes if "method" in changed)
    return tuple(dict.fromkeys((reported.metrics.method, *map(str, changes))))


def truth_beside(bag: Path) -> Path | None:
    """The file with the ground truth beside the recording's folder; None if there is none."""
    place = bag.resolve()
    beside = (place if place.is_dir() else place.parent).parent / GROUND_TRUTH_FILE
    return beside if beside.is_file() else None


def stored_truth(bag: Path) -> GroundTruth | None:
    """The ground truth beside the recording's folder; None if there is none."""
    beside = truth_beside(bag)
    return None if beside is None else read_ground_truth(beside)


def _check_overlap(truth: GroundTruth, run: Run, bag: Path) -> None:
    """Raise TrajectoryFileError when a ground truth and a recording have no time in common."""
    if not len(run.ros_ns):
        return
    spans = [(int(stamps[0]) / NS, int(stamps[-1]) / NS) for stamps in (truth.ros_ns, run.ros_ns)]
    (begin, end), (run_begin, run_end) = spans
    if end < run_begin or run_end < begin:
        raise TrajectoryFileError(
            f"the times of '{truth.source}', {begin:.3f} to {end:.3f} s, are not those of '{bag}', {run_begin:.3f} to "
            f"{run_end:.3f} s; expected ROS time"
        )
