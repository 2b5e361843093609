"""Shapes: exactly at the start pose, at rest at both ends, smooth between them, and feasible for two arms.

Smoothness is checked by finite differences on fine grids; feasibility by following each shape with the exact inverse of
the arm's Jacobian. Not tested here: how a controller follows them.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from ik_node.errors import InputError
from ik_node.interfaces.motion import Trajectory
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.trajectory import shapes

STARTS = {
    "panda": (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4),
    "ur5": (0.0, -1.2, 1.6, -1.97, -1.57, 0.0),
}


def start_pose() -> Array:
    pose = se3.exp(np.array([0.4, -0.2, 0.3, 2.0, 1.0, -0.5]))
    return pose


def coordinates(trajectory: Trajectory, times: Array) -> Array:
    """(N, 6): displacement and rotation vector from the first pose."""
    first = trajectory.pose(0.0)
    rows = []
    for time in times:
        pose = trajectory.pose(float(time))
        turn = se3.log_rotation(first[:3, :3].T @ pose[:3, :3])
        rows.append(np.concatenate((pose[:3, 3] - first[:3, 3], turn)))
    return np.array(rows)


def robot(name: str) -> Robot:
    arm = catalogue.find(name)
    return Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)


@pytest.mark.parametrize("name", shapes.SHAPES)
def test_begins_at_the_start_pose_and_holds_its_ends(name: str) -> None:
    """A demonstration starts at the pose of the arm; before and after, nothing moves. The start pose is equal bit for
    bit."""
    trajectory = shapes.SHAPES[name](start_pose())
    assert np.abs(trajectory.pose(0.0) - start_pose()).max() < 1e-15
    assert (trajectory.pose(-1.0) == trajectory.pose(0.0)).all()
    assert (trajectory.pose(trajectory.duration_s + 1.0) == trajectory.pose(trajectory.duration_s)).all()


@pytest.mark.parametrize("name", shapes.SHAPES)
def test_three_derivatives_are_continuous_and_vanish_at_the_ends(name: str) -> None:
    """A jump of the n-th derivative shows as a difference between neighbouring finite differences that does not
    decrease with the grid spacing; for a continuous derivative it decreases. The grids extend beyond both ends, where
    nothing moves."""
    trajectory = shapes.SHAPES[name](start_pose())

    def largest_step(dt: float, order: int) -> float:
        times = np.arange(-8 * dt, trajectory.duration_s + 8 * dt, dt)
        derivative = np.diff(coordinates(trajectory, times), n=order, axis=0) / dt**order
        return float(np.abs(np.diff(derivative, axis=0)).max())

    for order in (1, 2, 3):
        coarse, fine = largest_step(0.02, order), largest_step(0.01, order)
        assert fine <= 0.62 * coarse + 1e-7


@pytest.mark.parametrize(("arm", "name"), list(itertools.product(STARTS, shapes.SHAPES)))
def test_within_the_reach_and_limits_of_two_arms(arm: str, name: str) -> None:
    """Following a shape exactly keeps velocities under half of the URDF's limits, joints 0.3 rad inside theirs, and the
    smallest singular value (angular rows times 0.3 m) above 0.1 m: five times where directions begin to fade."""
    model, dt = robot(arm), 0.01
    q = np.array(STARTS[arm])
    trajectory = shapes.SHAPES[name](model.pose(q))
    for time in np.arange(0.0, trajectory.duration_s, dt):
        kinematics = model.evaluate(q)
        weighted = kinematics.jacobian_b * np.array([[1.0]] * 3 + [[0.3]] * 3)
        assert np.linalg.svd(weighted, compute_uv=False)[-1] > 0.1
        twist = se3.log(se3.inverse(kinematics.pose_sb) @ trajectory.pose(float(time) + dt)) / dt
        velocity = np.linalg.pinv(kinematics.jacobian_b) @ twist
        assert (np.abs(velocity) < 0.5 * model.limits.velocity).all()
        q = q + dt * velocity
        assert ((q > model.limits.lower + 0.3) & (q < model.limits.upper - 0.3)).all()
    assert np.abs(model.pose(q) - trajectory.pose(trajectory.duration_s)).max() < 1e-3


def test_the_usual_demonstration_is_what_it_says() -> None:
    """Size, length and peaks of the default figure of eight, as its docstring states them."""
    trajectory = shapes.figure_of_eight(start_pose())
    times = np.arange(0.0, 10.0, 0.005)
    path = coordinates(trajectory, times)
    speed = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1) / 0.005
    acceleration = np.linalg.norm(np.diff(path[:, :3], n=2, axis=0), axis=1) / 0.005**2
    assert trajectory.duration_s == pytest.approx(10.0)
    assert np.ptp(path, axis=0)[:3] == pytest.approx([0.0, 0.30, 0.15], abs=1e-4)
    assert (speed.max(), acceleration.max()) == (pytest.approx(0.167, abs=0.002), pytest.approx(0.2, abs=0.005))
    assert 0.3 < np.linalg.norm(path[:, 3:], axis=1).max() < 0.6


def test_the_phase_is_the_integral_of_its_rate() -> None:
    """The closed form of the ramp against numerical quadrature of the quintic, and the exact total."""
    timing = shapes.Cruise(total=2.0 * math.pi, rate=0.8, ramp_s=1.5)

    def rate(time_s: float) -> float:
        u = min(max(time_s, 0.0) / 1.5, 1.0)
        return 0.8 * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)

    for time_s in (0.2, 0.9, 1.5, 3.0):
        assert timing.phase(time_s) == pytest.approx(quad(rate, 0.0, time_s, points=[min(time_s, 1.5)])[0], abs=1e-12)
    assert timing.phase(timing.duration_s) == 2.0 * math.pi
    assert timing.phase(0.5 * timing.duration_s) == pytest.approx(math.pi, abs=1e-14)


@pytest.mark.parametrize(
    ("shift", "turn"), [(0.5, 0.1), (0.02, 0.1), (0.01, 1.5), (0.0, 0.2), (1e-4, 0.0)], ids=lambda value: f"{value:g}"
)
def test_a_line_is_as_fast_as_its_bounds_allow(shift: float, turn: float) -> None:
    """For each of the four bounds, its peak is reached and no other is exceeded: long, short, turning lines."""
    end = start_pose() @ se3.exp(np.array([0.0, shift, 0.0, 0.0, 0.0, 0.0]))
    end[:3, :3] = end[:3, :3] @ se3.exp_rotation(np.array([turn, 0.0, 0.0]))
    line = shapes.straight_line(start_pose(), end, 0.2, 0.5, 0.3, 1.0)
    dt = line.duration_s / 2000
    path = coordinates(line, np.arange(0.0, line.duration_s + dt, dt))
    used = [
        np.linalg.norm(np.diff(part, n=order, axis=0), axis=1).max() / dt**order / bound
        for part, order, bound in (
            (path[:, :3], 1, 0.2),
            (path[:, 3:], 1, 0.5),
            (path[:, :3], 2, 0.3),
            (path[:, 3:], 2, 1.0),
        )
    ]
    assert max(used) == pytest.approx(1.0, abs=2e-3)
    assert np.abs(line.pose(line.duration_s) - end).max() < 1e-12


def test_a_line_turns_the_short_way_and_may_be_no_line_at_all() -> None:
    """More than half a turn takes the other sense; between equal ends nothing moves and the duration is zero."""
    start = start_pose()
    end = start.copy()
    end[:3, :3] = start[:3, :3] @ se3.exp_rotation(np.array([0.0, 0.0, 1.5 * math.pi]))
    middle = shapes.StraightLine(start, end, 1.0).pose(0.5)
    half = se3.log_rotation(start[:3, :3].T @ middle[:3, :3])
    assert half == pytest.approx([0.0, 0.0, -0.25 * math.pi], abs=1e-12)
    still = shapes.straight_line(start, start)
    assert still.duration_s < 1e-6
    assert np.abs(still.pose(0.0) - start).max() < 1e-12


def test_a_sequence_runs_its_parts_and_refuses_a_jump() -> None:
    """Each part at its own time, the ends held; parts that do not meet are refused."""
    line = shapes.there_and_back(start_pose())
    eight = shapes.figure_of_eight(start_pose())
    both = shapes.sequence(line, shapes.hold(start_pose(), 0.0), eight)
    assert both.duration_s == pytest.approx(line.duration_s + eight.duration_s)
    for time_s in (0.0, 1.0, line.duration_s, line.duration_s + 3.3, both.duration_s, 99.0):
        part = line.pose(time_s) if time_s < line.duration_s else eight.pose(time_s - line.duration_s)
        assert np.abs(both.pose(time_s) - part).max() < 1e-9
    moved = start_pose()
    moved[0, 3] += 1e-3
    with pytest.raises(InputError, match=r"part 2 begins 0\.001 m"):
        shapes.sequence(line, shapes.hold(moved))
    with pytest.raises(InputError, match="at least one"):
        shapes.sequence()


def test_refuses_what_makes_no_motion() -> None:
    """Each argument that would give a jump or a value that is not finite is refused by its name."""
    pose = start_pose()
    with pytest.raises(InputError, match="ramp_s"):
        shapes.figure_of_eight(pose, ramp_s=9.0)
    with pytest.raises(InputError, match="width"):
        shapes.figure_of_eight(pose, width=math.nan)
    with pytest.raises(InputError, match="period_s"):
        shapes.circle(pose, period_s=0.0)
    with pytest.raises(InputError, match="turns"):
        shapes.circle(pose, turns=0)
    with pytest.raises(InputError, match="linear_speed"):
        shapes.straight_line(pose, pose, linear_speed=-1.0)
    with pytest.raises(InputError, match="duration_s"):
        shapes.hold(pose, -1.0)
    with pytest.raises(InputError, match="start_pose"):
        shapes.circle(np.full((4, 4), math.nan))
