"""What a control step costs in counts that noise does not change: calls of Python functions, specialisations.

A second evaluation of the kinematics, a computation in Python that was in compiled code, or a status text that is made
at each step shows here, on any machine. Times are measured by ``ik_benchmark tick``.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from loop import READY, Loop, make_robot

import ik_node
from ik_node.control.warm_up import warm_up
from ik_node.jit import compilation_count
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

STEPS = 50
CALLS = {"none": 135, "hull": 155}
"""Largest mean number of calls of the package's Python functions per control step, by ``obstacles.geometry``."""
ONCE = ("velocity_controller.compute", "solver.solve_twist", "robot.evaluate", "step_report.report_step")
PACKAGE = Path(ik_node.__file__).parent
ARM = PACKAGE / "robot" / "simulated_arm.py"


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def counted(loop: Loop) -> Counter[str]:
    """Calls of the package's Python functions in ``STEPS`` control steps, by module and name, without the arm's."""
    calls: Counter[str] = Counter()

    def count(frame: FrameType, event: str, argument: object) -> None:
        del argument
        file = Path(frame.f_code.co_filename)
        if event == "call" and PACKAGE in file.parents and file != ARM:
            calls[f"{file.stem}.{frame.f_code.co_name}"] += 1

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        for _ in range(STEPS):
            loop.tick()
    finally:
        sys.setprofile(before)
    return calls


@pytest.mark.parametrize("geometry", ["none", "hull"])
def test_a_control_step_calls_few_python_functions(panda: Robot, geometry: str) -> None:
    settings = Settings().with_values({"obstacles.geometry": geometry, "follow.enabled": False})
    warm_up(panda, settings)
    loop = Loop(panda, READY["panda"], settings)
    loop.run(0.1)
    pose = loop.pose()
    for index in range(10):
        loop.target(pose + np.eye(4, k=3) * 1e-3 * index)
        loop.run(0.02)
    specialisations = compilation_count()
    calls = counted(loop)
    assert {name: calls[name] for name in ONCE} == dict.fromkeys(ONCE, STEPS)
    assert compilation_count() == specialisations
    assert calls.total() / STEPS <= CALLS[geometry], calls.most_common(20)
