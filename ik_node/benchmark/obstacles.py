"""``ik_benchmark obstacles``: gradients against differences, scenes driven past, obstacles on the path, speed."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ik_node import bounded, collision, se3
from ik_node.arrival import arriving
from ik_node.benchmark.loop import PERIOD_S, ROW_SCALE, ours
from ik_node.benchmark.optimum import arm, random_position
from ik_node.benchmark.singularities import Sweep, decompose, solve
from ik_node.clearance import Clearance
from ik_node.clock import NS
from ik_node.control_law import twist_feedback
from ik_node.limits import joint_bounds, motion_limits
from ik_node.potentials import dexterity
from ik_node.potentials.avoidance import look_around
from ik_node.robot import Robot
from ik_node.scene import Scene, obstacle, shape
from ik_node.se3 import Array
from ik_node.settings import ControlSettings, LimitSettings, ObstacleSettings
from ik_node.trajectory.motion import Motion

READY = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.785])
"""A Panda in the middle of its workspace, rad."""

ACCELERATION = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""The Panda's, rad/s2."""


class Course(NamedTuple):
    """A motion of the tool and what stands beside it."""

    target: Sweep
    q: Array
    scene: Scene


class Geometries(NamedTuple):
    """The arm's solids with and without pairs of its own links; the latter measure clearances to obstacles."""

    whole: collision.Geometry
    without_itself: collision.Geometry


def solids(robot: Robot) -> Geometries:
    """Loaded once per robot."""
    return Geometries(collision.load(robot), collision.load(robot, self_collision=False))


class Trace(NamedTuple):
    """One run, one row per tick."""

    q: Array
    qd: Array
    error: Array
    """Distance of the tool point from its target, m."""
    turned: Array
    """The same for orientation, rad."""
    clearance: Array
    """To the nearest obstacle, m."""
    scale: Array


def follow(robot: Robot, course: Course, method: str, damper: bool, duration_s: float, geometries: Geometries) -> Trace:
    """The library's pieces in a loop with an ideal arm at 500 Hz; ``method`` plain or obstacle_gradient."""
    chosen, control = ObstacleSettings(damper=damper), ControlSettings()
    acceleration = ACCELERATION if robot.n == len(ACCELERATION) else (10.0,)
    limits = motion_limits(robot, LimitSettings(acceleration=acceleration), 1.0 / PERIOD_S)
    seeing, ruler, passing = Clearance(geometries.whole), Clearance(geometries.without_itself), ours()
    repel = method != "plain"
    q, qd, scale, rows = course.q.copy(), np.zeros(robot.n), 1.0, []
    for tick in range(round(duration_s / PERIOD_S)):
        now_s, now_ns = tick * PERIOD_S, int(tick * PERIOD_S * NS)
        pose_sd = course.target.pose(now_s)
        twist_d = se3.log(se3.inverse(pose_sd) @ course.target.pose(now_s + PERIOD_S)) / PERIOD_S
        state = robot.evaluate(q)
        law = twist_feedback(state.pose_sb, Motion(pose_sd, twist_d), control)
        feedback = law.twist_b - law.feedforward_b
        feedback = arriving(state.jacobian_b, law.error_b, feedback, limits, ROW_SCALE, 0.05)
        ruler.see(course.scene, now_ns)
        nearest = ruler.measure(q, np.zeros(ruler.pairs))[1].distance
        bounds = joint_bounds(limits, q, qd, PERIOD_S)
        change = limits.acceleration * PERIOD_S
        around = look_around(seeing, course.scene, q, qd, change, chosen, limits.dt_max_s, now_ns, repel)
        asked = passing(robot, q, state.jacobian_b, law.feedforward_b + feedback, qd, bounds, limits, scale)
        weight = gradient = None
        if repel:
            weight, gradient = robot.dynamics(q).mass_matrix, around.potential.gradient
            ahead = q + dexterity.LOOK_AHEAD_S * qd
            gradient = gradient + dexterity.dexterity(lambda p: robot.evaluate(p).jacobian_b, ahead, ROW_SCALE).gradient
        answer = bounded.solve(
            asked.jacobian,
            asked.twist,
            bounds.lo,
            bounds.hi,
            weight,
            gradient,
            control.gradient_gain if repel else 0.0,
            row_scale=ROW_SCALE,
            null_space_cap=np.full(robot.n, control.null_space_speed),
            dampers=around.dampers,
        )
        qd, scale, error = answer.joint_velocity, answer.scale, law.error_b
        rows.append(
            (q, qd, np.sqrt(error[:3] @ error[:3]), np.sqrt(error[3:] @ error[3:]), nearest, asked.pace * scale)
        )
        q = q + PERIOD_S * qd
    return Trace(*(np.array(column) for column in zip(*rows, strict=True)))


