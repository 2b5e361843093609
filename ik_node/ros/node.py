"""The node: joint states and targets in, joint velocities out. A thin shell around the controller."""

from __future__ import annotations

import time
import traceback
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ik_node.control.controller import Controller
from ik_node.control.warm_up import rehearse
from ik_node.errors import IkNodeError, InputError, RecordingError
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.samples import frames_of
from ik_node.interfaces.step import Step
from ik_node.jit import is_cold
from ik_node.messages.step_codec import CallKind
from ik_node.recording.input_table import INPUTS, Input
from ik_node.robot.catalogue import robot_from
from ik_node.robot.robot import Robot
from ik_node.ros import parameters, qos
from ik_node.ros.message_types import message_class
from ik_node.ros.publisher import StepPublisher
from ik_node.ros.recorder import NodeRecorder
from ik_node.ros.transforms import Transforms
from ik_node.settings.groups import Settings

TARGET_TOPICS = tuple(entry.topic for entry in INPUTS.values() if entry.name.startswith("target"))
"""Where one publisher is enough."""
WATCHDOG_S = 0.01
"""How often the controller is asked whether something is missing."""
MARKERS_S = 0.1
"""How often the run is shown as markers."""
LONGEST_RAMP_S = 5.0
"""A ramp to zero that takes longer than this at the end of the process is cut off."""


