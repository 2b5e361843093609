"""Motions beside obstacles with and without their gradient, and obstacles on the path, with the solver of the node."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.arms import arm
from benchmarks.loop import PERIOD_S, LoopRun, follow, settings_of
from benchmarks.sections import SectionResult
from benchmarks.singularities import Sweep, decompose, solve
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.differential_ik.solution import ArmState
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

READY = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.785])
"""Joint positions of a Panda in the middle of its workspace, rad."""

ACCELERATION = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Acceleration limits of the Panda, rad/s2."""


class SceneCase(NamedTuple):
    """A motion of the tool, the start, and the obstacles beside it."""

    target: Sweep
    q: Array
    scene: Scene


class SceneRun(NamedTuple):
    """One run; one row per control step."""

    run: LoopRun
    clearance: Array
    """Distance to the nearest obstacle, m."""


def run_scene(
    robot: Robot, scene_case: SceneCase, method: str, damper: bool, duration_s: float, query: DistanceQuery
) -> SceneRun:
    """Run the solver with ``method`` and an ideal arm at 500 Hz; ``query`` measures distances to obstacles only."""
    acceleration = ACCELERATION if robot.n == len(ACCELERATION) else (10.0,)
    watched = {"method": method, "obstacles.self_collision": True, "obstacles.velocity_damper": damper}
    solver = DifferentialIkSolver(robot, settings_of(acceleration, watched))
    solver.collision_monitor.scene = scene_case.scene
    query.set_scene(scene_case.scene, 0)
    clearance = list[float]()

    def measure(moment: ArmState) -> None:
        clearance.append(query.measure(moment.q, 0.0)[1].distance)

    run = follow(robot, scene_case.target, scene_case.q, solver.solve_twist, duration_s, observe=measure)
    return SceneRun(run, np.array(clearance))


def scene_case(
    seed: int, robot: Robot, geometry: collision_geometry.CollisionGeometry, anywhere: bool = False
) -> SceneCase | None:
    """Draw a straight motion of the tool with an obstacle that the middle of the arm passes at 5 to 40 mm.

    The direction to the obstacle is within 45 degrees of the null-space motion of the nearest link, the only motion
    that the gradient can use; with ``anywhere`` the direction is arbitrary. The arm starts at least 10 cm away. Returns
    None when the seed gives no motion within the limits and away from singularities, or no place for the obstacle.
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
    empty = SceneCase(target, q, Scene())
    query = DistanceQuery(geometry)
    run = run_scene(robot, empty, "plain", False, target.duration_s, query).run
    stretched = min(decompose(robot, q)[1][-1] for q in run.q[::50])
    if run.error_m.max() > 1e-3 or run.task_scale.min() < 1.0 or stretched < 0.1:
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
        query.set_scene(made, 0)
        for row in range(0, len(run.q), 20):
            near, _ = query.measure(run.q[row], 1.0)
            for pair, distance in zip(near.pair, near.distance.tolist(), strict=True):
                smallest = min(smallest, distance)
                first = min(first, distance) if row == 0 else first
                late = int(query.names(pair)[0][len("panda_link") :] or 0) if "link" in query.names(pair)[0] else 9
                tool = min(tool, distance) if late >= 6 else tool
        if 0.005 <= smallest <= 0.04 and tool > 0.08 and first > 0.1:
            return SceneCase(target, q, made)
    return None


class SceneResult(NamedTuple):
    """Figures of one scene with and without the gradient."""

    seed: int
    plain_m: float
    gradient_m: float
    path_rms_m: float
    """RMS distance between the two tool paths at the same time."""
    fastest: float
    """Highest joint speed with the gradient, as a fraction of its limit."""


def compare_gradient(
    seed: int, robot: Robot, geometry: collision_geometry.CollisionGeometry, anywhere: bool = False
) -> SceneResult | None:
    """Run one scene with and without the gradient; None when the seed gives no scene."""
    made = scene_case(seed, robot, geometry, anywhere)
    if made is None:
        return None
    duration_s = made.target.duration_s + 0.5
    query = DistanceQuery(geometry)
    plain, gradient = (run_scene(robot, made, way, False, duration_s, query) for way in ("plain", "obstacle_gradient"))
    apart = plain.run.pose[:, :3, 3] - gradient.run.pose[:, :3, 3]
    return SceneResult(
        seed,
        float(plain.clearance.min()),
        float(gradient.clearance.min()),
        float(np.sqrt((apart**2).sum(axis=1).mean())),
        float(np.max(np.abs(gradient.run.qd) / robot.limits.velocity)),
    )


def table(count: int, seed: int, anywhere: bool = False) -> SectionResult:
    """Run ``count`` seeded scenes on the Panda and check the benefit of the gradient."""
    robot = arm("panda")
    geometry = collision_geometry.load(robot, self_collision=False)
    lines = ["  seed   clearance plain   obstacle_gradient   gained   tool path moved by (RMS)   joint speed"]
    found, number = list[SceneResult](), seed * 1000
    while len(found) < count:
        one = compare_gradient(number, robot, geometry, anywhere)
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
    within = bool(np.median(gained) >= 30.0 and gained.min() >= -1.0 and moved < 0.1)
    return SectionResult(lines, within, [one._asdict() for one in found])


def on_the_path(name: str = "ur5") -> SectionResult:
    """Move straight to an obstacle and back: stopping distance, and speed on the way back compared with no obstacle."""
    robot = arm(name)
    query = DistanceQuery(collision_geometry.load(robot, self_collision=False))
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
            courses = (SceneCase(target, q, made), SceneCase(target, q, Scene()))
            blocked, free = (run_scene(robot, way, "plain", True, target.duration_s + 1.0, query) for way in courses)
            stopped = blocked.clearance[int(out_s / PERIOD_S)]
            back = slice(int((out_s + 0.5) / PERIOD_S), None)
            fastest = [_tool_speed(trace.run.pose[back]) for trace in (blocked, free)]
            contact, left = float(blocked.clearance.min()), float(blocked.run.error_m[-1])
            good &= contact > 0.0 and left < 1e-3 and fastest[0] >= 0.95 * fastest[1]
            lines.append(
                f"  {name}, {kind:9} at {speed:.1f} m/s: nearest {contact * 1e3:5.1f} mm, "
                f"waits at {stopped * 1e3:5.1f} mm; return at up to {fastest[0]:.3f} m/s "
                f"({fastest[1]:.3f} without it), ends {left * 1e3:.2f} mm from its target"
            )
    return SectionResult(lines, good)


def _tool_speed(poses: Array) -> float:
    """Return the highest speed of the tool, averaged over 10 control steps, m/s."""
    places = poses[::10, :3, 3]
    return float(np.sqrt((np.diff(places, axis=0) ** 2).sum(axis=1)).max() / (10 * PERIOD_S))
