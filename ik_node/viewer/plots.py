"""The plots beside the scene, each with a cursor at the displayed time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.report import quantities
from ik_node.viewer import decimation
from ik_node.viewer.timeline import Timeline

CURSOR_COLOUR = "#222222"
LINE_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#7a6f00", "#555555")
HEIGHT_PX = 92
LEGEND_PX = 40
AXIS_PX = 46
TOP_PX = 8
"""Above the plots, so that the highest tick label is not cut."""
TICK_SPACE_PX = 18
"""Minimum distance of the ticks of the vertical axis."""


FROM_ZERO = (0.0, None)
"""Range of a quantity that is never negative."""


class PlotSpec(NamedTuple):
    """Content of one plot."""

    title: str
    labels: tuple[str, ...]
    """Of the lines."""
    columns: Callable[[Timeline], Array]
    """Values, (k, lines)."""
    span: tuple[float | None, float | None] | None = None
    """Range of the vertical axis; None: automatic."""
    height_px: int = HEIGHT_PX
    hides_empty: bool = False
    """Whether the plot is hidden while it has no value."""


def plots_for(
    joints: tuple[str, ...],
    velocity_limits: Array,
    with_clearance: bool,
    to_trajectory: Callable[[Array], Array] | None = None,
) -> tuple[PlotSpec, ...]:
    """The plots of an arm.

    Args:
        joints: Joint names.
        velocity_limits: (n,), rad/s (m/s); infinite for none.
        with_clearance: Whether the clearance is computed.
        to_trajectory: Times (k,), s -> distance of the tool from the trajectory, (k,), m; None when it is not known.
    """
    limits = np.where(np.isfinite(velocity_limits) & (velocity_limits > 0.0), velocity_limits, np.nan)

    def plot(
        quantity: quantities.DisplayedQuantity,
        label: str,
        values: Callable[[Timeline], Array],
        span: tuple[float | None, float | None] | None = None,
    ) -> PlotSpec:
        return PlotSpec(quantity.title, (label,), lambda timeline: quantity.scaled(values(timeline))[:, None], span)

    plots = [
        _position_error(to_trajectory),
        PlotSpec(
            quantities.JOINT_SPEED.title,
            _short_names(joints),
            lambda timeline: quantities.JOINT_SPEED.scaled(timeline.joint_velocity / limits),
            height_px=HEIGHT_PX + 40,
        ),
        plot(quantities.SMALLEST_SINGULAR_VALUE, "sigma_min", lambda timeline: timeline.sigma_min, FROM_ZERO),
        plot(quantities.SCALE, "s", lambda timeline: timeline.scale, (0.0, 1.1)),
    ]
    plots.append(
        plot(
            quantities.OFF_DIRECTION_LINEAR,
            "off the direction",
            lambda timeline: np.linalg.norm(timeline.off_direction_b[:, :3], axis=1),
            FROM_ZERO,
        )
    )
    if with_clearance:
        plots.append(plot(quantities.CLEARANCE, "clearance", lambda timeline: timeline.clearance))
    return tuple(plots)


def _position_error(to_trajectory: Callable[[Array], Array] | None) -> PlotSpec:
    """The tool against the reference, and against the trajectory where that is known."""
    quantity = quantities.TOOL_POSITION_ERROR

    def to_reference(timeline: Timeline) -> Array:
        result: Array = quantity.scaled(timeline.position_error)[:, None]
        return result

    if to_trajectory is None:
        return PlotSpec(quantity.title, (quantities.TOOL_TO_REFERENCE,), to_reference, FROM_ZERO)

    def both(timeline: Timeline) -> Array:
        trajectory = quantity.scaled(to_trajectory(timeline.times_s))[:, None]
        return np.hstack((trajectory, to_reference(timeline)))

    labels = (quantities.TOOL_TO_TRAJECTORY, quantities.TOOL_TO_REFERENCE)
    return PlotSpec(f"Position error [{quantity.unit}]", labels, both, FROM_ZERO, HEIGHT_PX + LEGEND_PX)


def _short_names(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Names without their common prefix; numbers are kept whole."""
    shared = 0
    while len(joints) > 1 and all(len(j) > shared and j[shared] == joints[0][shared] for j in joints):
        shared += 1
    while shared and joints[0][shared - 1].isdigit():
        shared -= 1
    kept = tuple(joint[shared:] for joint in joints)
    return tuple(f"joint {name}" if name.isdigit() else name for name in kept) if all(kept) else joints


