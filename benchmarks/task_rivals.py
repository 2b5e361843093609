"""pink and mink with costs for each axis, for ``ik_benchmark task``.

Neither has a tolerance; what is free gets no cost, which masks the logarithm. mink's AxisAlignTask aligns one axis of
the tool without a logarithm. Each runs with the gain of this package and with its own default, which corrects the
whole error within one step; the velocity limits of the joints hold, the acceleration is not limited.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from benchmarks.tick_rivals import GAIN, Mink, Pink, optional_module
from ik_node.collision.scene import Scene
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

NO_SCENE = Scene({})


class Costs(NamedTuple):
    """Costs of a frame task of pink or mink, in the axes of the tool."""

    name: str
    linear: tuple[float, float, float]
    angular: tuple[float, float, float]
    aligns_z: bool = False
    """Whether mink's AxisAlignTask brings the z axis of the tool onto that of the target."""


class TaskPink(Pink):
    """pink with a frame task of given costs."""

    def __init__(self, robot: Robot, costs: Costs, gain: float, rate_hz: float) -> None:
        """Gain: part of the error that is corrected in a step."""
        super().__init__(robot, NO_SCENE, rate_hz)
        self.name = _name("pink", costs, gain, rate_hz)
        tasks = optional_module("pink.tasks")
        self._task = tasks.FrameTask(robot.tip_frame, list(costs.linear), list(costs.angular), gain=gain)


class TaskMink(Mink):
    """mink with a frame task of given costs, and its task of an axis."""

    def __init__(self, robot: Robot, costs: Costs, gain: float, rate_hz: float) -> None:
        """Gain: part of the error that is corrected in a step."""
        super().__init__(robot, NO_SCENE, rate_hz)
        self.name = _name("mink", costs, gain, rate_hz)
        mink = optional_module("mink")
        self._task = mink.FrameTask("tool", "site", costs.linear, costs.angular, gain=gain)
        self._tasks = [self._task]
        if costs.aligns_z:
            self._tasks.append(mink.AxisAlignTask("tool", "site", (0.0, 0.0, 1.0), gain=gain))

    def target(self, pose: Array, time_ns: int) -> None:
        """As in :class:`benchmarks.tick.Candidate`."""
        super().target(pose, time_ns)
        for task in self._tasks[1:]:
            task.set_target(self._target[:3, 2])


def make_rivals(robot: Robot, costs: Costs, rate_hz: float) -> list[Any]:
    """Candidates with these costs, with both gains; none that is not installed."""
    gains = GAIN / rate_hz, 1.0
    made: list[Any] = []
    if optional_module("pink") and not costs.aligns_z:
        made += [TaskPink(robot, costs, gain, rate_hz) for gain in gains]
    if optional_module("mink") and optional_module("mujoco"):
        made += [TaskMink(robot, costs, gain, rate_hz) for gain in gains]
    return made


def _name(library: str, costs: Costs, gain: float, rate_hz: float) -> str:
    return f"{library} {costs.name}, {gain * rate_hz:g}/s"
