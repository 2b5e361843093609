"""Selection of the active input; the reference does not jump when it changes.

The motions themselves are tested in test_stream.py, test_path.py and test_jog.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from loop import READY, make_robot

from ik_node.errors import TargetRefused
from ik_node.interfaces.clock import NS, Instant, Stamped
from ik_node.interfaces.samples import PathSample, TrajectorySample, TwistSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.json_codec import from_json, to_json
from ik_node.settings.groups import Settings
from ik_node.targets.arbiter import TargetArbiter
from ik_node.targets.arbiter_state import ArbiterSnapshot, TargetSource
from ik_node.targets.jog import TwistFrame

TICK_NS = 2_000_000
TICK_S = TICK_NS / NS
ROS_NS = 1_700_000_000 * NS
BASE = TwistFrame(np.eye(3), False)
START = se3.exp(np.array([0.4, 0.1, 0.5, 0.3, -0.8, 0.4]))


def base_only(frame: str) -> Array:
    assert frame == "base"
    return np.eye(4)


class Run:
    """Targets with control steps at 500 Hz from 1 s on; ROS time is larger by ``ROS_NS``."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.targets = TargetArbiter(settings or Settings())
        self.time_ns = NS
        self.targets.start(START, self.time_ns)
        self.time_rate = 1.0
        self.poses: list[Array] = []
        self.twists: list[Array] = []

    @property
    def now(self) -> Instant:
        return Instant(self.time_ns, ROS_NS + self.time_ns)

    def tick(self) -> None:
        motion = self.targets.advance(self.time_ns, TICK_S, self.time_rate)
        self.poses.append(motion.pose_sd)
        self.twists.append(motion.twist_d)
        self.time_ns += TICK_NS

    def go(self, duration_s: float, each: Callable[[], None] | None = None, rate_hz: float = 50.0) -> Run:
        every = round(1.0 / (rate_hz * TICK_S))
        for index in range(round(duration_s / TICK_S)):
            if each is not None and index % every == 0:
                each()
            self.tick()
        return self

    # --- inputs ---

    def pose(self, pose: Array | None = None) -> None:
        """A stream that moves along y."""
        sent = START.copy()
        sent[1, 3] += 0.1 * np.sin(0.002 * (self.time_ns - NS) / 1e6)
        self.targets.on_pose(sent if pose is None else pose, Stamped(self.time_ns, self.time_ns, 0))

    def path(self, begin_s: float = 0.0, duration_s: float = 2.0) -> None:
        """A path along x and back, with rotation."""
        times = np.linspace(0.0, duration_s, 21)
        bend = np.sin(np.pi * times / duration_s) ** 2
        poses = [START @ se3.exp(np.array([0.1 * b, 0.0, 0.0, 0.0, 0.3 * b, 0.0])) for b in bend.tolist()]
        sample = PathSample(
            ("base",) * 21,
            tuple(self.now.ros_ns + round((begin_s + time) * NS) for time in times.tolist()),
            np.array([pose[:3, 3] for pose in poses]),
            np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
        )
        self.targets.on_path(sample, base_only, self.now)

    def trajectory(self) -> None:
        """One second in the direction of z."""
        poses = [START, START.copy()]
        poses[1][2, 3] += 0.1
        sample = TrajectorySample(
            0,
            "base",
            (0, NS),
            np.array([pose[:3, 3] for pose in poses]),
            np.array([se3.quaternion_from_rotation(START[:3, :3])] * 2),
            np.zeros((2, 6)),
            np.empty((0, 6)),
        )
        self.targets.on_trajectory(sample, base_only, self.now)

    def twist(self, *twist: float) -> None:
        sent = twist or (0.1, 0.1, 0.0, 0.0, 0.2, 0.4)
        self.targets.on_twist(TwistSample(0, "base", np.array(sent)), BASE, self.now)


def in_base(pose: Array, twist_d: Array) -> Array:
    rotation = pose[:3, :3]
    return np.concatenate((rotation @ twist_d[:3], rotation @ twist_d[3:]))


def test_at_first_nobody_is_in_command() -> None:
    run = Run().go(0.2)
    targets = run.targets
    assert targets.source is TargetSource.NONE
    assert targets.ended
    assert targets.reason == "no target yet"
    assert targets.goal_sd is None
    assert np.isnan(targets.progress)
    assert max(np.abs(pose - START).max() for pose in run.poses) < 1e-12
    assert max(np.abs(twist).max() for twist in run.twists) < 1e-12


