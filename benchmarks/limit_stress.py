"""Hostile targets against joint limits: an ideal arm that must never break one, starts outside, lag and noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.loop import CONTROL, PERIOD_S, settings_of
from benchmarks.reference_solvers import ROBOTS, arm, random_position
from ik_node.control.feedback import twist_feedback
from ik_node.differential_ik.solution import Moment
from ik_node.differential_ik.solver import TickSolver
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.math.se3 import checked_pose
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, joint_bounds, stopping_distance
from ik_node.robot.robot import Robot

BROKEN = 1e-9
"""More than this beyond a limit is a broken limit, in its own unit."""


class Tally(NamedTuple):
    """What was counted; overshoots are the largest, 0 or less where nothing was exceeded."""

    ticks: int
    position: float
    velocity: float
    acceleration: float
    infeasible: int
    """Ticks at which a limit had to give way or something raised an error."""
    refused: int
    """Targets with NaN that were refused."""
    at_limits: int
    """Ticks with a joint within 1e-6 rad of a position limit."""
    slowed: int
    """Ticks with s < 1."""


def hostile_pose(robot: Robot, rng: np.random.Generator, q: Array) -> Array:
    """Reachable, out of reach, a step away, upside down, or not a number."""
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


def drive(name: str, ticks: int, seed: int, acceleration: float) -> Tally:
    """``ticks`` ticks of one robot with the node's solver; a new start at rest every 20,000."""
    robot, rng = arm(name), np.random.default_rng([seed, *name.encode()])
    solver = TickSolver(robot, settings_of((acceleration,)))
    limits = solver.limits
    position = velocity = change = -np.inf
    infeasible = refused = at_limits = slowed = 0
    q, qd, held_s, pose_sd, twist_d, until = np.zeros(robot.n), np.zeros(robot.n), PERIOD_S, np.eye(4), np.zeros(6), 0
    now_s = 0.0
    for tick in range(ticks):
        if tick % 20_000 == 0:
            q, qd, held_s, until = random_position(robot, rng), np.zeros(robot.n), PERIOD_S, tick
            pose_sd, twist_d = robot.pose(q), np.zeros(6)
            solver.begin()
        if tick >= until:
            until = tick + int(rng.integers(1, 400))
            try:
                pose_sd = checked_pose(hostile_pose(robot, rng, q))
                twist_d = rng.normal(size=6) * rng.choice([0.0, 0.3, 10.0])
            except IkNodeError:
                refused += 1
        twist = twist_feedback(robot.pose(q), Motion(pose_sd, twist_d), CONTROL).twist_b
        moment = Moment(q, q + 0.5 * PERIOD_S * qd, qd, held_s, round(now_s * NS))
        try:
            outcome = solver.follow_twist(moment, twist)
        except IkNodeError:
            infeasible += 1
            qd = np.zeros(robot.n)
            continue
        infeasible += bool(outcome.conceded)
        slowed += outcome.scale < 1.0
        change = max(change, float((np.abs(outcome.joint_velocity - qd) - limits.acceleration * held_s).max()))
        qd = outcome.joint_velocity
        velocity = max(velocity, float((np.abs(qd) - limits.velocity).max()))
        held_s = PERIOD_S * float(rng.choice([0.2, 0.5, 1.0, 1.0, 2.0, 5.0]))
        now_s += held_s
        q = q + held_s * qd
        beyond = float(np.maximum(q - limits.upper, limits.lower - q).max())
        position = max(position, beyond)
        at_limits += beyond > -1e-6
    return Tally(ticks, position, velocity, change, infeasible, refused, at_limits, slowed)


