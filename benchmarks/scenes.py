"""Scenes driven past by the node's tick, with and without the gradient of obstacles; obstacles on the path itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.loop import PERIOD_S, Run, follow, settings_of
from benchmarks.reference_solvers import arm
from benchmarks.singularities import Sweep, decompose, solve
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.distances import Clearance
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.differential_ik.solution import Moment
from ik_node.differential_ik.solver import TickSolver
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

READY = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.785])
"""A Panda in the middle of its workspace, rad."""

ACCELERATION = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""The Panda's, rad/s2."""


class Course(NamedTuple):
    """A motion of the tool and what stands beside it."""

    target: Sweep
    q: Array
    scene: Scene


class Trace(NamedTuple):
    """One run, one row per tick."""

    run: Run
    clearance: Array
    """To the nearest obstacle, m."""


def drive(robot: Robot, course: Course, method: str, damper: bool, duration_s: float, ruler: Clearance) -> Trace:
    """The node's tick with ``method`` and an ideal arm at 500 Hz; ``ruler`` measures, without pairs of own links."""
    acceleration = ACCELERATION if robot.n == len(ACCELERATION) else (10.0,)
    watched = {"method": method, "obstacles.self_collision": True, "obstacles.damper": damper}
    solver = TickSolver(robot, settings_of(acceleration, watched))
    solver.lookout.scene = course.scene
    ruler.see(course.scene, 0)
    clearance = list[float]()

    def measure(moment: Moment) -> None:
        clearance.append(ruler.measure(moment.q, np.zeros(ruler.pairs))[1].distance)

    run = follow(robot, course.target, course.q, solver.follow_twist, duration_s, seen=measure)
    return Trace(run, np.array(clearance))


