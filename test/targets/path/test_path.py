"""Paths and trajectories: C2 through their poses, exact feed-forward, start without a jump, geometry kept while s < 1.

References are closed forms of motions on SE(3), finite differences, and scipy's rotation spline. The tool is ideal: it
executes exactly the fraction ``time_rate`` of each twist.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from loop import READY, make_robot
from scipy.spatial.transform import Rotation, RotationSpline

from ik_node.control.feedback import twist_feedback
from ik_node.errors import TargetRefused, UnknownNameError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import PathSample, TrajectorySample
from ik_node.math import se3
from ik_node.math.quaternion import from_matrix
from ik_node.math.types import Array
from ik_node.settings.groups import PathSettings, Settings, TargetSettings
from ik_node.targets.bounds import APPROACH, PATH_ACCELERATION_FRACTION, motion_bounds
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.path.follower import PathFollower
from ik_node.targets.path.request import PathRequest, request_from_path, request_from_trajectory
from ik_node.targets.path.se3_spline import RigidSpline
from ik_node.targets.path.spline_fit import through_poses

TICK_S = 0.002
ROS_NS = 1_700_000_000 * NS
SETTINGS = PathSettings()
APPROACH_BOUNDS = motion_bounds(TargetSettings(), APPROACH).linear
MAX_ACCELERATION = np.array(PATH_ACCELERATION_FRACTION) * TargetSettings().max_acceleration


def screw(time_s: float) -> Array:
    """A rotation about a moving axis, from rest at 0 s to rest at 4 s."""
    u = min(max(time_s / 4.0, 0.0), 1.0)
    phase = 2.0 * np.pi * u**4 * (35 + u * (-84 + u * (70 - 20 * u)))
    pose = se3.exp(np.array([0.1, 0.02, 0.0, 0.0, 0.0, 0.5]) * np.sin(phase))
    pose = pose @ se3.exp(np.array([0.0, 0.1, 0.05, 0.4, -0.2, 0.0]) * (1 - np.cos(phase)))
    pose[:3, 3] += (0.4, 0.0, 0.5)
    return pose


def twist_of(pose: Callable[[float], Array], time_s: float) -> Array:
    """Return velocity of the origin and angular velocity in {s}, by differences of sixth order."""
    h = 1e-3
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    here = pose(time_s)
    velocity = sum(w * (pose(time_s + k * h)[:3, 3] - pose(time_s - k * h)[:3, 3]) for k, w in weights.items()) / (
        60.0 * h
    )
    rate = sum(
        w
        * (
            se3.log_rotation(pose(time_s + k * h)[:3, :3] @ here[:3, :3].T)
            - se3.log_rotation(pose(time_s - k * h)[:3, :3] @ here[:3, :3].T)
        )
        for k, w in weights.items()
    ) / (60.0 * h)
    return np.concatenate((velocity, rate))


def base_only(frame: str) -> Array:
    """The frames of a robot with no frame but its base."""
    if frame != "base":
        raise UnknownNameError("frame", frame, ["base"])
    return np.eye(4)


def path_of(poses: list[Array], times_s: list[float], begin_ns: int = ROS_NS) -> PathSample:
    """Content of the message; the path begins at ``begin_ns`` + the first time."""
    return PathSample(
        ("base",) * len(poses),
        tuple(begin_ns + round(time * NS) for time in times_s),
        np.array([pose[:3, 3] for pose in poses]),
        np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
    )


def trajectory_of(times_s: list[float], stamp_ns: int = 0, **changes: Any) -> TrajectorySample:
    """The analytic motion as poses with twists."""
    poses = [screw(time) for time in times_s]
    sample = TrajectorySample(
        stamp_ns,
        "base",
        tuple(round(time * NS) for time in times_s),
        np.array([pose[:3, 3] for pose in poses]),
        np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
        np.array([twist_of(screw, time) for time in times_s]),
        np.empty((0, 6)),
    )
    return sample._replace(**changes)


def resting(pose: Array) -> RigidMotion:
    x, y, z = pose[:3, 3].tolist()
    return RigidMotion((x, y, z), orientation=from_matrix(pose))


def route(sample: PathSample | TrajectorySample, now_ns: int = 0, settings: PathSettings = SETTINGS) -> PathRequest:
    """A request received at ``now_ns`` of the monotonic clock, when ROS time is ``ROS_NS`` plus the same value."""
    now = Instant(now_ns, ROS_NS + now_ns)
    if isinstance(sample, PathSample):
        return request_from_path(sample, base_only, now, settings)
    return request_from_trajectory(sample, base_only, now)


class Run:
    """An ideal tool that follows a path step by step."""

    def __init__(self, path: PathRequest, start: RigidMotion, tick_s: float = TICK_S, begin_ns: int = 0) -> None:
        self.follower = PathFollower(Settings())
        self.follower.begin(path, start, begin_ns)
        self.tool = pose_matrix(start)
        self.tick_ns, self.time_ns, self.time_rate = round(tick_s * NS), begin_ns, 1.0
        self.times: list[float] = []
        self.poses: list[Array] = []
        self.twists: list[Array] = []
        self.tools: list[Array] = []

    def go(self, until_s: float, time_rate: Callable[[float], float] = lambda _: 1.0) -> Run:
        while self.time_ns < round(until_s * NS):
            motion = self.follower.advance(self.time_ns, self.tick_ns / NS, self.time_rate, self.tool)
            self.times.append(self.time_ns / NS)
            self.poses.append(motion.pose_sd)
            self.twists.append(motion.twist_d)
            self.tools.append(self.tool)
            self.time_rate = time_rate(self.time_ns / NS)
            # proportional feedback for the error of the discrete steps
            error = se3.log(se3.inverse(self.tool) @ motion.pose_sd)
            twist = se3.adjoint(se3.inverse(self.tool) @ motion.pose_sd) @ motion.twist_d + 10.0 * error
            self.tool = self.tool @ se3.exp(self.time_rate * twist * self.tick_ns / NS)
            self.time_ns += self.tick_ns
        return self

    def angular_steps(self) -> Array:
        return np.array([se3.log_rotation(a[:3, :3].T @ b[:3, :3]) for a, b in pairwise(self.poses)])


def spline_of(times_s: Array, poses: list[Array], moving_start: bool = False) -> RigidSpline:
    positions = np.array([pose[:3, 3] for pose in poses])
    return RigidSpline(through_poses(times_s, positions, tuple(from_matrix(p) for p in poses), moving_start))


def random_poses(count: int, angle: float, seed: int) -> list[Array]:
    generator = np.random.default_rng(seed)
    poses = [np.eye(4)]
    for _ in range(count - 1):
        axis = generator.normal(size=3)
        step = np.concatenate((0.1 * generator.normal(size=3), angle * axis / np.linalg.norm(axis)))
        poses.append(poses[-1] @ se3.exp(step))
    return poses


# --- the spline ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.1, 1.0, 2.6, 3.1])
def test_goes_through_the_poses_with_continuous_acceleration(angle: float) -> None:
    poses = random_poses(7, angle, seed=3)
    times = np.array([0.0, 0.8, 1.5, 3.0, 3.4, 4.5, 5.5])
    spline = spline_of(times, poses)
    for time, pose in zip(times.tolist(), poses, strict=True):
        assert np.abs(pose_matrix(spline.motion(time)) - pose).max() < 1e-12
    for time in times[1:-1].tolist():
        before, after = spline.motion(time - 1e-10), spline.motion(time + 1e-10)
        assert np.abs(pose_matrix(before) - pose_matrix(after)).max() < 1e-8
        for one, other in zip(before, after, strict=True):
            if len(one) == 3:
                assert np.abs(np.subtract(one, other)).max() < 1e-6 * (1.0 + np.abs(one).max())
    for end in (spline.motion(0.0), spline.motion(5.5)):
        at_rest = (end.velocity, end.acceleration, end.rate, end.angular_acceleration)
        assert np.abs(at_rest).max() < 1e-9, "at rest, including zero acceleration"


def test_the_derivatives_are_those_of_the_pose() -> None:
    spline = spline_of(np.array([0.0, 0.8, 1.5, 3.0]), random_poses(4, 1.2, seed=5))

    def pose(time_s: float) -> Array:
        return pose_matrix(spline.motion(time_s))

    for time in (0.1, 0.7, 0.9, 1.4, 2.2):
        motion = spline.motion(time)
        twist = twist_of(pose, time)
        assert np.abs(twist - (*motion.velocity, *motion.rate)).max() < 1e-8
        h = 1e-4
        before, after = spline.motion(time - h), spline.motion(time + h)
        acceleration = np.subtract(after.velocity, before.velocity) / (2 * h)
        angular = np.subtract(after.rate, before.rate) / (2 * h)
        assert np.abs(acceleration - motion.acceleration).max() < 1e-4
        assert np.abs(angular - motion.angular_acceleration).max() < 1e-4


@pytest.mark.parametrize(("angle", "tolerance"), [(0.05, 1e-12), (0.5, 1e-8), (1.0, 1e-5)])
def test_between_the_ends_it_is_the_spline_of_least_bending(angle: float, tolerance: float) -> None:
    """Far from its ends, where scipy's spline is free and this one at rest, both are equal."""
    count = 60
    poses, times = random_poses(count, angle, seed=7), np.linspace(0.0, 60.0, count)
    spline = spline_of(times, poses)
    reference = RotationSpline(times, Rotation.from_matrix([pose[:3, :3] for pose in poses]))
    for time in (30.1, 31.7, 29.4):
        difference = Rotation.from_matrix(pose_matrix(spline.motion(time))[:3, :3]).inv() * reference(time)
        assert difference.magnitude() < tolerance


