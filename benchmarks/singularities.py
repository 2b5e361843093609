"""Motions through, near and past singularities, with this package and two prototypes (scaling only, fading only).

Targets are reachable and unreachable; starts are exactly singular or at an offset of 1e-12 rad.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.arms import arm
from benchmarks.loop import (
    LENGTH,
    PERIOD_S,
    ROW_SCALE,
    LoopRun,
    TwistSolver,
    exact,
    faded,
    follow,
    ours,
    path_error,
    settings_of,
    sign_changes,
)
from benchmarks.sections import SectionResult
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

TRACKING = (1e-3, 5e-3)
"""Full tracking: within 1 mm and 5 mrad of the target at the same time."""

SETTINGS = settings_of((10.0,))
"""Acceleration limit of 10 rad/s2 for every joint."""

MAX_RECOVERY_S = 1.0
"""Longest time without full tracking, beyond the least time that the joints need for their motion."""

RAMP_S = 0.2


class Sweep(NamedTuple):
    """Motion along a body twist and, with ``back``, back again; the pose at phase 0 is ``pose_at_zero``."""

    pose_at_zero: Array
    twist: Array
    start: float
    """Phase at the start, in seconds at full speed."""
    length_s: float
    back: bool

    @property
    def duration_s(self) -> float:
        """Time until the target is at rest."""
        one = self.length_s + RAMP_S
        return 2.0 * one + 0.5 if self.back else one

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        one = self.length_s + RAMP_S
        gone = _ramped(time_s, one) - (_ramped(time_s - one - 0.5, one) if self.back else 0.0)
        return np.asarray(self.pose_at_zero @ se3.exp((self.start + gone) * self.twist))


def _ramped(time_s: float, whole_s: float) -> float:
    """Return the distance at unit speed with ramps at both ends."""
    time_s = min(max(time_s, 0.0), whole_s)
    if time_s < RAMP_S:
        return 0.5 * time_s * time_s / RAMP_S
    if time_s > whole_s - RAMP_S:
        return whole_s - RAMP_S - 0.5 * (whole_s - time_s) ** 2 / RAMP_S
    return time_s - 0.5 * RAMP_S


class Singularity(NamedTuple):
    """A singular position and its lost direction."""

    name: str
    robot: Robot
    q: Array
    lost: Array
    """Unit lost direction u, rows scaled, (6,)."""
    motion: Array
    """Joint motion y that does not move the tool, (n,)."""
    slope: Array
    """Gradient of the singular value, (n,)."""


def decompose(robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Return u, sigma and y' of the scaled body Jacobian."""
    u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b, full_matrices=False)
    return u, sigma, rows


def slope_of_sigma(robot: Robot, q: Array) -> Array:
    """Return the gradient of the smallest singular value, (n,)."""
    u, _, rows = decompose(robot, q)
    result = np.zeros(robot.n)
    for joint in range(robot.n):
        step = np.zeros(robot.n)
        step[joint] = 1e-6
        difference = robot.evaluate(q + step).jacobian_b - robot.evaluate(q - step).jacobian_b
        result[joint] = u[:, -1] @ (ROW_SCALE[:, None] * difference / 2e-6) @ rows[-1]
    return result


def nearest_singular(robot: Robot, q: Array, joints: tuple[int, ...] = ()) -> Array:
    """Reduce the smallest singular value to zero by Newton steps in ``joints``, or in all."""
    mask = np.ones(robot.n)
    if joints:
        mask[:] = 0.0
        mask[list(joints)] = 1.0
    for _ in range(200):
        sigma = decompose(robot, q)[1][-1]
        if sigma < 1e-13:
            break
        slope = slope_of_sigma(robot, q) * mask
        q = q - slope * sigma / (slope @ slope)
    middle = 0.5 * (robot.limits.lower + robot.limits.upper)
    return middle + (q - middle + np.pi) % (2.0 * np.pi) - np.pi


def singularities() -> list[Singularity]:
    """Return three singularities of the UR5 (wrist, elbow, shoulder) and two of the Panda."""
    ur5, panda = arm("ur5"), arm("panda")
    places = [
        ("ur5 wrist", ur5, np.array([0.3, -1.2, 1.6, -1.2, 0.0, 0.4])),
        ("ur5 elbow", ur5, nearest_singular(ur5, np.array([0.3, -1.0, 0.1, -0.9, -1.2, 0.4]), (2,))),
        ("ur5 shoulder", ur5, nearest_singular(ur5, np.array([0.3, -1.9, 2.2, -1.0, 1.2, 0.4]), (1,))),
        ("panda wrist", panda, nearest_singular(panda, np.array([0.794, -0.775, -2.0, -2.0, 1.571, 3.0, 0.618]))),
        ("panda shoulder", panda, nearest_singular(panda, np.array([-1.1, 0.0, 1.5, -1.4, -0.833, 2.138, -1.032]))),
    ]
    result = []
    for name, robot, q in places:
        u, _, rows = decompose(robot, q)
        result.append(Singularity(name, robot, q, u[:, -1], rows[-1], slope_of_sigma(robot, q)))
    return result


