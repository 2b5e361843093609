"""``ik_benchmark ik``: success rate and time of inverse kinematics on random poses, with published tables."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks import haviland_corke
from benchmarks.haviland_corke import SearchMethod, SearchStatistics, levenberg_marquardt
from benchmarks.published import HAVILAND_CORKE, TRAC_IK, PublishedRow, PublishedTable
from ik_node.errors import InputError
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot

TOLERANCE = 1e-6
"""Tolerance of the poses, m and rad."""
SEED = 1
METHODS = {
    method.name: method
    for method in (
        SearchMethod("NR", haviland_corke.newton),
        SearchMethod("GN", haviland_corke.gauss_newton),
        SearchMethod("NR pinv", haviland_corke.newton_pinv),
        SearchMethod("GN pinv", haviland_corke.gauss_newton_pinv),
        levenberg_marquardt("Wampler", 1e-4),
        levenberg_marquardt("Wampler", 1e-6),
        levenberg_marquardt("Chan", 1.0),
        levenberg_marquardt("Chan", 0.1),
        levenberg_marquardt("Sugihara", 1e-3),
        levenberg_marquardt("Sugihara", 1e-4),
    )
}


class ReachResult(NamedTuple):
    """Result of :func:`reach`."""

    robot: str
    problems: int
    solved_percent: float
    mean_ms: float
    median_ms: float
    p99_ms: float
    max_ms: float
    mean_iterations: float
    max_iterations: int
    first_start_percent: float
    """Poses solved by the first search, from the middle of the range."""
    outside_limits: int
    """Solutions outside the joint limits."""
    false_claims: int
    """Solutions reported as converged whose pose is not within the tolerance."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_benchmark ik", description=__doc__)
    result.add_argument("--problems", type=int, default=10_000, help="poses per robot and method [%(default)s]")
    result.add_argument("--robots", nargs="+", default=list(TRAC_IK), help="for the first table [%(default)s]")
    result.add_argument("--only", choices=("reach", "haviland-corke"), help="one half of it")
    tables = sorted({table.robot for table in HAVILAND_CORKE})
    result.add_argument("--tables", nargs="+", choices=tables, default=tables, help="robots of the second table")
    result.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), help="of the second table")
    result.add_argument(
        "--draws", type=int, default=5, help="other random draws, for the spread of Haviland and Corke's experiment [5]"
    )
    result.add_argument("--json", action="store_true", help="print JSON")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 when a reported convergence is false or a solution is outside the limits."""
    options = parser().parse_args(arguments)
    if options.problems < 1 or options.draws < 0:
        raise InputError(f"--problems is {options.problems}, --draws {options.draws}; expected >= 1 and >= 0")
    document: dict[str, Any] = {}
    honest = True
    if options.only != "haviland-corke":
        results = []
        _print(options, _reach_head())
        for name in options.robots:
            results.append(reach(name, options.problems))
            _print(options, _reach_row(results[-1]))
        _print(options, _REACH_FOOT)
        honest = all(result.outside_limits == result.false_claims == 0 for result in results)
        document["reach"] = [result._asdict() for result in results]
    if options.only != "reach":
        document["haviland_corke"] = [
            _haviland_corke(table, options) for table in HAVILAND_CORKE if table.robot in options.tables
        ]
    if options.json:
        print(json.dumps(document, indent=1))
    return 0 if honest else 1


def reach(name: str, problems: int) -> ReachResult:
    """Solve random poses of the robot ``name``: poses at q drawn uniformly within the limits."""
    arm = catalogue.find(name)
    robot = Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)
    solver = PoseSolver(robot, eps_omega=TOLERANCE, eps_v=TOLERANCE)
    low = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
    high = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
    poses = [robot.pose(q) for q in np.random.default_rng(SEED).uniform(low, high, (problems, robot.n))]
    times, iterations, solved, first, outside, false = np.empty(problems), np.empty(problems, int), 0, 0, 0, 0
    for index, pose in enumerate(poses):
        begin = time.perf_counter()
        solution = solver.solve(pose)
        times[index] = 1e3 * (time.perf_counter() - begin)
        iterations[index] = solution.iterations
        solved += solution.converged
        first += solution.converged and solution.searches == 1
        outside += bool(((solution.q < robot.limits.lower) | (solution.q > robot.limits.upper)).any())
        false += solution.converged and not _reached(robot.pose(solution.q), pose)
    return ReachResult(
        name, problems, 100.0 * solved / problems, float(times.mean()), float(np.median(times)),
        float(np.percentile(times, 99)), float(times.max()), float(iterations.mean()), int(iterations.max()),
        100.0 * first / problems, outside, false,
    )  # fmt: skip


def _reached(pose: Array, wanted: Array) -> bool:
    """Compare by distance and angle, without the logarithm of the solver; 1 % covers the difference."""
    turn = pose[:3, :3].T @ wanted[:3, :3]
    sine = 0.5 * np.linalg.norm((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    angle = np.arctan2(sine, 0.5 * (np.trace(turn) - 1.0))
    return bool(max(float(np.linalg.norm(pose[:3, 3] - wanted[:3, 3])), float(angle)) <= 1.01 * TOLERANCE)


def _reach_head() -> str:
    return (
        f"Random reachable poses, joint limits kept, pose within {TOLERANCE:g} m and rad, start: middle of the range,\n"
        "at most 3000 iterations in all. Right: published (1e-5, at most 5 ms; their machine): solved %, mean ms.\n\n"
        f"{'robot':<10}{'solved %':>9}{'mean ms':>9}{'median':>8}{'p99':>7}{'max':>7}{'iter.':>7}{'max':>6}"
        f"{'1st start %':>13}{'outside':>9}{'false':>7}   | {'TRAC-IK':>13}{'KDL restarts':>15}{'KDL':>14}"
    )


def _reach_row(result: ReachResult) -> str:
    row = (
        f"{result.robot:<10}{result.solved_percent:9.2f}{result.mean_ms:9.3f}{result.median_ms:8.3f}"
        f"{result.p99_ms:7.2f}{result.max_ms:7.1f}{result.mean_iterations:7.1f}{result.max_iterations:6d}"
        f"{result.first_start_percent:13.1f}{result.outside_limits:9d}{result.false_claims:7d}   | "
    )
    if result.robot not in TRAC_IK:
        return row + f"{'-':>13}{'-':>15}{'-':>14}"
    other = TRAC_IK[result.robot]
    return row + "".join(
        f"{percent:{width}.2f} {mean:5.2f}"
        for width, (percent, mean) in ((7, other.trac_ik), (9, other.kdl_restarts), (8, other.kdl))
    )


_REACH_FOOT = """
outside: answers outside the joint limits. false: answers called converged that are not; both must be 0.
"""


def _haviland_corke(table: PublishedTable, options: argparse.Namespace) -> dict[str, Any]:
    arm = catalogue.find(table.robot)
    robot = Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)
    _print(
        options,
        f"\nHaviland and Corke, {table.title}; ours | published,\nand where the published mean lies among our draw "
        f"and {options.draws} others of a quarter the size\n\n{'method':<20}{'mean iter.':>16}{'median':>11}"
        f"{'infeasible %':>16}{'mean searches':>16}{'max':>10}{'outside %':>16}   mean iterations over draws",
    )
    rows = []
    for row in table.rows:
        if row.method not in options.methods:
            continue
        method = METHODS[row.method]
        ours = _run(robot, method, table, table.seed, options.problems)
        seeds = range(table.seed + 1, table.seed + 1 + options.draws)
        others = [_run(robot, method, table, seed, max(1, options.problems // 4)) for seed in seeds]
        means = [other.mean_iterations for other in (ours, *others)]
        _print(options, _comparison(ours, row, means))
        rows.append({"method": row.method, "ours": ours._asdict(), "published": row._asdict(), "draws": means})
    return {"table": table.title, "robot": table.robot, "rows": rows}


def _run(robot: Robot, method: SearchMethod, table: PublishedTable, seed: int, problems: int) -> SearchStatistics:
    return haviland_corke.run(
        robot, method, seed=seed, problems=problems, steps=table.steps, searches=table.searches,
        refuse_outside=table.refuse_outside,
    )  # fmt: skip


def _comparison(ours: SearchStatistics, row: PublishedRow, means: list[float]) -> str:
    middle, spread = float(np.mean(means)), float(np.std(means, ddof=1)) if len(means) > 1 else 0.0
    where = f"{(row.mean_iterations - middle) / spread:+.1f} sd" if spread > 0.0 else "-"
    if round(ours.mean_iterations, 2) == row.mean_iterations:
        where += ", equal"
    cpp = "" if row.mean_iterations_cpp is None else f"; their C++ {row.mean_iterations_cpp:.2f}"
    return (
        f"{row.method:<20}{ours.mean_iterations:8.2f} |{row.mean_iterations:6.2f}{ours.median_iterations:6.0f} |"
        f"{row.median_iterations:3.0f}{ours.infeasible_percent:9.2f} |{row.infeasible_percent:5.2f}"
        f"{ours.mean_searches:9.2f} |{row.mean_searches:5.2f}{ours.max_searches:5d} |{row.max_searches:3d}"
        f"{ours.outside_percent:9.2f} |{row.outside_percent:5.2f}   {middle:6.2f} +- {spread:.2f}: "
        f"published {where}{cpp}"
    )


def _print(options: argparse.Namespace, text: str) -> None:
    if not options.json:
        print(text, flush=True)