def test_deviation_from_the_truth_falls_with_the_fourth_power_of_the_spacing() -> None:
    """For an analytic motion, at 16 and at 32 poses per second."""
    errors = []
    for rate in (16, 32):
        times = np.linspace(0.0, 4.0, 4 * rate + 1)
        spline = spline_of(times, [screw(time) for time in times.tolist()])
        error = [
            se3.log(se3.inverse(screw(t)) @ pose_matrix(spline.motion(t))) for t in np.linspace(0.0, 4.0, 801).tolist()
        ]
        errors.append(np.abs(np.array(error).reshape(-1, 2, 3)).max(axis=(0, 2)))
    assert (errors[0] < (10e-6, 60e-6)).all()
    assert (errors[0] / errors[1] > 12.0).all()


def test_a_repeated_pose_is_a_pause_that_nothing_rings_into() -> None:
    a, b = np.eye(4), se3.exp(np.array([0.2, 0.0, 0.1, 0.0, 0.5, 0.0]))
    spline = spline_of(np.array([0.0, 2.0, 3.0, 5.0]), [a, b, b, a])
    for time in np.linspace(2.0, 3.0, 21).tolist():
        assert np.abs(pose_matrix(spline.motion(time)) - b).max() < 1e-12


# --- following -------------------------------------------------------------------------------------------------------


