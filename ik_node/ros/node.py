"""The node: joint states and targets in, joint velocities out.

It subscribes to bytes, decodes them, calls the controller through a
:class:`~ik_node.replay.recorded_controller.RecordedController` and publishes the Step.
"""

from __future__ import annotations

import gc
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from ik_node.control.compilation import compile_and_warm_up
from ik_node.control.controller import Controller
from ik_node.control.joint_states import CONTRADICTION
from ik_node.errors import IkNodeError, InputError, RecordingError, SettingsError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.delivery import CLOCK_PERIOD_S
from ik_node.interfaces.step import Level, Mode, Status, Step
from ik_node.messages.encode import Outgoing
from ik_node.messages.step_codec import CallKind
from ik_node.recording.input_table import INPUTS, Input
from ik_node.replay.recorded_controller import RecordedController
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.robot import Robot
from ik_node.ros import parameters, qos
from ik_node.ros.description_topic import DescriptionTopic
from ik_node.ros.input_queue import InputQueue
from ik_node.ros.message_types import message_class
from ik_node.ros.method_timer import MethodTimer
from ik_node.ros.publisher import StepPublisher
from ik_node.ros.recorder import NodeRecorder
from ik_node.ros.status_log import StatusLog, log_line
from ik_node.ros.steady_timer import create_steady_timer
from ik_node.ros.step_rates import StepRates
from ik_node.ros.throttled_log import ThrottledLog
from ik_node.ros.transforms import Transforms
from ik_node.ros.watchdog_status import WatchdogStatus
from ik_node.settings.groups import Settings

TARGET_TOPICS = tuple(entry.topic for entry in INPUTS.values() if entry.name.startswith("target"))
"""Topics that may have one publisher only."""
JOINT_STATES = INPUTS[CallKind.ON_JOINT_STATE].topic
MARKER_PERIOD_S = 0.1