def test_the_latest_that_asks_for_something_is_in_command() -> None:
    run = Run()
    targets = run.targets
    for send, source, reason in (
        (run.pose, TargetSource.POSE, "following target_pose"),
        (run.path, TargetSource.PATH, "moving to target_path"),
        (run.twist, TargetSource.TWIST, "jogging by target_twist"),
        (run.path, TargetSource.PATH, "moving to target_path"),
        (run.trajectory, TargetSource.TRAJECTORY, "moving to target_trajectory"),
        (run.pose, TargetSource.POSE, "following target_pose"),
        (run.twist, TargetSource.TWIST, "jogging by target_twist"),
        (run.pose, TargetSource.POSE, "following target_pose"),
    ):
        send()
        run.go(0.2, send if source in (TargetSource.POSE, TargetSource.TWIST) else None)
        assert targets.source is source
        assert not targets.ended
        if source in (TargetSource.PATH, TargetSource.TRAJECTORY):
            assert targets.reason in (reason, f"following {source.value}")
        else:
            assert targets.reason == reason


def test_a_twist_of_zero_takes_command_from_nobody() -> None:
    run = Run()
    run.path()
    run.go(0.1)
    run.twist(*np.zeros(6))
    assert run.targets.source.value == "target_path"
    run.twist()
    run.go(0.1)
    run.twist(*np.zeros(6))
    assert run.targets.source.value == "target_twist"


def test_who_falls_silent_or_is_done_leaves_the_arm_where_it_is() -> None:
    for send, reason in (
        (Run.pose, "the target stream has ended; holding the last pose"),
        (Run.path, "target_path has ended; holding its last pose"),
        (Run.trajectory, "target_trajectory has ended; holding its last pose"),
        (Run.twist, "target_twist has ended; holding the pose"),
    ):
        run = Run()
        if send in (Run.pose, Run.twist):
            run.go(0.5, lambda run=run, send=send: send(run))  # type: ignore[misc]
        else:
            send(run)
        run.go(4.0)
        assert run.targets.ended
        assert run.targets.reason == reason
        assert np.abs(run.twists[-1]).max() < 1e-6
        assert np.abs(run.poses[-1] - run.poses[-200]).max() < 1e-6


SENDERS: dict[str, Callable[[Run], None]] = {
    "pose": Run.pose,
    "path": Run.path,
    "trajectory": Run.trajectory,
    "twist": Run.twist,
}


@pytest.mark.parametrize("first", SENDERS)
@pytest.mark.parametrize("second", SENDERS)
def test_the_reference_is_continuous_in_pose_and_velocity_whoever_takes_over(first: str, second: str) -> None:
    run = Run()
    for name in (first, second, first):
        send = SENDERS[name]
        if name in ("pose", "twist"):
            run.go(0.7, lambda send=send: send(run))  # type: ignore[misc]
        else:
            send(run)
            run.go(0.7)
    steps = [se3.log(se3.inverse(a) @ b) for a, b in zip(run.poses, run.poses[1:], strict=False)]
    twists = np.array([in_base(pose, twist) for pose, twist in zip(run.poses, run.twists, strict=True)])
    assert np.abs(np.array(steps) / TICK_S - np.array(run.twists[:-1])).max() < 0.02, "each twist is executed"
    changes = np.diff(twists, axis=0).reshape(-1, 2, 3)
    assert np.linalg.norm(changes[:, 0], axis=1).max() < 0.025, "at most 10 m/s2, the bound of the stream"
    assert np.linalg.norm(changes[:, 1], axis=1).max() < 0.06
    moved = np.linalg.norm(np.diff([pose[:3, 3] for pose in run.poses], axis=0), axis=1)
    assert moved.max() > 1e-5, "it has to move for this test to be valid"


@pytest.mark.parametrize("name", ["path", "trajectory", "twist"])
def test_a_fast_reference_stops_soon_whoever_takes_over(name: str) -> None:
    """0.8 m/s and 1.5 rad/s: at the usual 2 m/s2 stopping would take 0.16 m, plus the ramp of the acceleration."""
    run = Run()

    def stream() -> None:
        elapsed_s = (run.time_ns - NS) / NS
        pose = START @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.5 * elapsed_s]))
        pose[1, 3] = START[1, 3] + 0.8 * elapsed_s
        run.pose(pose)

    run.go(0.5, stream)
    begin = len(run.poses)
    speed = np.linalg.norm(run.twists[-1].reshape(2, 3), axis=1)
    assert speed == pytest.approx((0.8, 1.5), abs=0.1)
    if name == "twist":
        run.twist(1e-9, 0.0, 0.0, 0.0, 0.0, 0.0)
    else:
        SENDERS[name](run)
    run.go(1.0)
    way = np.array([pose[1, 3] for pose in run.poses[begin:]]) - run.poses[begin][1, 3]
    turned = [se3.log_rotation(run.poses[begin][:3, :3].T @ pose[:3, :3])[2] for pose in run.poses[begin:]]
    assert way.max() < 0.1
    assert max(turned) < 0.25


