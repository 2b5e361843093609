"""Jogging: the commanded twist in the axes of its frame, bounded, at rest after the time-out.

References are closed forms. The arms execute exactly the pseudoinverse of their Jacobian, without limits; properties of
the reference alone are tested on it alone.
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, make_robot

from ik_node.control.feedback import twist_feedback
from ik_node.interfaces.clock import NS, Stamped
from ik_node.math import se3
from ik_node.math.quaternion import from_matrix
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ControlSettings, Settings
from ik_node.targets.bounds import JOG, motion_bounds
from ik_node.targets.jerk_limited_filter import RigidMotion
from ik_node.targets.jog import LEAD_LIMIT, Jog, TwistFrame, twist_frame

TICK_NS = 2_000_000
TICK_S = TICK_NS / NS
SETTINGS = Settings()
BOUNDS = motion_bounds(SETTINGS.target, JOG)
BASE = TwistFrame(np.eye(3), False)
START = se3.exp(np.array([0.4, 0.1, 0.5, 0.3, -0.8, 0.4]))


class Run:
    """Twists at 50 Hz, control steps at 500 Hz."""

    def __init__(self, start: Array = START) -> None:
        self.jog = Jog(SETTINGS)
        x, y, z = start[:3, 3].tolist()
        self.jog.begin(RigidMotion((x, y, z), orientation=from_matrix(start)), 0)
        self.tick = 0
        self.poses: list[Array] = []
        self.twists: list[Array] = []

    def go(
        self, duration_s: float, twist: tuple[float, ...] | None, frame: TwistFrame = BASE, time_rate: float = 1.0
    ) -> Run:
        """Run; None sends no twist."""
        for _ in range(round(duration_s / TICK_S)):
            now = self.tick * TICK_NS
            if twist is not None and self.tick % 10 == 0:
                self.jog.add(np.array(twist), frame, Stamped(now, now, 0))
            motion = self.jog.advance(now, TICK_S, time_rate)
            self.poses.append(motion.pose_sd)
            self.twists.append(motion.twist_d)
            self.tick += 1
        return self


def in_base(pose: Array, twist_d: Array) -> Array:
    """Velocity of the origin and angular velocity, in {s}."""
    rotation = pose[:3, :3]
    return np.concatenate((rotation @ twist_d[:3], rotation @ twist_d[3:]))


def test_the_twist_is_in_the_axes_of_its_frame() -> None:
    turn = se3.exp_rotation(np.array([0.3, 1.0, -0.4]))
    wanted = (0.05, -0.02, 0.1, 0.1, 0.2, -0.3)
    for frame, axes in ((BASE, np.eye(3)), (TwistFrame(turn, False), turn)):
        run = Run().go(2.0, wanted, frame)
        found = in_base(run.poses[-1], run.twists[-1])
        assert np.abs(found - np.concatenate((axes @ wanted[:3], axes @ wanted[3:]))).max() < 2e-4
    run = Run().go(2.0, wanted, TwistFrame(turn, True))
    assert np.abs(run.twists[-1] - np.concatenate((turn @ wanted[:3], turn @ wanted[3:]))).max() < 2e-3


def test_each_twist_leads_from_pose_to_pose() -> None:
    run = Run().go(1.0, (0.1, 0.0, -0.05, 0.5, 0.3, -0.4)).go(1.0, None)
    for pose, twist, after in zip(run.poses, run.twists, run.poses[1:], strict=False):
        assert np.abs(pose @ se3.exp(twist * TICK_S) - after).max() < 1e-12


def test_speed_acceleration_and_jerk_are_bounded() -> None:
    run = Run()
    for direction in (1.0, -1.0, 1.0):
        run.go(0.7, (2.0 * direction, 1.0, 0.0, 0.0, 5.0 * direction, 0.0))
    run.go(1.0, None)
    twists = np.array([in_base(pose, twist) for pose, twist in zip(run.poses, run.twists, strict=True)])
    bounds = (
        (0, *BOUNDS.linear[:3]),
        (3, *BOUNDS.angular[:3]),
    )
    for begin, speed, acceleration, jerk in bounds:
        velocity = twists[:, begin : begin + 3]
        assert np.linalg.norm(velocity, axis=1).max() <= speed * 1.001
        rates = np.diff(velocity, axis=0) / TICK_S
        assert np.linalg.norm(rates, axis=1).max() <= acceleration * 1.001
        assert np.linalg.norm(np.diff(rates, axis=0), axis=1).max() / TICK_S <= jerk * 1.01
    assert run.jog.ended


def test_what_is_too_fast_is_cut_and_keeps_its_direction() -> None:
    run = Run().go(1.0, (1.0, 2.0, -2.0, 0.0, 0.0, 0.3))
    assert run.jog.clamped
    found = in_base(run.poses[-1], run.twists[-1])
    assert np.abs(found[:3] - BOUNDS.linear.speed * np.array([1.0, 2.0, -2.0]) / 3.0).max() < 1e-3
    assert found[5] == pytest.approx(0.3, abs=1e-3)
    assert not run.go(0.1, (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)).jog.clamped


def test_silence_for_the_timeout_and_a_twist_of_zero_bring_it_to_rest() -> None:
    for silence in (None, (0.0,) * 6):
        run = Run().go(1.0, (0.2, 0.0, 0.0, 0.0, 0.0, 0.5))
        run.go(1.5, silence)
        assert np.abs(run.twists[-1]).max() < 1e-6
        assert run.jog.ended == (silence is None)


def test_it_goes_no_further_than_the_arm() -> None:
    free, slow = (
        Run().go(1.0, (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)),
        Run().go(1.0, (0.2, 0.0, 0.0, 0.0, 0.0, 0.0), time_rate=0.25),
    )
    way_free, way_slow = (run.poses[-1][:3, 3] - START[:3, 3] for run in (free, slow))
    assert np.abs(way_slow - 0.25 * way_free).max() < 1e-9


def test_the_reference_waits_for_a_tool_that_cannot_follow() -> None:
    run = Run()
    stuck = START.copy()
    for _ in range(1000):
        now = run.tick * TICK_NS
        run.jog.add(np.array([0.2, 0.0, 0.0, 0.0, 0.8, 0.0]), BASE, Stamped(now, now, 0))
        pose = run.jog.advance(now, TICK_S, 1.0, stuck).pose_sd
        run.tick += 1
    assert run.jog.lead_limited
    assert np.linalg.norm(pose[:3, 3] - stuck[:3, 3]) < 2.5 * LEAD_LIMIT.distance
    assert np.linalg.norm(se3.log_rotation(stuck[:3, :3].T @ pose[:3, :3])) < 2.5 * LEAD_LIMIT.angle
    lead = pose[0, 3] - stuck[0, 3]
    for _ in range(50):
        now = run.tick * TICK_NS
        run.jog.add(np.array([-0.2, 0.0, 0.0, 0.0, 0.0, 0.0]), BASE, Stamped(now, now, 0))
        pose = run.jog.advance(now, TICK_S, 1.0, stuck).pose_sd
        run.tick += 1
    assert pose[0, 3] - stuck[0, 3] < lead - 0.005, "motion back is free at once"


# --- with arms -------------------------------------------------------------------------------------------------------


def frames_at(robot: Robot, q: Array) -> Frames:
    """Return the frames of the model at q."""
    frames = Frames(robot)
    frames.position = q
    return frames


class ArmRun:
    """Jog, feedback on the twist and pseudoinverse, at 500 Hz."""

    def __init__(self, robot: Robot, start: tuple[float, ...]) -> None:
        self.robot, self.q, self.jog = robot, np.array(start), Jog(SETTINGS)
        pose = robot.pose(self.q)
        x, y, z = pose[:3, 3].tolist()
        self.jog.begin(RigidMotion((x, y, z), orientation=from_matrix(pose)), 0)
        self.velocity, self.tick = np.zeros(robot.n), 0

    def step(self, twist: Array, frame: str) -> Array:
        now = self.tick * TICK_NS
        if self.tick % 10 == 0:
            self.jog.add(twist, twist_frame(self.robot, frames_at(self.robot, self.q), frame), Stamped(now, now, 0))
        pose = self.robot.pose(self.q)
        law = twist_feedback(pose, self.jog.advance(now, TICK_S, 1.0, pose), ControlSettings())
        jacobian = self.robot.evaluate(self.q + 0.5 * TICK_S * self.velocity).jacobian_b
        self.velocity = np.linalg.pinv(jacobian) @ law.twist_b
        self.q = self.q + TICK_S * self.velocity
        self.tick += 1
        return self.robot.pose(self.q)


@pytest.mark.parametrize(("name", "axis"), [("panda", 0), ("panda", 1), ("ur5", 2)])
@pytest.mark.parametrize("in_tool", [False, True])
def test_a_turn_alone_keeps_the_tool_point_within_a_tenth_of_a_millimetre_over_90_degrees(
    name: str, axis: int, in_tool: bool
) -> None:
    robot = make_robot(name)
    run = ArmRun(robot, READY[name])
    start = robot.pose(run.q)
    twist = np.zeros(6)
    twist[3 + axis] = 0.5 if name == "ur5" else -0.5
    frame = robot.tip_frame if in_tool else robot.base_frame
    angle, moved = 0.0, 0.0
    for _ in range(3000):
        pose = run.step(twist, frame)
        angle = float(np.linalg.norm(se3.log_rotation(start[:3, :3].T @ pose[:3, :3])))
        moved = max(moved, float(np.linalg.norm(pose[:3, 3] - start[:3, 3])))
        if angle > np.pi / 2:
            break
    assert angle > np.pi / 2
    assert moved < 0.1e-3


def test_frames_of_the_model_are_taken_where_they_are() -> None:
    robot = make_robot("panda")
    q = np.array(READY["panda"]) + 0.2
    fixed = twist_frame(robot, frames_at(robot, q), "panda_link2")
    assert not fixed.in_tool
    assert np.abs(fixed.rotation - robot.frame_pose(q, "panda_link2")[:3, :3]).max() < 1e-12
    moving = twist_frame(robot, frames_at(robot, q), "panda_link8")
    assert moving.in_tool
    expected = robot.pose(q)[:3, :3].T @ robot.frame_pose(q, "panda_link8")[:3, :3]
    assert np.abs(moving.rotation - expected).max() < 1e-12
