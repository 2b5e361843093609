"""``ik_benchmark task``: tasks with a tolerance on spinning and moving targets, beside pink and mink.

An ideal arm moves as commanded, at 500 Hz; every candidate gets the target at every step. Two runs each: from a tool
that is 30 degrees off a target at rest in what is followed, and on a target that moves in it. In both the target also
moves in what is free, at the rate of the row. Errors are those of :mod:`ik_node.math.task_error`, beyond the bands.
"""

from __future__ import annotations

import argparse
import gc
import json
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.task_rivals import NO_SCENE, make_rivals
from benchmarks.task_scenarios import SCENARIOS, TILT_RAD, Scenario
from benchmarks.tick import BLOCK, RATE_HZ, Candidate, Ours
from ik_node import resources
from ik_node.interfaces.clock import NS
from ik_node.math.task_error import excess, task_deviation
from ik_node.math.task_tolerance import EXACT, TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import read_settings

START = {"ur5": (0.0, -1.2, 1.6, -1.97, -1.57, 0.0), "so101": (0.0, -0.5, 0.6, 0.5, 0.0)}
OURS, FULL = "ik_node", "ik_node, whole pose"
SETTLED_M, SETTLED_RAD = 1e-3, np.deg2rad(0.1)
"""Errors within which a tool has settled."""
LENGTH_M = 0.3
"""Length that converts rotations to comparable translations."""
SKIPPED_S = 1.0
"""Start of the run on a moving target, in which the tool, at rest, catches up; its errors do not count."""
SETTLING_TOLERANCE, ERROR_RATIO, TIME_RATIO = 0.05, 0.1, 1.3
"""Aims: deviation of the settling time from that without spin; error, of the best rival's; time, of the full task's."""
Target = Callable[[float], Array]


class Run(NamedTuple):
    """A run of one candidate, with a value per step."""

    target_us: Array
    """Computing time of taking the target."""
    step_us: Array
    """Computing time of the step."""
    errors: Array
    """(steps, 2): position, m, and rotation, rad, beyond the tolerance."""
    velocities: Array
    """(steps, n), rad/s."""

    def settling_s(self) -> float:
        """Time after which the error stays settled; NaN when it does not."""
        outside = np.flatnonzero((self.errors > (SETTLED_M, SETTLED_RAD)).any(axis=1))
        last = outside[-1] + 1 if len(outside) else 0
        return float(last / RATE_HZ) if last < len(self.errors) else float("nan")

    def acceleration(self) -> float:
        """Largest acceleration of a joint, from rest, rad/s2."""
        return float(np.abs(np.diff(self.velocities, axis=0, prepend=0.0)).max() * RATE_HZ)


class Row(NamedTuple):
    """Figures of one candidate; errors are those on a moving target."""

    scenario: str
    rate: float
    candidate: str
    settling_s: float
    rms_mm: float
    largest_mm: float
    rms_mrad: float
    largest_mrad: float
    total_mm: float
    """RMS of both errors, rotations times :data:`LENGTH_M`."""
    acceleration: float
    """Of both runs, rad/s2."""
    p10_us: float
    """10th percentile of the step, as ``ik_benchmark tick`` compares; without taking the target."""
    median_us: float
    target_us: float
    """10th percentile of taking the target."""


class Aim(NamedTuple):
    """An aim for this package in one row."""

    scenario: str
    rate: float
    name: str
    value: float
    at_most: float

    @property
    def met(self) -> bool:
        """False for NaN as well."""
        return self.value <= self.at_most


