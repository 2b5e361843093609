"""The rows of ``ik_benchmark tracking``: each follower on one target with one arm, and what is demanded of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from benchmarks.stream_baselines import Proportional
from benchmarks.streams import (
    GAIN,
    Figures,
    Smoothness,
    Stream,
    figures,
    first_seconds,
    follow,
    smoothness,
    verdict,
    yardstick,
)
from benchmarks.tracking_arm import ArmFollower, Leader, Node, Rival, Simulator
from ik_node.interfaces.clock import Stamped
from ik_node.interfaces.samples import PathSample, TrajectorySample
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings, TargetSettings

LENGTH_M = 0.3
"""Makes orientation errors comparable with position errors."""
NODE, SLOW_P = "ik_node", f"P, {GAIN:g} 1/s"
LEAST_PART, MOST_PART = 0.02, 1.5
"""Of the error per period, between which the best gain is looked for; 2 is unstable on any arm."""
NO_LIMIT = 100.0
"""rad/s2: no arm can do it."""
STILL = 1e-6
"""An orientation whose matrix changes by less than this has no lag."""
SEARCHED_S = 15.0


class Row(NamedTuple):
    """One follower's figures."""

    name: str
    linear: Figures
    angular: Figures
    joints: Smoothness
    search: tuple[tuple[float, float], ...] = ()
    """Gains tried, with the score of each; see :func:`score`."""
    slowed_s: float = 0.0
    """Time in which limits or a singularity took a part of the twist."""
    stopped_s: float = 0.0
    """Time in which no control law was at work: the arm was taken for one that does not follow."""

    def line(self) -> str:
        """For the table."""
        errors = " | ".join(
            f"{f.rms:9.3g}{f.max:9.3g}{f.lag_ms:5.0f}{f.after_lag:9.3g}" for f in (self.linear, self.angular)
        )
        slowed = f" | s < 1 for {self.slowed_s:.2f} s" if self.slowed_s else ""
        slowed += f" | STOPPED for {self.stopped_s:.2f} s" if self.stopped_s else ""
        return f"{self.name:<26}{errors} | " + "".join(f"{value:9.3g}" for value in self.joints) + slowed


def score(row: Row) -> float:
    """RMS position error plus LENGTH_M times the RMS orientation error, mm; infinite where a figure is not finite."""
    value = row.linear.rms + LENGTH_M * row.angular.rms
    return value if np.isfinite(value) else np.inf


class Demand(NamedTuple):
    """A figure and the most that it may be."""

    of: str
    what: str
    value: float
    most: float
    least: float = -np.inf

    @property
    def met(self) -> bool:
        """False where the figure is not a number."""
        return self.least <= self.value <= self.most

    def text(self) -> str:
        """One line."""
        bounds = f"{self.least:g} to {self.most:g}" if np.isfinite(self.least) else f"at most {self.most:g}"
        return f"{'met   ' if self.met else 'MISSED'} {self.what}: {self.value:.4g}, {bounds}"