def test_feed_forward_is_exact() -> None:
    """The twist of each step leads from its pose to the next one, and the poses are those of the path."""
    times = np.linspace(0.0, 4.0, 129)
    poses = [screw(time) for time in times.tolist()]
    run = Run(route(path_of(poses, times.tolist())), resting(poses[0])).go(5.0)
    spline = spline_of(times, poses)
    for time, pose, twist, after in zip(run.times, run.poses, run.twists, run.poses[1:], strict=False):
        assert np.abs(pose - pose_matrix(spline.motion(time))).max() < 1e-12
        assert np.abs(pose @ se3.exp(twist * TICK_S) - after).max() < 1e-12
    assert run.follower.finished
    assert run.follower.progress == 1.0
    assert max(np.abs(tool - pose).max() for tool, pose in zip(run.tools, run.poses, strict=True)) < 1e-9


def test_a_path_in_the_future_begins_at_its_time() -> None:
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    run = Run(route(path_of(poses, times.tolist(), ROS_NS + 501_300_000)), resting(poses[0])).go(0.5)
    assert run.follower.waiting
    assert run.follower.early
    run.go(3.0)
    spline = spline_of(times, poses)
    for time, pose in zip(run.times, run.poses, strict=True):
        assert np.abs(pose - pose_matrix(spline.motion(time - 0.5013))).max() < 1e-9
    assert run.follower.late_s < 1e-9