def run(candidates: Sequence[tuple[Candidate, Target, TaskTolerance]], robot: Robot, q: Array, steps: int) -> list[Run]:
    """Runs candidates in turns, a block of steps each; all of them start at q (n,)."""
    lower, upper = robot.limits.lower, robot.limits.upper
    runs = [Run(np.zeros(steps), np.zeros(steps), np.zeros((steps, 2)), np.zeros((steps, robot.n))) for _ in candidates]
    states = [q.copy() for _ in candidates]
    gc.collect()
    gc.disable()
    try:
        for begin in range(0, steps, BLOCK):
            for number, (candidate, target, tolerance) in enumerate(candidates):
                position, form = states[number], tolerance.form
                for tick in range(begin, min(begin + BLOCK, steps)):
                    pose, time_ns = target(tick / RATE_HZ), NS + round(tick * NS / RATE_HZ)
                    error = excess(task_deviation(form, robot.pose(position), pose).components, form.half_widths)
                    runs[number].errors[tick] = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
                    begin_ns = time.perf_counter_ns()
                    candidate.target(pose, time_ns)
                    taken_ns = time.perf_counter_ns()
                    velocity = candidate.step(position, time_ns)
                    runs[number].step_us[tick] = 1e-3 * (time.perf_counter_ns() - taken_ns)
                    runs[number].target_us[tick] = 1e-3 * (taken_ns - begin_ns)
                    runs[number].velocities[tick] = velocity
                    position = np.clip(position + velocity / RATE_HZ, lower, upper)
                states[number] = position
    finally:
        gc.enable()
    return runs


def measure(scenario: Scenario, rate: float, seconds: float, with_rivals: bool) -> list[Row]:
    """Both runs of all candidates."""
    values = {"rate_hz": RATE_HZ, "follow.enabled": False, "obstacles.geometry": "none"}
    exact = read_settings(resources.config_file(f"{scenario.robot}.yaml")).with_values(
        {**values, "task.tolerance": EXACT, "task.frame": "tool"}
    )
    settings = exact.with_values({"task.tolerance": scenario.tolerance, "task.frame": scenario.frame})
    robot = robot_from_settings(settings.arm)
    q = np.array(START[scenario.robot])
    runs = [
        run(candidates, robot, q, round(seconds * RATE_HZ))
        for candidates in (
            list(_candidates(scenario, rate, moving, robot, settings, exact, with_rivals)) for moving in (False, True)
        )
    ]
    names = [OURS, FULL, *(rival.name for rival in _rivals(scenario, robot, with_rivals))]
    return [_row(scenario, rate, name, *pair) for name, pair in zip(names, zip(*runs, strict=True), strict=True)]


def _candidates(
    scenario: Scenario, rate: float, moving: bool, robot: Robot, settings: Settings, exact: Settings, with_rivals: bool
) -> Iterator[tuple[Candidate, Target, TaskTolerance]]:
    start = robot.pose(np.array(START[scenario.robot]))
    tilt = 0.0 if moving else TILT_RAD
    tolerance = TaskTolerance(scenario.tolerance, scenario.frame)

    def target(time_s: float) -> Array:
        return scenario.pose(start, time_s, rate, moving, tilt)

    def still(time_s: float) -> Array:
        """The target without motion in what is free."""
        return scenario.pose(start, time_s, 0.0, moving, tilt)

    yield Ours(OURS, robot, settings, NO_SCENE), target, tolerance
    yield Ours(FULL, robot, exact, NO_SCENE), still, TaskTolerance()
    for rival in _rivals(scenario, robot, with_rivals):
        yield rival, target, tolerance


def _rivals(scenario: Scenario, robot: Robot, with_rivals: bool) -> list[Candidate]:
    if not with_rivals:
        return []
    return [rival for costs in scenario.rivals for rival in make_rivals(robot, costs, RATE_HZ)]


