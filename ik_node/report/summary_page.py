"""One run on one page: path, metrics, errors, joint velocities, singular values, scale, clearance and states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ik_node.recording.run import Run
from ik_node.report import quantities
from ik_node.report.canvas import convert_write_errors, new_figure, report_style
from ik_node.report.curves import draw_clearance, draw_joint_velocity, draw_tracking_error
from ik_node.report.metrics import RunMetrics
from ik_node.report.path_plot import draw_obstacles, draw_path
from ik_node.report.reported_run import ReportedRun, report_run, time_label
from ik_node.report.style import DPI, TEXT_COLOUR, VERMILION, decimate
from ik_node.report.text import as_text, title
from ik_node.report.timeline import draw_mode_bars

LEFT_LINES = 51.0
"""Lines of text that the left half has room for."""
SHORTEST_PATH_LINES = 17.0
"""Of these at least left for the path."""


def save_summary(run: Run, metrics: RunMetrics, path: str | Path) -> None:
    """Writes the summary page of one run.

    Args:
        run: The recorded run.
        metrics: Its metrics.
        path: The file; its suffix (png, svg, pdf) selects the format.

    Raises:
        MissingPackageError: matplotlib is not installed.
        RecordingError: The file cannot be written.
    """
    with report_style():
        figure = draw_summary(report_run(run, metrics))
        with convert_write_errors():
            figure.savefig(Path(path), dpi=DPI)


def draw_summary(reported: ReportedRun) -> Any:
    """Draws the page; call it within :func:`~ik_node.report.canvas.report_style`."""
    run, metrics = reported.run, reported.metrics
    figure = new_figure(9.2)
    figure.suptitle(title(metrics), x=0.03, y=0.975, ha="left", fontsize=15, fontweight="bold")
    outer = figure.add_gridspec(
        1, 2, width_ratios=(0.82, 1.0), left=0.03, right=0.975, top=0.915, bottom=0.06, wspace=0.12
    )
    text = "\n".join(as_text(metrics).splitlines()[1:])
    lines = 1.0 + text.count("\n")
    left = outer[0].subgridspec(2, 1, height_ratios=(max(LEFT_LINES - lines, SHORTEST_PATH_LINES), lines), hspace=0.02)
    joints = len(run.joints)
    right = outer[1].subgridspec(6, 1, height_ratios=(0.9, 0.9, 0.34 * joints, 0.8, 0.6, 0.28), hspace=0.36)
    if metrics.series is not None:
        axes = figure.add_subplot(left[0], projection="3d")
        draw_path(figure, axes, metrics.series)
        draw_obstacles(axes, run)
    _draw_text(figure.add_subplot(left[1]), text)
    first = figure.add_subplot(right[0])
    draw_tracking_error(first, [reported], quantities.POSITION_ERROR)
    draw_tracking_error(figure.add_subplot(right[1], sharex=first), [reported], quantities.ORIENTATION_ERROR)
    rows = right[2].subgridspec(joints, 1, hspace=0.12)
    _draw_joint_velocities([figure.add_subplot(rows[index], sharex=first) for index in range(joints)], reported)
    _draw_singular_value_and_scale(figure.add_subplot(right[3], sharex=first), reported)
    draw_clearance(figure.add_subplot(right[4], sharex=first), [reported])
    modes = figure.add_subplot(right[5], sharex=first)
    draw_mode_bars(modes, [reported])
    modes.set_xlabel(time_label([reported]))
    for axes in figure.axes:
        if axes is not modes and axes.get_shared_x_axes().joined(axes, modes):
            axes.tick_params(labelbottom=False)
    if len(run.times_s):
        first.set_xlim(*reported.span_s)
    return figure


def _draw_text(axes: Any, text: str) -> None:
    """The metrics as text."""
    axes.axis("off")
    axes.text(0.0, 0.98, text, family="monospace", fontsize=7.6, va="top", linespacing=1.45, transform=axes.transAxes)


def _draw_joint_velocities(rows: list[Any], reported: ReportedRun) -> None:
    """Velocity commands of all joints, one plot each."""
    place: Any = {"xycoords": "axes fraction", "ha": "left", "va": "center"}
    for axes, joint in zip(rows, reported.run.joints, strict=True):
        (peak,) = draw_joint_velocity(axes, [reported], joint, fill=True)
        axes.set_yticks([0.0])
        axes.set_yticklabels([joint], fontsize=7.5)
        axes.annotate(peak, (1.005, 0.5), fontsize=8, color=TEXT_COLOUR, **place)
    rows[0].set_title("Joint velocity commands with their limits (shaded); right: peak in % of the limit")


def _draw_singular_value_and_scale(axes: Any, reported: ReportedRun) -> None:
    """The smallest singular value with the threshold of regulation, and the scale s on a second axis."""
    run, colour, quantity = reported.run, reported.colour, quantities.SMALLEST_SINGULAR_VALUE
    axes.plot(*decimate(reported.times_s, run.singular_values[:, -1]), color=colour)
    threshold = run.settings.get("singularity.threshold")
    if isinstance(threshold, float):
        axes.axhline(threshold, color=VERMILION, linewidth=1.0, linestyle="--")
        place: Any = {"xycoords": ("axes fraction", "data"), "va": "bottom"}
        axes.annotate("regulated below", (0.005, threshold), color=VERMILION, **place)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(quantity.unit, color=colour)
    scale = axes.twinx()
    scale.grid(visible=False)
    scale.plot(*decimate(reported.times_s, run.scale), color=TEXT_COLOUR, linewidth=1.0)
    scale.set_ylim(0.0, 1.08)
    scale.set_ylabel("s", rotation=0)
    axes.set_title("Smallest singular value of the Jacobian (blue) and task scale s (black)")
