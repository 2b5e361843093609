"""The node's tick in the smallest closed loop: a target known exactly, an ideal arm. Shared by the benchmarks of limits
and obstacles, and by their tests. Everything is an argument; nothing here reads a clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from ik_node.control.feedback import twist_feedback
from ik_node.differential_ik import constrained
from ik_node.differential_ik.closed_form import resolve
from ik_node.differential_ik.solution import Moment, Outcome
from ik_node.differential_ik.solver import NOTHING_SEEN, TickSolver
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


class Target(Protocol):
    """A pose for every time."""

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""


Way = Callable[[Moment, Array], Outcome]
"""(arm, V) -> what is commanded, as :meth:`TickSolver.follow_twist`; may keep a state of its own."""


def settings_of(acceleration: tuple[float, ...], values: Mapping[str, Any] = MappingProxyType({})) -> Settings:
    """The defaults at 500 Hz with these accelerations and other parameters; self-collision is not watched."""
    chosen = {"rate_hz": 1.0 / PERIOD_S, "obstacles.self_collision": False, "limits.acceleration": acceleration}
    return Settings().with_values({**chosen, **values})


def ours(robot: Robot, settings: Settings) -> Way:
    """The tick of the node."""
    return TickSolver(robot, settings).follow_twist


def exact(robot: Robot, settings: Settings) -> Way:
    """The first prototype: V as it is, slowed down by the limits alone."""
    return _unpassed(robot, settings, lambda jacobian, twist: (jacobian, twist))


def faded(robot: Robot, settings: Settings) -> Way:
    """The second prototype: directions fade out below 0.05 m, whatever they would have cost."""

    def fade(jacobian: Array, twist: Array) -> tuple[Array, Array]:
        u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * jacobian, full_matrices=False)
        wanted = resolve(jacobian, twist, threshold=0.05, row_scale=ROW_SCALE, checked=True)
        safe = ((u * np.maximum(sigma, 1e-6)) @ rows) / ROW_SCALE[:, None]
        return safe, safe @ wanted.task_velocity

    return _unpassed(robot, settings, fade)


def _unpassed(robot: Robot, settings: Settings, ask: Callable[[Array, Array], tuple[Array, Array]]) -> Way:
    """The bounded problem of what ``ask`` makes of J and V, without the node's passage of singularities."""
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz)
    nothing, unknown = np.zeros(6), np.full(6, np.nan)

    def way(moment: Moment, twist_b: Array) -> Outcome:
        bounds = joint_bounds(limits, moment.q, moment.previous, moment.elapsed_s)
        jacobian = robot.evaluate(moment.q_middle).jacobian_b
        answer = constrained.solve(*ask(jacobian, twist_b), bounds.lo, bounds.hi, row_scale=ROW_SCALE)
        sigma = np.asarray(np.linalg.svd(ROW_SCALE[:, None] * jacobian, compute_uv=False))
        return Outcome(answer.joint_velocity, answer.scale, 1.0, nothing, unknown, unknown, sigma, (), (), NOTHING_SEEN)

    return way


class Run(NamedTuple):
    """What happened, one row per tick."""

    time_s: Array
    q: Array
    qd: Array
    pose: Array
    """Tool poses, (ticks, 4, 4)."""
    pace: Array
    """s of the Step: the part of V that was done."""
    sigma: Array
    error_m: Array
    error_rad: Array


def follow(
    robot: Robot,
    target: Target,
    q: Array,
    way: Way,
    duration_s: float,
    control: ControlSettings = CONTROL,
    seen: Callable[[Moment], None] = lambda moment: None,
) -> Run:
    """Follows ``target`` from rest at ``q`` with an ideal arm at 500 Hz; ``seen`` is told of every tick first."""
    q, qd = q.copy(), np.zeros(robot.n)
    rows = []
    for tick in range(round(duration_s / PERIOD_S)):
        time_s = tick * PERIOD_S
        pose_sd = target.pose(time_s)
        twist_d = se3.log(se3.inverse(pose_sd) @ target.pose(time_s + PERIOD_S)) / PERIOD_S
        pose_sb = robot.pose(q)
        law = twist_feedback(pose_sb, Motion(pose_sd, twist_d), control)
        moment = Moment(q, q + 0.5 * PERIOD_S * qd, qd, PERIOD_S, round(time_s * NS))
        seen(moment)
        outcome = way(moment, law.twist_b)
        qd, error = outcome.joint_velocity, law.error_b
        lengths = (float(np.sqrt(e @ e)) for e in (error[:3], error[3:]))
        rows.append((time_s, q, qd, pose_sb, outcome.scale, outcome.singular_values[-1], *lengths))
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
