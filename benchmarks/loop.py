"""The control step of the node in a minimal closed loop: a target known exactly and an ideal arm, in simulated time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from ik_node.control.feedback import twist_feedback
from ik_node.differential_ik import constrained
from ik_node.differential_ik.closed_form import resolve
from ik_node.differential_ik.solution import ArmState, DifferentialIkSolution
from ik_node.differential_ik.solver import NO_PAIR, DifferentialIkSolver
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.joint_limits import joint_bounds, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ControlSettings, Settings

PERIOD_S = 0.002
LENGTH = 0.3
ROW_SCALE = np.repeat((1.0, LENGTH), 3)
CONTROL = ControlSettings()


class PoseTarget(Protocol):
    """A pose as a function of time."""

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""


TwistSolver = Callable[[ArmState, Array], DifferentialIkSolution]
"""(arm state, V) -> solution, as :meth:`DifferentialIkSolver.solve_twist`; may have internal state."""


def settings_of(acceleration: tuple[float, ...], values: Mapping[str, Any] = MappingProxyType({})) -> Settings:
    """Return default settings at 500 Hz without self-collision, with these accelerations and other ``values``."""
    chosen = {"rate_hz": 1.0 / PERIOD_S, "obstacles.self_collision": False, "limits.acceleration": acceleration}
    return Settings().with_values({**chosen, **values})


def ours(robot: Robot, settings: Settings) -> TwistSolver:
    """Solver of the node."""
    return DifferentialIkSolver(robot, settings).solve_twist


def exact(robot: Robot, settings: Settings) -> TwistSolver:
    """First prototype: V is only scaled by the limits; singularities are not treated."""
    return _without_regulation(robot, settings, lambda jacobian, twist: (jacobian, twist))


def faded(robot: Robot, settings: Settings) -> TwistSolver:
    """Second prototype: singular directions below 0.05 m are faded out."""

    def fade(jacobian: Array, twist: Array) -> tuple[Array, Array]:
        u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * jacobian, full_matrices=False)
        wanted = resolve(jacobian, twist, threshold=0.05, row_scale=ROW_SCALE, checked=True)
        safe = ((u * np.maximum(sigma, 1e-6)) @ rows) / ROW_SCALE[:, None]
        return safe, safe @ wanted.task_velocity

    return _without_regulation(robot, settings, fade)


def _without_regulation(
    robot: Robot, settings: Settings, modify: Callable[[Array, Array], tuple[Array, Array]]
) -> TwistSolver:
    """Solver under limits for the J and V that ``modify`` returns, without regulation of singularities."""
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz)
    nothing, unknown = np.zeros(6), np.full(6, np.nan)

    def way(arm_state: ArmState, twist_b: Array) -> DifferentialIkSolution:
        bounds = joint_bounds(limits, arm_state.q, arm_state.previous, arm_state.elapsed_s)
        jacobian = robot.evaluate(arm_state.q_middle).jacobian_b
        answer = constrained.solve(*modify(jacobian, twist_b), bounds.lo, bounds.hi, row_scale=ROW_SCALE)
        sigma = np.asarray(np.linalg.svd(ROW_SCALE[:, None] * jacobian, compute_uv=False))
        off = jacobian @ answer.joint_velocity - answer.task_scale * twist_b
        return DifferentialIkSolution(
            answer.joint_velocity, answer.task_scale, 1.0, nothing, off, (), unknown, unknown, sigma, (), (), NO_PAIR
        )

    return way


class LoopRun(NamedTuple):
    """A run of k control steps; one row per step."""

    time_s: Array
    q: Array
    qd: Array
    pose: Array
    """Tool poses, (k, 4, 4)."""
    task_scale: Array
    """s, (k,)."""
    sigma: Array
    error_m: Array
    error_rad: Array


def follow(
    robot: Robot,
    target: PoseTarget,
    q: Array,
    way: TwistSolver,
    duration_s: float,
    control: ControlSettings = CONTROL,
    observe: Callable[[ArmState], None] = lambda arm_state: None,
) -> LoopRun:
    """Follow ``target`` from rest at ``q`` with an ideal arm at 500 Hz; ``observe`` is called before every step."""
    q, qd = q.copy(), np.zeros(robot.n)
    rows = []
    for tick in range(round(duration_s / PERIOD_S)):
        time_s = tick * PERIOD_S
        pose_sd = target.pose(time_s)
        twist_d = se3.log(se3.inverse(pose_sd) @ target.pose(time_s + PERIOD_S)) / PERIOD_S
        pose_sb = robot.pose(q)
        feedback = twist_feedback(pose_sb, Motion(pose_sd, twist_d), control)
        arm_state = ArmState(q, q + 0.5 * PERIOD_S * qd, qd, PERIOD_S, round(time_s * NS))
        observe(arm_state)
        solution = way(arm_state, feedback.twist_b)
        qd, error = solution.joint_velocity, feedback.error_b
        lengths = (float(np.sqrt(e @ e)) for e in (error[:3], error[3:]))
        rows.append((time_s, q, qd, pose_sb, solution.task_scale, solution.singular_values[-1], *lengths))
        q = q + PERIOD_S * qd
    return LoopRun(*(np.array(column) for column in zip(*rows, strict=True)))


def sign_changes(qd: Array, least: float = 0.02) -> int:
    """Return the largest number of sign changes of a joint velocity; speeds below ``least`` rad/s do not count."""
    most = 0
    for column in qd.T:
        moving = np.sign(column[np.abs(column) > least])
        most = max(most, int(np.count_nonzero(moving[1:] != moving[:-1])))
    return most


def path_error(target: PoseTarget, duration_s: float, poses: Array) -> tuple[float, float]:
    """Return the largest distance of ``poses`` (k, 4, 4) from the geometric path, m and rad."""
    path = np.array([target.pose(time_s) for time_s in np.linspace(0.0, duration_s, 1500)])
    worst = np.zeros(2)
    for pose in poses:
        apart = np.sqrt(((path[:, :3, 3] - pose[:3, 3]) ** 2).sum(axis=1))
        trace = np.einsum("kij,ij->k", path[:, :3, :3], pose[:3, :3])
        angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
        nearest = int(np.argmin(apart**2 + (LENGTH * angle) ** 2))
        worst = np.maximum(worst, (apart[nearest], angle[nearest]))
    return float(worst[0]), float(worst[1])
