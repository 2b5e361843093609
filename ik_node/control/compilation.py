"""Compilation of all functions of the control step, before the first warm-up of a version, on several cores.

Each process makes a warm-up with an arm of its own, and they divide the functions among themselves
(:func:`ik_node.jit.shared_compilation`). What they leave is compiled by the warm-up that follows, which loads the rest
from disk.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable

from ik_node.control.warm_up import warm_up
from ik_node.jit import (
    CompilationProgress,
    cache_folder,
    compilation_reports,
    is_cold,
    mark_warm,
    shared_compilation,
)
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

MAX_PROCESSES = 4
"""A third of the time is spent on one function, which is not divided; each process takes 0.3 GB."""
JOINT = """
<joint name="joint{0}" type="revolute"><parent link="link{0}"/><child link="link{1}"/><origin xyz="0 0 0.15"/>
<axis xyz="{2} {3} {4}"/><limit lower="-2.5" upper="2.5" velocity="2" effort="50"/></joint>
<link name="link{1}"><inertial><mass value="2"/><origin xyz="0 0 0.07"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01"
iyz="0" izz="0.01"/></inertial><collision><origin xyz="0 0 0.07"/><geometry><cylinder radius="0.04" length="0.1"/>
</geometry></collision></link>
"""


def compile_and_warm_up(robot: Robot, settings: Settings, report: Callable[[str], None]) -> int:
    """Calls every compiled function of the control loop once, after it was compiled or loaded from disk.

    Args:
        robot: The arm.
        settings: Settings of the real controller.
        report: Receives the progress of the compilation as texts; none when everything is loaded from disk.

    Returns:
        The number of functions that were loaded or compiled.
    """
    with compilation_reports(report) as progress:
        count = min(len(os.sched_getaffinity(0)), MAX_PROCESSES)
        if count > 1 and is_cold() and cache_folder() is not None:
            _compile_in_processes(count, progress)
        called = warm_up(robot, settings)
    mark_warm()
    return called


def _compile_in_processes(count: int, progress: CompilationProgress) -> None:
    """Each process prints the names of the functions that it begins with, and ends when nobody reads them any more."""
    reading, writing = os.pipe()
    processes = []
    try:
        with os.fdopen(reading) as lines:
            with os.fdopen(writing) as output:
                for _ in range(count):
                    processes.append(
                        subprocess.Popen(
                            [sys.executable, "-m", __name__],
                            stdin=subprocess.DEVNULL,
                            stdout=output,
                            stderr=subprocess.DEVNULL,  # what a process leaves is compiled, or fails, in this one
                        )
                    )
            for line in lines:  # until the last process ends
                progress.begin(line.strip())
    finally:
        for process in processes:
            process.kill()
            process.wait()


def sample_arm() -> Robot:
    """An arm of seven joints without files: cylinders, masses, and an axis of another direction at each joint."""
    joints = (JOINT.format(number, number + 1, *((0, 0, 1), (0, 1, 0))[number % 2]) for number in range(7))
    return Robot(f'<robot name="sample"><link name="link0"/>{"".join(joints)}</robot>')


def print_name(name: str) -> None:
    """In one piece, because all processes print to the same pipe."""
    os.write(1, f"{name}\n".encode())


def main() -> None:
    """One of the processes: compiles, and prints the name of each function that it begins with."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whether the compilation ends is decided by the process that waits
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # not that of a node with real-time priority
    folder = cache_folder()
    if folder is not None:
        with shared_compilation(folder, print_name):
            warm_up(sample_arm(), Settings())


if __name__ == "__main__":
    main()
