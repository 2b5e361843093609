"""Selects the active input among poses, paths, trajectories and twists, and returns its reference motion.

Rule: **the latest accepted target is active.** A pose, path, trajectory or twist that is accepted replaces the active
input; a pose cancels a running path, and a path ends a stream. A zero twist keeps or ends jogging, but does not replace
another input. When the active input ends, the arm holds the last pose until the next target. The reference never jumps:
the new input takes over its position, velocity and acceleration.

``time_rate`` is the fraction s of each twist that the limits allow. The references of paths and of jogging advance by
that fraction, so that a path is followed later but exactly, and jogging does not run ahead of the arm. A stream cannot
be slowed down, since its samples are the present target: the arm falls behind and catches up on the shortest way.
"""

from __future__ import annotations

from math import nan

import numpy as np

from ik_node.errors import InputError, TargetRefused
from ik_node.interfaces.clock import NS, Instant, Stamped, to_monotonic
from ik_node.interfaces.delivery import MAX_STAMP_AGE_S
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.samples import FARTHEST_M, PathSample, TrajectorySample, TwistSample
from ik_node.math.numerics import checked_vector
from ik_node.math.types import Array
from ik_node.robot.reach import reach_of
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.targets.arbiter_state import ArbiterSnapshot, TargetSource
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.jog import Jog, TwistFrame
from ik_node.targets.members import TaskMembers, at_pose
from ik_node.targets.path.follower import PathFollower
from ik_node.targets.path.request import (
    FASTEST_M_S,
    FASTEST_RAD_S,
    FramePose,
    PathRequest,
    request_from_path,
    request_from_trajectory,
)
from ik_node.targets.stream.stream import StreamedPoses

SOURCE_CHANGES = 4
"""This many changes between two inputs ..."""
SOURCE_CHANGES_WITHIN_S = 2.0
"""... within this time mean that both are published at the same time."""


