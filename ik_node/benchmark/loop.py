"""A closed loop in the smallest form: target, twist, singularities, limits, an ideal arm. Shared by the benchmarks of
limits and obstacles, and by their tests. Everything is an argument; nothing here reads a clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from ik_node import bounded, se3
from ik_node.arrival import arriving
from ik_node.control_law import twist_feedback
from ik_node.limits import JointBounds, MotionLimits, joint_bounds
from ik_node.resolution import resolve
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import ControlSettings, SingularitySettings
from ik_node.singularity import START, PassageState, pass_singularities
from ik_node.trajectory.motion import Motion

PERIOD_S = 0.002
LENGTH = 0.3
ROW_SCALE = np.repeat((1.0, LENGTH), 3)
CONTROL = ControlSettings()


class Target(Protocol):
    """A pose for every time."""

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""


class Request(NamedTuple):
    """What the bounded problem is to solve."""

    jacobian: Array
    twist: Array
    pace: float
    sigma: float


Passing = Callable[[Robot, Array, Array, Array, Array, JointBounds, MotionLimits, float], Request]
"""(robot, q, J, V, command that stands, box, limits, s before) -> what to solve; may keep a state of its own."""


def ours(settings: SingularitySettings | None = None) -> Passing:
    """The package's own way past singularities."""
    chosen = SingularitySettings() if settings is None else settings
    state: list[PassageState] = [START]

    def passing(
        robot: Robot,
        q: Array,
        jacobian: Array,
        twist: Array,
        previous: Array,
        bounds: JointBounds,
        limits: MotionLimits,
        scale: float,
    ) -> Request:
        found = pass_singularities(
            lambda p: robot.evaluate(p).jacobian_b,
            q,
            jacobian,
            twist,
            previous,
            bounds,
            limits,
            ROW_SCALE,
            chosen,
            state[0],
            PERIOD_S,
            scale,
        )
        state[0] = found.state
        return Request(found.jacobian, found.twist, found.pace, float(found.singular_values[-1]))

    return passing


def exact(
    robot: Robot,
    q: Array,
    jacobian: Array,
    twist: Array,
    previous: Array,
    bounds: JointBounds,
    limits: MotionLimits,
    scale: float,
) -> Request:
    """The first prototype: V as it is, slowed down by the limits alone."""
    del robot, q, previous, bounds, limits, scale
    sigma = np.linalg.svd(ROW_SCALE[:, None] * jacobian, compute_uv=False)
    return Request(jacobian, twist, 1.0, float(sigma[-1]))


def faded(threshold: float) -> Passing:
    """The second prototype: directions fade out below ``threshold``, whatever they would have cost."""

    def passing(
        robot: Robot,
        q: Array,
        jacobian: Array,
        twist: Array,
        previous: Array,
        bounds: JointBounds,
        limits: MotionLimits,
        scale: float,
    ) -> Request:
        del robot, q, previous, bounds, limits, scale
        u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * jacobian, full_matrices=False)
        wanted = resolve(jacobian, twist, threshold=threshold, row_scale=ROW_SCALE, checked=True)
        raised = np.maximum(sigma, 1e-6)
        safe = ((u * raised) @ rows) / ROW_SCALE[:, None]
        return Request(safe, safe @ wanted.task_velocity, 1.0, float(sigma[-1]))

    return passing


class Run(NamedTuple):
    """What happened, one row per tick."""

    time_s: Array
    q: Array
    qd: Array
    pose: Array
    """Tool poses, (ticks, 4, 4)."""
    pace: Array
    """Part of V that was done: pace of the passage times s."""
    sigma: Array
    error_m: Array
    error_rad: Array


def follow(
    robot: Robot, target: Target, q: Array, limits: MotionLimits, duration_s: float, passing: Passing | None = None
) -> Run:
    """Follows ``target`` from rest at ``q`` with an ideal arm at 500 Hz, ``plain``."""
    way = ours() if passing is None else passing
    q, qd, scale = q.copy(), np.zeros(robot.n), 1.0
    rows = []
    for tick in range(round(duration_s / PERIOD_S)):
        time_s = tick * PERIOD_S
        pose_sd = target.pose(time_s)
        twist_d = se3.log(se3.inverse(pose_sd) @ target.pose(time_s + PERIOD_S)) / PERIOD_S
        state = robot.evaluate(q)
        law = twist_feedback(state.pose_sb, Motion(pose_sd, twist_d), CONTROL)
        feedback = law.twist_b - law.feedforward_b
        feedback = arriving(state.jacobian_b, law.error_b, feedback, limits, ROW_SCALE, 0.05)
        bounds = joint_bounds(limits, q, qd, PERIOD_S)
        asked = way(robot, q, state.jacobian_b, law.feedforward_b + feedback, qd, bounds, limits, scale)
        answer = bounded.solve(asked.jacobian, asked.twist, bounds.lo, bounds.hi, row_scale=ROW_SCALE)
        qd, scale = answer.joint_velocity, answer.scale
        error = law.error_b
        rows.append(
            (
                time_s,
                q,
                qd,
                state.pose_sb,
                asked.pace * scale,
                asked.sigma,
                *(np.sqrt(e @ e) for e in (error[:3], error[3:])),
            )
        )
        q = q + PERIOD_S * qd
    return Run(*(np.array(column) for column in zip(*rows, strict=True)))


def sign_changes(qd: Array, least: float = 0.02) -> int:
    """How often the joint that does it most turns round, rests and motions below ``least`` rad/s not counted."""
    most = 0
    for column in qd.T:
        moving = np.sign(column[np.abs(column) > least])
        most = max(most, int(np.count_nonzero(moving[1:] != moving[:-1])))
    return most


def path_error(target: Target, duration_s: float, poses: Array) -> tuple[float, float]:
    """Largest distance of ``poses`` (k, 4, 4) from the geometric path, whatever the time: m, rad."""
    path = np.array([target.pose(time_s) for time_s in np.linspace(0.0, duration_s, 1500)])
    worst = np.zeros(2)
    for pose in poses:
        apart = np.sqrt(((path[:, :3, 3] - pose[:3, 3]) ** 2).sum(axis=1))
        trace = np.einsum("kij,ij->k", path[:, :3, :3], pose[:3, :3])
        angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
        nearest = int(np.argmin(apart**2 + (LENGTH * angle) ** 2))
        worst = np.maximum(worst, (apart[nearest], angle[nearest]))
    return float(worst[0]), float(worst[1])
