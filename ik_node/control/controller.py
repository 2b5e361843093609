"""The controller: calls in, Steps out.

It is an event machine. Every call carries the time at which it is made, nothing inside looks at a clock, and the same
calls in the same order give the same bits: on the robot, in the simulator and in a replay.

What stops the arm, and how:

================================================  =============================================================
cause                                             response
================================================  =============================================================
the target stream ends or falls silent            the reference brakes within its bounds; the last pose is held
pause, deactivation, a signal                     ramp to zero within the acceleration limits, zeros, then nothing
joint states too slow                             the same ramp; goes on when they are fast enough again
joint states dead, not finite                     zeros at once; goes on from the measured position
an exception or a non-finite result inside        zeros at once; stays until reset
================================================  =============================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ik_node.collision.scene import Scene
from ik_node.control.controller_state import CycleSnapshot, ControllerSnapshot
from ik_node.control.following_error import FollowMonitor
from ik_node.control.joint_states import JointState, JointStateMerger, JointStateSnapshot
from ik_node.control.state_machine import Supervision, StateMachineSnapshot
from ik_node.control.status import StatusSnapshot
from ik_node.control.velocity_controller import Decision, Law
from ik_node.errors import IkNodeError, InputError, SceneError, StateRefused, TargetRefused, UnknownNameError
from ik_node.interfaces.clock import NS, Instant, place
from ik_node.interfaces.samples import (
    JointSample,
    ObstacleSample,
    PathSample,
    PoseSample,
    TrajectorySample,
    TwistSample,
)
from ik_node.interfaces.snapshot import capture, restore
from ik_node.interfaces.step import Level, Mode, Status, Step, bare_step
from ik_node.math.types import Array
from ik_node.robot.frames import Frames, FramesSnapshot
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.robot.srdf import with_srdf_text
from ik_node.settings.groups import Settings
from ik_node.targets.arbiter import Targets, twist_frame

INTERVAL_SMOOTHING = 0.02
"""Weight of the newest interval in the running mean of the time between ticks."""
TARGET_AHEAD_S = 0.5
"""Target stamps may lie this far in the future (a planner's look-ahead) and still be believed."""
NOBODY_LISTENS = Status(Level.WARN, Mode.STOPPED, "nobody listens to the commands")


class Controller:
    """Composes robot, target, control law, resolution and limits; one instance belongs to one thread."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        """Raises SettingsError when a list of limits does not fit the number of joints, or an SRDF cannot be read."""
        settings = with_srdf_text(settings)
        self.robot = robot
        self.settings = settings
        self.targets_refused = 0
        self.states_refused = 0
        self._law = Law(robot, settings)
        self._states = JointStateMerger(robot.joints, settings.state)
        self._targets = Targets(settings, robot)
        self._frames = Frames(robot)
        self._supervision = Supervision()
        self._status = self._supervision.says
        self._tick = 0
        self._state: JointState | None = None
        self._period_s = 1.0 / settings.control.rate_hz
        self._period_ns = round(self._period_s * NS)
        self._interval_s = self._period_s
        self._due_ns = 0
        self._last_tick_ns = 0
        self._follow = FollowMonitor(robot, settings.follow)
        self._retry_ns = 0
        self._listeners = 1
        self._keep_targets = False

    @property
    def status(self) -> Status:
        """What the controller is doing, and why."""
        return self._status.status

    @property
    def at_rest(self) -> bool:
        """True when the last command was zero and no further one comes by itself."""
        return not self._supervision.moving

    # --- inputs ------------------------------------------------------------------------------------------------------

    def on_joint_state(self, sample: JointSample, now: Instant) -> Step | None:
        """Takes a joint state; returns the tick it makes, or None. One that is refused stops the arm."""
        try:
            state = self._states.add(sample, now)
        except StateRefused as error:
            self.states_refused += 1
            return self._stop(now, Level.ERROR, f"joint state refused: {error}")
        if state is None or not self._is_due(state.time_ns):
            return None
        try:
            return self._on_state(state, now)
        except Exception as error:  # whatever went wrong inside, the arm must stop, and a person must see why
            reason = str(error) if isinstance(error, IkNodeError) else f"{type(error).__name__}: {error}"
            return self._fault(now, reason)

    def on_target_pose(self, sample: PoseSample, now: Instant) -> None:
        """Takes a pose of the stream. Raises TargetRefused, and goes on with what it had, when it is unusable."""
        with self._refusals():
            pose_sd = self._frames.place(sample, "target")
        stamped = place(sample.stamp_ns, now, round(self.settings.target.max_age_s * NS), round(TARGET_AHEAD_S * NS))
        self._status.flag("target stamps disagree with this clock; arrival counts", stamped.skew_ns != 0, now)
        if self._supervision.closed_loop:
            self._targets.on_pose(pose_sd, stamped)

    def on_target_path(self, sample: PathSample, now: Instant) -> None:
        """Takes a path. Raises TargetRefused naming the pose, and goes on with what it had."""
        with self._refusals():
            self._targets.on_path(sample, self._frames.pose, now, self._ready().position)

    def on_target_trajectory(self, sample: TrajectorySample, now: Instant) -> None:
        """Takes a trajectory of poses and twists. Raises TargetRefused naming the point; goes on with what it had."""
        with self._refusals():
            self._ready()
            self._targets.on_trajectory(sample, self._frames.pose, now)

    def on_target_twist(self, sample: TwistSample, now: Instant) -> None:
        """Takes a twist to jog by. Raises TargetRefused, and goes on with what it had."""
        with self._refusals():
            self._ready()
            frame = twist_frame(self.robot, self._frames, sample.frame_id)
            self._targets.on_twist(sample, frame, now)

    def on_obstacles(self, samples: tuple[ObstacleSample, ...], now: Instant) -> None:
        """Takes obstacles as they are now. Raises SceneError naming those that cannot be used; the others count."""
        max_age_ns = round(self.settings.target.max_age_s * NS)
        wrong = self._law.solver.lookout.take(samples, self._frames, now, max_age_ns)
        self._status.note("obstacles", f"obstacle refused: {wrong}" if wrong else "")
        if wrong:
            raise SceneError(wrong)

    def on_transform(self, answer: str, now: Instant) -> None:
        """Takes where a frame outside the robot's model is: :func:`ik_node.robot.frames.answer_text`."""
        del now
        with self._refusals():
            self._frames.answer(answer)

    def on_publishers(self, crowd: str, now: Instant) -> None:
        """Takes which target topics have several publishers, in words; empty for none."""
        del now
        self._status.note("publishers", crowd)

    def on_listeners(self, count: int, now: Instant) -> None:
        """Takes how many listen to the commands; a node that nobody listens to does not pretend to move an arm."""
        self._listeners = count
        if count == 0 and self._supervision.closed_loop:
            self._keep_targets = True
            self._ramp_down(now, NOBODY_LISTENS)

    def on_clock(self, now: Instant) -> Step | None:
        """What happens when nothing arrives: dead joint states, the rest of a ramp. To be called every 10 ms or so."""
        if self._supervision.ramp is not None and now.monotonic_ns - self._last_tick_ns >= 2.0 * self._period_s * NS:
            return self._bare_step(now, self._supervision.ramp_velocity(now))
        if self._supervision.closed_loop:
            timeout_s = self.settings.state.timeout_s
            if now.monotonic_ns - self._states.received_ns > timeout_s * NS:
                return self._stop(now, Level.ERROR, f"no joint state for {timeout_s:g} s")
        if self.status.mode is Mode.WAITING and self._states.missing():
            missing = ", ".join(self._states.missing())
            self._status.set(Status(Level.OK, Mode.WAITING, f"waiting for a joint state of {missing}"))
        return None

    # --- requests ----------------------------------------------------------------------------------------------------

    def pause(self, now: Instant, reason: str = "paused by request") -> None:
        """Ramps to zero and stays there until :meth:`resume`. A fault stays a fault."""
        if self.status.mode is not Mode.FAULT:
            self._keep_targets = False
            self._ramp_down(now, Status(Level.OK, Mode.PAUSED, reason))

    def resume(self) -> None:
        """Starts again from the measured position, at rest; changes nothing when neither paused nor about to be."""
        self._supervision.resume()

    def reset(self) -> None:
        """Leaves a fault or a pause and starts again from the measured position."""
        self._status.note("target")
        self._status.note("obstacles")
        self._supervision.reset()

    def check(self, settings: Settings) -> None:
        """Raises SettingsError when these settings do not fit the robot; changes nothing."""
        motion_limits(self.robot, settings.limits, settings.control.rate_hz)

    def apply(self, settings: Settings) -> None:
        """Takes over changed settings; raises as :meth:`check` does, then without having changed anything."""
        self._law.configure(settings)
        self.settings = settings
        self._states.configure(settings.state)
        self._targets.configure(settings)
        self._follow.configure(settings.follow)

    @property
    def geometry(self) -> str:
        """A digest of what distances are measured with; see :attr:`ik_node.collision.monitor.Lookout.digest`."""
        return self._law.solver.lookout.digest

    @property
    def pairs(self) -> str:
        """Which pairs of links are watched, and why others are not, for a person."""
        return self._law.solver.lookout.pairs

    @property
    def scene(self) -> Scene:
        """The obstacles that there are."""
        return self._law.solver.lookout.scene

    # --- state -------------------------------------------------------------------------------------------------------

    def capture(self) -> ControllerSnapshot:
        """Everything that decides what comes next, beside the robot and the settings."""
        return ControllerSnapshot(
            capture(self, CycleSnapshot),
            capture(self._supervision, StateMachineSnapshot),
            capture(self._status, StatusSnapshot),
            capture(self._states, JointStateSnapshot),
            capture(self._frames, FramesSnapshot),
            self._targets.capture(),
            self._follow.capture(),
            self._law.capture(),
            self._law.solver.lookout.scene,
        )

    def restore(self, snapshot: ControllerSnapshot) -> None:
        """Goes on, bit for bit, where a controller of the same robot and settings was when ``snapshot`` was captured."""
        restore(self, snapshot.cycle)
        self._frames.position = None if self._state is None else self._state.position
        restore(self._supervision, snapshot.supervision)
        restore(self._status, snapshot.status)
        restore(self._states, snapshot.joint_states)
        restore(self._frames, snapshot.frames)
        self._targets.restore(snapshot.targets)
        self._follow.restore(snapshot.follow)
        self._law.restore(snapshot.law)
        self._law.solver.lookout.scene = snapshot.scene

    # --- one tick ----------------------------------------------------------------------------------------------------

    def _is_due(self, time_ns: int) -> bool:
        """Keeps the mean tick rate at or below rate_hz, whatever the rate of the joint states."""
        period_ns = self._period_ns
        if time_ns < self._due_ns - period_ns // 4:
            return False
        self._due_ns = max(self._due_ns, time_ns - period_ns) + period_ns
        return True

    def _on_state(self, state: JointState, now: Instant) -> Step | None:
        if self._state is not None:
            interval_s = (state.time_ns - self._state.time_ns) / NS
            self._interval_s += INTERVAL_SMOOTHING * (interval_s - self._interval_s)
        self._state = state
        self._frames.position = state.position
        self._last_tick_ns = now.monotonic_ns
        if self._supervision.ramp is not None:
            return self._bare_step(now, self._supervision.ramp_velocity(now))
        return self._track(state, now) if self._may_move(state, now) else None

    def _may_move(self, state: JointState, now: Instant) -> bool:
        """Whether a control law may be at work; begins it from the measured position, or leads the arm to rest."""
        if self._supervision.held_back:
            return False
        obstruction = self._obstruction(state, now)
        if obstruction is not None:
            self._keep_targets = self._keep_targets or self._supervision.closed_loop
            self._ramp_down(now, obstruction)
            return False
        if not self._supervision.closed_loop:
            if now.monotonic_ns < self._retry_ns:
                return False
            self._follow.forget()
            self._law.begin(state.time_ns, now.monotonic_ns - self._period_ns)
            begin = self._targets.rest_at if self._keep_targets else self._targets.start
            begin(self.robot.pose(state.position), state.time_ns)
            self._keep_targets = False
        return True

    def _obstruction(self, state: JointState, now: Instant) -> Status | None:
        """What forbids to move the arm as things are; None when nothing does."""
        slowest_s = self._period_s / max(self.settings.control.min_rate_fraction, 1e-3)
        if self._interval_s > slowest_s:
            reason = f"joint states slower than {1.0 / slowest_s:.0f} Hz, the part min_rate_fraction of rate_hz"
            return Status(Level.ERROR, Mode.STOPPED, reason)
        if self._listeners == 0:
            return NOBODY_LISTENS
        if self._supervision.closed_loop and self.settings.follow.enabled:
            reason = self._follow.observe(state.time_ns, state.position, self._law.velocity)
            if reason:
                self._retry_ns = now.monotonic_ns + round(self.settings.follow.retry_s * NS)
                return Status(Level.WARN, Mode.STOPPED, reason)
        return None

    def _track(self, state: JointState, now: Instant) -> Step:
        pose_sb = self.robot.pose(state.position)
        motion = self._targets.advance(state.time_ns, self._interval_s, self._law.pace, pose_sb)
        decision = self._law.decide(state, pose_sb, motion, self._interval_s, now)
        asked, outcome, _ = decision
        self._say_what_happens(now, decision)
        self._tick += 1
        return Step(
            tick=self._tick - 1,
            now=now,
            state_time_ns=state.time_ns,
            joint_position=state.position,
            joint_velocity=outcome.joint_velocity,
            pose_sb=pose_sb,
            pose_sd=motion.pose_sd,
            error_b=asked.error_b,
            feedforward_b=asked.feedforward_b,
            twist_b=asked.twist_b,
            lost_b=outcome.lost_b,
            scale=outcome.scale,
            multiplier_task=outcome.multiplier_task,
            multiplier_potential=outcome.multiplier_potential,
            singular_values=outcome.singular_values,
            binding=outcome.binding,
            progress=self._targets.progress,
            path_distance=self._targets.distance_m,
            clearance=outcome.closest.distance,
            closest_points=outcome.closest.points_s,
            closest_pair=outcome.closest.names,
            status=self.status,
        )

    def _say_what_happens(self, now: Instant, decision: Decision) -> None:
        conditions = self._law.conditions(decision)
        if self._states.skew_ns != 0:
            conditions.append("joint state stamps disagree with this clock; arrival counts")
        conditions.extend(self._targets.remarks)
        self._status.mention(conditions, now)
        ended = self._targets.ended
        mode = Mode.HOLDING if ended else Mode.TRACKING
        self._status.set(Status(Level.OK, mode, self._targets.reason_when(ended)))

    def _ready(self) -> JointState:
        """The last joint state of an arm that a control law moves; TargetRefused otherwise."""
        if self._state is None or not self._supervision.closed_loop:
            raise TargetRefused(f"the arm is {self.status.mode.value}: {self.status.reason}")
        return self._state

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """What is wrong with a target is counted, said in the status, and raised as TargetRefused."""
        try:
            yield
        except (InputError, UnknownNameError) as error:
            self.targets_refused += 1
            self._status.note("target", f"target refused: {error}")
            raise TargetRefused(str(error)) from error
        self._status.note("target")

    # --- coming to rest ----------------------------------------------------------------------------------------------

    def _ramp_down(self, now: Instant, rest: Status) -> None:
        self._supervision.ramp_down(self._law.velocity, self._law.solver.limits.acceleration, now, rest)

    def _stop(self, now: Instant, level: Level, reason: str) -> Step | None:
        """Zeros at once; goes on from the measured position with the next good state, unless paused or at fault."""
        moved = self._supervision.moving
        self._supervision.stop(level, reason)
        self._keep_targets = False
        self._state = self._frames.position = None
        self._interval_s = self._period_s
        return self._bare_step(now, np.zeros(self.robot.n)) if moved else None

    def _fault(self, now: Instant, reason: str) -> Step:
        self._supervision.fault(reason)
        return self._bare_step(now, np.zeros(self.robot.n))

    def _bare_step(self, now: Instant, velocity: Array) -> Step:
        """A step that commands ``velocity`` without a control law."""
        self._law.command(velocity, now.monotonic_ns)
        self._last_tick_ns = now.monotonic_ns
        self._tick += 1
        state = self._state
        if state is None:
            position, pose_sb, time_ns = np.full(self.robot.n, np.nan), np.full((4, 4), np.nan), now.monotonic_ns
        else:
            position, pose_sb, time_ns = state.position, self.robot.pose(state.position), state.time_ns
        return bare_step(self._tick - 1, now, time_ns, position, pose_sb, velocity, self.status)