def table(ticks: int, seed: int = 1) -> tuple[list[str], bool]:
    """``ticks`` in total over all robots and accelerations, as lines, and whether no limit was broken."""
    lines = [
        f"{ticks} ticks of hostile targets: jumps, out of reach, upside down, NaN; holds of 0.2 to 5 periods",
        "robot        rad/s2    ticks  largest excess of position  velocity  acceleration   infeasible  NaN refused  "
        "at a limit  s < 1",
    ]
    good, accelerations = True, (2.0, 10.0, 50.0)
    each = max(1, ticks // (len(ROBOTS) * len(accelerations)))
    for name in ROBOTS:
        for acceleration in accelerations:
            tally = drive(name, each, seed, acceleration)
            worst = max(tally.position, tally.velocity, tally.acceleration)
            good &= worst <= BROKEN and tally.infeasible == 0
            lines.append(
                f"{name:12} {acceleration:5.0f} {tally.ticks:9d}  {tally.position:25.1e} {tally.velocity:9.1e} "
                f"{tally.acceleration:13.1e} {tally.infeasible:12d} {tally.refused:12d} "
                f"{tally.at_limits / tally.ticks:11.1%} {tally.slowed / tally.ticks:6.0%}"
            )
    return lines, good


LANES = 2000


def _lanes(margin: float, recovery_speed: float = 0.1) -> MotionLimits:
    """Joints of one kind: 2 rad wide, 2 rad/s, 10 rad/s2."""
    ones = np.ones(LANES)
    return MotionLimits(-ones + margin, ones - margin, 2.0 * ones, 10.0 * ones, 0.01, recovery_speed)


def outside(seed: int = 1) -> tuple[list[str], bool]:
    """Starts outside a position limit, moving out: how much further it goes, beside what no controller can avoid."""
    rng, limits = np.random.default_rng(seed), _lanes(0.0)
    q = 1.0 + 10.0 ** rng.uniform(-6.0, -0.5, LANES)
    qd = rng.uniform(0.0, 2.0, LANES)
    start, unavoidable = q.copy(), stopping_distance(qd, limits.acceleration, 0.002)
    farthest, fastest, came_back = q.copy(), 0.0, 0.0
    for tick in range(5000):
        bounds = joint_bounds(limits, q, qd, 0.002)
        qd = bounds.hi  # As far out as the box lets it.
        q = q + 0.002 * qd
        farthest = np.maximum(farthest, q)
        fastest = max(fastest, float(-qd.min()))
        came_back = tick * 0.002 if (q > 1.0 + 1e-9).any() else came_back
    excess = (farthest - start) - unavoidable
    lines = [
        f"{LANES} starts outside a limit by up to 0.3 rad, outward at up to 2 rad/s, pushed out: further out by "
        f"{float((farthest - start).max()):.4f} rad at most, unavoidable {float(unavoidable.max()):.4f}; "
        f"beyond the unavoidable at most {float(excess.max()):.1e}; back at no more than {fastest:.2f} rad/s, "
        f"all inside after {came_back:.1f} s"
    ]
    return lines, bool(excess.max() < BROKEN and fastest <= limits.recovery_speed + BROKEN)


def lagged(margin: float, noise: float, seed: int = 1, ticks: int = 5000) -> float:
    """Largest excess of a 1 rad limit by joints that follow with a lag of 20 ms and one sample of delay, measured with
    ``noise`` rad, pushed by hostile choices."""
    rng, limits = np.random.default_rng(seed), _lanes(margin)
    q, actual = rng.uniform(-0.9, 0.9, LANES), np.zeros(LANES)
    before, command = np.zeros(LANES), np.zeros(LANES)
    worst = -np.inf
    for tick in range(ticks):
        bounds = joint_bounds(limits, q + noise * rng.normal(size=LANES), command, 0.002)
        share = rng.uniform(size=LANES)
        share[: LANES // 2] = 1.0
        share[LANES // 2 : 3 * LANES // 4] = (tick // 200) % 2
        before, command = command, np.clip(bounds.lo + share * (bounds.hi - bounds.lo), bounds.lo, bounds.hi)
        actual = actual + (before - actual) * (1.0 - np.exp(-0.002 / 0.02))
        q = q + 0.002 * actual
        worst = max(worst, float((np.abs(q) - 1.0).max()))
    return worst


def lag_table() -> tuple[list[str], bool]:
    """Overshoot under lag and noise, and the margin that prevents it."""
    lines, good = (
        ["lag 20 ms, one sample of delay, 2 rad/s, 10 rad/s2, measured with noise; worst excess of a limit"],
        True,
    )
    for noise in (0.0, 1e-4, 1e-3):
        bare = lagged(0.0, noise)
        margin = 1.1 * max(bare, 0.0)
        rest = lagged(margin, noise, seed=2)
        good &= rest <= BROKEN
        lines.append(
            f"  noise {noise:.0e} rad: {bare * 1e3:7.2f} mrad without a margin; "
            f"limits.position_margin of {margin * 1e3:.2f} mrad leaves {rest * 1e3:+.2f} mrad"
        )
    return lines, good
