"""Which input is in command, and the motion that it asks for.

The rule: **the latest one that asks for something is in command.** A pose, a path, a trajectory or a twist that is
accepted takes command from whatever had it; a running path is dropped by a pose and a stream by a path. A twist of zero
asks for nothing: it keeps or ends a jog, but takes command from nobody. An input that falls silent, or a path that is
done, keeps the arm where it left it (hold) until the next one.

The reference never jumps: whoever takes command gets it with the position, velocity and acceleration that it has.

What ``time_rate`` does: the reference of a path and of a jog goes on by the part s of each twist that the limits let
through, so that a path is kept, only later, and a jog does not run ahead of the arm. A stream cannot be slowed: its
samples say where the target is now. There the arm falls behind, and catches up along the shortest way.
"""

from __future__ import annotations

from enum import Enum
from math import nan
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError, TargetRefused
from ik_node.interfaces.clock import NS, Instant, Stamped, to_monotonic
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.samples import PathSample, TrajectorySample, TwistSample
from ik_node.math.numerics import checked_vector
from ik_node.math.quaternion import from_matrix
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.targets.jerk_limited_filter import RigidMotion
from ik_node.targets.jog import Jog, JogSnapshot, TwistFrame
from ik_node.targets.path.follower import PathFollower, PathSnapshot
from ik_node.targets.path.request import (
    FASTEST_M_S,
    FASTEST_RAD_S,
    FramePose,
    PathRequest,
    request_from_path,
    request_from_trajectory,
)
from ik_node.targets.stream.stream import StreamedPoses, StreamSnapshot

MAX_STAMP_AGE_S = 1.0
"""If the stamp of a target is older than this, the time of arrival is used instead."""
SOURCE_CHANGES = 4
"""So many changes of command between two inputs ..."""
SOURCE_CHANGES_WITHIN_S = 2.0
"""... in this time mean that both are being published at once."""


class TargetSource(Enum):
    """Who is in command; the values are the names of the inputs."""

    NONE = "none"
    POSE = "target_pose"
    PATH = "target_path"
    TRAJECTORY = "target_trajectory"
    TWIST = "target_twist"


class ArbiterSnapshot(NamedTuple):
    """Everything that is remembered; plain data."""

    source: TargetSource
    previous_source: TargetSource
    """Who was in command before."""
    changes_ns: tuple[int, ...]
    """When command last changed between those two."""
    time_ns: int
    warning: str
    """What a person should know about the last path or twist."""
    stream: StreamSnapshot
    path: PathSnapshot
    jog: JogSnapshot