class PlotPanel:
    """Draws timelines into uPlot charts."""

    def __init__(self, server: Any, plots: tuple[PlotSpec, ...]) -> None:
        """Adds the charts to the current GUI container."""
        self._plots = plots
        empty = (np.array([0.0, 1.0]),)
        self._handles = [
            server.gui.add_uplot(
                data=empty + tuple(np.zeros(2) for _ in range(len(plot.labels) + 1)),
                series=_series(plot),
                title=plot.title,
                scales=scales_of(plot, np.zeros((2, len(plot.labels)))),
                axes=(
                    {"size": 24 if len(plot.labels) == 1 else 38, "font": "10px sans-serif"},
                    {"size": AXIS_PX, "font": "10px sans-serif", "space": TICK_SPACE_PX},
                ),
                legend={"show": len(plot.labels) > 1, "live": False},
                cursor={"sync": {"key": "time"}},
                height=plot.height_px,
                padding=(TOP_PX, 10, 0, 0),
            )
            for plot in plots
        ]
        self._drawn: tuple[Timeline, float, float] | None = None
        self._lines: list[tuple[Array, Array]] = []

    def draw(self, timeline: Timeline, begin_s: float, end_s: float, now_s: float) -> None:
        """Draws ``timeline`` between two times, with the cursor at ``now_s``."""
        if len(timeline.times_s) < 2:
            return
        if self._drawn is None or self._drawn[0] is not timeline or self._drawn[1:] != (begin_s, end_s):
            self._lines = self._decimated(timeline, begin_s, end_s)
            self._drawn = (timeline, begin_s, end_s)
            self._update_scales()
        for plot, handle, (times, values) in zip(self._plots, self._handles, self._lines, strict=True):
            if plot.hides_empty:
                handle.visible = bool(np.isfinite(values).any())
            if len(times) > 1:
                cursor = np.zeros(len(times))
                cursor[int(np.abs(times - now_s).argmin())] = 1.0
                handle.data = (times, *values.T, cursor)

    def _update_scales(self) -> None:
        for plot, handle, (_, values) in zip(self._plots, self._handles, self._lines, strict=True):
            scales = scales_of(plot, values)
            if scales != handle.scales:  # the chart is made anew
                handle.scales = scales

    def _decimated(self, timeline: Timeline, begin_s: float, end_s: float) -> list[tuple[Array, Array]]:
        first, last = timeline.row(begin_s), int(np.searchsorted(timeline.times_s, end_s, side="right"))
        shown = timeline.section(first, last)
        return [_contiguous(*decimation.decimate(shown.times_s, plot.columns(shown))) for plot in self._plots]


def scales_of(plot: PlotSpec, values: Array) -> dict[str, Any]:
    """Scales of a chart, with a range of the vertical axis where uPlot would not find one that shows the values.

    uPlot draws 0 to 100 for a quantity that is zero everywhere, and nothing when the first value of a line is NaN.

    Args:
        plot: The plot.
        values: Its values, (k, lines); NaN where they are not known.
    """
    scales: dict[str, Any] = {"x": {"time": False}, "now": {"range": (0.01, 1.0)}}
    span = plot.span
    finite = values[np.isfinite(values)]
    if span in (None, FROM_ZERO):
        if not finite.size or (span == FROM_ZERO and not (finite > 0.0).any()):
            span = (0.0, 1.0)
        elif not np.isfinite(values[0]).all():
            low, high = (0.0 if span == FROM_ZERO else float(finite.min())), float(finite.max())
            # In steps, so that the range of a live plot seldom changes.
            step = 10.0 ** np.floor(np.log10(max(high - low, 1e-3 * abs(high), 1e-9)))
            span = (float(step * np.floor(low / step)), float(step * (np.floor(high / step) + 1.0)))
    return {**scales, "y": {"range": span}} if span else scales


def _contiguous(times: Array, values: Array) -> tuple[Array, Array]:
    return np.ascontiguousarray(times), np.asfortranarray(values)


def _series(plot: PlotSpec) -> tuple[dict[str, Any], ...]:
    lines = [
        {"label": label, "stroke": LINE_COLOURS[index % len(LINE_COLOURS)], "width": 1.2, "points": {"show": False}}
        for index, label in enumerate(plot.labels)
    ]
    cursor = {"label": "now", "stroke": CURSOR_COLOUR, "width": 1.0, "scale": "now", "points": {"show": False}}
    return ({"label": "t [s]"}, *lines, cursor)
