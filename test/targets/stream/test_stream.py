"""Streamed poses as a smooth motion: exact for simple targets, bounded for any input.

The returned twist must equal the motion of the pose over the interval, so most properties are tested on both. The
references are closed forms of the targets; the bounds are checked on finite differences of the commanded twist.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ik_node.interfaces.clock import Stamped
from ik_node.math.se3 import exp, exp_rotation, inverse, log, log_rotation
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.stream.stream import StreamedPoses

SETTINGS = TargetSettings()
TICK_NS = 2_000_000
TICK_S = TICK_NS / 1e9


def ns(time_s: float) -> int:
    return round(time_s * 1e9)


def pose(position: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: tuple[float, float, float] = (0, 0, 0)) -> Array:
    result = np.eye(4)
    result[:3, :3] = exp_rotation(np.array(turn, dtype=float))
    result[:3, 3] = position
    return result


class Run:
    """Passes samples to the stream at each control step and collects the results."""

    def __init__(self, start: Array, settings: TargetSettings = SETTINGS) -> None:
        self.stream = StreamedPoses(settings)
        self.stream.start(start, 0)
        self.tick = 0
        self.times: list[float] = []
        self.poses: list[Array] = []
        self.twists: list[Array] = []

    def go(self, until_s: float, samples: list[tuple[Stamped, Array]]) -> Run:
        """Run with ``samples`` ordered by arrival."""
        waiting = [sample for sample in samples if sample[0].received_ns > (self.tick - 1) * TICK_NS]
        while self.tick * TICK_NS < ns(until_s):
            now = self.tick * TICK_NS
            while waiting and waiting[0][0].received_ns <= now:
                stamped, sample = waiting.pop(0)
                self.stream.add(sample, stamped)
            motion = self.stream.advance(now, TICK_S)
            self.times.append(now / 1e9)
            self.poses.append(motion.pose_sd)
            self.twists.append(motion.twist_d)
            self.tick += 1
        return self

    def twists_s(self) -> Array:
        """Velocity of the origin and angular velocity, both in {s}: the quantities that the bounds apply to."""
        return np.array(
            [
                np.concatenate((p[:3, :3] @ v[:3], p[:3, :3] @ v[3:]))
                for p, v in zip(self.poses, self.twists, strict=True)
            ]
        )


def clean(
    target: Callable[[float], Array], period_s: float, until_s: float, delay_s: float = 0.001
) -> list[tuple[Stamped, Array]]:
    times = np.arange(0.0, until_s, period_s)
    return [(Stamped(ns(t), ns(t + delay_s), 0), target(float(t))) for t in times]


def check_bounds(run: Run, settings: TargetSettings = SETTINGS, slack: float = 1.02) -> None:
    """Check finite differences of the twists. Twists are means over an interval, so their k-th differences are means
    too."""
    for half, speed, acceleration, jerk in (
        (slice(0, 3), settings.max_speed[0], settings.max_acceleration[0], settings.max_jerk[0]),
        (slice(3, 6), settings.max_speed[1], settings.max_acceleration[1], settings.max_jerk[1]),
    ):
        v = run.twists_s()[:, half]
        a = np.diff(v, axis=0) / TICK_S
        j = np.diff(a, axis=0) / TICK_S
        assert np.linalg.norm(v, axis=1).max() <= slack * speed
        assert np.linalg.norm(a, axis=1).max() <= slack * acceleration
        assert np.linalg.norm(j, axis=1).max() <= 1.1 * slack * jerk


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 500.0])
def test_a_screw_of_constant_velocity_is_followed_without_error(rate_hz: float) -> None:
    """Constant velocity in R^3 and constant angular velocity: estimator and reference are exact for it."""

    def target(t: float) -> Array:
        return pose((0.1 * t, -0.05 * t, 0.3), (0.3 * t, 0.2 * t, -0.1 * t))

    run = Run(target(0.0)).go(4.0, clean(target, 1.0 / rate_hz, 4.0))
    for t, pose_sd, twist_d in list(zip(run.times, run.poses, run.twists, strict=True))[-500:]:
        assert np.abs(log(inverse(target(t)) @ pose_sd)).max() < 1e-6
        expected = log(inverse(target(t)) @ target(t + TICK_S)) / TICK_S
        assert np.abs(twist_d - expected).max() < 1e-5


@pytest.mark.parametrize("late_s", [0.001, 0.007, 0.1])
def test_late_ticks_change_nothing(late_s: float) -> None:
    """A control step that is late, after newer samples have arrived, gives the same motion."""

    def target(t: float) -> Array:
        return pose((0.1 * t, 0.0, 0.0), (0.0, 0.0, 0.4 * t))

    run = Run(target(0.0)).go(1.0, clean(target, 0.002, 1.0))
    now = 1.0
    for stamped, sample in clean(target, 0.002, 1.5):
        if stamped.received_ns > ns(1.0):
            run.stream.add(sample, stamped)
        if stamped.received_ns >= ns(now + late_s):
            now = stamped.received_ns / 1e9
            motion = run.stream.advance(stamped.received_ns, TICK_S)
            assert np.abs(log(inverse(target(now)) @ motion.pose_sd)).max() < 1e-7


def figure_of_eight(t: float) -> Array:
    """0.3 m x 0.15 m in 10 s, with rotating tool; smooth start over the first second."""
    s = t - 0.5 if t > 1.0 else 2.5 * t**4 - 3.0 * t**5 + t**6
    w = 0.2 * np.pi * s
    return pose((0.4 + 0.15 * np.sin(w), 0.075 * np.sin(2 * w), 0.5), (0.4 * np.sin(w), 0.4 * np.sin(2 * w), 0.0))


@pytest.mark.parametrize(("rate_hz", "limit_mm", "limit_mrad"), [(50.0, 0.1, 0.4), (500.0, 0.03, 0.1)])
def test_a_clean_stream_is_followed_without_lag(rate_hz: float, limit_mm: float, limit_mrad: float) -> None:
    """Against the closed form at the same time, transport 0.3-3 ms: an error of 0.1 mm is 1 ms of lag here."""
    rng = np.random.default_rng(1)
    samples = [
        (Stamped(ns(t), ns(t + rng.uniform(0.0003, 0.003)), 0), figure_of_eight(float(t)))
        for t in np.arange(0.0, 6.0, 1.0 / rate_hz)
    ]
    samples.sort(key=lambda sample: sample[0].received_ns)
    run = Run(figure_of_eight(0.0)).go(6.0, samples)
    errors = [log(inverse(figure_of_eight(t)) @ p) for t, p in zip(run.times, run.poses, strict=True)]
    rms = np.sqrt(np.mean(np.square(errors), axis=0) @ np.kron(np.eye(2), np.ones((3, 1)))) * 1e3
    assert rms[0] < limit_mm
    assert rms[1] < limit_mrad


def test_the_twist_is_what_the_pose_does() -> None:
    """When the next step is on time, the pose has moved by exactly hold_s times the twist."""
    run = Run(figure_of_eight(0.0)).go(3.0, clean(figure_of_eight, 0.02, 3.0))
    for before, twist, after in zip(run.poses, run.twists, run.poses[1:], strict=False):
        np.testing.assert_allclose(before @ exp(twist * TICK_S), after, atol=1e-12)


def hostile(seed: int) -> list[tuple[Stamped, Array]]:
    """Jumps, noise, bursts, gaps, repeats, decreasing stamps: every disturbance that is not refused."""
    rng = np.random.default_rng(seed)
    samples = []
    t, position, turn = 0.0, np.zeros(3), np.zeros(3)
    velocity = np.zeros(6)
    while t < 4.0:
        t += float(rng.choice([1e-9, 0.001, 0.01, 0.02, 0.05, 0.3], p=[0.05, 0.25, 0.3, 0.2, 0.15, 0.05]))
        kind = rng.uniform()
        if kind < 0.1:
            position = rng.normal(size=3) * 0.4
        elif kind < 0.2:
            turn = rng.normal(size=3) * 2.0
        elif kind < 0.4:
            velocity = rng.normal(size=6) * rng.choice([0.0, 0.2, 3.0])
        position = position + velocity[:3] * 0.01
        turn = turn + velocity[3:] * 0.01
        stamp = t - float(rng.choice([0.0, 0.001, 0.03, 0.5]))
        samples.append(
            (Stamped(ns(stamp), ns(t), 0), pose((position[0], position[1], position[2]), (turn[0], turn[1], turn[2])))
        )
    return samples


@pytest.mark.parametrize("seed", range(6))
def test_speed_acceleration_and_jerk_are_bounded_whatever_comes(seed: int) -> None:
    """The bounds apply to the motion, not to the input."""
    run = Run(pose()).go(5.0, hostile(seed))
    assert np.isfinite(run.twists).all()
    check_bounds(run)


def test_tighter_bounds_are_kept_too() -> None:
    """Bounds come from the settings, not from the defaults."""
    tight = TargetSettings(max_speed=(0.2, 0.5), max_acceleration=(1.0, 2.0), max_jerk=(20.0, 40.0))
    check_bounds(Run(pose(), tight).go(4.0, hostile(11)), tight)


def test_the_same_input_gives_the_same_bits_and_a_snapshot_goes_on() -> None:
    """A replay restores the state in the middle of a run."""
    samples = hostile(3)
    whole, first = Run(pose()).go(4.0, samples), Run(pose()).go(2.0, samples)
    second = Run(pose())
    second.stream.restore(first.stream.capture())
    second.tick = first.tick
    second.go(4.0, samples)
    assert np.array_equal(np.array(whole.twists), np.array(first.twists + second.twists))
    assert np.array_equal(np.array(whole.poses), np.array(first.poses + second.poses))


def test_duplicates_and_old_samples_change_nothing() -> None:
    """Repeated and reordered messages are counted and have no other effect."""
    samples = clean(figure_of_eight, 0.02, 3.0)
    spoilt: list[tuple[Stamped, Array]] = []
    for index, (stamped, sample) in enumerate(samples):
        spoilt.append((stamped, sample))
        if index % 3 == 0:
            spoilt.append((stamped, sample))
        if index % 5 == 4:
            spoilt.append((Stamped(samples[index - 2][0].time_ns, stamped.received_ns, 0), samples[index - 2][1]))
    plain, dirty = Run(figure_of_eight(0.0)).go(3.0, samples), Run(figure_of_eight(0.0)).go(3.0, spoilt)
    assert np.array_equal(np.array(plain.twists), np.array(dirty.twists))
    assert dirty.stream.duplicates == 50
    assert dirty.stream.reordered == 30


def test_a_gap_is_bridged_for_a_period_and_then_waited_out() -> None:
    """Constant velocity, then no samples: the motion comes to rest a little further, and catches up afterwards."""

    def target(t: float) -> Array:
        return pose((0.2 * t, 0.0, 0.0))

    samples = [s for s in clean(target, 0.05, 4.0) if not 2.0 < s[0].time_ns / 1e9 < 2.4]
    run = Run(target(0.0)).go(4.0, samples)
    x = np.array([p[0, 3] for p in run.poses])
    at = {t: x[round(t / TICK_S)] for t in (2.0, 2.3, 2.38)}
    assert at[2.3] == pytest.approx(at[2.38], abs=3e-4)
    assert 0.2 * 2.0 < at[2.3] < 0.2 * 2.15
    assert x[-1] == pytest.approx(0.2 * run.times[-1], abs=1e-4)
    check_bounds(run)


def test_one_lost_sample_moves_the_motion_little() -> None:
    """At constant velocity a lost sample is bridged without a visible effect."""

    def target(t: float) -> Array:
        return pose((0.2 * t, 0.0, 0.0))

    lossy = clean(target, 0.05, 3.0)
    del lossy[30]
    whole, run = Run(target(0.0)).go(3.0, clean(target, 0.05, 3.0)), Run(target(0.0)).go(3.0, lossy)
    assert np.abs(np.array(run.poses) - np.array(whole.poses)).max() < 1e-9


def test_after_its_end_the_stream_is_held_at_the_last_sample() -> None:
    """No samples for timeout_s: the motion returns from the extrapolated pose to the last sample and rests there."""

    def target(t: float) -> Array:
        return pose((0.2 * t, 0.0, 0.0), (0.0, 0.5 * t, 0.0))

    run = Run(target(0.0)).go(1.0, clean(target, 0.05, 1.0))
    assert not run.stream.ended
    run.go(3.5, [])
    assert run.stream.ended
    goal = run.stream.goal_sd
    assert goal is not None
    assert np.abs(log(inverse(goal) @ run.poses[-1])).max() < 1e-5
    assert np.abs(run.twists[-1]).max() < 1e-5
    check_bounds(run)


def test_a_jump_is_approached_along_a_line_with_the_shortest_turn() -> None:
    """From rest to a pose at 0.3 m and nearly 180 degrees: reported as a jump, straight, about one axis, in time."""
    turn = np.array([1.0, 2.0, -0.5])
    turn *= np.radians(179.0) / np.linalg.norm(turn)
    start, goal = pose((0.1, 0.2, 0.3)), pose((0.3, 0.0, 0.4), tuple(turn))
    samples = [(Stamped(ns(t), ns(t), 0), start if t < 0.5 else goal) for t in np.arange(0.0, 3.0, 0.02)]
    run = Run(start).go(0.5, samples)
    assert not run.stream.jumped
    run.go(0.6, samples)
    assert run.stream.jumped
    run.go(1.9, samples)
    assert np.degrees(np.linalg.norm(log_rotation(goal[:3, :3].T @ run.poses[-1][:3, :3]))) < 5.0
    run.go(3.0, samples)
    assert not run.stream.jumped
    assert np.abs(log(inverse(goal) @ run.poses[-1])).max() < 1e-6
    line = (goal - start)[:3, 3] / np.linalg.norm((goal - start)[:3, 3])
    for p in run.poses:
        gone = p[:3, 3] - start[:3, 3]
        assert np.linalg.norm(gone - line * (line @ gone)) < 1e-9
        assert np.linalg.norm(np.cross(log_rotation(p[:3, :3]), turn)) < 1e-6
    check_bounds(run)


def test_a_goal_that_flickers_about_180_degrees_is_reached() -> None:
    """The shortest rotation changes its sense at every sample; the motion keeps its first sense."""
    sides = (pose(turn=(0.0, 0.0, np.pi - 0.01)), pose(turn=(0.0, 0.0, -np.pi + 0.01)))
    samples = [(Stamped(ns(t), ns(t), 0), sides[i % 2]) for i, t in enumerate(np.arange(0.0, 3.0, 0.02))]
    run = Run(pose()).go(3.0, samples)
    assert np.linalg.norm(log_rotation(sides[0][:3, :3].T @ run.poses[-1][:3, :3])) < 0.05
    check_bounds(run)


def test_hold_comes_to_rest_and_stays() -> None:
    """Used by pause; further samples have no effect until the next start."""

    def target(t: float) -> Array:
        return pose((0.2 * t, 0.0, 0.0))

    run = Run(target(0.0)).go(1.0, clean(target, 0.02, 3.0))
    run.stream.hold()
    run.go(3.0, clean(target, 0.02, 3.0))
    assert np.abs(run.twists[-1]).max() < 1e-9
    assert run.poses[-1][0, 3] < 0.2 + 0.2 * 0.15
    check_bounds(run)
    run.stream.start(run.poses[-1], ns(3.0))
    assert run.stream.goal_sd is None
    assert run.stream.gap_ns == 0


def test_time_never_runs_backwards() -> None:
    """A clock that steps back returns the present pose again, and the motion continues from there."""
    run = Run(figure_of_eight(0.0)).go(1.0, clean(figure_of_eight, 0.02, 1.0))
    now = run.stream.advance(ns(1.0), TICK_S)
    again = run.stream.advance(ns(0.5), TICK_S)
    assert np.array_equal(now.pose_sd, again.pose_sd)
    assert np.array_equal(now.twist_d, again.twist_d)


@pytest.mark.parametrize("rate_hz", [30.0, 100.0, 1000.0])
def test_the_tick_rate_matters_little(rate_hz: float) -> None:
    """Long control steps are subdivided: 30 Hz gives the motion of 1000 Hz within a tenth of a millimetre."""
    settings = TargetSettings()
    fine, other = StreamedPoses(settings), StreamedPoses(settings)
    for stream in (fine, other):
        stream.start(figure_of_eight(0.0), 0)
    samples = clean(figure_of_eight, 0.02, 3.0)
    ends = []
    for stream, rate in ((fine, 500.0), (other, rate_hz)):
        waiting = list(samples)
        for tick in range(int(3.0 * rate)):
            now = ns(tick / rate)
            while waiting and waiting[0][0].received_ns <= now:
                stamped, sample = waiting.pop(0)
                stream.add(sample, stamped)
            stream.advance(now, 1.0 / rate)
        ends.append(stream.advance(ns(3.0), 1.0 / rate).pose_sd)
    assert np.abs(ends[0] - ends[1]).max() < 1e-4
