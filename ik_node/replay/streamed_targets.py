"""Controller calls of a stream of target poses that exists as numbers only: a simulation without ROS."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ik_node.control.controller import Controller
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.delivery import CLOCK_PERIOD_S
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array
from ik_node.messages.encode import encode_joint_state, encode_pose
from ik_node.messages.step_codec import Call, CallKind
from ik_node.recording.call_log import RecordedCall
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

LEAD_S = 0.2
"""Time from the first joint state to the first target."""


class SimulatedStart(NamedTuple):
    """Where and when a simulation begins."""

    position: Array
    """Joint positions (n,), rad (m)."""
    now: Instant
    """Time of the first joint state."""


class StreamedTargets:
    """A :class:`~ik_node.replay.call_source.CallSource`: joint states, clock calls and target poses at their times.

    The positions in the joint states are those of the start; :mod:`ik_node.replay.closed_loop` replaces them by those
    of the simulated arm.
    """

    def __init__(
        self,
        robot: Robot,
        settings: Settings,
        start: SimulatedStart,
        targets: Sequence[tuple[float, Array]],
        state_rate_hz: float,
        hold_s: float,
    ) -> None:
        """Describe the run.

        Args:
            robot: The robot.
            settings: Settings of the controller.
            start: Start of the simulated arm.
            targets: (time_s, T_sd) in the order of their times, from :data:`LEAD_S` after the start on.
            state_rate_hz: Rate of the joint states.
            hold_s: Time after the last target.
        """
        self.initial_settings = settings
        self._robot = robot
        self._start = start
        self._targets = targets
        self._state_period_ns = round(NS / state_rate_hz)
        self._end_ns = self.at_ns(targets[-1][0] + hold_s) if targets else self.at_ns(hold_s)

    def at_ns(self, time_s: float) -> int:
        """Monotonic time of a target, ns."""
        return self._start.now.monotonic_ns + round((LEAD_S + time_s) * NS)

    def robot(self) -> Robot:
        """A new robot of the run."""
        old = self._robot
        return Robot(old.urdf, old.base_frame, old.tip_frame, old.joints, self.initial_settings.arm.joint_prefix)

    def controller(self, settings: Settings | None = None) -> Controller:
        """A new controller, as it is after its activation."""
        return Controller(self.robot(), settings or self.initial_settings)

    def settings(self, recorded: RecordedCall) -> Settings:
        """The settings, which never change."""
        del recorded
        return self.initial_settings

    def entries(self) -> Iterator[RecordedCall]:
        """The calls; of those at one time the target is first, as of a stream that waits for the next joint state."""
        later_ns = self._start.now.ros_ns - self._start.now.monotonic_ns
        for number, (time_ns, _, kind, data) in enumerate(heapq.merge(self._poses(), self._states(), self._clock())):
            sequence = -1 if kind is CallKind.ON_CLOCK else number
            yield RecordedCall(number, Call(kind, sequence, Instant(time_ns, time_ns + later_ns)), data, None)

    def _poses(self) -> Iterator[tuple[int, int, CallKind, bytes]]:
        later_ns = self._start.now.ros_ns - self._start.now.monotonic_ns
        for time_s, pose in self._targets:
            time_ns = self.at_ns(time_s)
            quaternion = quaternion_from_rotation(pose[:3, :3])
            data = encode_pose(self._robot.base_frame, time_ns + later_ns, pose[:3, 3], quaternion)
            yield time_ns, 0, CallKind.ON_TARGET_POSE, data

    def _states(self) -> Iterator[tuple[int, int, CallKind, bytes]]:
        later_ns = self._start.now.ros_ns - self._start.now.monotonic_ns
        for time_ns in range(self._start.now.monotonic_ns, self._end_ns, self._state_period_ns):
            data = encode_joint_state(self._robot.joints, time_ns + later_ns, self._start.position)
            yield time_ns, 1, CallKind.ON_JOINT_STATE, data

    def _clock(self) -> Iterator[tuple[int, int, CallKind, bytes]]:
        for time_ns in range(self._start.now.monotonic_ns, self._end_ns, round(CLOCK_PERIOD_S * NS)):
            yield time_ns, 2, CallKind.ON_CLOCK, b""