def course(seed: int, robot: Robot, geometries: Geometries, anywhere: bool = False) -> Course | None:
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
    run = follow(robot, empty, "plain", False, target.duration_s, geometries)
    geometry = geometries.without_itself
    stretched = min(decompose(robot, q)[1][-1] for q in run.q[::50])
    if run.error.max() > 1e-3 or run.scale.min() < 1.0 or stretched < 0.1:
        return None
    links = {name: index for index, name in enumerate(geometry.names())}
    ruler = Clearance(geometry)
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


def pass_by(seed: int, robot: Robot, geometries: Geometries, anywhere: bool = False) -> Passed | None:
    """Drives one scene both ways; None where the seed gives none."""
    made = course(seed, robot, geometries, anywhere)
    if made is None:
        return None
    duration_s = made.target.duration_s + 0.5
    runs = [follow(robot, made, method, False, duration_s, geometries) for method in ("plain", "obstacle_gradient")]
    tools = [np.array([robot.pose(q)[:3, 3] for q in run.q[::5]]) for run in runs]
    apart = tools[0] - tools[1]
    return Passed(
        seed,
        float(runs[0].clearance.min()),
        float(runs[1].clearance.min()),
        float(np.sqrt((apart**2).sum(axis=1).mean())),
        float(np.max(np.abs(runs[1].qd) / robot.limits.velocity)),
    )


def scenes(count: int, seed: int, anywhere: bool = False) -> tuple[list[str], bool]:
    """``count`` seeded scenes on the Panda, as lines, and whether the gradient kept its word."""
    robot = arm("panda")
    geometries = solids(robot)
    lines = ["  seed   clearance plain   obstacle_gradient   gained   tool path moved by (RMS)   joint speed"]
    found, number = list[Passed](), seed * 1000
    while len(found) < count:
        one = pass_by(number, robot, geometries, anywhere)
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
    geometries = solids(robot)
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
            run = follow(robot, Course(target, q, made), "plain", True, target.duration_s + 1.0, geometries)
            free = follow(robot, Course(target, q, Scene()), "plain", True, target.duration_s + 1.0, geometries)
            stopped = run.clearance[int(out_s / PERIOD_S)]
            back = slice(int((out_s + 0.5) / PERIOD_S), None)
            fastest = [_tool_speed(robot, trace.q[back]) for trace in (run, free)]
            contact = float(run.clearance.min())
            good &= contact > 0.0 and run.error[-1] < 1e-3 and fastest[0] >= 0.95 * fastest[1]
            lines.append(
                f"  {name}, {kind:9} at {speed:.1f} m/s: nearest {contact * 1e3:5.1f} mm, "
                f"waits at {stopped * 1e3:5.1f} mm; way back at up to {fastest[0]:.3f} m/s "
                f"({fastest[1]:.3f} without it), ends {run.error[-1] * 1e3:.2f} mm from its target"
            )
    return lines, good


def _tool_speed(robot: Robot, q: Array) -> float:
    """Highest speed of the tool over steps of 10 ticks, m/s."""
    places = np.array([robot.pose(row)[:3, 3] for row in q[::10]])
    return float(np.sqrt((np.diff(places, axis=0) ** 2).sum(axis=1)).max() / (10 * PERIOD_S))


def gradients(positions: int, seed: int) -> tuple[list[str], bool]:
    """grad_h against central differences: balls exactly, hulls as measured; both sides of contact."""
    rng, lines, good = np.random.default_rng(seed), [], True
    for name, kind, size in (
        ("z1", "sphere", (0.08,)),
        ("panda", "sphere", (0.08,)),
        ("panda", "capsule", (0.05, 0.3)),
        ("panda", "box", (0.2, 0.1, 0.1)),
        ("panda", "cylinder", (0.06, 0.2)),
        ("ur5", "sphere", (0.08,)),
    ):
        robot = arm(name)
        clearance, still = Clearance(collision.load(robot)), np.zeros(robot.n)
        chosen, errors = ObstacleSettings(), []

        def value(
            q: Array, scene: Scene, clearance: Clearance = clearance, still: Array = still
        ) -> tuple[float, Array, float]:
            found = look_around(clearance, scene, q, still, still, ObstacleSettings(), 0.01, 0)
            return found.potential.value, found.potential.gradient, found.closest.distance

        inside = 0
        for _ in range(positions):
            q, made = random_position(robot, rng), Scene()
            for index in range(6):
                pose = se3.exp(rng.normal(size=6))
                pose[:3, 3] = rng.uniform(-0.7, 0.7, 3)
                made = made.put(obstacle(str(index), shape(kind, size), pose))
            _, gradient, nearest = value(q, made)
            step = 1e-6
            reference = np.array(
                [
                    (value(q + step * row, made)[0] - value(q - step * row, made)[0]) / (2.0 * step)
                    for row in np.eye(robot.n)
                ]
            )
            if np.abs(reference).max() > 1e-3 * chosen.strength:
                errors.append(float(np.abs(gradient - reference).max() / np.abs(reference).max()))
                inside += nearest < 0.0
        good &= float(np.quantile(errors, 0.9)) < 2e-3
        lines.append(
            f"  {name:6} against {kind:9}: {len(errors)} positions in range, {inside} in penetration; relative error "
            f"median {np.median(errors):.1e}, 90 % {np.quantile(errors, 0.9):.1e}, worst {max(errors):.1e}"
        )
    return lines, good


