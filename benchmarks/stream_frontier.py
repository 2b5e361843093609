"""The frontier of ``ik_benchmark streams --frontier``: lag, error after lag and acceleration of followers of streams.

A follower trades these three against each other; most have one parameter, which gives a curve. One follower dominates
another if it is better in all three. At equal acceleration, the error of a family is interpolated along its curve
(logarithmically); outside the range of its accelerations it has none. The acceleration is the RMS of the change of the
commanded velocity over 20 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise, product
from math import exp, inf, log
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.stream_baselines import Follower, LastSlope, Proportional
from benchmarks.stream_data import Stream, StreamNoise, held_out, transported
from benchmarks.stream_filters import AlphaBeta, KalmanAcceleration, OneEuro
from benchmarks.stream_metrics import TICK_S, StreamMetrics, follow, reference_track, stream_metrics
from benchmarks.stream_ruckig import TimeOptimal
from ik_node.report.canvas import convert_write_errors, new_figure, report_style
from ik_node.settings.groups import TargetSettings
from ik_node.targets.stream.stream import StreamedPoses

NODE = "ik_node"
EQUAL = 1.1
"""Largest ratio of the node's error to that of a rival at equal acceleration."""
STILL = 1e-6
"""Acceleration of all followers below which a stream has no such motion."""
HALVES = ("position", "orientation")
UNITS = (("mm", "m/s$^2$"), ("mrad", "rad/s$^2$"))


class Variant(NamedTuple):
    """A follower with one value of its parameter."""

    family: str
    parameter: float
    make: Callable[[], Follower]


def rivals() -> list[Variant]:
    """Return all rivals; those of a family in order of their parameter."""
    settings = TargetSettings()
    found = [Variant("P, 1/s", gain, partial(Proportional, gain)) for gain in (5.0, 10.0, 20.0, 30.0, 60.0)]
    found.append(Variant("whole error", 0.0, lambda: Proportional(1.0 / TICK_S, *settings.max_speed)))
    found += [Variant("one-euro, Hz", hz, partial(OneEuro, hz)) for hz in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)]
    found += [Variant("alpha-beta", a, partial(AlphaBeta, a)) for a in (0.15, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95)]
    found += [
        Variant("Kalman, 1/s", w, partial(KalmanAcceleration, w)) for w in (4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 100.0)
    ]
    found.append(Variant("last slope", 0.0, lambda: LastSlope(settings)))
    if TimeOptimal.available():
        found += [
            Variant("Ruckig", part, partial(TimeOptimal, settings, part))
            for part in (0.005, 0.02, 0.05, 0.15, 0.5, 1.0)
        ]
    return found


class FrontierPoint(NamedTuple):
    """Figures of one follower, for position or orientation."""

    family: str
    parameter: float
    lag_ms: float
    after_lag: float
    acceleration: float
    """RMS over 20 ms."""


