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
from typing import NamedTuple

from benchmarks.stream_baselines import Follower, LastSlope, Proportional
from benchmarks.stream_data import Stream, StreamNoise, held_out, transported
from benchmarks.stream_filters import AlphaBeta, KalmanAcceleration, OneEuro
from benchmarks.stream_metrics import TICK_S, StreamMetrics, follow, reference_track, stream_metrics
from benchmarks.stream_ruckig import TimeOptimal
from ik_node.settings.groups import TargetSettings
from ik_node.targets.stream.stream import StreamedPoses

NODE = "ik_node"
EQUAL = 1.1
"""Largest ratio of the node's error to that of a rival at equal acceleration."""
STILL = 1e-6
"""Acceleration of all followers below which a stream has no such motion."""
HALVES = ("position", "orientation")


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
        error, family, _ = self.best_rival
        return (self.node.after_lag / error, family) if error < inf else (0.0, "none")

    @property
    def best_rival(self) -> tuple[float, str, float]:
        """Smallest error of a rival at the acceleration of the node, its family and its lag in ms; infinite if none."""
        found = [(*self._at(family, self.node.acceleration), family) for family in self.families]
        error, lag_ms, family = min(found, default=(inf, inf, "none"))
        return error, family, lag_ms

    @property
    def met(self) -> bool:
        """True if no rival is better in all three, nor by more than a tenth at equal acceleration."""
        return not self.dominated_by and self.ratio[0] <= EQUAL

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families of rivals."""
        return tuple(dict.fromkeys(rival.family for rival in self.rivals))

    def _at(self, family: str, acceleration: float) -> tuple[float, float]:
        """Smallest error of a family at an acceleration, and the lag there, in ms; infinite outside its range."""
        points = [rival for rival in self.rivals if rival.family == family]
        best = (inf, inf)
        for first, second in pairwise(points):
            low, high = sorted((first, second), key=lambda point: point.acceleration)
            if 0.0 < low.acceleration <= acceleration <= high.acceleration and low.acceleration < high.acceleration:
                part = log(acceleration / low.acceleration) / log(high.acceleration / low.acceleration)
                error = exp((1.0 - part) * log(low.after_lag) + part * log(high.after_lag))
                best = min(best, (error, (1.0 - part) * low.lag_ms + part * high.lag_ms))
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