def _row(scenario: Scenario, rate: float, name: str, settling: Run, moving: Run) -> Row:
    errors = moving.errors[round(SKIPPED_S * RATE_HZ) :]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    acceleration = max(settling.acceleration(), moving.acceleration())
    step_us, target_us = (times[len(times) // 5 :] for times in (moving.step_us, moving.target_us))
    p10, median = np.quantile(step_us, (0.1, 0.5)).tolist()
    return Row(
        scenario.name,
        rate,
        name,
        settling.settling_s(),
        1e3 * float(rms[0]),
        1e3 * float(errors[:, 0].max()),
        1e3 * float(rms[1]),
        1e3 * float(errors[:, 1].max()),
        1e3 * float(np.hypot(rms[0], LENGTH_M * rms[1])),
        acceleration,
        p10,
        median,
        float(np.quantile(target_us, 0.1)),
    )


def aims(rows: Sequence[Row], still_settling_s: float) -> list[Aim]:
    """The aims for this package in the rows of one scenario and rate.

    Args:
        rows: Of all candidates.
        still_settling_s: Its settling time on the target without spin.

    Returns:
        Settling, error when there are rivals, and time.
    """
    found = {row.candidate: row for row in rows}
    ours, full = found.pop(OURS), found.pop(FULL)
    place = ours.scenario, ours.rate
    change = abs(ours.settling_s / still_settling_s - 1.0)
    made = [Aim(*place, "settling time, change by the spin", change, SETTLING_TOLERANCE)]
    if found:
        best = min(found.values(), key=lambda row: row.total_mm)
        made.append(Aim(*place, f"error / {best.candidate}", ours.total_mm / best.total_mm, ERROR_RATIO))
    made.append(Aim(*place, "time / whole pose, 10 %", ours.p10_us / full.p10_us, TIME_RATIO))
    made.append(Aim(*place, "time / whole pose, median", ours.median_us / full.median_us, TIME_RATIO))
    return made


HEADING = (
    f"{'candidate':26}{'settling':>9}{'error: RMS':>20}{'largest':>20}{'accel.':>10}{'step: 10 %':>12}"
    f"{'median':>8}{'target':>8}\n"
    f"{'':26}{'s':>9}{'mm':>10}{'mrad':>10}{'mm':>10}{'mrad':>10}{'rad/s2':>10}{'us':>12}{'us':>8}{'us':>8}"
)


def text(row: Row) -> str:
    """One line of the table."""
    return (
        f"{row.candidate:26}{row.settling_s:9.3f}{row.rms_mm:10.3g}{row.rms_mrad:10.3g}{row.largest_mm:10.3g}"
        f"{row.largest_mrad:10.3g}{row.acceleration:10.1f}{row.p10_us:12.1f}{row.median_us:8.1f}{row.target_us:8.1f}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 0, whatever is missed."""
    parser = argparse.ArgumentParser(prog="ik_benchmark task", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=list(SCENARIOS), default=list(SCENARIOS), help="[%(default)s]")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each run, more than 1 [%(default)s]")
    parser.add_argument("--ours", action="store_true", help="without pink and mink")
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    options = parser.parse_args(arguments)
    if not options.seconds > SKIPPED_S:
        parser.error(f"--seconds is {options.seconds:g}; it has to be more than {SKIPPED_S:g}")
    rows: list[Row] = []
    judged: list[Aim] = []
    for scenario in (SCENARIOS[name] for name in options.only):
        still = float("nan")
        for rate in scenario.rates:
            found = measure(scenario, rate, options.seconds, not options.ours)
            still = found[0].settling_s if rate == 0.0 else still
            unit = "m/s" if np.isinf(scenario.tolerance[:3]).any() else "rad/s"
            print(f"\n{scenario.name}, {scenario.robot}, free part {rate:g} {unit}\n{HEADING}")
            print("\n".join(text(row) for row in found))
            for aim in (made := aims(found, still)):
                verdict = "met" if aim.met else "MISSED"
                print(f"  {aim.name}: {aim.value:.4f}, at most {aim.at_most:g}: {verdict}", flush=True)
            rows += found
            judged += made
    if options.json:
        machine = {"processor": platform.processor() or platform.machine(), "python": platform.python_version()}
        content = {
            "machine": machine,
            "rows": [row._asdict() for row in rows],
            "aims": [{**aim._asdict(), "met": aim.met} for aim in judged],
        }
        options.json.write_text(json.dumps(content, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