def course(seed: int, robot: Robot, geometry: collision_geometry.Geometry, anywhere: bool = False) -> Course | None:
    """A straight motion of the tool with an obstacle beside the arm's middle, which the arm would pass at 5 to 40 mm.

    The obstacle stands in the way of the null-space motion of the link it is nearest to, within 45 degrees: that motion
    is all that the gradient has. ``anywhere``: wherever it happens to stand, above and below the arm too.
    The arm starts 10 cm away or more. None where the dice give no motion within the limits and
    away from singularities, or no place for the obstacle that leaves the tool free.
    """
    rng = np.random.default_rng(seed)
    q = READY + rng.uniform(-0.35, 0.35, 7)
    start = robot.pose(q)
    direction = rng.normal(size=6) * np.array([1.0, 1.0, 0.6, 0.4, 0.4, 0.4])
    twist = 0.12 * direction / np.linalg.norm(direction[:3])
    target = Sweep(start, twist, 0.0, 3.0, False)
    last = solve(robot, target.pose(target.duration_s), q)
    if last is None:
        return None
    empty = Course(target, q, Scene())
    ruler = Clearance(geometry)
    run = drive(robot, empty, "plain", False, target.duration_s, ruler).run
    stretched = min(decompose(robot, q)[1][-1] for q in run.q[::50])
    if run.error_m.max() > 1e-3 or run.pace.min() < 1.0 or stretched < 0.1:
        return None
    links = {name: index for index, name in enumerate(geometry.names())}
    for _ in range(100):
        tick = int(rng.integers(len(run.q) // 4, 3 * len(run.q) // 4))
        link = geometry.links[links[f"panda_link{rng.integers(3, 6)}"]]
        jacobian = robot.root_jacobian(run.q[tick])
        point = robot.data.oMi[link.parent].act(link.points[rng.integers(len(link.points))])
        away = rng.normal(size=3)
        null = np.linalg.svd(robot.evaluate(run.q[tick]).jacobian_b)[2][-1] * robot.joint_moves(link.parent)
        evading = jacobian[:3] @ null + np.cross(jacobian[3:] @ null, point)
        if not anywhere and abs(away @ evading) < 0.7 * np.linalg.norm(away) * np.linalg.norm(evading):
            continue
        radius, gap = float(rng.uniform(0.04, 0.1)), float(rng.uniform(0.005, 0.04))
        pose = np.eye(4)
        pose[:3, 3] = point + away / np.linalg.norm(away) * (radius + gap)
        made = Scene().put(obstacle("ball", shape("sphere", (radius,)), pose))
        smallest, tool, first = np.inf, np.inf, np.inf
        ruler.see(made, 0)
        for row in range(0, len(run.q), 20):
            near, _ = ruler.measure(run.q[row], np.full(ruler.pairs, 1.0))
            for pair, distance in zip(near.pair, near.distance.tolist(), strict=True):
                smallest = min(smallest, distance)
                first = min(first, distance) if row == 0 else first
                late = int(ruler.names(pair)[0][len("panda_link") :] or 0) if "link" in ruler.names(pair)[0] else 9
                tool = min(tool, distance) if late >= 6 else tool
        if 0.005 <= smallest <= 0.04 and tool > 0.08 and first > 0.1:
            return Course(target, q, made)
    return None


class Passed(NamedTuple):
    """One scene, with and without the gradient."""

    seed: int
    plain_m: float
    gradient_m: float
    path_rms_m: float
    """RMS distance between the two tool paths at the same time."""
    fastest: float
    """Highest joint speed of the gradient's run as part of its limit."""


def pass_by(seed: int, robot: Robot, geometry: collision_geometry.Geometry, anywhere: bool = False) -> Passed | None:
    """Drives one scene both ways; None where the seed gives none."""
    made = course(seed, robot, geometry, anywhere)
    if made is None:
        return None
    duration_s = made.target.duration_s + 0.5
    ruler = Clearance(geometry)
    plain, gradient = (drive(robot, made, way, False, duration_s, ruler) for way in ("plain", "obstacle_gradient"))
    apart = plain.run.pose[:, :3, 3] - gradient.run.pose[:, :3, 3]
    return Passed(
        seed,
        float(plain.clearance.min()),
        float(gradient.clearance.min()),
        float(np.sqrt((apart**2).sum(axis=1).mean())),
        float(np.max(np.abs(gradient.run.qd) / robot.limits.velocity)),
    )


def table(count: int, seed: int, anywhere: bool = False) -> tuple[list[str], bool]:
    """``count`` seeded scenes on the Panda, as lines, and whether the gradient kept its word."""
    robot = arm("panda")
    geometry = collision_geometry.load(robot, self_collision=False)
    lines = ["  seed   clearance plain   obstacle_gradient   gained   tool path moved by (RMS)   joint speed"]
    found, number = list[Passed](), seed * 1000
    while len(found) < count:
        one = pass_by(number, robot, geometry, anywhere)
        number += 1
        if one is None:
            continue
        found.append(one)
        lines.append(
            f"{one.seed:6d} {one.plain_m * 1e3:14.1f} mm {one.gradient_m * 1e3:16.1f} mm "
            f"{(one.gradient_m - one.plain_m) * 1e3:7.1f} {one.path_rms_m * 1e6:20.3f} um {one.fastest:17.0%}"
        )
    gained = np.array([one.gradient_m - one.plain_m for one in found]) * 1e3
    moved = max(one.path_rms_m for one in found) * 1e3
    lines.append(
        f"gained: median {np.median(gained):.1f} mm, worst {gained.min():+.1f} mm; tool path moved by at most "
        f"{moved:.4f} mm RMS"
    )
    return lines, bool(np.median(gained) >= 30.0 and gained.min() >= -1.0 and moved < 0.1)


def on_the_path(name: str = "ur5") -> tuple[list[str], bool]:
    """Straight at an obstacle and back: where it stops, how fast it leaves, beside the same way back without it."""
    robot = arm(name)
    ruler = Clearance(collision_geometry.load(robot, self_collision=False))
    q = READY if name == "panda" else np.array([0.0, -1.2, 1.6, -1.97, -1.57, 0.0])
    start = robot.pose(q)
    lines, good = [], True
    for kind, size in (
        ("sphere", (0.1,)),
        ("box", (0.2, 0.2, 0.2)),
        ("cylinder", (0.08, 0.4)),
        ("capsule", (0.08, 0.3)),
    ):
        for speed in (0.1, 0.3):
            twist = np.concatenate((start[:3, :3].T @ np.array([0.0, -speed, 0.0]), np.zeros(3)))
            there = np.eye(4)
            there[:3, 3] = start[:3, 3] + (0.0, -0.42, 0.0)
            made = Scene().put(obstacle("thing", shape(kind, size), there))
            target = Sweep(start, twist, 0.0, 0.4 / speed, True)
            out_s = 0.4 / speed + 0.4
            courses = (Course(target, q, made), Course(target, q, Scene()))
            blocked, free = (drive(robot, way, "plain", True, target.duration_s + 1.0, ruler) for way in courses)
            stopped = blocked.clearance[int(out_s / PERIOD_S)]
            back = slice(int((out_s + 0.5) / PERIOD_S), None)
            fastest = [_tool_speed(trace.run.pose[back]) for trace in (blocked, free)]
            contact, left = float(blocked.clearance.min()), float(blocked.run.error_m[-1])
            good &= contact > 0.0 and left < 1e-3 and fastest[0] >= 0.95 * fastest[1]
            lines.append(
                f"  {name}, {kind:9} at {speed:.1f} m/s: nearest {contact * 1e3:5.1f} mm, "
                f"waits at {stopped * 1e3:5.1f} mm; way back at up to {fastest[0]:.3f} m/s "
                f"({fastest[1]:.3f} without it), ends {left * 1e3:.2f} mm from its target"
            )
    return lines, good


def _tool_speed(poses: Array) -> float:
    """Highest speed of the tool over steps of 10 ticks, m/s."""
    places = poses[::10, :3, 3]
    return float(np.sqrt((np.diff(places, axis=0) ** 2).sum(axis=1)).max() / (10 * PERIOD_S))