def speed(ticks: int = 3000) -> tuple[list[str], bool]:
    """What looking around costs a tick."""
    robot, rng = arm("panda"), np.random.default_rng(1)
    geometry, lines = collision.load(robot), []
    for count in (0, 1, 5, 20):
        made = Scene()
        for index in range(count):
            pose = np.eye(4)
            pose[:3, 3] = rng.uniform(-0.8, 0.8, 3)
            made = made.put(obstacle(str(index), shape("sphere", (0.08,)), pose))
        clearance, taken = Clearance(geometry), []
        before = READY
        for tick in range(ticks):
            q = READY + 0.3 * np.sin(np.arange(7) + 0.5 * tick * PERIOD_S)
            qd, before = (q - before) / PERIOD_S, q
            start = time.perf_counter()
            look_around(clearance, made, q, qd, np.full(7, 0.02), ObstacleSettings(), 0.01, 0)
            taken.append(time.perf_counter() - start)
        lines.append(
            f"  panda, {count:2d} spheres, {clearance.pairs} pairs: "
            f"10 % {np.quantile(taken, 0.1) * 1e6:.0f} us, median {np.median(taken) * 1e6:.0f} us, "
            f"99 % {np.quantile(taken, 0.99) * 1e6:.0f} us"
        )
    return lines, True


def conservative() -> tuple[list[str], bool]:
    """By how much the hulls stand off the links, and which pairs are watched."""
    lines = []
    for name in ("panda", "ur5", "ur10", "ur3", "xarm7", "kinova", "talos_arm"):
        geometry = collision.load(arm(name))
        excess = {link: f"{value * 1e3:.0f}" for link, value in geometry.conservatism().items() if value > 5e-4}
        worst = ", ".join(f"{link} {value}" for link, value in excess.items()) or "none by more than 0.5"
        left_out = [pair for pair in geometry.pairs if not pair.watched and pair.reason != "joined by one joint"]
        lines.append(f"  {name}: {len(geometry.watched())} pairs watched; hull off the mesh, mm: {worst}")
        lines += [f"    not watched: {pair.first} - {pair.second}: {pair.reason}" for pair in left_out]
    return lines, True


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the figures; 1 when one is out of its bounds."""
    parser = argparse.ArgumentParser(prog="ik_benchmark obstacles", description=__doc__)
    parser.add_argument("--scenes", type=int, default=20, help="scenes to be driven past")
    parser.add_argument("--anywhere", action="store_true", help="obstacles out of the null space's reach too")
    parser.add_argument("--positions", type=int, default=300, help="positions for the gradients, each kind")
    parser.add_argument("--seed", type=int, default=1, help="of everything random")
    parser.add_argument("--only", choices=("scenes", "path", "gradients", "speed", "geometry"), help="one part")
    options = parser.parse_args(arguments)
    parts: dict[str, Callable[[], tuple[list[str], bool]]] = {
        "geometry": conservative,
        "gradients": lambda: gradients(options.positions, options.seed),
        "scenes": lambda: scenes(options.scenes, options.seed, options.anywhere),
        "path": lambda: _both(on_the_path("ur5"), on_the_path("panda")),
        "speed": speed,
    }
    good = True
    for name, part in parts.items():
        if options.only in (None, name):
            lines, within = part()
            print(f"\n{name}: {'within its bounds' if within else 'OUT OF ITS BOUNDS'}")
            print("\n".join(lines), flush=True)
            good &= within
    return 0 if good else 1


def _both(first: tuple[list[str], bool], second: tuple[list[str], bool]) -> tuple[list[str], bool]:
    return first[0] + second[0], first[1] and second[1]


if __name__ == "__main__":
    sys.exit(main())