class TargetArbiter:
    """Every input's targets in, one motion out. All times are monotonic nanoseconds; one thread."""

    def __init__(self, settings: Settings, robot: Robot | None = None) -> None:
        """``robot``: so that paths without times get some that its joints can keep."""
        self._stream = StreamedPoses(settings.target)
        self._path = PathFollower(settings, robot)
        self._jog = Jog(settings)
        self._settings = settings
        self._source = self._previous_source = TargetSource.NONE
        self._changes_ns: tuple[int, ...] = ()
        self._time_ns = 0
        self._warning = ""

    def configure(self, settings: Settings) -> None:
        """Other settings from now on; whoever is in command goes on."""
        self._settings = settings
        self._stream.configure(settings.target)
        self._path.configure(settings)
        self._jog.configure(settings)

    def capture(self) -> ArbiterSnapshot:
        """A snapshot, for :meth:`restore`."""
        return ArbiterSnapshot(
            self._source,
            self._previous_source,
            self._changes_ns,
            self._time_ns,
            self._warning,
            self._stream.capture(),
            self._path.capture(),
            self._jog.capture(),
        )

    def restore(self, snapshot: ArbiterSnapshot) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._source, self._previous_source, self._changes_ns, self._time_ns, self._warning = snapshot[:5]
        self._stream.restore(snapshot.stream)
        self._path.restore(snapshot.path)
        self._jog.restore(snapshot.jog)

    # --- inputs ------------------------------------------------------------------------------------------------------

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Nobody in command, at rest at ``pose_sd`` (4, 4); everything else is forgotten."""
        self._source = self._previous_source = TargetSource.NONE
        self._changes_ns, self._warning, self._time_ns = (), "", time_ns
        self._stream.start(pose_sd, time_ns)
        self._path.forget()
        self._jog.begin(_resting(pose_sd), time_ns)

    def rest_at(self, pose_sd: Array, time_ns: int) -> None:
        """Goes on with whoever is in command, from rest at ``pose_sd``: for an arm that did not follow for a while."""
        reference = _resting(pose_sd)
        self._time_ns = time_ns
        if self._source is TargetSource.POSE:
            self._stream.rest_at(reference, time_ns)
        elif self._on_path:
            self._path.rest_at(reference, time_ns)
        else:
            self._jog.rest_at(reference, time_ns)

    def on_pose(self, pose_sd: Array, stamped: Stamped) -> None:
        """A checked pose (4, 4) of the stream."""
        if self._source is not TargetSource.POSE:
            reference = self._motion()
            self._take_command(TargetSource.POSE, stamped.received_ns)
            self._stream.take_over(reference, self._time_ns)
        self._stream.add(pose_sd, stamped)

    def on_path(self, sample: PathSample, frame_pose: FramePose, now: Instant, q: Array | None = None) -> None:
        """A path; the joints are at q (n,). Raises TargetRefused naming the pose, and goes on with what it had.

        Without q, times for a path that has none are found from the bounds on the tool's motion alone.
        """
        self._follow(request_from_path(sample, frame_pose, now, self._settings.path), TargetSource.PATH, now, q)

    def on_trajectory(self, sample: TrajectorySample, frame_pose: FramePose, now: Instant) -> None:
        """A trajectory. Raises TargetRefused naming the point, and goes on with what it had."""
        self._follow(request_from_trajectory(sample, frame_pose, now), TargetSource.TRAJECTORY, now)

    def on_twist(self, sample: TwistSample, frame: TwistFrame, now: Instant) -> None:
        """A twist to jog by. Raises TargetRefused, and goes on with what it had."""
        try:
            twist = checked_vector(sample.twist, 6, "target twist")
        except InputError as error:
            raise TargetRefused(str(error)) from error
        if np.linalg.norm(twist[:3]) > FASTEST_M_S or np.linalg.norm(twist[3:]) > FASTEST_RAD_S:
            raise TargetRefused(
                f"target twist is {twist.tolist()}; accepted: {FASTEST_M_S:g} m/s and {FASTEST_RAD_S:g} rad/s"
            )
        stamped = to_monotonic(sample.stamp_ns, now, round(MAX_STAMP_AGE_S * NS))
        age_s, timeout_s = (now.monotonic_ns - stamped.time_ns) / NS, self._settings.jog.timeout_s
        if age_s >= timeout_s:
            raise TargetRefused(f"target twist is {age_s:.3g} s old; jog.timeout_s is {timeout_s:g}")
        if self._source is not TargetSource.TWIST:
            if not twist.any():
                return
            reference = self._motion()
            self._take_command(TargetSource.TWIST, now.monotonic_ns)
            self._jog.begin(reference, self._time_ns)
        self._jog.add(twist, frame, stamped)
        self._warning = "stamps of target_twist disagree with this clock; arrival counts" if stamped.skew_ns else ""

    def _follow(self, request: PathRequest, source: TargetSource, now: Instant, q: Array | None = None) -> None:
        reference = self._motion()
        self._path.begin(request, reference, self._time_ns, q)
        self._take_command(source, now.monotonic_ns)
        self._warning = request.warning

    def _take_command(self, source: TargetSource, time_ns: int) -> None:
        if source is self._source:
            return
        between_two = source is self._previous_source
        self._changes_ns = (*self._changes_ns, time_ns)[-SOURCE_CHANGES:] if between_two else (time_ns,)
        self._source, self._previous_source = source, self._source
        self._warning = ""
        if not self._on_path:
            self._path.forget()

    # --- ticks -------------------------------------------------------------------------------------------------------

    def advance(self, time_ns: int, hold_s: float, time_rate: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        ``time_rate``: the part of the last twist that the arm did, 0 to 1: s, and 0 while the robot does not follow.
        ``pose_sb`` (4, 4): where the tool is; without it there is no distance to a path, and no leash on a jog.
        """
        self._time_ns = max(self._time_ns, time_ns)
        if self._source is TargetSource.POSE:
            return self._stream.advance(time_ns, hold_s)
        if self._on_path:
            return self._path.advance(time_ns, hold_s, time_rate, pose_sb)
        return self._jog.advance(time_ns, hold_s, time_rate, pose_sb)

    def _motion(self) -> RigidMotion:
        """The reference at the last tick."""
        if self._source is TargetSource.POSE:
            return self._stream.motion()
        return self._path.motion() if self._on_path else self._jog.motion()

    @property
    def _on_path(self) -> bool:
        return self._source in (TargetSource.PATH, TargetSource.TRAJECTORY)

    # --- what there is to say ----------------------------------------------------------------------------------------

    @property
    def source(self) -> TargetSource:
        """Which input is in command, or was when it ended."""
        return self._source

    @property
    def ended(self) -> bool:
        """Nothing more is asked for; the last pose is held."""
        if self._source is TargetSource.POSE:
            return self._stream.ended
        if self._on_path:
            return self._path.finished
        return self._source is TargetSource.NONE or self._jog.ended

    @property
    def reason(self) -> str:
        """What is being done, in words that stay the same while it is."""
        return self.reason_when(self.ended)

    def reason_when(self, ended: bool) -> str:
        """:attr:`reason`, for who has asked for :attr:`ended`."""
        if self._source is TargetSource.POSE:
            return "the target stream has ended; holding the last pose" if ended else "following target_pose"
        name = self._source.value
        if self._source is TargetSource.NONE:
            return "no target yet"
        if self._source is TargetSource.TWIST:
            return f"no {name} any more; holding the pose" if ended else f"jogging by {name}"
        return self._path_reason(name)

    def _path_reason(self, name: str) -> str:
        if self._path.finished:
            return f"{name} is done; holding its last pose"
        if self._path.timing:
            return f"finding times for {name}"
        if self._path.waiting:
            return f"there, but {name} begins later" if self._path.early else f"going to {name}"
        return f"following {name}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know besides."""
        if self._source is TargetSource.POSE and not self._warning and len(self._changes_ns) < SOURCE_CHANGES:
            return ()
        found = []
        changes = self._changes_ns
        if len(changes) == SOURCE_CHANGES and self._time_ns - changes[0] < SOURCE_CHANGES_WITHIN_S * NS:
            names = sorted((self._source.value, self._previous_source.value))
            found.append(f"{' and '.join(names)} take command from each other")
        if self._source is TargetSource.TWIST and self._jog.clamped:
            found.append("target_twist is faster than jogging may be and is scaled down")
        if self._source is TargetSource.TWIST and self._jog.lead_limited:
            found.append("the tool cannot follow target_twist")
        if self._warning:
            found.append(self._warning)
        return tuple(found)

    @property
    def stream(self) -> StreamedPoses:
        """The stream of poses, for its figures."""
        return self._stream

    @property
    def progress(self) -> float:
        """Part of the path that has been gone through, 0 to 1; NaN without a path in command."""
        return self._path.progress if self._on_path else nan

    @property
    def late_s(self) -> float:
        """How much later than by its stamps the path is [s]; NaN without a path in command."""
        return self._path.late_s if self._on_path else nan

    @property
    def distance_m(self) -> float:
        """Distance of the tool point from the path [m]; NaN without a path in command."""
        return self._path.distance_m if self._on_path else nan

    @property
    def goal_sd(self) -> Array | None:
        """Where it will end, (4, 4): the stream's last sample, the path's last pose; None without one."""
        if self._source is TargetSource.POSE:
            return self._stream.goal_sd
        return self._path.goal_sd if self._on_path else None


def twist_frame(robot: Robot, frames: Frames, frame: str) -> TwistFrame:
    """The axes of ``frame``, now; InputError with the frames that there are."""
    rotation = frames.pose(frame)[:3, :3]
    if frame in robot.frames and robot.moves_with_tool(frame) and frames.position is not None:
        return TwistFrame(robot.pose(frames.position)[:3, :3].T @ rotation, True)
    return TwistFrame(rotation, False)


def _resting(pose_sd: Array) -> RigidMotion:
    x, y, z = pose_sd[:3, 3].tolist()
    return RigidMotion((x, y, z), orientation=from_matrix(pose_sd))