class SingularityRun(NamedTuple):
    """One motion at a singularity."""

    place: Singularity
    label: str
    target: Sweep
    q: Array
    """Start, (n,)."""


def solve(robot: Robot, pose: Array, q: Array) -> Array | None:
    """Solve inverse kinematics near ``q``; None when there is no solution within the limits."""
    for _ in range(300):
        state = robot.evaluate(q)
        error = se3.log(se3.inverse(state.pose_sb) @ pose)
        if np.linalg.norm(error) < 1e-11:
            break
        jacobian = state.jacobian_b
        damped = jacobian @ jacobian.T + 1e-10 * np.eye(6)
        q = q + np.clip(jacobian.T @ np.linalg.solve(damped, error), -0.1, 0.1)
    inside = (q > robot.limits.lower).all() and (q < robot.limits.upper).all()
    return q if inside and np.linalg.norm(error) < 1e-8 else None


def singularity_runs(speed: float = 0.15, seed: int = 5) -> list[SingularityRun]:
    """Return the motions of every singularity.

    Past it at offsets of 0, 3 and 20 mm to both sides in two random directions; from it (and from an offset of 1e-12
    rad) along the lost direction and back, in both senses; into it from 6 cm away, beyond and back. ``speed`` is in
    m/s, with rotations times the characteristic length.
    """
    rng, result = np.random.default_rng(seed), []
    for place in singularities():
        centre = place.robot.pose(place.q)
        aside = 0.3 * place.slope / np.linalg.norm(place.slope)
        for number in range(2):
            direction = rng.normal(size=6)
            direction -= place.lost * (place.lost @ direction)
            twist = speed * direction / np.linalg.norm(direction) / ROW_SCALE
            for offset in (0.0, 0.003, -0.003, 0.02, -0.02):
                target = Sweep(centre @ se3.exp(offset * place.lost / ROW_SCALE), twist, -0.8, 1.6, False)
                starts = [solve(place.robot, target.pose(0.0), place.q + side * aside) for side in (1.0, -1.0)]
                start = next((found for found in starts if found is not None), None)
                if start is not None:
                    result.append(
                        SingularityRun(place, f"past at {offset * 1e3:+.0f} mm, direction {number}", target, start)
                    )
        for sign in (1.0, -1.0):
            twist = sign * speed * place.lost / ROW_SCALE
            for beside in (0.0, 1e-12):
                target = Sweep(centre, twist, 0.0, 0.5, True)
                result.append(
                    SingularityRun(place, f"from {beside:g} rad, {sign:+.0f}u", target, place.q + beside * place.motion)
                )
            target = Sweep(centre, twist / speed * 0.2, -0.3, 0.6, True)
            start = solve(place.robot, target.pose(0.0), place.q + 0.3 * place.motion)
            if start is not None:
                result.append(SingularityRun(place, f"into it, {sign:+.0f}u", target, start))
    return result


class PassMetrics(NamedTuple):
    """Figures of one motion."""

    speed: float
    """Highest joint speed, as a fraction of its limit."""
    changes: int
    """Largest number of sign changes of a joint velocity."""
    path_m: float
    path_rad: float
    error_m: float
    """Largest distance from the target at the same time."""
    slowed_s: float
    """Time lost by slowing down."""
    untracked_s: float
    """Longest time without full tracking while the target was reachable."""
    needless_s: float
    """The same, minus the least time that the joints need for their motion in it."""
    left_m: float
    """Distance from the target at the end, at rest."""
    left_rad: float


REST_S = 1.5


def within_reach(drive: SingularityRun, run: LoopRun) -> Array:
    """Return per control step whether the target has a solution within the limits; checked every 20 ms."""
    result = np.ones(len(run.time_s), dtype=bool)
    seeds = [drive.q, drive.q + 0.1, drive.q - 0.1]
    for tick in range(0, len(run.time_s), 10):
        pose = drive.target.pose(float(run.time_s[tick]))
        reachable = False
        for number, seed in enumerate([*seeds, run.q[tick]]):
            found = _closest(drive.place.robot, pose, seed)
            if found is not None:
                reachable = True
                if number < len(seeds):
                    seeds[number] = found
        result[tick : tick + 10] = reachable
    return result


def _closest(robot: Robot, pose: Array, q: Array) -> Array | None:
    for _ in range(40):
        state = robot.evaluate(q)
        error = se3.log(se3.inverse(state.pose_sb) @ pose)
        size = float(np.linalg.norm(error))
        if size < 1e-8:
            break
        jacobian = state.jacobian_b
        damped = jacobian @ jacobian.T + (1e-3 * size + 1e-12) * np.eye(6)
        q = q + np.clip(jacobian.T @ np.linalg.solve(damped, error), -0.2, 0.2)
    inside = (q >= robot.limits.lower).all() and (q <= robot.limits.upper).all()
    return q if inside and size < 1e-4 else None