@pytest.mark.parametrize("seed", range(4))
def test_whatever_comes_the_reference_does_not_jump(seed: int) -> None:
    """Random inputs; the highest bounds are those of the stream."""
    generator, run = np.random.default_rng(seed), Run()
    stream_until, twist_until, twist = 0, 0, np.zeros(6)
    for tick in range(1500):
        choice = generator.random()
        if choice < 0.004:
            run.path(float(generator.choice([-3000.0, -0.5, -0.1, 0.0, 0.05, 0.5])), float(generator.uniform(0.8, 3.0)))
        elif choice < 0.006:
            run.trajectory()
        elif choice < 0.01:
            stream_until = tick + int(generator.integers(10, 500))
        elif choice < 0.014:
            twist_until, twist = tick + int(generator.integers(10, 500)), 0.2 * generator.normal(size=6)
        if tick < stream_until and tick % 25 == 0:
            run.pose()
        elif tick < twist_until and tick % 10 == 0:
            run.twist(*twist)
        run.tick()
    twists = np.array([in_base(pose, twist_d) for pose, twist_d in zip(run.poses, run.twists, strict=True)])
    accelerations = np.linalg.norm(np.diff(twists, axis=0).reshape(-1, 2, 3), axis=2) / TICK_S
    assert (accelerations.max(axis=0) < (10.1, 25.1)).all()
    assert (accelerations.max(axis=0) > (1.0, 3.0)).all(), "it has to move for this test to be valid"


def test_two_inputs_at_once_are_noticed() -> None:
    run = Run()
    run.go(0.5, run.pose)
    assert run.targets.warnings == ()
    for _ in range(5):
        run.pose()
        run.twist()
        run.go(0.1)
    assert "target_pose and target_twist are published at the same time" in run.targets.warnings
    run.go(3.0, run.pose)
    assert run.targets.warnings == ()