def test_a_path_that_has_begun_is_joined_where_it_is() -> None:
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    near = screw(1.5) @ se3.exp(np.array([0.004, -0.003, 0.002, 0.01, 0.0, 0.02]))
    run = Run(route(path_of(poses, times.tolist(), ROS_NS - 1_500_000_000)), resting(near)).go(4.0)
    assert not run.follower.waiting
    assert np.abs(run.poses[0] - near).max() < 1e-9, "it starts at the present pose of the arm"
    spline = spline_of(times, poses)
    late_s = run.follower.late_s
    assert late_s == 0.0, "the motion is completed"
    assert run.follower.finished
    settled = [pose for time, pose in zip(run.times, run.poses, strict=True) if 1.5 < time < 2.0]
    on_path = min(
        np.abs(settled[0] - pose_matrix(spline.motion(time))).max() for time in np.linspace(2.5, 3.2, 2000).tolist()
    )
    assert on_path < 1e-4


def test_joined_in_motion_it_is_on_time() -> None:
    """A planner sends its path repeatedly, starting at the pose that the arm should have by now."""
    first = np.linspace(0.0, 4.0, 65)
    run = Run(route(path_of([screw(t) for t in first.tolist()], first.tolist())), resting(screw(0.0))).go(1.5)
    again = first[first > 1.4]
    sample = path_of([screw(t) for t in again.tolist()], again.tolist())
    run.follower.begin(route(sample, run.time_ns), run.follower.motion(), run.time_ns - run.tick_ns)
    run.go(3.9)
    assert run.follower.late_s < 1e-9
    errors = [np.abs(pose - screw(time))[:3, 3].max() for time, pose in zip(run.times, run.poses, strict=True)]
    assert max(errors) < 1e-3
    twists = np.array(run.twists)
    assert np.abs(np.diff(twists, axis=0)).max() < 0.02, "no jump in velocity"