def measure(
    drive: SingularityRun, way: Callable[[Robot, Settings], TwistSolver], settings: Settings = SETTINGS
) -> tuple[PassMetrics, LoopRun]:
    """Run the motion and return its figures; ``way`` is :func:`ours`, :func:`exact` or :func:`faded`."""
    robot = drive.place.robot
    run = follow(robot, drive.target, drive.q, way(robot, settings), drive.target.duration_s + REST_S)
    path = path_error(drive.target, drive.target.duration_s, run.pose[::5])
    full = np.asarray((run.error_m < TRACKING[0]) & (run.error_rad < TRACKING[1]))
    reach = within_reach(drive, run)
    longest = needless = 0.0
    for begin, end in _intervals(np.logical_and(reach, ~full)):
        longest = max(longest, (end - begin) * PERIOD_S)
        least = least_time(run.q[end - 1] - run.q[begin], run.qd[begin], robot.limits.velocity, settings)
        needless = max(needless, (end - begin) * PERIOD_S - least)
    figures = PassMetrics(
        float(np.max(np.abs(run.qd) / robot.limits.velocity)),
        sign_changes(run.qd),
        path[0],
        path[1],
        float(np.hypot(run.error_m, LENGTH * run.error_rad).max()),
        float((1.0 - run.task_scale).sum() * PERIOD_S),
        longest,
        needless,
        float(run.error_m[-1]),
        float(run.error_rad[-1]),
    )
    return figures, run


def _intervals(flags: Array) -> list[tuple[int, int]]:
    """Return begin and end of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def least_time(distances: Array, speed: Array, fastest: Array, settings: Settings) -> float:
    """Return a lower bound of the time in which joints can move by ``distances`` (n,), s.

    Each joint starts at ``speed`` (n,), accelerates to at most ``fastest`` (n,) and need not stop at the end.
    """
    acceleration = settings.limits.acceleration[0]
    distance, begin = np.abs(distances), np.clip(speed * np.sign(distances), -fastest, fastest)
    end = np.sqrt(np.maximum(begin, 0.0) ** 2 + 2.0 * acceleration * distance)
    ramp = (np.minimum(end, fastest) - begin) / acceleration
    ramp_way = (np.minimum(end, fastest) ** 2 - np.maximum(begin, 0.0) ** 2) / (2.0 * acceleration)
    return float(np.max(np.where(distance > 0.0, ramp + np.maximum(distance - ramp_way, 0.0) / fastest, 0.0)))


WAYS = {"ours": ours, "slow": exact, "fade": faded}
"""Solver of this package and two prototypes."""


def table(
    only: Sequence[str] = ("",), ways: Sequence[str] = tuple(WAYS), settings: Settings = SETTINGS
) -> SectionResult:
    """Run the motions whose name contains one of ``only``, in ``ways``; ours has to stay within its bounds."""
    acceleration = settings.limits.acceleration[0]
    lines = [
        f"motions at 0.15 m/s, {acceleration:g} rad/s2, 500 Hz; slow: V scaled only, fade: directions below 0.05 m",
        f"{'':46}{'joint':>7}{'sign':>9}{'off the path':>19}{'slowed':>9}{'off the':>10}{'untracked':>11}"
        f"{'more than':>11}",
        f"{'':46}{'speed':>7}{'changes':>9}{'mm':>8}{'mrad':>11}{'s':>9}{'target mm':>10}{'s':>11}{'needed s':>11}",
    ]
    good, found, rows = True, list[tuple[str, PassMetrics]](), list[dict[str, Any]]()
    for drive in singularity_runs():
        name = f"{drive.place.name}: {drive.label}"
        if not any(part in name for part in only):
            continue
        for way in ways:
            figures, _ = measure(drive, WAYS[way], settings)
            found.append((way, figures))
            rows.append({"drive": name, "way": way, **figures._asdict()})
            if way == "ours":
                good &= figures.speed <= 1.0 + 1e-9 and figures.changes <= 12 and figures.needless_s <= MAX_RECOVERY_S
            lines.append(
                f"{name if way == ways[0] else '':40}{way:6}{figures.speed:7.2f}{figures.changes:9d}"
                f"{figures.path_m * 1e3:8.2f}{figures.path_rad * 1e3:11.1f}{figures.slowed_s:9.2f}"
                f"{figures.error_m * 1e3:10.1f}{figures.untracked_s:11.2f}{figures.needless_s:11.2f}"
            )
    for way in ways:
        mine = [figures for name, figures in found if name == way]
        if mine:
            path = [np.hypot(f.path_m, LENGTH * f.path_rad) * 1e3 for f in mine]
            lines.append(
                f"{way}: off the path, rotations times {LENGTH} m: median {np.median(path):.2f} mm, "
                f"worst {max(path):.1f} mm; "
                f"untracked while reachable: median {np.median([f.untracked_s for f in mine]):.2f} s, "
                f"worst {max(f.untracked_s for f in mine):.2f} s, {max(f.needless_s for f in mine):.2f} s more than "
                f"the joints need; most sign changes {max(f.changes for f in mine)}"
            )
    return SectionResult(lines, good, rows)