def test_what_is_refused_changes_nothing() -> None:
    run, other = Run(), Run()
    for each in (run, other):
        each.go(0.3, each.pose)
    bad = np.array([0.1, np.nan, 0.0, 0.0, 0.0, 0.0])
    for twist, stamp_ns, reason in (
        (bad, 0, "target twist is not finite"),
        (np.full(6, 1e9), 0, "accepted: 10 m/s and 30 rad/s"),
        (np.full(6, 0.1), run.now.ros_ns - NS // 2, "target twist is 0.5 s old; jog.timeout_s is 0.25"),
    ):
        with pytest.raises(TargetRefused, match=reason):
            run.targets.on_twist(TwistSample(stamp_ns, "base", twist), BASE, run.now)
    empty = PathSample((), (), np.empty((0, 3)), np.empty((0, 4)))
    with pytest.raises(TargetRefused, match="a path of 0 poses"):
        run.targets.on_path(empty, base_only, run.now)
    for each in (run, other):
        each.go(0.3, each.pose)
    assert np.array_equal(run.poses, other.poses)
    assert run.targets.source is TargetSource.POSE


def test_progress_and_goal_of_a_path() -> None:
    run = Run()
    run.path(begin_s=0.5)
    run.go(0.1)
    assert run.targets.reason == "waiting for the start time of target_path"
    run.go(1.4)
    assert run.targets.reason == "following target_path"
    assert run.targets.progress == pytest.approx(0.5, abs=0.01)
    assert run.targets.late_s == pytest.approx(0.0, abs=1e-9)
    goal = run.targets.goal_sd
    assert goal is not None
    assert np.abs(goal - START).max() < 1e-9


def test_stamps_in_the_past_are_remarked() -> None:
    run = Run()
    run.path(begin_s=-100.0)
    run.go(0.1)
    assert run.targets.warnings == ("all stamps of target_path are in the past; it begins on arrival",)
    assert run.targets.reason == "following target_path"


def test_stamps_from_another_clock_are_remarked() -> None:
    run = Run()
    for stamp_ns, warnings in (
        (run.now.ros_ns - 3600 * NS, ("stamps of target_twist disagree with this clock; using the time of arrival",)),
        (run.now.ros_ns, ()),
    ):
        run.targets.on_twist(TwistSample(stamp_ns, "base", np.array([0.1, 0, 0, 0, 0, 0])), BASE, run.now)
        run.tick()
        assert run.targets.warnings == warnings
    run.path(begin_s=-ROS_NS / NS)
    assert run.targets.warnings == (), "stamps that count from 0 are times from the start"


@pytest.mark.parametrize("name", SENDERS)
def test_after_standing_still_it_goes_on_from_where_the_arm_is(name: str) -> None:
    run = Run()
    send = SENDERS[name]
    each = (lambda: send(run)) if name in ("pose", "twist") else None
    send(run)
    run.go(0.5, each)
    run.time_rate = 0.0
    run.go(0.5, each)
    arm = run.poses[-1].copy()
    arm[:3, 3] += (0.01, -0.005, 0.0)
    run.targets.rest_at(arm, run.time_ns)
    run.time_rate = 1.0
    run.tick()
    assert np.abs(run.poses[-1] - arm).max() < 1e-9
    assert np.abs(run.twists[-1]).max() < 0.01, "it starts from rest"
    assert run.targets.source.value == f"target_{name}"
    run.go(3.0, each)
    if name in ("path", "trajectory"):
        assert run.targets.ended
        goal = run.targets.goal_sd
        assert goal is not None
        assert np.abs(run.poses[-1] - goal).max() < 1e-6


def script(run: Run, begin: int, end: int) -> None:
    """A sequence of many inputs, by control step."""
    for tick in range(begin, end):
        run.time_rate = 0.3 if tick % 97 > 80 else 1.0
        if tick % 25 == 0 and tick % 900 < 300:
            run.pose()
        if tick in (310, 1330, 2200):
            run.path(begin_s=0.1 if tick == 310 else -0.3)
        if tick == 700:
            run.trajectory()
        if tick % 10 == 0 and 1000 < tick < 1200:
            run.twist()
        run.tick()


def test_the_same_calls_give_the_same_bits_also_from_a_snapshot_in_between() -> None:
    """The snapshot is encoded and decoded as in a recording."""
    whole = Run()
    script(whole, 0, 2600)
    for cut in (150, 350, 600, 750, 1050, 1400, 2250):
        first = Run()
        script(first, 0, cut)
        snapshot = from_json(to_json(first.targets.capture()), ArbiterSnapshot)
        second = Run()
        second.targets.start(np.eye(4), 0)
        second.targets.restore(snapshot)
        second.time_ns = first.time_ns
        script(second, cut, 2600)
        assert np.array_equal(np.array(first.poses + second.poses), np.array(whole.poses))
        assert np.array_equal(np.array(first.twists + second.twists), np.array(whole.twists))
    assert whole.targets.source is TargetSource.PATH


def test_a_snapshot_holds_what_has_been_found_out_of_a_path_without_times() -> None:
    robot = make_robot("panda")
    q = np.array(READY["panda"])
    start = robot.pose(q)
    poses = [start @ se3.exp(np.array([0.1 * np.sin(a), 0.0, 0.0, 0.0, 0.2 * a, 0.0])) for a in np.linspace(0, 3, 20)]
    sample = PathSample(
        ("base",) * 20,
        (0,) * 20,
        np.array([pose[:3, 3] for pose in poses]),
        np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
    )
    runs = []
    for cuts in ((), (5,), (100, 400)):
        targets = TargetArbiter(Settings(), robot)
        targets.start(start, 0)
        targets.on_path(sample, base_only, Instant(0, ROS_NS), q)
        twists = []
        for tick in range(1000):
            if tick in cuts:
                snapshot = from_json(to_json(targets.capture()), ArbiterSnapshot)
                targets = TargetArbiter(Settings(), robot)
                targets.restore(snapshot)
            twists.append(targets.advance(tick * TICK_NS, TICK_S).twist_d)
            if tick == 5:
                assert targets.reason == "computing times for target_path"
        runs.append(np.array(twists))
        assert targets.reason == "following target_path"
    assert np.abs(runs[0]).max() > 0.05
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])


def test_other_settings_count_from_now_on() -> None:
    run = Run()
    run.go(0.5, run.twist)
    slower = Settings().with_values({"target.max_speed": (0.04, 2.5)})
    run.targets.configure(slower)
    run.go(0.5, run.twist)
    assert np.linalg.norm(run.twists[-1][:3]) == pytest.approx(0.01, abs=1e-3)