class IkNode(LifecycleNode):  # type: ignore[misc]
    """Cartesian velocity control as a lifecycle node.

    It configures and activates itself unless the parameter ``autostart`` is false.
    """

    def __init__(self, arguments: Sequence[str] | None = None) -> None:
        super().__init__("ik_node")
        self._autostart = parameters.declare(self, arguments)
        self._status_log = StatusLog(lambda level, line: log_line(self, level, line))
        self._rates = StepRates()
        self._joint_states_skipped = 0
        self._configured_with = ""
        self._calls: RecordedController | None = None
        self._recorder = NodeRecorder(self)
        self._active = False
        self._command_subscribers = 1
        self._publisher_conflict = ""
        self._transforms = Transforms(self)
        self._inputs: list[Any] = []
        self._input_notes: dict[str, str] = {}
        self._queue = InputQueue(lambda kind, data: self._on_input(kind, INPUTS[kind], data, self._now()))
        self._publisher = StepPublisher(self)
        self._watchdog = WatchdogStatus(self)
        self._description = DescriptionTopic(self, ThrottledLog(self), self._on_description)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/record", self._on_record)
        create_steady_timer(self, CLOCK_PERIOD_S, self._on_clock)
        create_steady_timer(self, 1.0, self._on_second)
        create_steady_timer(self, MARKER_PERIOD_S, self._on_markers)
        parameters.follow_changes(self, self._settings, self._check_settings, self._apply_settings)
        if not self._autostarted():
            raise IkNodeError("the node could not be configured; see the log above")

    # --- lifecycle ---------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, load the robot, open the topics; FAILURE with the reason in the log."""
        del state
        try:
            settings = parameters.read(self)
            robot = robot_from_settings(settings.arm, self._description.text)
            self._method_timer = MethodTimer(robot, settings)
            for line in self._method_timer.reports():
                self.get_logger().info(line)
            controller = Controller(robot, settings, self._method_timer.methods)
            controller.method.fail(self._method_timer.slow(settings.control.method))
            self._calls = RecordedController(controller, self._send, timer_ns=time.perf_counter_ns)
            arm = settings.arm
            self._configured_with = "" if arm.robot or arm.robot_description else self._description.text
            self._description.check(robot, self._configured_with)
            self._warm_up(robot, settings)
            self._publisher.configure(robot, settings)
        except Exception as error:  # rclpy would change to the error state, which ends the node, without a message
            is_expected = isinstance(error, IkNodeError)
            self.get_logger().error(f"not configured: {error if is_expected else traceback.format_exc()}")
            reason = str(error) if is_expected else f"{type(error).__name__}: {error}"
            self._publisher.publish_status(Status(Level.ERROR, Mode.WAITING, f"not configured: {reason}"))
            self._calls = None
            return TransitionCallbackReturn.FAILURE
        if settings.recording.enabled:
            try:
                self._start_recording()
            except RecordingError as error:  # the node controls the arm without a recording
                self.get_logger().error(f"not recorded: {error}")
        self._inputs = [self._subscribe(kind) for kind in INPUTS]
        joints = ", ".join(robot.joints)
        self.get_logger().info(f"configured: {robot.base_frame} -> {robot.tip_frame}, joints {joints}")
        if not (settings.arm.tip_frame or settings.arm.robot):
            self.get_logger().warning(f"tip_frame is not set: {robot.default_tip_text}")
        self.get_logger().info(controller.collision_monitor.pairs)
        return TransitionCallbackReturn.SUCCESS

    def _warm_up(self, robot: Robot, settings: Settings) -> None:
        start_s = time.monotonic()
        compile_and_warm_up(robot, settings, self.get_logger().info)
        gc.unfreeze()
        gc.collect()
        gc.freeze()  # a full collection of what was loaded and compiled would hold up the commands for 0.1 s
        self.get_logger().info(f"warmed up in {time.monotonic() - start_s:.1f} s")

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start at the measured position, which is held until a target arrives."""
        self._resume()
        self._active = True
        self._publish_status()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ramp to zero, then respond."""
        self._ramp_to_rest("deactivated")
        self._active = False
        self._queue.clear()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close topics and recording."""
        del state
        self._close()
        self.get_logger().info("not configured any more: waiting for a request to configure")
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ramp to zero and close everything, from any state."""
        del state
        self._ramp_to_rest("shut down")
        self._active = False
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def finish(self, executor: Any) -> None:
        """Ramp to zero and complete the recording, after a signal and before the process ends."""
        del executor
        try:
            self._ramp_to_rest("the process is ending")
        finally:
            self._close()

    def _autostarted(self) -> bool:
        """Configure and activate once a robot is known; return False when that failed."""
        arm = parameters.read(self).arm
        is_known = bool(arm.robot or arm.robot_description or self._description.text)
        if self._autostart and not is_known:
            waiting = f"waiting for robot_description on {self._description.name}"
            self.get_logger().info(waiting)
            status = Status(Level.OK, Mode.WAITING, waiting).with_warning(self._description.refusal)
            self._publisher.publish_status(status)
        if not (self._autostart and is_known and self._calls is None):
            return True
        is_configured = self.trigger_configure() == TransitionCallbackReturn.SUCCESS
        return bool(is_configured and self.trigger_activate() == TransitionCallbackReturn.SUCCESS)

    def _close(self) -> None:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        self._input_notes = {}
        self._queue.clear()
        self._recorder.close()
        self._publisher.delete_markers(self._now())
        self._calls = None

    def _ramp_to_rest(self, reason: str) -> None:
        """Ramp to zero with clock calls, however long it takes: no other callback runs during this one."""
        if self._calls is None or not self._active:
            return
        controller = self._calls.controller
        try:
            self._pause(reason)
            period_s = 2.0 / controller.settings.control.rate_hz
            while not controller.at_rest:
                time.sleep(period_s)
                self._on_clock()
        finally:  # an exception of the ramp leaves no velocity either
            self._publisher.publish_zero()
        self._publish_status()

    # --- inputs ------------------------------------------------------------------------------------------------------

    def _subscribe(self, kind: CallKind) -> Any:
        """Subscribe to the bytes of an input: they are recorded, and decoded faster here than in rclpy."""
        entry = INPUTS[kind]

        def on_bytes(data: bytes) -> None:
            if self._active:
                self._queue.put(kind, data)

        profile = qos.STREAM if entry.streamed else qos.OUTPUT
        return self.create_subscription(message_class(entry.type_name), entry.topic, on_bytes, profile, raw=True)

    def _on_input(self, kind: CallKind, entry: Input, data: bytes, now: Instant) -> None:
        if self._calls is None:
            return
        try:
            sample = entry.decode(data)
            self._transforms.pass_frames(self._calls, sample, now)
        except InputError as error:
            self._note_input(entry.name, f"{entry.name} refused: {error}", now)
            return
        self._note_input(entry.name, "", now)
        with suppress(IkNodeError):  # the reason is in the status, which is logged
            self._calls.call(kind, now, sample, data)
        if slow := self._method_timer.slow(self._calls.controller.settings.control.method):
            self._calls.call(CallKind.ON_METHOD_FAULT, now, slow)
        self._publish_status()

    def _note_input(self, name: str, note: str, now: Instant) -> None:
        """Report in the status why an input is not used; an empty note ends the report."""
        if self._calls is not None and note != self._input_notes.get(name, ""):
            self._input_notes[name] = note
            self._calls.call(CallKind.ON_INPUT_NOTE, now, f"{name} {note}")
            self._publish_status()

    def _on_description(self) -> None:
        if self._calls is None:
            self._autostarted()
        else:
            self._description.check(self._calls.controller.robot, self._configured_with)
            self._publish_status()

    def _on_clock(self) -> None:
        if self._calls is not None and self._active:
            now = self._now()
            if self._publisher.command_subscribers != self._command_subscribers:
                self._command_subscribers = self._publisher.command_subscribers
                self._calls.call(CallKind.ON_LISTENERS, now, self._command_subscribers)
            self._calls.call(CallKind.ON_CLOCK, now)
            self._publish_status()
            self._queue.run()

    def _on_second(self) -> None:
        if self._calls is not None:
            now = self._now()
            self._check_publishers(self._calls, now)
            skipped = self._queue.take_skipped()
            for kind, entry in INPUTS.items():
                note = f"{entry.name}: messages arrive faster than they are processed" if kind in skipped else ""
                self._note_input(f"{entry.name}.rate", note, now)
            self._joint_states_skipped += skipped[CallKind.ON_JOINT_STATE]
            counts = {**self._calls.controller.counts}
            counts["joint_states"] += self._joint_states_skipped
            rates = self._rates.values(counts, now.monotonic_ns)
            if self._active and (text := self._rates.mismatch(rates, self._calls.controller.settings.control.rate_hz)):
                self.get_logger().warning(text)
            status = self._status(self._calls)
            values = {**self._recorder.values(), **rates, "watchdog": self._watchdog.state}
            self._recorder.record(self._publisher.publish_diagnostics(status, now, values), now)

    def _check_publishers(self, calls: RecordedController, now: Instant) -> None:
        """Report target topics with several publishers.

        Several drivers may publish joint states; they are reported only if their positions contradict each other.
        """
        counts = {topic: self.count_publishers(self.resolve_topic_name(topic)) for topic in TARGET_TOPICS}
        conflict = ", ".join(f"{count} publishers on {topic[2:]}" for topic, count in counts.items() if count > 1)
        count = self.count_publishers(self.resolve_topic_name(JOINT_STATES))
        if count > 1 and CONTRADICTION in calls.controller.status.reason:
            text = f"{count} publishers on {JOINT_STATES} contradict each other"
            conflict = f"{conflict}, {text}" if conflict else text
        if conflict != self._publisher_conflict:
            self._publisher_conflict = conflict
            calls.call(CallKind.ON_PUBLISHERS, now, conflict)

    def _on_markers(self) -> None:
        if self._calls is not None:
            self._publisher.publish_markers(self._calls.controller.collision_monitor.scene, self._now())

    # --- requests ----------------------------------------------------------------------------------------------------

    def _pause(self, reason: str) -> None:
        if self._calls is not None:
            self._calls.call(CallKind.PAUSE, self._now(), reason)

    def _resume(self) -> None:
        if self._calls is not None:
            self._calls.call(CallKind.RESUME, self._now())

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._pause("paused by request")
        else:
            self._resume()
        return self._respond(response)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if self._calls is not None:
            self._calls.call(CallKind.RESET, self._now())
        return self._respond(response)

    def _respond(self, response: Any) -> Any:
        """Fill in success, and the reason of the status as message."""
        response.success = self._calls is not None
        response.message = "not configured" if self._calls is None else self._calls.controller.status.reason
        self._publish_status()
        return response

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                response.message = f"recording to {self._start_recording()}"
            else:
                response.message = self._recorder.end()
            response.success = True
        except IkNodeError as error:
            response.message = str(error)
        return response

    # --- outputs -----------------------------------------------------------------------------------------------------

    def _status(self, calls: RecordedController) -> Status:
        status = self._recorder.with_warning(calls.controller.status)
        return status.with_warning(self._description.warning).with_warning(self._description.refusal)

    def _send(self, step: Step) -> list[Outgoing]:
        """Publish a Step and return the messages; none when the process was held up between the call and this point.

        The arm may have been stopped meanwhile. The next call detects the gap and commands zero.
        """
        age_s = (time.monotonic_ns() - step.now.monotonic_ns) / NS
        is_late = self._calls is not None and age_s > self._calls.controller.settings.state.timeout_s
        if is_late and step.joint_velocity.any():
            return []
        return self._publisher.publish_step(step, self._calls is not None and self._calls.recording is not None)

    def _publish_status(self) -> None:
        if self._calls is not None:
            status = self._status(self._calls)
            message = self._publisher.publish_status(status)
            if message is not None:
                self._recorder.record(message, self._now())
            self._status_log.add(status)

    def _start_recording(self) -> str:
        """Start a recording and return its folder; raises RecordingError when that is not possible."""
        if self._calls is None:
            raise RecordingError("the node has to be configured before it can record")
        inputs = {entry.name: self.resolve_topic_name(entry.topic) for entry in INPUTS.values()}
        return self._recorder.start(self._calls, self._publisher.topics | inputs, self._now())

    # --- settings ----------------------------------------------------------------------------------------------------

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Change parameters; whole numbers are taken for doubles, and every refusal names the parameter."""
        try:
            return super().set_parameters_atomically(parameters.checked_changes(parameter_list))
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=str(error))

    def _settings(self) -> Settings:
        return parameters.read(self) if self._calls is None else self._calls.controller.settings

    def _check_settings(self, settings: Settings) -> None:
        if self._calls is not None:
            self._calls.controller.check(settings)

    def _apply_settings(self, settings: Settings) -> None:
        if self._calls is not None:
            self._calls.call(CallKind.APPLY, self._now(), settings)

    def _now(self) -> Instant:
        return Instant(time.monotonic_ns(), self.get_clock().now().nanoseconds)
