"""Stress targets against joint limits: an ideal arm, starts outside limits, lag and noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.arms import ROBOTS, arm, random_position
from benchmarks.loop import CONTROL, PERIOD_S, settings_of
from benchmarks.sections import SectionResult
from ik_node.control.feedback import twist_feedback
from ik_node.differential_ik.solution import ArmState
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.math.se3 import checked_pose
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, joint_bounds, stopping_distance
from ik_node.robot.robot import Robot

LIMIT_TOLERANCE = 1e-9
"""Largest excess of a limit that counts as rounding, in the unit of the limit."""


class LimitStatistics(NamedTuple):
    """Counts of one run, and the largest excess of each kind of limit (0 or less: none was exceeded)."""

    ticks: int
    position: float
    velocity: float
    acceleration: float
    infeasible: int
    """Control steps in which a limit was relaxed or an error was raised."""
    refused: int
    """Refused targets, with NaN."""
    at_limits: int
    """Control steps with a joint within 1e-6 rad of a position limit."""
    slowed: int
    """Control steps with s < 1."""


def stress_pose(robot: Robot, rng: np.random.Generator, q: Array) -> Array:
    """Draw a target: reachable, out of reach, 10 mm away, upside down, or with NaN."""
    kind = rng.integers(5)
    if kind == 0:
        return robot.pose(random_position(robot, rng))
    pose = robot.pose(random_position(robot, rng) if kind == 1 else q)
    if kind == 1:
        pose[:3, 3] *= rng.uniform(1.0, 5.0)
    elif kind == 2:
        pose[:3, 3] += 0.01 * rng.normal(size=3)
    elif kind == 3:
        pose[:3, :3] = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    else:
        pose[rng.integers(3), rng.integers(4)] = np.nan
    return pose


def stress(name: str, ticks: int, seed: int, acceleration: float) -> LimitStatistics:
    """Run ``ticks`` control steps of one robot with the solver of the node; restart at rest every 20,000 steps."""
    robot, rng = arm(name), np.random.default_rng([seed, *name.encode()])
    solver = DifferentialIkSolver(robot, settings_of((acceleration,)))
    limits = solver.limits
    position = velocity = change = -np.inf
    infeasible = refused = at_limits = slowed = 0
    q, qd, held_s, pose_sd, twist_d, until = np.zeros(robot.n), np.zeros(robot.n), PERIOD_S, np.eye(4), np.zeros(6), 0
    now_s = 0.0
    for tick in range(ticks):
        if tick % 20_000 == 0:
            q, qd, held_s, until = random_position(robot, rng), np.zeros(robot.n), PERIOD_S, tick
            pose_sd, twist_d = robot.pose(q), np.zeros(6)
            solver.reset()
        if tick >= until:
            until = tick + int(rng.integers(1, 400))
            try:
                pose_sd = checked_pose(stress_pose(robot, rng, q))
                twist_d = rng.normal(size=6) * rng.choice([0.0, 0.3, 10.0])
            except IkNodeError:
                refused += 1
        twist = twist_feedback(robot.pose(q), Motion(pose_sd, twist_d), CONTROL).twist_b
        arm_state = ArmState(q, q + 0.5 * PERIOD_S * qd, qd, held_s, round(now_s * NS))
        try:
            solution = solver.solve_twist(arm_state, twist)
        except IkNodeError:
            infeasible += 1
            qd = np.zeros(robot.n)
            continue
        infeasible += bool(solution.relaxed)
        slowed += solution.task_scale < 1.0
        change = max(change, float((np.abs(solution.joint_velocity - qd) - limits.acceleration * held_s).max()))
        qd = solution.joint_velocity
        velocity = max(velocity, float((np.abs(qd) - limits.velocity).max()))
        held_s = PERIOD_S * float(rng.choice([0.2, 0.5, 1.0, 1.0, 2.0, 5.0]))
        now_s += held_s
        q = q + held_s * qd
        beyond = float(np.maximum(q - limits.upper, limits.lower - q).max())
        position = max(position, beyond)
        at_limits += beyond > -1e-6
    return LimitStatistics(ticks, position, velocity, change, infeasible, refused, int(at_limits), int(slowed))


def table(ticks: int, seed: int = 1, robots: Sequence[str] = ROBOTS) -> SectionResult:
    """Run ``ticks`` control steps over all ``robots`` and accelerations; no limit may be exceeded."""
    lines = [
        f"{ticks} control steps with stress targets: jumps, out of reach, upside down, NaN; holds of 0.2 to 5 periods",
        "robot        rad/s2    ticks  largest excess of position  velocity  acceleration   infeasible  NaN refused  "
        "at a limit  s < 1",
    ]
    good, accelerations, rows = True, (2.0, 10.0, 50.0), list[dict[str, Any]]()
    each = max(1, ticks // (len(robots) * len(accelerations)))
    for name in robots:
        for acceleration in accelerations:
            tally = stress(name, each, seed, acceleration)
            rows.append({"robot": name, "acceleration_limit": acceleration, **tally._asdict()})
            worst = max(tally.position, tally.velocity, tally.acceleration)
            good &= worst <= LIMIT_TOLERANCE and tally.infeasible == 0
            lines.append(
                f"{name:12} {acceleration:5.0f} {tally.ticks:9d}  {tally.position:25.1e} {tally.velocity:9.1e} "
                f"{tally.acceleration:13.1e} {tally.infeasible:12d} {tally.refused:12d} "
                f"{tally.at_limits / tally.ticks:11.1%} {tally.slowed / tally.ticks:6.0%}"
            )
    return SectionResult(lines, good, rows)


JOINTS = 2000
"""Simulated joints, one run each."""


def _joint_limits(margin: float, recovery_speed: float = 0.1) -> MotionLimits:
    """Return equal limits for all joints: 2 rad wide, 2 rad/s, 10 rad/s2."""
    ones = np.ones(JOINTS)
    return MotionLimits(-ones + margin, ones - margin, 2.0 * ones, 10.0 * ones, 0.01, recovery_speed)


def outside(seed: int = 1) -> SectionResult:
    """Start outside a position limit, moving outwards; compare the excess with the stopping distance."""
    rng, limits = np.random.default_rng(seed), _joint_limits(0.0)
    q = 1.0 + 10.0 ** rng.uniform(-6.0, -0.5, JOINTS)
    qd = rng.uniform(0.0, 2.0, JOINTS)
    start, unavoidable = q.copy(), stopping_distance(qd, limits.acceleration, 0.002)
    farthest, fastest, came_back = q.copy(), 0.0, 0.0
    for tick in range(5000):
        bounds = joint_bounds(limits, q, qd, 0.002)
        qd = bounds.hi  # the most outward admissible velocity
        q = q + 0.002 * qd
        farthest = np.maximum(farthest, q)
        fastest = max(fastest, float(-qd.min()))
        came_back = tick * 0.002 if (q > 1.0 + 1e-9).any() else came_back
    excess = (farthest - start) - unavoidable
    lines = [
        f"{JOINTS} starts outside a limit by up to 0.3 rad, outward at up to 2 rad/s, pushed out: further out by "
        f"{float((farthest - start).max()):.4f} rad at most, unavoidable {float(unavoidable.max()):.4f}; "
        f"beyond the unavoidable at most {float(excess.max()):.1e}; back at no more than {fastest:.2f} rad/s, "
        f"all inside after {came_back:.1f} s"
    ]
    row = {"beyond_unavoidable": float(excess.max()), "fastest_back": fastest, "all_inside_after_s": came_back}
    within = bool(excess.max() < LIMIT_TOLERANCE and fastest <= limits.recovery_speed + LIMIT_TOLERANCE)
    return SectionResult(lines, within, [row])


def lagged(margin: float, noise: float, seed: int = 1, ticks: int = 5000) -> float:
    """Return the largest excess of a 1 rad limit under adversarial commands, rad.

    The joints have a first-order lag of 20 ms and one sample of delay; their positions are measured with ``noise`` rad.
    """
    rng, limits = np.random.default_rng(seed), _joint_limits(margin)
    q, actual = rng.uniform(-0.9, 0.9, JOINTS), np.zeros(JOINTS)
    before, command = np.zeros(JOINTS), np.zeros(JOINTS)
    worst = -np.inf
    for tick in range(ticks):
        bounds = joint_bounds(limits, q + noise * rng.normal(size=JOINTS), command, 0.002)
        share = rng.uniform(size=JOINTS)
        share[: JOINTS // 2] = 1.0
        share[JOINTS // 2 : 3 * JOINTS // 4] = (tick // 200) % 2
        before, command = command, np.clip(bounds.lo + share * (bounds.hi - bounds.lo), bounds.lo, bounds.hi)
        actual = actual + (before - actual) * (1.0 - np.exp(-0.002 / 0.02))
        q = q + 0.002 * actual
        worst = max(worst, float((np.abs(q) - 1.0).max()))
    return worst


def lag_table(ticks: int = 5000) -> SectionResult:
    """Measure the overshoot under lag and noise, and check the margin that prevents it."""
    rows = list[dict[str, Any]]()
    lines, good = (
        ["lag 20 ms, one sample of delay, 2 rad/s, 10 rad/s2, measured with noise; worst excess of a limit"],
        True,
    )
    for noise in (0.0, 1e-4, 1e-3):
        bare = lagged(0.0, noise, ticks=ticks)
        margin = 1.1 * max(bare, 0.0)
        rest = lagged(margin, noise, seed=2, ticks=ticks)
        rows.append({"noise": noise, "bare": bare, "margin": margin, "rest": rest})
        good &= rest <= LIMIT_TOLERANCE
        lines.append(
            f"  noise {noise:.0e} rad: {bare * 1e3:7.2f} mrad without a margin; "
            f"limits.position_margin of {margin * 1e3:.2f} mrad leaves {rest * 1e3:+.2f} mrad"
        )
    return SectionResult(lines, good, rows)