class TargetArbiter:
    """Targets of all inputs in, one reference motion out; times are monotonic nanoseconds, one thread."""

    def __init__(self, settings: Settings, robot: Robot | None = None) -> None:
        """``robot``: its reach, and its joint limits for the speed along paths without times; None to ignore them."""
        self._reach = None if robot is None else reach_of(robot)
        self.out_of_reach = ""
        """Warning that the last pose, or the farthest of a path, is out of the arm's reach, and by how much."""
        self._stream = StreamedPoses(settings.target)
        self._path = PathFollower(settings, robot)
        self._jog = Jog(settings)
        self._settings = settings
        self._members = TaskMembers(settings.task)
        self._tool_sb: Array | None = None
        self._newest_sd: Array | None = None
        self._source = self._previous_source = TargetSource.NONE
        self._changes_ns: tuple[int, ...] = ()
        self._time_ns = 0
        self._warning = ""

    def configure(self, settings: Settings) -> None:
        """Applies other settings; the active input is kept."""
        before, self._settings = self._settings, settings
        self._stream.configure(settings.target)
        self._path.configure(settings)
        self._jog.configure(settings)
        if settings.task != before.task:
            self._change_task()

    def _change_task(self) -> None:
        """Applies another tolerance: the reference moves on from the tool, in what was free, to the target."""
        before, self._members = self._members, TaskMembers(self._settings.task)
        reference, newest_sd = self._motion(), self._newest_sd
        if self._tool_sb is not None:
            reference = at_pose(reference, before.pose(pose_matrix(reference), self._tool_sb))
        if self._source is TargetSource.POSE:
            newest_sd = self._stream.goal_sd if newest_sd is None else newest_sd
            member = None if newest_sd is None else self._members.pose(newest_sd, pose_matrix(reference))
            self._stream.replace(member, reference, self._time_ns)
        elif self._on_path:
            self._path.move_to(reference)
        else:
            self._jog.rest_at(reference, self._time_ns)
        if self._members.follows_whole_pose:
            self._tool_sb = self._newest_sd = None

    def capture(self) -> ArbiterSnapshot:
        """A snapshot for :meth:`restore`."""
        return ArbiterSnapshot(
            self._source,
            self._previous_source,
            self._changes_ns,
            self._time_ns,
            self._warning,
            self._stream.capture(),
            self._path.capture(),
            self._jog.capture(),
            self.out_of_reach,
            self._tool_sb,
            self._newest_sd,
        )

    def restore(self, snapshot: ArbiterSnapshot) -> None:
        """Continues from a snapshot, bit for bit."""
        self._source, self._previous_source, self._changes_ns, self._time_ns, self._warning = snapshot[:5]
        self._stream.restore(snapshot.stream)
        self._path.restore(snapshot.path)
        self._jog.restore(snapshot.jog)
        self.out_of_reach = snapshot.out_of_reach
        self._tool_sb, self._newest_sd = snapshot.tool_sb, snapshot.newest_sd

    # --- inputs -------------------------------------------------------------------------------------------------------

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Starts without an active input, at rest at ``pose_sd`` (4, 4)."""
        self._source = self._previous_source = TargetSource.NONE
        self._changes_ns, self._warning, self._time_ns = (), "", time_ns
        self.out_of_reach = ""
        self._stream.start(pose_sd, time_ns)
        self._path.forget()
        self._jog.begin(_resting(pose_sd), time_ns)

    def rest_at(self, pose_sd: Array, time_ns: int) -> None:
        """Continues with the active input from rest at ``pose_sd`` (4, 4), after the arm has not followed."""
        reference = _resting(pose_sd)
        self._time_ns = time_ns
        if self._source is TargetSource.POSE:
            self._stream.rest_at(reference, time_ns)
        elif self._on_path:
            self._path.rest_at(reference, time_ns)
        else:
            self._jog.rest_at(reference, time_ns)

    def on_pose(self, pose_sd: Array, stamped: Stamped) -> None:
        """Adds a pose of the stream.

        Args:
            pose_sd: T_sd (4, 4), checked.
            stamped: Its times.
        """
        if self._source is not TargetSource.POSE:
            reference = self._motion()
            self._take_command(TargetSource.POSE, stamped.received_ns)
            self._stream.take_over(reference, self._time_ns)
        if not self._members.follows_whole_pose:
            self._newest_sd = pose_sd
            last_sd = self._stream.goal_sd
            pose_sd = self._members.pose(pose_sd, pose_matrix(self._motion()) if last_sd is None else last_sd)
        self._stream.add(pose_sd, stamped)
        self.out_of_reach = self._reach_warning(pose_sd[None, :3, 3], "target")

    def on_path(self, sample: PathSample, frame_pose: FramePose, now: Instant, q: Array | None = None) -> None:
        """Starts a path.

        Args:
            sample: The path.
            frame_pose: Function from the name of a frame to its pose T_sf.
            now: Time of arrival.
            q: Joint positions (n,); without them only the bounds of the tool limit the speed along a path without
                time stamps.

        Raises:
            TargetRefused: The path is invalid; the message states the number of the pose. The active input is kept.
        """
        members = TaskMembers(self._settings.task, self._motion())
        request = request_from_path(sample, frame_pose, now, self._settings.path, members)
        self._follow(request, TargetSource.PATH, now, q)

    def on_trajectory(self, sample: TrajectorySample, frame_pose: FramePose, now: Instant) -> None:
        """Starts a trajectory.

        Args:
            sample: The trajectory.
            frame_pose: Function from the name of a frame to its pose T_sf.
            now: Time of arrival.

        Raises:
            TargetRefused: The trajectory is invalid; the message states the number of the point. The active input is
                kept.
        """
        members = TaskMembers(self._settings.task, self._motion())
        self._follow(request_from_trajectory(sample, frame_pose, now, members), TargetSource.TRAJECTORY, now)

    def on_twist(self, sample: TwistSample, frame: TwistFrame, now: Instant) -> None:
        """Jogs by a twist.

        Args:
            sample: The twist.
            frame: Axes in which it is expressed, from :func:`twist_frame`.
            now: Time of arrival.

        Raises:
            TargetRefused: The twist is invalid, too fast or too old. The active input is kept.
        """
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
        twist = self._members.twist(twist, frame, self._motion())
        if self._source is not TargetSource.TWIST:
            if not twist.any():
                return
            reference = self._motion()
            self._take_command(TargetSource.TWIST, now.monotonic_ns)
            self._jog.begin(reference, self._time_ns)
        self._jog.add(twist, frame, stamped)
        self._warning = (
            "stamps of target_twist disagree with this clock; using the time of arrival" if stamped.skew_ns else ""
        )

    def _follow(self, request: PathRequest, source: TargetSource, now: Instant, q: Array | None = None) -> None:
        reference = self._motion()
        self._path.begin(request, reference, self._time_ns, q)
        self._take_command(source, now.monotonic_ns)
        self._warning = request.warning
        self.out_of_reach = self._reach_warning(request.positions, f"pose {{}} of {source.value}")

    def _reach_warning(self, positions: Array, name: str) -> str:
        """Warning about the farthest of ``positions`` (N, 3), whose number is inserted into ``name``."""
        if self._reach is None:
            return ""
        excess = self._reach.excess(positions)
        farthest = int(np.argmax(excess))
        return f"{name.format(farthest)} is {excess[farthest]:.2f} m out of reach" if excess[farthest] > 0.0 else ""

    def _take_command(self, source: TargetSource, time_ns: int) -> None:
        if source is self._source:
            return
        between_two = source is self._previous_source
        self._changes_ns = (*self._changes_ns, time_ns)[-SOURCE_CHANGES:] if between_two else (time_ns,)
        self._source, self._previous_source = source, self._source
        self._warning = self.out_of_reach = ""
        if not self._on_path:
            self._path.forget()

    # --- control steps ------------------------------------------------------------------------------------------------

    def advance(
        self,
        time_ns: int,
        hold_s: float,
        time_rate: float = 1.0,
        pose_sb: Array | None = None,
        q: Array | None = None,
    ) -> Motion:
        """The desired motion at a control step.

        Args:
            time_ns: Monotonic time of the step.
            hold_s: Time for which the twist will be applied.
            time_rate: Fraction of the last twist that the arm executed, 0 to 1; 0 while the robot does not follow.
            pose_sb: Measured T_sb (4, 4), for the distance from a path and the lead limit of jogging; None for neither.
            q: Measured joint positions (n,), for the foresight on a path; None for none.

        Returns:
            T_sd at ``time_ns`` and its mean body twist V_d over ``hold_s``.
        """
        self._time_ns = max(self._time_ns, time_ns)
        if pose_sb is not None and not self._members.follows_whole_pose:
            self._tool_sb, is_used = pose_sb, self._source is not TargetSource.POSE
            pose_sb = self._members.pose(pose_sb, pose_matrix(self._motion())) if is_used else pose_sb
        if self._source is TargetSource.POSE:
            return self._stream.advance(time_ns, hold_s)
        if self._on_path:
            return self._path.advance(time_ns, hold_s, time_rate, pose_sb, q)
        return self._jog.advance(time_ns, hold_s, time_rate, pose_sb)

    def _motion(self) -> RigidMotion:
        """The reference at the last control step."""
        if self._source is TargetSource.POSE:
            return self._stream.motion()
        return self._path.motion() if self._on_path else self._jog.motion()

    @property
    def foreseen(self) -> bool:
        """True on a path whose joint motion ahead is known."""
        return self._on_path and self._path.foreseen

    @property
    def _on_path(self) -> bool:
        return self._source in (TargetSource.PATH, TargetSource.TRAJECTORY)

    # --- status -------------------------------------------------------------------------------------------------------

    @property
    def source(self) -> TargetSource:
        """The active input, also after it has ended."""
        return self._source

    @property
    def ended(self) -> bool:
        """True if there is no active target; the last pose is held."""
        if self._source is TargetSource.POSE:
            return self._stream.ended
        if self._on_path:
            return self._path.finished
        return self._source is TargetSource.NONE or self._jog.ended

    @property
    def reason(self) -> str:
        """Status text; it changes only when the activity does."""
        return self.reason_when(self.ended)

    def reason_when(self, ended: bool) -> str:
        """:attr:`reason` with a known value of :attr:`ended`."""
        if self._source is TargetSource.POSE:
            return "the target stream has ended; holding the last pose" if ended else "following target_pose"
        name = self._source.value
        if self._source is TargetSource.NONE:
            return "no target yet"
        if self._source is TargetSource.TWIST:
            return f"{name} has ended; holding the pose" if ended else f"jogging by {name}"
        return self._path.reason(name)

    @property
    def target_note(self) -> str:
        """What makes the active target unreachable for the tool, in place or in time; empty for nothing."""
        too_fast = self._stream.too_fast if self._source is TargetSource.POSE else ""
        return "; ".join(filter(None, (self.out_of_reach, too_fast)))

    @property
    def gap_ns(self) -> int:
        """Monotonic begin of the gap before the last pose in which the reference decelerated; 0 for none."""
        return self._stream.gap_ns if self._source is TargetSource.POSE else 0

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user."""
        if self._source is TargetSource.POSE and not self._warning and len(self._changes_ns) < SOURCE_CHANGES:
            return ()
        found = []
        changes = self._changes_ns
        if len(changes) == SOURCE_CHANGES and self._time_ns - changes[0] < SOURCE_CHANGES_WITHIN_S * NS:
            names = sorted((self._source.value, self._previous_source.value))
            found.append(f"{' and '.join(names)} are published at the same time")
        if self._source is TargetSource.TWIST and self._jog.clamped:
            found.append("target_twist exceeds the maximum speed of jogging and is reduced")
        if self._source is TargetSource.TWIST and self._jog.lead_limited:
            found.append("the tool cannot follow target_twist")
        if self._warning:
            found.append(self._warning)
        return tuple(found)

    @property
    def stream(self) -> StreamedPoses:
        """The stream of poses, for its metrics."""
        return self._stream

    @property
    def progress(self) -> float:
        """Completed fraction of the path, 0 to 1; NaN without an active path."""
        return self._path.progress if self._on_path else nan

    @property
    def late_s(self) -> float:
        """Delay of the path behind its stamps [s]; NaN without an active path."""
        return self._path.late_s if self._on_path else nan

    @property
    def distance_m(self) -> float:
        """Distance of the tool point from the path [m]; NaN without an active path."""
        return self._path.distance_m if self._on_path else nan

    @property
    def goal_sd(self) -> Array | None:
        """Final pose (4, 4): last sample of the stream or last pose of the path; None without one."""
        if self._source is TargetSource.POSE:
            return self._stream.goal_sd
        return self._path.goal_sd if self._on_path else None


def check_distance(pose_sd: Array) -> None:
    """Raises TargetRefused when a pose (4, 4) is further than FARTHEST_M from {s}, as poses of paths are refused."""
    if not np.abs(pose_sd[:3, 3]).max() <= FARTHEST_M:
        raise TargetRefused(f"target is more than {FARTHEST_M:g} m away")


def _resting(pose_sd: Array) -> RigidMotion:
    return at_pose(RigidMotion(), pose_sd)
