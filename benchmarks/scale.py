"""``ik_benchmark scale``: computing time of a control step per arm, for several arms in one process and in one each.

In one process the controllers take turns step by step, as in a process that composes several nodes. With a process for
each arm all run at the same time, more of them than there are cores. Computing time of the process is counted, so that
waiting for a core is not.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from benchmarks.tick import ARMS, RATE_HZ, START, TARGET_STEPS, Ours, circle
from ik_node.collision.scene import Scene
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.settings.groups import Settings

COUNTS = (1, 2, 4, 8)
WARM_STEPS = 200
MAX_RATIO = 1.3
"""Computing time per arm beside that of one arm that counts as constant."""


class Times(NamedTuple):
    """Computing time of a control step, us."""

    p10: float
    mean: float


def steps_of(count: int, steps: int, arm: str) -> Times:
    """Times of a step with ``count`` controllers in this process."""
    settings = Settings(arm=ARMS[arm]).with_values({"rate_hz": RATE_HZ, "follow.enabled": False})
    robots = [catalogue.robot_from_settings(settings.arm) for _ in range(count)]
    controllers = [Ours(str(index), robot, settings, Scene()) for index, robot in enumerate(robots)]
    start = np.array(START[arm])[: robots[0].n]
    pose, states = robots[0].pose(start), [start.copy() for _ in controllers]
    times: Array = np.empty((steps, count))
    for tick in range(WARM_STEPS + steps):
        time_ns = NS + round(tick * NS / RATE_HZ)
        for index, controller in enumerate(controllers):
            if tick % TARGET_STEPS == 0:
                controller.target(circle(pose, tick / RATE_HZ), time_ns)
            begin_ns = time.thread_time_ns()
            velocity = controller.step(states[index], time_ns)
            if tick >= WARM_STEPS:
                times[tick - WARM_STEPS, index] = 1e-3 * (time.thread_time_ns() - begin_ns)
            states[index] = states[index] + velocity / RATE_HZ
    return Times(float(np.quantile(times, 0.1)), float(times.mean()))


def _run(pipe: Connection, steps: int, arm: str) -> None:
    steps_of(1, 1, arm)  # loads the machine code
    pipe.send("ready")
    pipe.recv()
    pipe.send(steps_of(1, steps, arm))


def steps_of_processes(count: int, steps: int, arm: str) -> Times:
    """Times of a step with a process for each of ``count`` controllers; the mean of the processes."""
    context = get_context("spawn")
    pairs = [context.Pipe() for _ in range(count)]
    processes = [context.Process(target=_run, args=(theirs, steps, arm), daemon=True) for _, theirs in pairs]
    for process in processes:
        process.start()
    for pipe, _ in pairs:
        pipe.recv()
    for pipe, _ in pairs:
        pipe.send("go")
    found = [pipe.recv() for pipe, _ in pairs]
    for process in processes:
        process.join()
    return Times(*np.mean(np.array(found), axis=0).tolist())


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table; returns 1 when the computing time per arm grows."""
    parser = argparse.ArgumentParser(prog="ik_benchmark scale", description=__doc__)
    parser.add_argument("--robot", choices=list(ARMS), default="panda", help="[%(default)s]")
    parser.add_argument("--steps", type=int, default=3000, help="control steps per arm [%(default)s]")
    parser.add_argument("--arms", type=int, nargs="+", default=COUNTS, help="[1 2 4 8]")
    options = parser.parse_args(arguments)
    print(f"{options.robot}, computing time of a control step per arm, us")
    print(f"{'arms':>5}{'one process: 10 %':>20}{'mean':>8}{'a process each: 10 %':>24}{'mean':>8}")
    rows = []
    for count in options.arms:
        one = steps_of(count, options.steps, options.robot)
        each = steps_of_processes(count, options.steps, options.robot)
        rows.append((one, each))
        print(f"{count:5}{one.p10:20.1f}{one.mean:8.1f}{each.p10:24.1f}{each.mean:8.1f}", flush=True)
    ratios = [max(entry[place].p10 for entry in rows) / rows[0][place].p10 for place in range(2)]
    print(f"largest ratio to one arm: {ratios[0]:.2f} in one process, {ratios[1]:.2f} with a process each")
    return 1 if max(ratios) > MAX_RATIO else 0


if __name__ == "__main__":
    sys.exit(main())
