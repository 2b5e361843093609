"""``ik_benchmark obstacles``: gradients against differences, scenes driven past, obstacles on the path, speed."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from benchmarks import scenes
from benchmarks.loop import PERIOD_S
from benchmarks.reference_solvers import arm, random_position
from benchmarks.sections import Part, print_parts
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.avoidance import look_around
from ik_node.collision.distances import Clearance
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.settings.groups import ObstacleSettings


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
        clearance, still = Clearance(collision_geometry.load(robot)), np.zeros(robot.n)
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
    geometry, lines = collision_geometry.load(robot), []
    for count in (0, 1, 5, 20):
        made = Scene()
        for index in range(count):
            pose = np.eye(4)
            pose[:3, 3] = rng.uniform(-0.8, 0.8, 3)
            made = made.put(obstacle(str(index), shape("sphere", (0.08,)), pose))
        clearance, taken = Clearance(geometry), []
        before = scenes.READY
        for tick in range(ticks):
            q = scenes.READY + 0.3 * np.sin(np.arange(7) + 0.5 * tick * PERIOD_S)
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
        geometry = collision_geometry.load(arm(name))
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
    parts: dict[str, Part] = {
        "geometry": conservative,
        "gradients": lambda: gradients(options.positions, options.seed),
        "scenes": lambda: scenes.table(options.scenes, options.seed, options.anywhere),
        "path": lambda: _both(scenes.on_the_path("ur5"), scenes.on_the_path("panda")),
        "speed": speed,
    }
    return print_parts(parts, options.only)


def _both(first: tuple[list[str], bool], second: tuple[list[str], bool]) -> tuple[list[str], bool]:
    return first[0] + second[0], first[1] and second[1]


if __name__ == "__main__":
    sys.exit(main())