class Bench:
    """One target, one arm, one control rate."""

    def __init__(
        self,
        robot: Robot,
        start: Array,
        simulator: Simulator,
        stream: Stream,
        samples: Sequence[tuple[Stamped, Array]],
        settings: Settings,
    ) -> None:
        """``start`` (n,): joint positions at rest at the stream's first pose; ``settings``: the node's."""
        self._robot, self._start, self._simulator = robot, start, simulator
        self._stream, self._samples, self._settings = stream, samples, settings
        self._rate_hz = rate_hz = settings.control.rate_hz
        self._known = yardstick(stream, int(stream.times_s[-1] * rate_hz), 1.0 / rate_hz)

    def row(self, name: str, leader: Leader) -> Row:
        """One run."""
        follower = ArmFollower(self._robot, self._start, self._simulator, leader, self._rate_hz)
        track = follow(follower, self._stream, self._samples, 1.0 / self._rate_hz)
        linear, angular = figures(track, self._stream, self._known)
        return Row(name, linear, angular, smoothness(np.array(follower.velocities), 1.0 / self._rate_hz))

    def node(
        self,
        known: PathSample | TrajectorySample | None = None,
        name: str = NODE,
        values: Mapping[str, Any] = MappingProxyType({}),
    ) -> Row:
        """The node with its settings and those that describe the arm, but for ``values`` by full name."""
        model = self._simulator.model(1.0 / self._rate_hz)
        told = {"arm_lag_s": model.lag_s, "arm_delay_s": model.delay_s, **values}
        leader = Node(self._robot, self._settings.with_values(told), known)
        row = self.row(name, leader)
        return row._replace(slowed_s=leader.slowed / self._rate_hz, stopped_s=leader.stopped / self._rate_hz)

    def untold_node(self, known: PathSample | TrajectorySample | None = None) -> Row:
        """The node as if the arm obeyed at once."""
        return self.node(known, f"{NODE}, not told of the lag", {"arm_lag_s": 0.0, "arm_delay_s": 0.0})

    def unlimited_node(self) -> Row:
        """The node without acceleration limits to speak of, as the rivals are."""
        return self.node(None, f"{NODE}, no acc. limit", {"limits.acceleration": (NO_LIMIT,)})

    def rivals(self) -> list[Row]:
        """P control at :data:`~benchmarks.streams.GAIN`, at its best gain, and the whole error clipped."""
        target = TargetSettings()
        speeds = target.max_linear_speed, target.max_angular_speed
        return [
            self.row(SLOW_P, Rival(self._robot, Proportional(GAIN))),
            self._search("P, {:.4g} 1/s", self._rate_hz, Proportional),
            self._search("{:.3g} of the error, clipped", 1.0, lambda part: Proportional(part * self._rate_hz, *speeds)),
        ]

    def _search(self, name: str, unit: float, make: Callable[[float], Proportional]) -> Row:
        """The best gain, written in ``unit`` per part of the error per period: by factors of 2, then of 2^(1/4).

        It is looked for on the first SEARCHED_S of the target.
        """
        short = self._shortened()

        def run(bench: Bench, part: float) -> Row:
            return bench.row(name.format(part * unit), Rival(self._robot, make(part * unit)))

        def tried(part: float) -> tuple[float, Row]:
            return part, run(short, part)

        steps = int(np.log2(MOST_PART / LEAST_PART)) + 1
        coarse = [tried(LEAST_PART * 2.0**step) for step in range(steps)] + [tried(1.0)]
        best = min(coarse, key=lambda pair: score(pair[1]))[0]
        fine = [tried(min(best * 2.0 ** (step / 4.0), MOST_PART)) for step in (-3, -2, -1, 1, 2, 3)]
        found = dict(sorted(coarse + fine, key=lambda pair: pair[0]))
        best = min(found, key=lambda part: score(found[part]))
        search = tuple((part * unit, score(row)) for part, row in found.items())
        return (found[best] if short is self else run(self, best))._replace(search=search)

    def _shortened(self) -> Bench:
        if self._stream.times_s[-1] <= SEARCHED_S:
            return self
        stream = first_seconds(self._stream, SEARCHED_S)
        return Bench(self._robot, self._start, self._simulator, stream, self._samples, self._settings)


def known_demands(of: str, simulator: Simulator, rate_hz: float, rows: Sequence[Row]) -> list[Demand]:
    """Of a target that is known as a whole. ``rows`` begins with the node's and ends with the rivals'."""
    ours, rivals = rows[0], rows[-2:]
    if not simulator.lag_s:
        if rate_hz != 500.0:
            return []
        return [
            Demand(of, "RMS position error, um", 1e3 * ours.linear.rms, 0.1),
            Demand(of, "RMS orientation error, urad", 1e3 * ours.angular.rms, 0.1),
        ]
    demands = []
    for what, part in (("position", "linear"), ("orientation", "angular")):
        better = min(getattr(rival, part).rms for rival in rivals)
        name = f"{ours.name}: RMS {what} error as part of the better rival's"
        demands.append(Demand(of, name, getattr(ours, part).rms / better, 1.0 / 3.0))
    return demands


def order_demand(of: str, rates_hz: Sequence[float], rows: Sequence[Row]) -> list[Demand]:
    """That the error falls with the square of the tick; ``rows``: the node's at ``rates_hz``, each twice the last."""
    demands = []
    for rate_hz, before, after in zip(rates_hz, rows, rows[1:], strict=False):
        for what, part in (("position", "linear"), ("orientation", "angular")):
            ratio = getattr(before, part).rms / getattr(after, part).rms
            name = f"RMS {what} error, {rate_hz:g} Hz over {2.0 * rate_hz:g} Hz"
            demands.append(Demand(of, name, ratio, 4.6, 3.4))
    return demands


def stream_demands(of: str, stream: Stream, ours: Row, rival: Row) -> list[Demand]:
    """Of streams at 20 to 33 Hz; ``rival``: P control at its usual gain."""
    period_s = float(np.median(np.diff(stream.times_s)))
    judged = verdict((ours.linear, ours.angular), (rival.linear, rival.angular), period_s)
    smoother = rival.joints.acceleration_peak / ours.joints.acceleration_peak
    demands = [
        ("position lag, ms", ours.linear.lag_ms, max(30.0, 1e3 * period_s), -np.inf),
        ("position error after lag as part of P's", judged.position_after_lag, 1.0, -np.inf),
        ("peak acceleration per tick below P's, times", smoother, np.inf, 5.0),
    ]
    if np.ptp(stream.poses[:, :3, :3], axis=0).max() > STILL:
        demands += [
            ("rotation lag, ms", ours.angular.lag_ms, 1.5e3 * period_s, -np.inf),
            ("orientation error after lag as part of P's", judged.rotation_after_lag, 1.0, -np.inf),
        ]
    return [Demand(of, f"{ours.name}: {what}", value, most, least) for what, value, most, least in demands]
