"""Rows of ``ik_benchmark tracking``: one follower on one target with one arm; and the requirements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from benchmarks.stream_baselines import Proportional
from benchmarks.stream_data import Stream, first_seconds
from benchmarks.stream_metrics import (
    Smoothness,
    StreamMetrics,
    follow,
    reference_track,
    smoothness,
    stream_metrics,
)
from benchmarks.streams import GAIN, stream_ratings
from benchmarks.tracking_arm import ArmFollower, ArmVariant, BaselineController, JointController, NodeController
from ik_node.interfaces.clock import Stamped
from ik_node.interfaces.samples import PathSample, TrajectorySample
from ik_node.math.types import Array
from ik_node.report.lateness import LateStepMetrics, LateTargetMetrics
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings, TargetSettings

LENGTH_M = 0.3
"""Length that makes orientation errors comparable with position errors."""
NODE, BASELINE_P = "ik_node", f"P, {GAIN:g} 1/s"
LEAST_PART, MOST_PART = 0.02, 1.5
"""Range of the search for the best gain, as a fraction of the error per period; 2 is unstable on any arm."""
NO_LIMIT = 100.0
"""Acceleration limit that no arm reaches, rad/s2."""
STILL = 1e-6
"""Change of the rotation matrix below which the orientation is constant and has no lag."""
SEARCHED_S = 15.0


class LateInputs(NamedTuple):
    """What came late in a run of the node."""

    targets: int
    late_targets: LateTargetMetrics
    late_steps: LateStepMetrics

    def line(self) -> str:
        """Return a line of the table."""
        age, state, steps = self.late_targets.age, self.late_steps.state_age, self.late_steps
        return (
            f"{self.targets} targets, {self.late_targets.late} late, {self.late_targets.lost} lost; age of the target "
            f"{age.median_ms:.0f}, {age.p95_ms:.0f}, {age.max_ms:.0f} ms, of the joint state {state.median_ms:.1f}, "
            f"{state.p95_ms:.1f}, {state.max_ms:.0f} ms (median, p95, max); {steps.late} steps late, "
            f"{steps.by_machine} by this machine; {steps.held_too_long} commands held too long; "
            f"{steps.hold_ups} hold-ups, {steps.hold_ups_s:.2f} s, max {steps.hold_up_max_ms:.0f} ms"
        )


class FollowerResult(NamedTuple):
    """Figures of one follower."""

    name: str
    linear: StreamMetrics
    angular: StreamMetrics
    joints: Smoothness
    search: tuple[tuple[float, float], ...] = ()
    """Gains of the search with their scores; see :func:`score`."""
    slowed_s: float = 0.0
    """Time with s < 1."""
    stopped_s: float = 0.0
    """Time without control, because the arm was diagnosed as not following."""
    late: LateInputs | None = None
    """Of runs of the node over DDS."""

    def line(self) -> str:
        """Return a line of the table."""
        errors = " | ".join(
            f"{f.rms:9.3g}{f.max:9.3g}{f.lag_ms:5.0f}{f.after_lag:9.3g}" for f in (self.linear, self.angular)
        )
        slowed = f" | s < 1 for {self.slowed_s:.2f} s" if self.slowed_s else ""
        slowed += f" | STOPPED for {self.stopped_s:.2f} s" if self.stopped_s else ""
        return f"{self.name:<26}{errors} | " + "".join(f"{value:9.3g}" for value in self.joints) + slowed


def score(row: FollowerResult) -> float:
    """Return RMS position error plus LENGTH_M times RMS orientation error, mm; infinite when not finite."""
    value = row.linear.rms + LENGTH_M * row.angular.rms
    return value if np.isfinite(value) else np.inf


class Requirement(NamedTuple):
    """A figure with its bounds."""

    of: str
    what: str
    value: float
    most: float
    least: float = -np.inf

    @property
    def met(self) -> bool:
        """True when the figure is within its bounds; False for NaN."""
        return self.least <= self.value <= self.most

    def text(self) -> str:
        """Return one line of text."""
        bounds = f"{self.least:g} to {self.most:g}" if np.isfinite(self.least) else f"at most {self.most:g}"
        return f"{'met   ' if self.met else 'MISSED'} {self.what}: {self.value:.4g}, {bounds}"


class TrackingCase:
    """Runs followers on one target with one arm at one control rate."""

    def __init__(
        self,
        robot: Robot,
        start: Array,
        simulator: ArmVariant,
        stream: Stream,
        samples: Sequence[tuple[Stamped, Array]],
        settings: Settings,
    ) -> None:
        """``start`` (n,): joint positions at the first pose of the stream; ``settings``: those of the node."""
        self._robot, self._start, self._simulator = robot, start, simulator
        self._stream, self._samples, self._settings = stream, samples, settings
        self._rate_hz = rate_hz = settings.control.rate_hz
        self._known = reference_track(stream, int(stream.times_s[-1] * rate_hz), 1.0 / rate_hz)

    def row(self, name: str, leader: JointController) -> FollowerResult:
        """Run one controller."""
        follower = ArmFollower(self._robot, self._start, self._simulator, leader, self._rate_hz)
        track = follow(follower, self._stream, self._samples, 1.0 / self._rate_hz)
        linear, angular = stream_metrics(track, self._stream, self._known)
        return FollowerResult(name, linear, angular, smoothness(np.array(follower.velocities), 1.0 / self._rate_hz))

    def node(
        self,
        known: PathSample | TrajectorySample | None = None,
        name: str = NODE,
        values: Mapping[str, Any] = MappingProxyType({}),
    ) -> FollowerResult:
        """Run the node with its settings, the model of the arm, and other ``values`` by full name."""
        model = self._simulator.model(1.0 / self._rate_hz)
        model_values = {"arm_lag_s": model.lag_s, "arm_delay_s": model.delay_s, **values}
        leader = NodeController(self._robot, self._settings.with_values(model_values), known)
        row = self.row(name, leader)
        return row._replace(slowed_s=leader.slowed / self._rate_hz, stopped_s=leader.stopped / self._rate_hz)

    def uncompensated_node(self, known: PathSample | TrajectorySample | None = None) -> FollowerResult:
        """Run the node without a model of lag and delay."""
        return self.node(known, f"{NODE}, without lag model", {"arm_lag_s": 0.0, "arm_delay_s": 0.0})

    def unlimited_node(self) -> FollowerResult:
        """Run the node practically without acceleration limits, like the baselines."""
        return self.node(None, f"{NODE}, no acc. limit", {"limits.acceleration": (NO_LIMIT,)})

    def baselines(self, searched: bool = True) -> list[FollowerResult]:
        """Return P control at :data:`~benchmarks.streams.GAIN`, at its best gain, and the whole error clipped.

        Only the first unless ``searched``.
        """
        if not searched:
            return [self.row(BASELINE_P, BaselineController(self._robot, Proportional(GAIN)))]
        target = TargetSettings()
        speeds = target.max_speed
        return [
            self.row(BASELINE_P, BaselineController(self._robot, Proportional(GAIN))),
            self._search("P, {:.4g} 1/s", self._rate_hz, Proportional),
            self._search("{:.3g} of the error, clipped", 1.0, lambda part: Proportional(part * self._rate_hz, *speeds)),
        ]

    def _search(self, name: str, unit: float, make: Callable[[float], Proportional]) -> FollowerResult:
        """Search the best gain on the first SEARCHED_S of the target: by factors of 2, then of 2^(1/4).

        ``unit`` is the gain that removes the whole error in one period.
        """
        short = self._shortened()

        def run(bench: TrackingCase, part: float) -> FollowerResult:
            return bench.row(name.format(part * unit), BaselineController(self._robot, make(part * unit)))

        def tried(part: float) -> tuple[float, FollowerResult]:
            return part, run(short, part)

        steps = int(np.log2(MOST_PART / LEAST_PART)) + 1
        coarse = [tried(LEAST_PART * 2.0**step) for step in range(steps)] + [tried(1.0)]
        best = min(coarse, key=lambda pair: score(pair[1]))[0]
        fine = [tried(min(best * 2.0 ** (step / 4.0), MOST_PART)) for step in (-3, -2, -1, 1, 2, 3)]
        found = dict(sorted(coarse + fine, key=lambda pair: pair[0]))
        best = min(found, key=lambda part: score(found[part]))
        search = tuple((part * unit, score(row)) for part, row in found.items())
        return (found[best] if short is self else run(self, best))._replace(search=search)

    def _shortened(self) -> TrackingCase:
        if self._stream.times_s[-1] <= SEARCHED_S:
            return self
        stream = first_seconds(self._stream, SEARCHED_S)
        return TrackingCase(self._robot, self._start, self._simulator, stream, self._samples, self._settings)


def known_requirements(
    of: str, simulator: ArmVariant, rate_hz: float, rows: Sequence[FollowerResult]
) -> list[Requirement]:
    """Return the requirements for a known target; the first row is the node, the last two are baselines."""
    ours, baselines = rows[0], rows[-2:]
    if not simulator.lag_s:
        if rate_hz != 500.0:
            return []
        return [
            Requirement(of, "RMS position error, um", 1e3 * ours.linear.rms, 0.1),
            Requirement(of, "RMS orientation error, urad", 1e3 * ours.angular.rms, 0.1),
        ]
    requirements = []
    for what, part in (("position", "linear"), ("orientation", "angular")):
        better = min(getattr(baseline, part).rms for baseline in baselines)
        name = f"{ours.name}: RMS {what} error relative to the better baseline"
        requirements.append(Requirement(of, name, getattr(ours, part).rms / better, 1.0 / 3.0))
    return requirements


def order_requirements(of: str, rates_hz: Sequence[float], rows: Sequence[FollowerResult]) -> list[Requirement]:
    """Require an error of second order in the control period; each of ``rates_hz`` is twice the previous one."""
    requirements = []
    for rate_hz, before, after in zip(rates_hz, rows, rows[1:], strict=False):
        for what, part in (("position", "linear"), ("orientation", "angular")):
            ratio = getattr(before, part).rms / getattr(after, part).rms
            name = f"RMS {what} error, {rate_hz:g} Hz over {2.0 * rate_hz:g} Hz"
            requirements.append(Requirement(of, name, ratio, 4.6, 3.4))
    return requirements


def stream_requirements(of: str, stream: Stream, ours: FollowerResult, baseline: FollowerResult) -> list[Requirement]:
    """Return the requirements for streams at 20 to 33 Hz; ``baseline`` is P control at its usual gain."""
    period_s = float(np.median(np.diff(stream.times_s)))
    ratings = stream_ratings((ours.linear, ours.angular), (baseline.linear, baseline.angular), period_s)
    smoother = baseline.joints.acceleration_peak / ours.joints.acceleration_peak
    requirements = [
        ("position lag, ms", ours.linear.lag_ms, max(30.0, 1e3 * period_s), -np.inf),
        ("position error without lag relative to P", ratings.position_after_lag, 1.0, -np.inf),
        ("peak acceleration of P per control step, relative", smoother, np.inf, 5.0),
    ]
    if np.ptp(stream.poses[:, :3, :3], axis=0).max() > STILL:
        requirements += [
            ("rotation lag, ms", ours.angular.lag_ms, 1.5e3 * period_s, -np.inf),
            ("orientation error without lag relative to P", ratings.rotation_after_lag, 1.0, -np.inf),
        ]
    return [Requirement(of, f"{ours.name}: {what}", value, most, least) for what, value, most, least in requirements]
