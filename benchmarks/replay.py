"""``ik_benchmark replay``: runs of the node with every method, replayed bit for bit, and the speed of replay."""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.control.warm_up import warm_up
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource, calls
from ik_node.replay.what_if import RECORDED, compare, ground_truth_of, make_variants
from ik_node.settings.method_names import METHOD_NAMES

ROBOTS = ("panda", "ur5")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_benchmark replay", description=__doc__)
    result.add_argument("--robots", nargs="+", default=list(ROBOTS), help="[%(default)s]")
    result.add_argument("--methods", nargs="+", default=list(METHOD_NAMES), help="[%(default)s]")
    result.add_argument("--seconds", type=float, default=60.0, help="duration of each run, s [%(default)s]")
    result.add_argument("--rate", type=float, default=500.0, help="control rate, Hz [%(default)s]")
    result.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="parameter of the node")
    result.add_argument("--keep", type=Path, help="folder of the recordings; existing ones are reused")
    result.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes of the what-if runs [%(default)s]")
    result.add_argument("--json", action="store_true", help="print JSON")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Record, replay and print; return 0 when every run gives the same bits."""
    options = parser().parse_args(arguments)
    found: list[dict[str, Any]] = []
    fetched_s = 0.0
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for robot in options.robots:
            for method in options.methods:
                out = folder / f"{robot}_{method}"
                if not out.exists():
                    record(out, robot, method, options)
                if not found:
                    fetched_s = fetch(out / "bag")
                    if not options.json:
                        print(f"machine code fetched in {fetched_s:.1f} s, once per process and not counted below")
                found.append({"robot": robot, "method": method, **replayed(out / "bag")})
                if not options.json:
                    print(_row(found[-1]), flush=True)
        several = what_if(folder / f"{options.robots[0]}_{options.methods[0]}" / "bag", max(1, options.jobs or 1))
    if options.json:
        print(json.dumps({"fetched_s": fetched_s, "same": found, "what_if": several}, indent=1))
    else:
        print(
            f"what if: {several['runs']} methods on {several['jobs']} processes in {several['took_s']:.1f} s:"
            f" {several['simulated_s']:.0f} s simulated, {several['times_real_time']:.1f} times real time"
        )
    return 0 if all(entry["identical"] for entry in found) else 1


def record(out: Path, robot: str, method: str, options: argparse.Namespace) -> None:
    """Record a run of the node over DDS."""
    with tempfile.TemporaryDirectory() as scratch:
        poses = Path(scratch, "poses.csv")
        _write_poses(poses, options.seconds)
        arguments = ["--headless", "--robot", robot, "--method", method, "--rate", str(options.rate), "--relative"]
        for value in options.set:
            arguments += ["--set", value]
        command = [sys.executable, "-m", "ik_node.cli.demo", *arguments, "--trajectory", str(poses), "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise IkNodeError(f"ik_demo ended with {done.returncode}:\n{done.stdout[-1000:]}{done.stderr[-1000:]}")


def _write_poses(path: Path, seconds: float) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "x", "y", "z", "qx", "qy", "qz", "qw"))
        for index in range(int(50.0 * seconds) + 1):
            angle = 2.0 * np.pi * index / 500.0
            y, z, half = 0.1 * np.sin(angle), 0.05 * np.sin(2.0 * angle), 0.1 * np.sin(angle)
            writer.writerow((index / 50.0, 0.0, y, z, 0.0, 0.0, np.sin(half), np.cos(half)))


def fetch(bag: Path) -> float:
    """Load the machine code; return the time that takes, s."""
    begin = time.perf_counter()
    recorded = RecordingSource(bag)
    warm_up(recorded.robot(), recorded.head.settings)
    return time.perf_counter() - begin


def replayed(bag: Path) -> dict[str, Any]:
    """Replay one recording and measure the processor time."""
    wall, begin = time.perf_counter(), time.process_time()
    found = replay(RecordingSource(bag))
    took_s, wall_s = time.process_time() - begin, time.perf_counter() - wall
    return {
        "identical": found.identical,
        "ticks": found.steps,
        "duration_s": found.duration_s,
        "processor_s": took_s,
        "wall_s": wall_s,
        "times_real_time": found.duration_s / took_s,
        "us_per_tick": 1e6 * took_s / found.steps,
    }


def what_if(bag: Path, jobs: int) -> dict[str, Any]:
    """Run all methods on one recording in several processes."""
    opened = partial(RecordingSource, bag)
    wanted = (RECORDED, *make_variants(opened().initial_settings, ["all"], {}))
    truth = ground_truth_of(bag, "")
    begin = time.perf_counter()
    runs = compare(opened, wanted, truth, jobs)
    took_s = time.perf_counter() - begin
    times = [event.call.now.monotonic_ns for event in calls(opened())]
    duration_s = (times[-1] - times[0]) / NS
    simulated_s = len(runs) * duration_s
    return {
        "runs": len(runs),
        "jobs": jobs,
        "took_s": took_s,
        "simulated_s": simulated_s,
        "times_real_time": simulated_s / took_s,
    }


def _row(entry: dict[str, Any]) -> str:
    same = "bit for bit" if entry["identical"] else "PARTS"
    return (
        f"{entry['robot']:<8} {entry['method']:<18} {same:<12} {entry['ticks']:6d} ticks of {entry['duration_s']:.1f} s"
        f" in {entry['processor_s']:.1f} s: {entry['times_real_time']:.1f} times real time,"
        f" {entry['us_per_tick']:.0f} us per tick"
    )


if __name__ == "__main__":
    sys.exit(main())
