"""``ik_benchmark obstacles``: gradients against differences, motions beside obstacles, obstacles on the path, speed."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks import scenes
from benchmarks.arms import arm, random_position
from benchmarks.loop import PERIOD_S
from benchmarks.sections import Section, SectionResult, print_sections
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.avoidance import avoidance_terms
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.monitor import UPRIGHT, CollisionMonitor
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import ObstacleSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.settings.groups import ObstacleSettings


def gradients(positions: int, seed: int) -> SectionResult:
    """Compare grad_h with central differences: exact for spheres, measured for hulls, outside and in penetration."""
    rng, lines, good = np.random.default_rng(seed), [], True
    rows = list[dict[str, Any]]()
    for name, kind, size in (
        ("z1", "sphere", (0.08,)),
        ("panda", "sphere", (0.08,)),
        ("panda", "capsule", (0.05, 0.3)),
        ("panda", "box", (0.2, 0.1, 0.1)),
        ("panda", "cylinder", (0.06, 0.2)),
        ("ur5", "sphere", (0.08,)),
    ):
        robot = arm(name)
        clearance, still = DistanceQuery(collision_geometry.load(robot)), np.zeros(robot.n)
        chosen, errors = ObstacleSettings(), []

        def value(
            q: Array, scene: Scene, clearance: DistanceQuery = clearance, still: Array = still
        ) -> tuple[float, Array, float]:
            found = avoidance_terms(clearance, scene, q, still, still, ObstacleSettings(), 0.01, 0)
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
            if np.abs(reference).max() > 1e-3 * chosen.repulsion_force:
                errors.append(float(np.abs(gradient - reference).max() / np.abs(reference).max()))
                inside += nearest < 0.0
        good &= float(np.quantile(errors, 0.9)) < 2e-3
        median, most = float(np.median(errors)), float(np.quantile(errors, 0.9))
        rows.append({"robot": name, "shape": kind, "compared": len(errors), "median": median, "most": most})
        lines.append(
            f"  {name:6} against {kind:9}: {len(errors)} positions in range, {inside} in penetration; relative error "
            f"median {np.median(errors):.1e}, 90 % {np.quantile(errors, 0.9):.1e}, worst {max(errors):.1e}"
        )
    return SectionResult(lines, good, rows)


def speed(ticks: int = 3000) -> SectionResult:
    """Measure the computing time of distances and avoidance terms per control step."""
    robot, rng = arm("panda"), np.random.default_rng(1)
    geometry, lines = collision_geometry.load(robot), []
    for count in (0, 1, 5, 20):
        made = Scene()
        for index in range(count):
            pose = np.eye(4)
            pose[:3, 3] = rng.uniform(-0.8, 0.8, 3)
            made = made.put(obstacle(str(index), shape("sphere", (0.08,)), pose))
        clearance, taken = DistanceQuery(geometry), []
        before = scenes.READY
        for tick in range(ticks):
            q = scenes.READY + 0.3 * np.sin(np.arange(7) + 0.5 * tick * PERIOD_S)
            qd, before = (q - before) / PERIOD_S, q
            start = time.perf_counter()
            avoidance_terms(clearance, made, q, qd, np.full(7, 0.02), ObstacleSettings(), 0.01, 0)
            taken.append(time.perf_counter() - start)
        lines.append(
            f"  panda, {count:2d} spheres, {clearance.pairs} pairs: "
            f"10 % {np.quantile(taken, 0.1) * 1e6:.0f} us, median {np.median(taken) * 1e6:.0f} us, "
            f"99 % {np.quantile(taken, 0.99) * 1e6:.0f} us"
        )
    return SectionResult(lines, True)


def messages(count: int = 500, moved: int = 10, rounds: int = 200) -> SectionResult:
    """Measure taking a MarkerArray of ``count`` spheres of which ``moved`` moved, and the next control step."""
    robot, rng = arm("panda"), np.random.default_rng(1)
    monitor, frames = CollisionMonitor(robot, ObstacleSettings()), Frames(robot)
    direction = rng.normal(size=(count, 3))
    places = 2.0 * direction / np.linalg.norm(direction, axis=1)[:, None]
    q, still = np.array(scenes.READY), np.zeros(robot.n)
    taken, stepped, quiet = list[float](), list[float](), list[float]()
    for number in range(rounds):
        places[rng.choice(count, moved, replace=False)] += 0.01 * rng.normal(size=(moved, 3))
        samples = tuple(
            ObstacleSample(0, robot.base_frame, f"{index}", "add", "sphere", (0.05,), place.copy(), UPRIGHT, 0)
            for index, place in enumerate(places)
        )
        now = Instant(NS + number * NS // 30, NS + number * NS // 30)
        begin = time.perf_counter()
        monitor.update_obstacles(samples, frames, now, NS)
        taken.append(time.perf_counter() - begin)
        for times in (stepped, quiet):
            begin = time.perf_counter()
            monitor.update(q, still, np.full(7, 0.02), 0.01, now.monotonic_ns, True)
            times.append(time.perf_counter() - begin)
    lines = [f"  panda, {count} spheres at 30 Hz of which {moved} moved:"]
    for what, times in (("message", taken), ("distances in the next step", stepped), ("in the one after", quiet)):
        low, median = 1e6 * np.quantile(times[10:], (0.1, 0.5))
        lines.append(f"    {what:28} 10 % {low:.0f} us, median {median:.0f} us")
    return SectionResult(lines, True)


def conservative() -> SectionResult:
    """List by how much hulls exceed their links, and the checked pairs."""
    lines = []
    for name in ("panda", "ur5", "ur10", "ur3", "xarm7", "kinova", "talos_arm"):
        geometry = collision_geometry.load(arm(name))
        excess = {link: f"{value * 1e3:.0f}" for link, value in geometry.conservatism().items() if value > 5e-4}
        worst = ", ".join(f"{link} {value}" for link, value in excess.items()) or "none by more than 0.5"
        left_out = [pair for pair in geometry.pairs if not pair.watched and pair.reason != "adjacent"]
        lines.append(f"  {name}: {len(geometry.watched())} pairs checked; hull outside the mesh, mm: {worst}")
        lines += [f"    not checked: {pair.first} - {pair.second}: {pair.reason}" for pair in left_out]
    return SectionResult(lines, True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; return 1 when one is out of its bounds."""
    parser = argparse.ArgumentParser(prog="ik_benchmark obstacles", description=__doc__)
    parser.add_argument("--scenes", type=int, default=20, help="number of scenes")
    parser.add_argument("--anywhere", action="store_true", help="also obstacles that null-space motion cannot avoid")
    parser.add_argument("--positions", type=int, default=300, help="positions per kind of gradient")
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers")
    parser.add_argument(
        "--only", choices=("scenes", "path", "gradients", "speed", "messages", "geometry"), nargs="+", default=[]
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per row instead of the tables")
    options = parser.parse_args(arguments)
    sections: dict[str, Section] = {
        "geometry": conservative,
        "gradients": lambda: gradients(options.positions, options.seed),
        "scenes": lambda: scenes.table(options.scenes, options.seed, options.anywhere),
        "path": lambda: _both(scenes.on_the_path("ur5"), scenes.on_the_path("panda")),
        "speed": speed,
        "messages": messages,
    }
    return print_sections(sections, options.only, options.json)


def _both(first: SectionResult, second: SectionResult) -> SectionResult:
    return SectionResult(first.lines + second.lines, first.within and second.within, [*first.rows, *second.rows])


if __name__ == "__main__":
    sys.exit(main())
