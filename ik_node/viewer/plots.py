"""The plots beside the scene, each with a needle at the moment that is shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.viewer import decimation
from ik_node.viewer.timeline import Film

INK = "#222222"
NEEDLE = "#d55e00"
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#7a6f00", "#555555")
HEIGHT_PX = 92
AXIS_PX = 46


class Plot(NamedTuple):
    """One plot."""

    title: str
    labels: tuple[str, ...]
    """Of the lines."""
    columns: Callable[[Film], Array]
    """(k, lines)."""
    span: tuple[float | None, float | None] | None = None
    """Of the vertical axis; None: as the lines need it."""
    height_px: int = HEIGHT_PX


def plots_for(joints: tuple[str, ...], velocity_limits: Array, with_clearance: bool) -> tuple[Plot, ...]:
    """The plots of an arm. ``velocity_limits`` (n,): rad/s (m/s), infinite where there is none."""
    limits = np.where(np.isfinite(velocity_limits) & (velocity_limits > 0.0), velocity_limits, np.nan)
    plots = [
        Plot("Position error [mm]", ("error",), lambda film: 1e3 * film.position_error()[:, None], (0.0, None)),
        Plot(
            "Joint velocity as part of its limit",
            _short(joints),
            lambda film: film.joint_velocity / limits,
            height_px=HEIGHT_PX + 40,
        ),
        Plot("Least singular value [m]", ("sigma_min",), lambda film: film.sigma_min[:, None], (0.0, None)),
        Plot("Scale s", ("s",), lambda film: film.scale[:, None], (0.0, 1.1)),
    ]
    if with_clearance:
        plots.append(Plot("Clearance [mm]", ("clearance",), lambda film: 1e3 * film.clearance[:, None]))
    return tuple(plots)


def _short(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Names without what all of them begin with, numbers kept whole."""
    shared = 0
    while len(joints) > 1 and all(len(j) > shared and j[shared] == joints[0][shared] for j in joints):
        shared += 1
    while shared and joints[0][shared - 1].isdigit():
        shared -= 1
    kept = tuple(joint[shared:] for joint in joints)
    return tuple(f"joint {name}" if name.isdigit() else name for name in kept) if all(kept) else joints


class Plots:
    """Draws films into uPlot charts."""

    def __init__(self, server: Any, plots: tuple[Plot, ...]) -> None:
        """Adds the charts to the GUI container that is open."""
        self._plots = plots
        nothing = (np.array([0.0, 1.0]),)
        self._handles = [
            server.gui.add_uplot(
                data=nothing + tuple(np.zeros(2) for _ in range(len(plot.labels) + 1)),
                series=_series(plot),
                title=plot.title,
                scales={
                    "x": {"time": False},
                    "now": {"range": (0.01, 1.0)},
                    **({"y": {"range": plot.span}} if plot.span else {}),
                },
                axes=(
                    {"size": 24 if len(plot.labels) == 1 else 38, "font": "10px sans-serif"},
                    {"size": AXIS_PX, "font": "10px sans-serif"},
                ),
                legend={"show": len(plot.labels) > 1, "live": False},
                cursor={"sync": {"key": "time"}},
                height=plot.height_px,
                padding=(0, 10, 0, 0),
            )
            for plot in plots
        ]
        self._drawn: tuple[Film, float, float] | None = None
        self._lines: list[tuple[Array, Array]] = []

    def draw(self, film: Film, begin_s: float, end_s: float, now_s: float) -> None:
        """The part of ``film`` between two times, with the needle at ``now_s``."""
        if len(film.times_s) < 2:
            return
        if self._drawn is None or self._drawn[0] is not film or self._drawn[1:] != (begin_s, end_s):
            self._lines = self._thinned(film, begin_s, end_s)
            self._drawn = (film, begin_s, end_s)
        for handle, (times, values) in zip(self._handles, self._lines, strict=True):
            if len(times) > 1:
                needle = np.zeros(len(times))
                needle[int(np.abs(times - now_s).argmin())] = 1.0
                handle.data = (times, *values.T, needle)

    def _thinned(self, film: Film, begin_s: float, end_s: float) -> list[tuple[Array, Array]]:
        first, last = film.row(begin_s), int(np.searchsorted(film.times_s, end_s, side="right"))
        part = film.part(first, last)
        return [_contiguous(*decimation.thin(part.times_s, plot.columns(part))) for plot in self._plots]


def _contiguous(times: Array, values: Array) -> tuple[Array, Array]:
    return np.ascontiguousarray(times), np.asfortranarray(values)


def _series(plot: Plot) -> tuple[dict[str, Any], ...]:
    lines = [
        {"label": label, "stroke": COLOURS[index % len(COLOURS)], "width": 1.2, "points": {"show": False}}
        for index, label in enumerate(plot.labels)
    ]
    needle = {"label": "now", "stroke": NEEDLE, "width": 1.0, "scale": "now", "points": {"show": False}}
    return ({"label": "t [s]"}, *lines, needle)
