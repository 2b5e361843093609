"""The controller: calls with inputs and times in, Steps out.

Every call carries its time, and no clock is read, so the same calls in the same order give the same bits: on the robot,
in simulation and in a replay.

What stops the arm, and how, is the table in :mod:`ik_node.control.state_machine`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ik_node.collision.monitor import CollisionMonitor
from ik_node.control.controller_state import ControllerSnapshot, CycleSnapshot
from ik_node.control.following_error import RETRY_S, FollowingErrorMonitor
from ik_node.control.hold_up import MAX_RAMP_GAP_PERIODS, RESTART_S, reason_when_late
from ik_node.control.joint_states import JointState, JointStateMerger, JointStateSnapshot
from ik_node.control.settings_check import check_settings
from ik_node.control.state_machine import StateMachine, StateMachineSnapshot
from ik_node.control.status import StatusSnapshot
from ik_node.control.step_report import report_step
from ik_node.control.step_timer import StepTimer, TimerSnapshot
from ik_node.control.steps import closed_loop_step, open_loop_step
from ik_node.control.velocity_controller import VelocityController
from ik_node.differential_ik.own_methods import GivenMethods, with_method_listed
from ik_node.differential_ik.selected_method import SelectedMethod
from ik_node.errors import IkNodeError, InputError, SceneError, StateRefused, TargetRefused, UnknownNameError
from ik_node.interfaces import samples as inputs
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.delivery import MAX_AGE_NS, target_times
from ik_node.interfaces.snapshot import capture, restore
from ik_node.interfaces.step import Level, Mode, Status, Step
from ik_node.math.types import Array
from ik_node.robot.frames import Frames, FramesSnapshot
from ik_node.robot.robot import Robot
from ik_node.robot.srdf import with_srdf_text
from ik_node.settings.groups import Settings
from ik_node.targets.arbiter import TargetArbiter, check_distance
from ik_node.targets.arbiter_state import TargetSource
from ik_node.targets.jog import twist_frame

NO_SUBSCRIBER = Status(Level.WARN, Mode.STOPPED, "no subscriber on the command topic")


class Controller:
    """Velocity controller of one arm, driven by joint states. Not thread-safe.

    All methods ``on_...`` take an input with ``now``, its time of arrival. Those of targets raise TargetRefused when
    the target cannot be used; the previous target then stays in command.
    """

    def __init__(self, robot: Robot, settings: Settings, methods: GivenMethods | None = None) -> None:
        """Creates the components.

        Args:
            robot: The arm.
            settings: All settings.
            methods: Functions of the own methods that ``method`` and ``extra_methods`` name; default: they are imported
                (:mod:`ik_node.differential_ik.own_methods`).

        Raises:
            SettingsError: A list of limits does not match the number of joints, an SRDF cannot be read, or an own
                method cannot be loaded.
            SceneError: The scene file cannot be used.
            UnknownNameError: ``obstacles`` names a link that does not exist.
        """
        settings = with_method_listed(with_srdf_text(settings))
        self.robot, self.settings = robot, settings
        self.targets_refused = 0
        """Number of refused targets."""
        self.states_refused = 0
        """Number of refused joint states."""
        self._velocity_controller = VelocityController(robot, settings, methods)
        self._joint_states = JointStateMerger(robot, settings)
        self._targets = TargetArbiter(settings, robot)
        self._frames = Frames(robot)
        self._state_machine = StateMachine()
        self._status = self._state_machine.reporter
        self._status.note("task", self._velocity_controller.task_note)
        self._timer = StepTimer(settings.control.rate_hz)
        self._following_error = FollowingErrorMonitor(robot, settings.follow)
        self._state: JointState | None = None
        self._tick = self._last_step_ns = self._retry_ns = 0
        self._subscribers, self._keep_targets = 1, False

    @property
    def status(self) -> Status:
        """Mode and reason."""
        return self._status.status

    @property
    def at_rest(self) -> bool:
        """True when the last command was zero and no further one follows without a new input."""
        return not self._state_machine.moving

    @property
    def counts(self) -> dict[str, int]:
        """Counts of joint states, control steps, clock calls, hold-ups and targets, for the diagnostics."""
        return {"steps": self._tick, **self._timer.counts(), **self._targets.stream.counts()}

    @property
    def collision_monitor(self) -> CollisionMonitor:
        """Collision geometry and obstacles."""
        return self._velocity_controller.solver.collision_monitor

    @property
    def method(self) -> SelectedMethod:
        """The method, with the faults of an own one."""
        return self._velocity_controller.solver.method

    # --- inputs ------------------------------------------------------------------------------------------------------

    def on_joint_state(self, sample: inputs.JointSample, now: Instant) -> Step | None:
        """Adds a joint state and makes a control step if one is due.

        Returns:
            The Step with the command; None without a control step. A joint state that is refused stops the arm.
        """
        self._timer.add_call(now.monotonic_ns)
        if (step := self._stop_when_late(now)) is not None:
            return step
        if self._joint_states.is_stale(now):
            self._timer.skip_silence(now.monotonic_ns)
        try:
            state = self._joint_states.add(sample, now)
        except StateRefused as error:
            self.states_refused += 1
            return self._stop(now, Level.ERROR, f"joint state refused: {error}")
        if self._joint_states.warning:
            self._status.set_condition(self._joint_states.warning, True, now)
        if self._joint_states.settled and self._state_machine.moving:
            return self._stop(now, Level.ERROR, self._joint_states.settled)
        if state is None or not self._timer.is_due(state.time_ns, now.monotonic_ns):
            return None
        try:
            return self._on_state(state, now)
        except Exception as error:  # any exception must stop the arm, with its reason in the status
            reason = str(error) if isinstance(error, IkNodeError) else f"{type(error).__name__}: {error}"
            self._state_machine.fault(reason)
            return self._bare_step(now, np.zeros(self.robot.n))

    def on_target_pose(self, sample: inputs.PoseSample, now: Instant) -> None:
        """Adds a pose of the target stream."""
        with self._refusals(TargetSource.POSE.value):
            pose_sd = self._frames.pose_of(sample, "target")
            check_distance(pose_sd)
        stamped = target_times(sample.stamp_ns, now)
        condition = "target stamps disagree with this clock; the time of arrival is used"
        self._status.set_condition(condition, stamped.skew_ns != 0, now)
        if self._state_machine.closed_loop:
            self._targets.on_pose(pose_sd, stamped)

    def on_target_path(self, sample: inputs.PathSample, now: Instant) -> None:
        """Starts to follow a path; TargetRefused names the invalid pose."""
        with self._refusals(TargetSource.PATH.value):
            self._targets.on_path(sample, self._frames.pose, now, self._ready().position)

    def on_target_trajectory(self, sample: inputs.TrajectorySample, now: Instant) -> None:
        """Starts to follow a trajectory of poses and twists; TargetRefused names the invalid point."""
        with self._refusals(TargetSource.TRAJECTORY.value):
            self._ready()
            self._targets.on_trajectory(sample, self._frames.pose, now)

    def on_target_twist(self, sample: inputs.TwistSample, now: Instant) -> None:
        """Jogs the tool with a twist."""
        with self._refusals(TargetSource.TWIST.value):
            self._ready()
            frame = twist_frame(self.robot, self._frames, sample.frame_id)
            self._targets.on_twist(sample, frame, now)

    def on_obstacles(self, samples: tuple[inputs.ObstacleSample, ...], now: Instant) -> None:
        """Adds, changes and deletes obstacles; raises SceneError naming those that cannot be used."""
        errors = self.collision_monitor.update_obstacles(samples, self._frames, now, MAX_AGE_NS)
        self._status.note("obstacles", f"obstacle refused: {errors}" if errors else "")
        if errors:
            raise SceneError(errors)

    def on_transform(self, transform: str, now: Instant) -> None:
        """Sets the pose of a frame outside the robot model, see :func:`ik_node.robot.frames.transform_text`."""
        del now
        with self._refusals("transform"):
            self._frames.set_transform(transform)

    def on_input_note(self, text: str, now: Instant) -> None:
        """Sets the note on an input that is not used. ``text``: its name, a space, and the note; no note ends it."""
        del now
        name, _, note = text.partition(" ")
        self._status.note(f"input {name}", note)

    def on_publishers(self, conflict: str, now: Instant) -> None:
        """Sets the text that names the target topics with several publishers; empty for none."""
        del now
        self._status.note("publishers", conflict)

    def on_listeners(self, count: int, now: Instant) -> Step | None:
        """Sets the number of subscribers of the command topic; 0 stops the arm. Returns a Step as :meth:`pause`."""
        step = self._stop_when_late(now)
        self._subscribers = count
        if count == 0 and self._state_machine.closed_loop:
            self._keep_targets = True
            self._ramp_down(now, NO_SUBSCRIBER)
        return step

    def on_clock(self, now: Instant) -> Step | None:
        """Stops the arm when joint states are stale, and continues a ramp without them; to be called every 10 ms.

        Returns:
            The Step with the command; None when there is none.
        """
        self._timer.add_clock_call(now.monotonic_ns)
        if (step := self._stop_when_late(now)) is not None:
            return step
        overdue = now.monotonic_ns - self._last_step_ns >= MAX_RAMP_GAP_PERIODS * self._timer.period_s * NS
        if self._state_machine.ramp is not None and overdue:
            return self._ramp_step(now)
        if self.status.mode is Mode.WAITING and (waiting := self._joint_states.waiting_status(now)) is not None:
            self._status.set(waiting)
        return None

    # --- requests ----------------------------------------------------------------------------------------------------

    def pause(self, now: Instant, reason: str = "paused by request") -> Step | None:
        """Ramps to zero and stays stopped until :meth:`resume`; a fault stays. Returns zeros instead of a late ramp."""
        step = self._stop_when_late(now)
        if self.status.mode is not Mode.FAULT:
            self._keep_targets = False
            self._ramp_down(now, Status(Level.OK, Mode.PAUSED, reason))
        return step

    def resume(self) -> None:
        """Ends a pause; the arm holds the measured position. Has no effect when not paused."""
        self._timer.skip_clock_calls()
        self._state_machine.resume()

    def reset(self) -> None:
        """Ends a fault or a pause, and that of an own method; the arm holds the measured position."""
        for subject in ("obstacles", "transform", *(source.value for source in TargetSource)):
            self._status.note(subject)
        self.method.clear_fault()
        self._state_machine.reset()

    def check(self, settings: Settings) -> None:
        """Raises SettingsError when settings do not match the robot; changes nothing."""
        check_settings(self.robot, settings, self.method.own)

    def apply(self, settings: Settings) -> None:
        """Applies changed settings; raises SettingsError as :meth:`check` does, without any change."""
        law = self._velocity_controller
        law.configure(settings)
        law.set_rate(self._timer.expected_hz)
        self._status.note("limits", law.slowing())
        self._status.note("task", law.task_note)
        self._state_machine.change_ramp(law.velocity, law.solver.limits.acceleration, law.commanded_ns)
        self.settings = settings
        self._joint_states.configure(settings)
        self._targets.configure(settings)
        self._following_error.configure(settings.follow)

    # --- snapshot ----------------------------------------------------------------------------------------------------

    def capture(self) -> ControllerSnapshot:
        """Complete internal state, for :meth:`restore`."""
        return ControllerSnapshot(
            capture(self, CycleSnapshot),
            capture(self._timer, TimerSnapshot),
            capture(self._state_machine, StateMachineSnapshot),
            capture(self._status, StatusSnapshot),
            capture(self._joint_states, JointStateSnapshot),
            capture(self._frames, FramesSnapshot),
            self._targets.capture(),
            self._following_error.capture(),
            self._velocity_controller.capture(),
            self.collision_monitor.scene,
        )

    def restore(self, snapshot: ControllerSnapshot) -> None:
        """Continues, bit for bit, from the snapshot of a controller with the same robot and settings."""
        restore(self, snapshot.cycle)
        self._frames.position = None if self._state is None else self._state.position
        restore(self._timer, snapshot.timer)
        self._velocity_controller.set_rate(self._timer.expected_hz)
        restore(self._state_machine, snapshot.state_machine)
        restore(self._status, snapshot.status)
        restore(self._joint_states, snapshot.joint_states)
        restore(self._frames, snapshot.frames)
        self._targets.restore(snapshot.targets)
        self._following_error.restore(snapshot.following_error)
        self._velocity_controller.restore(snapshot.velocity_controller)
        self.collision_monitor.scene = snapshot.scene

    # --- one control step --------------------------------------------------------------------------------------------

    def _on_state(self, state: JointState, now: Instant) -> Step | None:
        self._velocity_controller.set_rate(self._timer.expected_hz)
        if self._state is not None:
            self._timer.add_interval((state.time_ns - self._state.time_ns) / NS)
        self._state = state
        self._frames.position = state.position
        self._last_step_ns = now.monotonic_ns
        if self._state_machine.ramp is not None:
            return self._ramp_step(now)
        return self._track(state, now) if self._may_move(state, now) else None

    def _may_move(self, state: JointState, now: Instant) -> bool:
        """True when the control law may compute a command. Starts it at the measured position, or starts a ramp."""
        if self._state_machine.latched:
            return False
        stop = self._stop_status(state, now)
        if stop is not None:
            self._keep_targets = self._keep_targets or self._state_machine.closed_loop
            self._ramp_down(now, stop)
            return False
        if not self._state_machine.closed_loop:
            if now.monotonic_ns < self._retry_ns:
                return False
            self._following_error.reset()
            self._velocity_controller.start(state.time_ns, now.monotonic_ns - round(self._timer.period_s * NS))
            start_targets = self._targets.rest_at if self._keep_targets else self._targets.start
            start_targets(self.robot.pose(state.position), state.time_ns)
            self._keep_targets = False
        return True

    def _stop_status(self, state: JointState, now: Instant) -> Status | None:
        """Status when the arm must stop; None when it may move."""
        if self._timer.too_slow:
            return Status(Level.ERROR, Mode.STOPPED, self._timer.too_slow)
        if self._subscribers == 0:
            return NO_SUBSCRIBER
        if self._state_machine.closed_loop and self.settings.follow.enabled:
            reason = self._following_error.update(state.time_ns, state.position, self._velocity_controller.velocity)
            if reason:
                self._retry_ns = now.monotonic_ns + round(RETRY_S * NS)
                return Status(Level.WARN, Mode.STOPPED, reason)
        return None

    def _track(self, state: JointState, now: Instant) -> Step:
        pose_sb, interval_s, law = self.robot.pose(state.position), self._timer.interval_s, self._velocity_controller
        motion = self._targets.advance(state.time_ns, interval_s, law.task_scale, pose_sb, state.position)
        output = law.compute(state, pose_sb, motion, interval_s, now, self._targets.foreseen)
        report_step(self._status, now, output, law, self._targets, self._timer, self._joint_states)
        self._tick += 1
        return closed_loop_step(self._tick - 1, now, state, pose_sb, motion, output, self._targets, self.status)

    def _ready(self) -> JointState:
        """Last joint state while the control law is active; raises TargetRefused otherwise."""
        if self._state is None or not self._state_machine.closed_loop:
            raise TargetRefused(f"the arm is {self.status.mode.value}: {self.status.reason}")
        return self._state

    @contextmanager
    def _refusals(self, name: str) -> Iterator[None]:
        """Counts errors of an input, notes them until it is accepted or reset, and raises them as TargetRefused."""
        try:
            yield
        except (InputError, UnknownNameError) as error:
            self.targets_refused += 1
            self._status.note(name, f"{name} refused: {error}")
            raise TargetRefused(str(error)) from error
        self._status.note(name)

    # --- stopping ----------------------------------------------------------------------------------------------------

    def _ramp_down(self, now: Instant, idle_status: Status) -> None:
        acceleration = self._velocity_controller.solver.limits.acceleration
        self._state_machine.ramp_down(self._velocity_controller.velocity, acceleration, now, idle_status)

    def _stop_when_late(self, now: Instant) -> Step | None:
        """Commands zero when joint states are stale, or the node was held up during a ramp; None otherwise."""
        since_step_ns = now.monotonic_ns - self._last_step_ns
        late = reason_when_late(self._state_machine, self._joint_states, since_step_ns, self._timer.period_s, now)
        if late is None:
            return None
        delay_s = self._timer.restart_delay_s(now.monotonic_ns, RESTART_S if late.is_held_up else 0.0)
        self._retry_ns = now.monotonic_ns + round(delay_s * NS)
        return self._stop(now, Level.ERROR, late.reason)

    def _stop(self, now: Instant, level: Level, reason: str) -> Step | None:
        """Commands zero at once; the next valid state starts again, unless paused or in a fault."""
        was_moving, is_repeated = self._state_machine.moving, self._retry_ns - now.monotonic_ns > RETRY_S * NS
        repeated = f"; repeated, continues after {self._timer.recovery_s:g} s" if is_repeated else ""
        self._state_machine.stop(level, reason + repeated)
        self._keep_targets = False
        self._state = self._frames.position = None
        self._timer.reset_interval()
        return self._bare_step(now, np.zeros(self.robot.n)) if was_moving else None

    def _ramp_step(self, now: Instant) -> Step:
        self._status.note("limits", self._velocity_controller.slowing())
        velocity = self._velocity_controller.slowed(self._state_machine.ramp_velocity(now), now)
        return self._bare_step(now, velocity)

    def _bare_step(self, now: Instant, velocity: Array) -> Step:
        """Step that commands ``velocity`` (n,) without a control law."""
        self._velocity_controller.command(velocity, now.monotonic_ns)
        self._last_step_ns = now.monotonic_ns
        self._tick += 1
        return open_loop_step(self._tick - 1, now, self._state, self.robot, velocity, self.status)