class FrontierRow(NamedTuple):
    """The node and its rivals on one stream, for position or orientation."""

    stream: str
    noise: str
    half: str
    node: FrontierPoint
    rivals: tuple[FrontierPoint, ...]

    @property
    def dominated_by(self) -> tuple[str, ...]:
        """Rivals that are better in all three."""
        node = self.node
        return tuple(
            f"{r.family} {r.parameter:g}"
            for r in self.rivals
            if r.lag_ms < node.lag_ms and r.after_lag < node.after_lag and r.acceleration < node.acceleration
        )

    @property
    def ratio(self) -> tuple[float, str]:
        """Error of the node relative to the best family at equal acceleration, and that family; 0 without one."""
        errors = {family: self._error_at(family, self.node.acceleration) for family in self.families}
        best = min(errors, key=lambda family: errors[family])
        return (self.node.after_lag / errors[best], best) if errors[best] < inf else (0.0, "none")

    @property
    def met(self) -> bool:
        """True if no rival is better in all three, nor by more than a tenth at equal acceleration."""
        return not self.dominated_by and self.ratio[0] <= EQUAL

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families of rivals."""
        return tuple(dict.fromkeys(rival.family for rival in self.rivals))

    def _error_at(self, family: str, acceleration: float) -> float:
        points = [rival for rival in self.rivals if rival.family == family]
        best = inf
        for first, second in pairwise(points):
            low, high = sorted((first, second), key=lambda point: point.acceleration)
            if 0.0 < low.acceleration <= acceleration <= high.acceleration and low.acceleration < high.acceleration:
                part = log(acceleration / low.acceleration) / log(high.acceleration / low.acceleration)
                best = min(best, exp((1.0 - part) * log(low.after_lag) + part * log(high.after_lag)))
        return best


def frontier_rows(stream: Stream, noise: StreamNoise, seed: int, others: Sequence[Variant]) -> list[FrontierRow]:
    """Run the node and all rivals on a stream; a constant orientation gives no row."""
    settings = TargetSettings()
    samples = transported(stream, noise, seed)
    known = reference_track(stream, int(stream.times_s[-1] / TICK_S))

    def points(variant: Variant) -> tuple[FrontierPoint, ...]:
        both = stream_metrics(follow(variant.make(), stream, samples), stream, known)
        return tuple(_point(variant, metrics) for metrics in both)

    node = points(Variant(NODE, 0.0, lambda: StreamedPoses(settings)))
    found = [points(variant) for variant in others]
    return [
        FrontierRow(stream.name, noise.name, half, node[i], tuple(pair[i] for pair in found))
        for i, half in enumerate(HALVES)
        if max(pair[i].acceleration for pair in found) > STILL
    ]


def _point(variant: Variant, metrics: StreamMetrics) -> FrontierPoint:
    return FrontierPoint(
        variant.family, variant.parameter, metrics.lag_ms, metrics.after_lag, metrics.acceleration_20ms_rms
    )


def as_json(row: FrontierRow) -> Mapping[str, object]:
    """Return a row as plain values."""
    return {
        "stream": row.stream,
        "noise": row.noise,
        "held_out": held_out(row.stream),
        "half": row.half,
        "node": row.node._asdict(),
        "rivals": [rival._asdict() for rival in row.rivals],
        "dominated_by": row.dominated_by,
        "ratio": row.ratio[0],
        "ratio_to": row.ratio[1],
        "met": row.met,
    }


HEAD = """lag ms, RMS error after the lag, RMS acceleration over 20 ms of this node; ratio of its error to that of the
best rival at equal acceleration; rivals that are better in all three"""


def line(row: FrontierRow) -> str:
    """Return a line of the table."""
    node, (ratio, family) = row.node, row.ratio
    name = f"{row.stream}, {row.noise}, {row.half}"
    return (
        f"{'met   ' if row.met else 'MISSED'} {name:<56}{node.lag_ms:4.0f}{node.after_lag:9.3f}"
        f"{node.acceleration:9.3f}  x {ratio:.2f} {family}  {', '.join(row.dominated_by)}"
    )


def summary(rows: Sequence[FrontierRow]) -> list[str]:
    """Return the number of rows that meet each aim, for position and orientation, tuned on and held out."""
    lines = []
    for half, out in product(HALVES, (False, True)):
        own = [row for row in rows if row.half == half and held_out(row.stream) == out]
        if own:
            equal = sum(row.ratio[0] <= EQUAL for row in own)
            free = sum(not row.dominated_by for row in own)
            lines.append(
                f"{half}, {'held out' if out else 'tuned on'}: of {len(own)} rows, "
                f"no rival is better in all three in {free}, "
                f"nor by more than a tenth at equal acceleration in {equal}"
            )
    return lines


def draw(rows: Sequence[FrontierRow], path: Path) -> None:
    """Write the picture of the rows of one stream: error and lag over acceleration, by position and orientation.

    Raises:
        RecordingError: The file cannot be written.
        MissingPackageError: matplotlib is not installed.
    """
    with report_style(), convert_write_errors():
        figure = new_figure(3.2 * 2)
        axes = figure.subplots(2, len(rows), squeeze=False, sharex="col")
        for column, row in enumerate(rows):
            _draw_row(axes[0][column], axes[1][column], row)
        figure.suptitle(f"{rows[0].stream}, {rows[0].noise}")
        axes[0][0].legend(fontsize="x-small")
        figure.savefig(path)


def _draw_row(errors: Any, lags: Any, row: FrontierRow) -> None:
    error_unit, acceleration_unit = UNITS[HALVES.index(row.half)]
    for axes, value, label in (
        (errors, "after_lag", f"error after lag, {error_unit}"),
        (lags, "lag_ms", "lag, ms"),
    ):
        for family in row.families:
            points = [rival for rival in row.rivals if rival.family == family]
            axes.plot(
                [p.acceleration for p in points],
                [getattr(p, value) for p in points],
                ".-",
                label=family,
                linewidth=0.8,
            )
        axes.plot([row.node.acceleration], [getattr(row.node, value)], "k*", markersize=11, label=NODE)
        axes.set_xscale("log")
        axes.tick_params(axis="x", which="minor", labelbottom=False)
        axes.set_ylabel(label)
    errors.set_yscale("log")
    errors.set_title(row.half)
    lags.set_xlabel(f"RMS acceleration over 20 ms, {acceleration_unit}")
