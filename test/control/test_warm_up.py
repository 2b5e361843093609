"""No function is compiled while an arm moves: after the warm-up, recorded runs of every kind, and targets of every kind
on other arms, find every function compiled.

Each run has its own process, because functions compiled by another run or test would hide missing ones.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support import PROJECT

BAGS = sorted(path.parent for path in (PROJECT / "bags").glob("*/metadata.yaml"))
PROGRAM = """
import sys
from ik_node.jit import compilation_count
from ik_node.replay.call_source import RecordingSource
from ik_node.control.warm_up import warm_up
from ik_node.replay.bitwise import replay

bag = RecordingSource(sys.argv[1])
compiled = warm_up(bag.robot(), bag.head.settings)
before = compilation_count()
ticks = replay(bag).steps
print(compiled, ticks, compilation_count() - before)
"""


LOOP = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from loop import Loop, make_robot
from ik_node.interfaces.clock import NS
from ik_node.jit import compilation_count
from ik_node.interfaces.samples import ObstacleSample, PathSample, TrajectorySample, TwistSample
from ik_node.control.warm_up import warm_up
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.settings.groups import Settings

robot = make_robot(sys.argv[2])
compiled = warm_up(robot, Settings())
lower, upper = robot.limits.lower, robot.limits.upper
start = np.where(np.isfinite(lower) & np.isfinite(upper), 0.3 * lower + 0.7 * upper, 0.5)
before = compilation_count()
loop = Loop(robot, start)
controller, base = loop.controller, robot.base_frame
loop.run(0.1)
at = loop.position.copy()
loop.position[0] += 1.0
loop.run(0.01)
loop.position[:] = at
loop.run(0.1)
begin = loop.pose()
times_ns = tuple(round(0.1 * count * NS) for count in range(6))
points = begin[:3, 3] + 0.004 * np.arange(6.0)[:, None]
quaternions = np.repeat(quaternion_from_rotation(begin[:3, :3])[None], 6, axis=0)
controller.on_obstacles(
    (ObstacleSample(0, base, "box", "add", "box", (0.1, 0.1, 0.1), points[-1] + 0.2, quaternions[0], 0),), loop.now
)
stamps = tuple(loop.now.ros_ns + time_ns for time_ns in times_ns)
controller.on_target_path(PathSample((base,) * 6, stamps, points, quaternions), loop.now)
loop.run(0.8)
controller.on_target_path(PathSample((base,) * 6, (0,) * 6, points[::-1] + 0.01, quaternions), loop.now)
loop.run(1.0)
none = np.zeros((0, 6))
controller.on_target_trajectory(TrajectorySample(0, base, times_ns, points, quaternions, none, none), loop.now)
loop.run(0.3)
controller.on_target_twist(TwistSample(0, base, np.full(6, 0.05)), loop.now)
loop.run(0.5)
loop.follow(lambda time: begin, 0.5, 50.0)
far = begin.copy()
far[:3, 3] += 5.0
loop.target(far)
loop.run(1.0)
free = float("inf")
tolerances = (0, 0, 0, free, free, free), (0, 0, free, 0, 0, free), (0.01, 0, 0, 0.1, 0, 0), (0, 0, 0, free, 0.1, free)
for tolerance in tolerances:
    loop.settings = loop.settings.with_values({"task.tolerance": tolerance})
    controller.apply(loop.settings)
    loop.follow(lambda time: begin, 0.3, 50.0)
    controller.on_target_path(PathSample((base,) * 6, (0,) * 6, points, quaternions), loop.now)
    loop.run(0.2)
    controller.on_target_twist(TwistSample(0, base, np.full(6, 0.05)), loop.now)
    loop.run(0.2)
weights = tuple(1.0 + count for count in range(robot.n))
values = {"locked_joints": robot.joints[-1:], "method": "joint_weighted", "joint_weights": weights}
for changes in (values, {"task.tolerance": (0.0,) * 6}, {"control_law": "ik_difference"}, {"locked_joints": ()}):
    loop.settings = loop.settings.with_values(changes)
    controller.apply(loop.settings)
    loop.follow(lambda time: begin, 0.3, 50.0)
    controller.on_target_twist(TwistSample(0, base, np.full(6, 0.05)), loop.now)
    loop.run(0.2)
print(compiled, len(loop.steps), compilation_count() - before)
"""


@pytest.mark.parametrize("robot", ["z1", pytest.param("talos_arm", marks=pytest.mark.exhaustive), "kinova"])
def test_every_kind_of_target_finds_every_function_compiled(robot: str) -> None:
    _nothing_late([sys.executable, "-c", LOOP, str(PROJECT / "test"), robot])


@pytest.mark.parametrize("bag", BAGS, ids=lambda path: path.name)
def test_a_recorded_run_finds_every_function_compiled(bag: Path) -> None:
    _nothing_late([sys.executable, "-c", PROGRAM, str(bag)])


def _nothing_late(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    compiled, ticks, late = map(int, done.stdout.split())
    assert compiled > 0
    assert ticks > 0
    assert late == 0