class IkNode(LifecycleNode):  # type: ignore[misc]
    """Cartesian velocity control as a lifecycle node that configures and activates itself unless told not to."""

    def __init__(self) -> None:
        super().__init__("ik_node")
        parameters.declare(self)
        about = ParameterDescriptor(description="Configure and activate without being asked.", read_only=True)
        self._autostart = bool(self.declare_parameter("autostart", True, about).value)
        self._described = ""
        self._controller: Controller | None = None
        self._recorder = NodeRecorder(self)
        self._active = False
        self._listeners = 1
        self._crowd = ""
        self._transforms = Transforms(self)
        self._inputs: list[Any] = []
        self._publisher = StepPublisher(self)
        self.create_subscription(String, "robot_description", self._on_description, qos.LATCHED)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/record", self._on_record)
        self.create_timer(WATCHDOG_S, self._on_watchdog)
        self.create_timer(1.0, self._on_second)
        self.create_timer(MARKERS_S, self._on_markers)
        parameters.follow_changes(self, self._settings, self._check_settings, self._apply_settings)
        if not self._start_by_itself():
            raise IkNodeError("the node could not be configured; the reason stands above")

    # --- lifecycle ---------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reads the parameters, loads the robot, opens the topics; FAILURE with the reason in the log."""
        del state
        try:
            settings = parameters.read(self)
            robot = robot_from(settings.arm, self._described)
            self._controller = Controller(robot, settings)
            self._rehearse(robot, settings)
            self._publisher.configure(robot, settings)
        except IkNodeError as error:
            self.get_logger().error(f"not configured: {error}")
            self._controller = None
            return TransitionCallbackReturn.FAILURE
        except Exception:  # rclpy would turn it into an error state without a word
            self.get_logger().error(f"not configured: {traceback.format_exc()}")
            self._controller = None
            return TransitionCallbackReturn.ERROR
        if settings.recording.enabled:
            try:
                self._start_recording()
            except RecordingError as error:  # the arm is worth more than the recording
                self.get_logger().error(f"not recorded: {error}")
        self._inputs = [self._listen(kind) for kind in INPUTS]
        moved = ", ".join(robot.joints)
        self.get_logger().info(f"configured: {robot.base_frame} -> {robot.tip_frame}, joints {moved}")
        self.get_logger().info(self._controller.pairs)
        return TransitionCallbackReturn.SUCCESS

    def _rehearse(self, robot: Robot, settings: Settings) -> None:
        if is_cold():
            self.get_logger().info("compiling, once for this version: half a minute")
        began = time.monotonic()
        rehearse(robot, settings)
        self.get_logger().info(f"rehearsed in {time.monotonic() - began:.1f} s")

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Goes on from the measured position; until a target comes it is held."""
        self._resume()
        self._active = True
        self._publish_status()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ramps to zero before it answers."""
        self._ramp_to_rest("deactivated")
        self._active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Closes topics and recording."""
        del state
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ramps to zero and closes everything, from any state."""
        del state
        self._ramp_to_rest("shut down")
        self._active = False
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def finish(self, executor: Any) -> None:
        """Last acts of the process, after a signal: the arm comes to rest, the recording is made whole."""
        del executor
        self._ramp_to_rest("the process was asked to end")
        self._close()

    def _start_by_itself(self) -> bool:
        """Configures and activates as soon as a robot is known; False when that went wrong."""
        wanted = parameters.read(self).arm
        known = bool(wanted.robot or wanted.robot_description or self._described)
        begin = self._autostart and known and self._controller is None
        if not begin:
            return True
        done = self.trigger_configure() == TransitionCallbackReturn.SUCCESS
        return bool(done and self.trigger_activate() == TransitionCallbackReturn.SUCCESS)

    def _close(self) -> None:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = []
        self._recorder.close()
        self._publisher.no_markers(self._now())
        self._controller = None

    def _ramp_to_rest(self, reason: str) -> None:
        """Drives the ramp itself: no callback runs meanwhile, so the controller's clock call makes the steps."""
        controller = self._controller
        if controller is None or not self._active:
            return
        self._pause(reason)
        until = time.monotonic() + LONGEST_RAMP_S
        period_s = 2.0 / controller.settings.control.rate_hz
        while not controller.at_rest and time.monotonic() < until:
            time.sleep(period_s)
            self._on_watchdog()
        self._publisher.zeros()
        self._publish_status()

    # --- inputs ------------------------------------------------------------------------------------------------------

    def _listen(self, kind: CallKind) -> Any:
        """Subscribes to the bytes of an input: they are recorded as they came, and decoded faster than rclpy does."""
        entry = INPUTS[kind]

        def on_bytes(data: bytes) -> None:
            if self._active:
                self._on_input(kind, entry, data, self._now())

        profile = qos.STREAM if entry.streamed else qos.OUTPUT
        return self.create_subscription(message_class(entry.type_name), entry.topic, on_bytes, profile, raw=True)

    def _on_input(self, kind: CallKind, entry: Input, data: bytes, now: Instant) -> None:
        if self._controller is None:
            return
        try:
            sample = entry.decode(data)
        except InputError as error:
            self.get_logger().warning(f"{entry.name} dropped: {error}", throttle_duration_sec=1.0)
            return
        self._ask_for_frames(sample, now)
        step = None
        try:
            step = entry.make(self._controller, sample, now)
        except IkNodeError as error:
            self.get_logger().warning(f"{entry.name} refused: {error}", throttle_duration_sec=1.0)
        self._send(step, kind, now, entry.name, data)

    def _ask_for_frames(self, sample: object, now: Instant) -> None:
        """Tells the controller what tf knows of the frames of a sample that the robot's model does not have."""
        controller = self._controller
        unknown = [frame for frame in frames_of(sample) if controller and frame not in controller.robot.frames]
        if controller is None or not unknown:
            return
        for answer in self._transforms.answers(controller.robot.base_frame, unknown):
            try:
                controller.on_transform(answer, now)
            except IkNodeError as error:
                self.get_logger().warning(f"transform refused: {error}", throttle_duration_sec=1.0)
            self._recorder.called(CallKind.ON_TRANSFORM, now, text=answer)

    def _on_description(self, message: String) -> None:
        self._described = message.data
        self._start_by_itself()

    def _on_watchdog(self) -> None:
        if self._controller is not None and self._active:
            now = self._now()
            if self._publisher.listeners != self._listeners:
                self._listeners = self._publisher.listeners
                self._controller.on_listeners(self._listeners, now)
                self._recorder.called(CallKind.ON_LISTENERS, now, text=str(self._listeners))
            self._send(self._controller.on_clock(now), CallKind.ON_CLOCK, now)

    def _on_second(self) -> None:
        if self._controller is not None:
            now = self._now()
            self._count_publishers(self._controller, now)
            status, values = self._recorder.remark(self._controller.status), self._recorder.values()
            self._recorder.said(self._publisher.diagnostics(status, now, values), now)

    def _count_publishers(self, controller: Controller, now: Instant) -> None:
        """Two who say where the tool should go cannot both be followed; drivers may share the topic of joint states."""
        counts = {topic: self.count_publishers(self.resolve_topic_name(topic)) for topic in TARGET_TOPICS}
        crowd = ", ".join(f"{count} publishers on {topic[2:]}" for topic, count in counts.items() if count > 1)
        if crowd != self._crowd:
            self._crowd = crowd
            controller.on_publishers(crowd, now)
            self._recorder.called(CallKind.ON_PUBLISHERS, now, text=crowd)

    def _on_markers(self) -> None:
        if self._controller is not None:
            self._publisher.markers(self._controller.scene, self._now())

    # --- requests ----------------------------------------------------------------------------------------------------

    def _pause(self, reason: str) -> None:
        if self._controller is not None:
            now = self._now()
            self._controller.pause(now, reason)
            self._recorder.called(CallKind.PAUSE, now, text=reason)

    def _resume(self) -> None:
        if self._controller is not None:
            self._controller.resume()
            self._recorder.called(CallKind.RESUME, self._now())

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._pause("paused by request")
        else:
            self._resume()
        return self._answer(response)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if self._controller is not None:
            self._controller.reset()
            self._recorder.called(CallKind.RESET, self._now())
        return self._answer(response)

    def _answer(self, response: Any) -> Any:
        """Success with the status as its message, or what stands in the way."""
        response.success = self._controller is not None
        response.message = self._controller.status.reason if self._controller is not None else "not configured"
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

    def _send(self, step: Step | None, kind: CallKind, now: Instant, name: str = "", data: bytes = b"") -> None:
        """Publishes what a step commands, first of all, then what it tells; only then records the call and the step."""
        outgoing = [] if step is None else self._publisher.step(step)
        self._recorder.called(kind, now, name, data)
        if step is not None:
            self._recorder.sent(step, outgoing)
        if self._controller is not None:
            self._recorder.between_calls(self._controller, now)
        self._publish_status()

    def _publish_status(self) -> None:
        if self._controller is not None:
            said = self._publisher.status(self._recorder.remark(self._controller.status))
            if said is not None:
                self._recorder.said(said, self._now())

    def _start_recording(self) -> str:
        """Returns the folder; RecordingError when it exists or cannot be written, or there is nothing to record."""
        if self._controller is None:
            raise RecordingError("nothing to record before the node is configured")
        inputs = {entry.name: self.resolve_topic_name(entry.topic) for entry in INPUTS.values()}
        return self._recorder.start(self._controller, self._publisher.topics | inputs, self._now())

    # --- settings ----------------------------------------------------------------------------------------------------

    def _settings(self) -> Settings:
        return parameters.read(self) if self._controller is None else self._controller.settings

    def _check_settings(self, settings: Settings) -> None:
        if self._controller is not None:
            self._controller.check(settings)

    def _apply_settings(self, settings: Settings) -> None:
        if self._controller is not None:
            self._controller.apply(settings)
            self._recorder.applied(settings, self._now())

    def _now(self) -> Instant:
        return Instant(time.monotonic_ns(), self.get_clock().now().nanoseconds)