def test_far_from_the_arm_it_goes_there_straight_within_bounds_and_begins_late() -> None:
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    start = poses[0] @ se3.exp(np.array([0.15, -0.1, 0.05, 0.0, 0.0, 0.0]))
    start[:3, :3] = start[:3, :3] @ se3.exp_rotation(np.array([0.8, 0.3, -0.5]))
    run = Run(route(path_of(poses, times.tolist(), ROS_NS + NS // 10)), resting(start)).go(0.5)
    assert run.follower.waiting
    run.go(12.0)
    assert run.follower.finished
    assert np.abs(run.poses[-1] - poses[-1]).max() < 1e-9
    moved = np.array([pose[:3, 3] for pose in run.poses])
    begun = int(np.argmin(np.linalg.norm(moved[:1500] - poses[0][:3, 3], axis=1) > 1e-3))
    assert begun > 100
    way = poses[0][:3, 3] - start[:3, 3]
    aside = np.cross(moved[:begun] - start[:3, 3], way / np.linalg.norm(way))
    assert np.abs(aside).max() < 1e-6, "the motion is straight"
    turns = np.array([se3.log_rotation(start[:3, :3].T @ pose[:3, :3]) for pose in run.poses[:begun]])
    axis = se3.log_rotation(start[:3, :3].T @ poses[0][:3, :3])
    assert np.abs(np.cross(turns, axis / np.linalg.norm(axis))).max() < 1e-6, "it takes the shortest rotation"
    speeds = np.gradient(moved[:begun], TICK_S, axis=0)
    accelerations = np.gradient(speeds, TICK_S, axis=0)
    jerks = np.gradient(accelerations, TICK_S, axis=0)[4:-4]
    assert np.linalg.norm(speeds, axis=1).max() <= APPROACH_BOUNDS.speed * 1.001
    assert np.linalg.norm(accelerations, axis=1).max() <= APPROACH_BOUNDS.acceleration * 1.01
    assert np.linalg.norm(jerks, axis=1).max() <= APPROACH_BOUNDS.jerk * 1.05


def test_begun_late_it_leaves_nothing_out() -> None:
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    start = poses[0].copy()
    start[2, 3] += 0.1
    run = Run(route(path_of(poses, times.tolist(), ROS_NS - NS)), resting(start)).go(3.0)
    assert not run.follower.waiting
    assert run.follower.late_s > 1.5
    run.go(9.0)
    passed = np.array([pose[:3, 3] for pose in run.poses])
    for pose in poses:
        assert np.linalg.norm(passed - pose[:3, 3], axis=1).min() < 1e-3


def test_while_the_limits_slow_the_arm_the_path_waits_and_its_geometry_is_kept() -> None:
    """Only the step in which s changes has a twist of another part of the interval: 0.5 um."""
    times = np.linspace(0.0, 6.0, 129)
    poses = [screw(time * 4.0 / 6.0) for time in times.tolist()]

    def time_rate(time_s: float) -> float:
        return 0.15 if 0.7 < time_s < 2.0 else 0.6 if 2.5 < time_s < 4.5 else 1.0

    run = Run(route(path_of(poses, times.tolist())), resting(poses[0]))
    distances = []
    while not run.follower.finished:
        run.go(run.time_ns / NS + TICK_S, time_rate)
        distances.append(run.follower.distance_m)
    assert max(distances) < 1e-6
    assert run.time_ns / NS == pytest.approx(6.0 + 0.85 * 1.3 + 0.4 * 2.0, abs=0.01), "later by the lost time"
    run.go(run.time_ns / NS + 0.5)
    assert np.abs(run.tool - poses[-1]).max() < 1e-6


def test_after_a_stop_the_path_goes_on_where_it_was_left() -> None:
    """The arm was stopped and pushed aside: it returns straight, and then completes the rest of the geometry."""
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    run = Run(route(path_of(poses, times.tolist())), resting(poses[0])).go(1.7)
    left, done = run.tool, run.follower.progress
    aside = left.copy()
    aside[2, 3] += 0.05
    run.tool = aside
    run.follower.rest_at(resting(aside), run.time_ns)
    begin = len(run.poses)
    run.go(2.0)
    assert run.follower.waiting
    assert run.follower.progress == pytest.approx(done, abs=1e-3), "it is neither skipped nor started again"
    run.go(9.0)
    assert run.follower.finished
    assert np.abs(run.tool - poses[-1]).max() < 1e-6
    moved = np.array([pose[:3, 3] for pose in run.poses[begin:]])
    assert np.abs(moved[0] - aside[:3, 3]).max() < 1e-9
    speeds = np.linalg.norm(np.diff(moved, axis=0), axis=1) / TICK_S
    assert np.abs(np.diff(speeds)).max() / TICK_S < 3.0
    for pose in poses[29:]:
        assert np.linalg.norm(moved - pose[:3, 3], axis=1).min() < 1e-3


def test_late_says_how_much() -> None:
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    run = Run(route(path_of(poses, times.tolist())), resting(poses[0])).go(2.0, lambda _: 0.5)
    assert run.follower.late_s == pytest.approx(1.0, abs=0.01)
    assert run.follower.progress == pytest.approx(0.25, abs=0.01)


def test_the_distance_to_the_path_is_that_of_its_nearest_point() -> None:
    times = np.linspace(0.0, 4.0, 65)
    spline = spline_of(times, [screw(time) for time in times.tolist()])
    fine = np.array([spline.pose(time)[0] for time in np.linspace(0.0, 4.0, 40_001).tolist()])
    generator = np.random.default_rng(2)
    for time in (0.9, 1.7, 2.4, 3.0):
        point = fine[round(time * 10_000)] + 0.01 * generator.normal(size=3)
        x, y, z = point.tolist()
        found_s, distance = spline.nearest((x, y, z), time - 0.05)
        window = fine[round((time - 0.3) * 10_000) : round((time + 0.3) * 10_000)]
        assert distance == pytest.approx(np.linalg.norm(window - point, axis=1).min(), abs=1e-7)
        assert abs(found_s - time) < 0.3


def test_ticks_that_come_late_leave_the_path_where_it_should_be() -> None:
    times = np.linspace(0.0, 4.0, 65)
    poses = [screw(time) for time in times.tolist()]
    follower = PathFollower(Settings())
    follower.begin(route(path_of(poses, times.tolist())), resting(poses[0]), 0)
    spline = spline_of(times, poses)
    generator = np.random.default_rng(4)
    now_ns = 0
    while now_ns < 3 * NS:
        motion = follower.advance(now_ns, TICK_S)
        assert np.abs(motion.pose_sd - pose_matrix(spline.motion(now_ns / NS))).max() < 1e-9
        now_ns += int(generator.integers(1_000_000, 9_000_000))


# --- trajectories with twists ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("accelerations", [False, True])
def test_poses_with_twists_are_met_with_their_twists(accelerations: bool) -> None:
    times = np.linspace(0.0, 4.0, 33).tolist()
    sample = trajectory_of(times)
    if accelerations:
        h = 1e-3
        values = [(twist_of(screw, t + h) - twist_of(screw, t - h)) / (2 * h) for t in times]
        sample = sample._replace(accelerations=np.array(values))
    knots = route(sample).knots
    assert knots is not None
    spline = RigidSpline(knots)
    for time, twist in zip(times, sample.twists, strict=True):
        motion = spline.motion(time)
        assert np.abs(pose_matrix(motion) - screw(time)).max() < 1e-12
        assert np.abs(twist - (*motion.velocity, *motion.rate)).max() < 1e-9
    for time in times[1:-1]:
        before, after = spline.motion(time - 1e-9), spline.motion(time + 1e-9)
        assert np.abs(np.subtract(before.acceleration, after.acceleration)).max() < 1e-6
        assert np.abs(np.subtract(before.angular_acceleration, after.angular_acceleration)).max() < 1e-5
    errors = [se3.log(se3.inverse(screw(t)) @ pose_matrix(spline.motion(t))) for t in np.linspace(0, 4, 801).tolist()]
    worst = np.abs(np.array(errors).reshape(-1, 2, 3)).max(axis=(0, 2))
    assert (worst < ((2e-6, 10e-6) if accelerations else (10e-6, 60e-6))).all()


def test_twists_are_in_the_axes_of_the_header() -> None:
    base = se3.exp(np.array([0.3, -0.2, 0.1, 0.4, 1.0, -0.7]))
    inside = trajectory_of(np.linspace(0.0, 4.0, 33).tolist(), frame_id="table")

    def frames(frame: str) -> Array:
        assert frame == "table"
        return base

    knots = request_from_trajectory(inside, frames, Instant(0, ROS_NS)).knots
    assert knots is not None
    spline = RigidSpline(knots)

    def moved(time_s: float) -> Array:
        return base @ screw(time_s)

    for time in (0.9, 1.55, 2.6):
        motion = spline.motion(time)
        assert np.abs(pose_matrix(motion) - moved(time)).max() < 1e-4
        assert np.abs(twist_of(moved, time) - (*motion.velocity, *motion.rate)).max() < 1e-3


def test_a_trajectory_that_begins_and_ends_in_motion_is_joined_and_left_without_a_jump() -> None:
    times = np.linspace(1.0, 3.0, 33).tolist()
    run = Run(route(trajectory_of(times)), resting(screw(1.0))).go(0.9)
    assert run.follower.waiting, "the first point starts one second after the start"
    run.go(6.0)
    assert run.follower.finished
    assert np.abs(run.poses[-1] - screw(3.0)).max() < 1e-6
    twists = np.array(run.twists)
    accelerations = np.linalg.norm(np.diff(twists[:, :3], axis=0), axis=1) / TICK_S
    assert accelerations.max() < 3.0, "bounded, no step of 0.15 m/s in one control step"
    assert np.linalg.norm(twist_of(screw, 1.0)[:3]) > 0.1, "it has to be moving for this test to be valid"


def test_without_twists_it_is_a_path() -> None:
    times = np.linspace(0.0, 4.0, 65).tolist()
    run = Run(route(trajectory_of(times, twists=np.empty((0, 6)))), resting(screw(0.0))).go(4.5)
    assert run.follower.finished
    spline = spline_of(np.array(times), [screw(time) for time in times])
    for time, pose in zip(run.times, run.poses, strict=True):
        assert np.abs(pose - pose_matrix(spline.motion(time))).max() < 1e-9


# --- without times ---------------------------------------------------------------------------------------------------


def test_a_path_without_times_gets_times_within_the_speeds_and_accelerations() -> None:
    poses = [screw(time) for time in np.linspace(0.0, 4.0, 33).tolist()]
    sample = path_of(poses, [0.0] * len(poses))
    run = Run(route(sample), resting(poses[0]))
    while not run.follower.finished:
        run.go(run.time_ns / NS + 0.1)
    passed = np.array([pose[:3, 3] for pose in run.poses])
    for pose in poses:
        assert np.linalg.norm(passed - pose[:3, 3], axis=1).min() < 1e-3
    twists = np.array(run.twists)
    assert np.linalg.norm(twists[:, :3], axis=1).max() <= SETTINGS.speed[0] * 1.02
    assert np.linalg.norm(twists[:, 3:], axis=1).max() <= SETTINGS.speed[1] * 1.02
    velocities = np.diff(passed, axis=0) / TICK_S
    rates = run.angular_steps() / TICK_S
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() / TICK_S <= MAX_ACCELERATION[0] * 1.02
    assert np.linalg.norm(np.diff(rates, axis=0), axis=1).max() / TICK_S <= MAX_ACCELERATION[1] * 1.1


def test_a_path_without_times_keeps_its_poses_however_unevenly_they_lie() -> None:
    """Corners, a turn without translation, a tiny step and a repeated pose."""
    steps = [(0.2, 0, 0, 0, 0, 0), (0, 0.1, 0, 0, 0, 0), (0, 0, 0, 0, 0, 1.0), (1e-5, 0, 0, 0, 0, 0), (0,) * 6]
    poses = [screw(0.0)]
    for step in steps:
        poses.append(poses[-1] @ se3.exp(np.array(step, dtype=float)))
    run = Run(route(path_of(poses, [5.0] * len(poses))), resting(poses[0]))
    while not run.follower.finished:
        run.go(run.time_ns / NS + 0.1)
    assert run.time_ns < 20 * NS
    for pose in poses:
        errors = [np.abs(se3.log(se3.inverse(pose) @ passed)).max() for passed in run.poses]
        assert min(errors) < 2e-3
    twists = np.array(run.twists)
    assert np.linalg.norm(twists[:, :3], axis=1).max() <= SETTINGS.speed[0] * 1.02
    assert np.linalg.norm(twists[:, 3:], axis=1).max() <= SETTINGS.speed[1] * 1.02


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_times_are_found_that_the_joints_can_keep(name: str) -> None:
    """The bounds of the tool are inactive here; the pseudoinverse moves the joints."""
    robot = make_robot(name)
    q = np.array(READY[name])
    start = robot.pose(q)
    poses = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 25).tolist():
        pose = start.copy()
        pose[1:3, 3] += (0.15 * np.sin(angle), 0.15 * (np.cos(angle) - 1.0))
        pose[:3, :3] = pose[:3, :3] @ se3.exp_rotation(np.array([0.3 * np.sin(angle), 0.0, 0.0]))
        poses.append(pose)
    values = {"limits.velocity_fraction": 0.2, "limits.acceleration": (1.0,)}
    fast = {"path.speed": (10.0, 10.0), "target.max_acceleration": (200.0, 125.0)}
    settings = Settings().with_values(values | fast)
    follower = PathFollower(settings, robot)
    follower.begin(route(path_of(poses, [0.0] * 25), settings=settings.path), resting(start), 0, q)
    assert follower.waiting, "the times are not computed yet"
    speeds, velocity, time_ns = [], np.zeros(robot.n), 0
    while not follower.finished:
        pose = robot.pose(q)
        law = twist_feedback(pose, follower.advance(time_ns, TICK_S, 1.0, pose), settings.control)
        jacobian = robot.evaluate(q + 0.5 * TICK_S * velocity).jacobian_b
        velocity = np.linalg.pinv(jacobian) @ law.twist_b
        q = q + TICK_S * velocity
        speeds.append(velocity)
        time_ns += round(TICK_S * NS)
        assert time_ns < 60 * NS
    used = np.abs(speeds) / (0.2 * robot.limits.velocity)
    accelerations = np.abs(np.diff(speeds, axis=0)).max() / TICK_S
    assert used.max() < 1.0
    assert accelerations < 1.0
    assert max(used.max(), accelerations) > 0.6, "no slower than necessary"
    assert follower.distance_m < 1e-5


# --- invalid input ---------------------------------------------------------------------------------------------------


GOOD = [screw(time) for time in np.linspace(0.0, 4.0, 9).tolist()]
TIMES = np.linspace(0.0, 4.0, 9).tolist()


def changed(index: int, **values: object) -> PathSample:
    """The valid path with one pose changed."""
    sample = path_of(GOOD, TIMES)
    positions, quaternions = sample.positions.copy(), sample.quaternions.copy()
    frames, stamps = list(sample.frame_ids), list(sample.stamps_ns)
    for array, name in ((positions, "position"), (quaternions, "quaternion")):
        if name in values:
            array[index] = values[name]
    if "frame" in values:
        frames[index] = str(values["frame"])
    if "stamp_ns" in values:
        stamps[index] = int(str(values["stamp_ns"]))
    return PathSample(tuple(frames), tuple(stamps), positions, quaternions)


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (path_of([], []), "a path of 0 poses; expected at least 2"),
        (path_of(GOOD[:1], TIMES[:1]), "a path of 1 poses; expected at least 2"),
        (changed(3, position=(np.nan, 0, 0)), "position of pose 3 is not finite"),
        (changed(4, position=(0, np.inf, 0)), "position of pose 4 is not finite"),
        (changed(5, position=(0, 1e300, 0)), "pose 5 is more than 100 m away"),
        (changed(2, quaternion=(0, 0, 0, 0)), "orientation of pose 2 is no unit quaternion"),
        (changed(2, quaternion=(0, np.nan, 0, 1)), "orientation of pose 2 is not finite"),
        (changed(2, quaternion=(0, 0, 0, 1.01)), "orientation of pose 2 is no unit quaternion"),
        (changed(6, stamp_ns=ROS_NS), "pose 6 is not later than pose 5, by 2.5 s"),
        (changed(6, stamp_ns=ROS_NS + round(TIMES[5] * NS)), "pose 6 is not later than pose 5, by 0 s"),
        (changed(6, stamp_ns=ROS_NS + round(TIMES[5] * NS) + 1), "stamps of pose 6 and the one before it ask for more"),
        (changed(7, frame="map"), "pose 7: unknown frame 'map'; valid: base"),
        (path_of(GOOD, TIMES, ROS_NS + 100 * NS), "it begins in 100 s; at most 60 s are accepted"),
        (path_of(GOOD * 1000, list(range(9000))), "a path of 9000 poses; at most 2000 are accepted"),
        (path_of([GOOD[0]] * 3, [0.0] * 3), "whose poses are all the same"),
        (trajectory_of([0.0]), "a path of 1 poses"),
        (trajectory_of([0.0, 1.0], twists=np.full((2, 6), np.nan)), "velocity of pose 0 is not finite"),
        (trajectory_of([0.0, 1.0], twists=np.full((2, 6), 50.0)), "pose 0 has a velocity above 10 m/s"),
        (trajectory_of([0.0, 1.0], accelerations=np.full((2, 6), np.inf)), "acceleration of pose 0 is not finite"),
        (trajectory_of([0.0, 1.0], twists=np.empty((0, 6)), accelerations=np.zeros((2, 6))), "without velocities"),
        (trajectory_of([0.0, 1.0], frame_id="map"), "unknown frame 'map'; valid: base"),
    ],
)
def test_what_cannot_be_followed_is_refused_by_the_number_of_the_pose(
    sample: PathSample | TrajectorySample, reason: str
) -> None:
    with pytest.raises(TargetRefused, match=reason):
        route(sample)


def test_slightly_denormal_and_flipped_quaternions_are_put_right() -> None:
    sample = path_of(GOOD, TIMES)
    dirty = sample._replace(quaternions=sample.quaternions * np.where(np.arange(9) % 2, -1.0005, 0.9995)[:, None])
    clean, put_right = route(sample), route(dirty)
    a = [pose_matrix(RigidMotion(orientation=orientation)) for orientation in clean.orientations]
    b = [pose_matrix(RigidMotion(orientation=orientation)) for orientation in put_right.orientations]
    assert np.abs(np.array(a) - np.array(b)).max() < 1e-12


@pytest.mark.parametrize(("begin_s", "warning"), [(0, ""), (17, ""), (1_699_999_900, "are in the past")])
def test_stamps_of_the_past_only_say_how_long(begin_s: int, warning: str) -> None:
    """Stamps that count from 0 are relative by convention; past dates cause a warning."""
    found = route(path_of(GOOD, TIMES, begin_s * NS))
    assert found.begin_ns is None
    assert warning in found.warning
    assert bool(warning) == bool(found.warning)
    run = Run(found, resting(GOOD[0])).go(4.1)
    assert run.follower.finished
