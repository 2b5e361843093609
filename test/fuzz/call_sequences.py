"""Calls of a controller in any order, through the bytes of messages, with an arm that moves as commanded.

:class:`CallDriver` makes the calls and checks every Step against the limits in force; :class:`CallSequence` is the
hypothesis state machine that draws the calls.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from arms import ball_arm
from fuzz_targets import URDF, markers_message, path_message, pose_message, quaternion_message, trajectory_message
from hypothesis import assume
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from loop import READY, make_robot

from ik_node.control.controller import Controller
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import IkNodeError, InputError, SceneError, SettingsError, TargetRefused
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import Level, Mode, Step
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array
from ik_node.messages import encode
from ik_node.messages.cdr import header, make, serialize
from ik_node.messages.step_codec import CallKind
from ik_node.messages.step_outputs import StepOutputs
from ik_node.recording.input_table import INPUTS
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.replay.recorded_controller import RecordedController
from ik_node.robot.joint_limits import motion_limits, stopping_distance
from ik_node.robot.robot import Robot
from ik_node.settings.groups import CONTROL_LAWS, Settings, describe
from ik_node.settings.method_names import METHOD_NAMES

COUNTS: Counter[str] = Counter()
"""Numbers of sequences, calls, Steps and compared replays of this process."""
ROUNDING = 1e-9
"""Excess over a limit that is a rounding error, rad/s (m/s)."""
OUTSIDE = 1e-6
"""Distance beyond a position limit that is a rounding error, rad (m)."""
ROS_OFFSET_NS = 1_700_000_000 * NS
REFUSALS: dict[CallKind, type[IkNodeError]] = {CallKind.ON_OBSTACLES: SceneError, CallKind.APPLY: SettingsError}
"""What a call may raise, where it is not TargetRefused."""
CHANGEABLE = tuple(about for about in describe() if not about.read_only)


class CallDriver:
    """Makes calls, moves the arm, and checks what comes out."""

    def __init__(self, robot: Robot, start: Array, settings: Settings, directory: Path | None = None) -> None:
        """``directory``: the calls are recorded in this new folder."""
        self.robot, self.settings = robot, settings
        self.controller = Controller(robot, settings)
        outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)
        self.calls = RecordedController(self.controller, outputs.messages)
        self.time_ns = NS
        self.q = np.array(start, dtype=np.float64)
        self.velocity = np.zeros(robot.n)
        self.commanded_ns = self.time_ns
        self.heard_ns = self.time_ns
        """Time of the last joint state of any kind."""
        self.exact = True
        """The arm was measured in every period and has moved as commanded, within constant limits."""
        self.steps = 0
        self.directory = directory
        if directory is not None:
            self.record(directory, RecorderOptions(own_thread=False))

    @property
    def now(self) -> Instant:
        """Present time."""
        return Instant(self.time_ns, self.time_ns + ROS_OFFSET_NS)

    @property
    def period_ns(self) -> int:
        """Nominal control period."""
        return round(NS / self.settings.control.rate_hz)

    def record(self, directory: Path, options: RecorderOptions) -> None:
        """Starts a recording."""
        self.calls.start(directory, "/ik_node", self.now, options=options, robot_name="arm")

    def advance(self, gap_ns: int) -> None:
        """Moves the arm for a time, as it was commanded."""
        held_ns = self.time_ns + gap_ns - self.commanded_ns
        if self.velocity.any() and held_ns > self.limits().dt_max_s * NS:
            self.exact = False
        self.q = self.q + self.velocity * (gap_ns / NS)
        self.time_ns += gap_ns

    def limits(self) -> Any:
        """Limits in force."""
        return motion_limits(self.robot, self.settings.limits, self.settings.control.rate_hz)

    def send(self, kind: CallKind, data: bytes) -> Step | None:
        """A call with a message, as the node makes it; a message that cannot be decoded makes none."""
        try:
            argument = INPUTS[kind].decode(data)
        except InputError:
            COUNTS["not decoded"] += 1
            return None
        return self.call(kind, argument, data)

    def call(self, kind: CallKind, argument: Any = None, data: bytes = b"") -> Step | None:
        """Makes a call and checks its result."""
        COUNTS["calls"] += 1
        try:
            step = self.calls.call(kind, self.now, argument, data)
        except REFUSALS.get(kind, TargetRefused):
            COUNTS["refused"] += 1
            return None
        if kind is CallKind.APPLY:
            self.exact = self.exact and argument.limits == self.settings.limits
            self.settings = argument
        if kind is CallKind.ON_JOINT_STATE:
            self.heard_ns = self.time_ns
        if step is not None:
            self.check(step)
            self.steps += 1
            COUNTS["steps"] += 1
            self.velocity, self.commanded_ns = step.joint_velocity.copy(), self.time_ns
        return step

    def check(self, step: Step) -> None:
        """Fails when the command of a Step exceeds a limit in force."""
        velocity, limits = step.joint_velocity, self.limits()
        assert velocity.shape == (self.robot.n,)
        assert np.isfinite(velocity).all(), f"not finite: {step}"
        elapsed_s = (self.time_ns - self.commanded_ns) / NS
        change = limits.acceleration * elapsed_s
        stops = (Mode.STOPPED, Mode.FAULT, Mode.PAUSED)
        if not (np.abs(velocity - self.velocity) <= change + ROUNDING).all():
            assert not velocity.any(), f"over the acceleration limit: {self.velocity} -> {velocity} in {elapsed_s} s"
            assert step.status.mode in stops, f"zero at once, but {step.status}"
            assert step.status.level is Level.ERROR or step.status.mode is Mode.PAUSED, f"no reason: {step.status}"
        approached = np.abs(self.velocity) - limits.acceleration * min(elapsed_s, limits.dt_max_s)
        assert (np.abs(velocity) <= np.maximum(limits.velocity, approached) + ROUNDING).all(), "over a velocity limit"
        control = self.settings.control
        if step.status.mode in (Mode.TRACKING, Mode.HOLDING) and control.arm_lag_s == control.arm_delay_s == 0.0:
            self._check_position(step, limits, min(elapsed_s, limits.dt_max_s))
        if self.exact:
            over = np.maximum(limits.lower - self.q, self.q - limits.upper).max()
            assert over <= OUTSIDE, f"{over} beyond a position limit"

    def _check_position(self, step: Step, limits: Any, held_s: float) -> None:
        """Each joint can stop before its position limit, or decelerates as fast as it may."""
        for sign, room in ((1.0, limits.upper - step.joint_position), (-1.0, step.joint_position - limits.lower)):
            speed, before = sign * step.joint_velocity, sign * self.velocity
            way = stopping_distance(np.maximum(speed, 0.0), limits.acceleration, limits.dt_max_s)
            slowest = np.maximum(before - limits.acceleration * held_s, 0.0)
            good = (way <= np.maximum(room, 0.0) + OUTSIDE) | (speed <= slowest + OUTSIDE)
            assert good.all(), f"towards a position limit: {speed} with {room} left"

    def measure(self) -> bytes:
        """The joint state of the arm."""
        return encode.encode_joint_state(self.robot.joints, self.now.ros_ns, self.q)

    def run(self, periods: int) -> None:
        """Joint states in every period, and clock calls every 10 ms."""
        for number in range(periods):
            self.advance(self.period_ns)
            self.send(CallKind.ON_JOINT_STATE, self.measure())
            if number % 5 == 4:
                self.call(CallKind.ON_CLOCK)

    def finish(self) -> None:
        """Ends the recording, and replays it bit for bit."""
        recording = self.calls.recording
        if recording is None:
            return
        recording.close()
        assert recording.error == ""
        if self.directory is not None and self.steps:
            result = replay(RecordingSource(self.directory))
            assert result.identical, f"the replay differs: {result}"
            COUNTS["replays"] += 1


def _arm(name: str) -> tuple[Robot, Array]:
    """An arm, with positions from which it can move."""
    if name not in _ARMS:
        _ARMS[name] = ball_arm() if name == "balls" else make_robot(name)
    robot = _ARMS[name]
    return robot, np.array(READY[name]) if name in READY else np.array([0.3, 0.4, -0.5, 0.6, 0.7, -0.4])


_ARMS: dict[str, Robot] = {}
ARMS = ("panda", "ur5", "balls")

ODD_NUMBERS = (0.0, -0.0, 1e-300, -1.0, 3.0, 99.0, 101.0, 1e6, 1e160, float("inf"), float("-inf"), float("nan"))
numbers = st.sampled_from(ODD_NUMBERS) | st.floats(-2.0, 2.0)
gaps_ns = st.sampled_from((0, 1, 1_000, 400_000, 2_000_000, 5_000_000, 9_000_000, 10_000_000))
long_gaps_ns = st.sampled_from((20_000_000, 60_000_000, 99_000_000, 101_000_000, 160_000_000, 600 * NS)) | st.integers(
    0, 3 * NS
)
frames = st.sampled_from(("", "base", "tool", "camera", "no frame", "li\nne", "x" * 300))
offsets = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)


class CallSequence(RuleBasedStateMachine):
    """Any order of calls. What is drawn: bytes of messages, texts, settings and gaps of time."""

    def __init__(self) -> None:
        super().__init__()
        self.folder: Path | None = None
        self.driver: CallDriver

    @initialize(
        arm=st.sampled_from(ARMS),
        method=st.sampled_from(METHOD_NAMES),
        law=st.sampled_from(CONTROL_LAWS),
        exact=st.booleans(),
        record=st.booleans(),
    )
    def begin(self, arm: str, method: str, law: str, exact: bool, record: bool) -> None:
        COUNTS["sequences"] += 1
        robot, start = _arm(arm)
        values = {"method": method, "control_law": law, "obstacles.self_collision": arm == "balls"}
        settings = Settings().with_values(values)
        directory = None
        if record:
            self.folder = Path(tempfile.mkdtemp(prefix="ik_node_calls_"))
            directory = self.folder / "run"
        self.driver = CallDriver(robot, start, settings, directory)
        self.keeps_exact = exact
        self.driver.run(5)

    def frame(self, name: str) -> str:
        known = {"base": self.driver.robot.base_frame, "tool": self.driver.robot.tip_frame}
        return known.get(name, name)

    def near(self, offset: list[float], turn: float = 0.0) -> Any:
        """A pose beside that of the tool."""
        at = self.driver.robot.pose(self.driver.q)
        quaternion = quaternion_from_rotation(at[:3, :3])
        pose = pose_message(float(at[0, 3]) + offset[0])
        pose.position.y, pose.position.z = float(at[1, 3]) + offset[1], float(at[2, 3]) + offset[2]
        axis = np.array([1.0, 0.0, 0.0, 0.0]) * turn + quaternion
        pose.orientation = quaternion_message(*(axis / np.linalg.norm(axis)).tolist())
        return pose

    # --- time and joint states ---------------------------------------------------------------------------------------

    @rule(periods=st.integers(1, 40))
    def run_periods(self, periods: int) -> None:
        self.driver.run(periods)

    @rule(gap_ns=gaps_ns)
    def clock(self, gap_ns: int) -> None:
        self.driver.advance(gap_ns)
        self.driver.call(CallKind.ON_CLOCK)

    @precondition(lambda self: not self.keeps_exact or not self.driver.velocity.any())
    @rule(gap_ns=long_gaps_ns, is_clock=st.booleans())
    def silence(self, gap_ns: int, is_clock: bool) -> None:
        driver = self.driver
        driver.advance(gap_ns)
        if not is_clock:
            driver.send(CallKind.ON_JOINT_STATE, driver.measure())
            return
        driver.call(CallKind.ON_CLOCK)
        if driver.time_ns - driver.heard_ns > driver.settings.state.timeout_s * NS:
            assert driver.controller.status.mode not in (Mode.TRACKING, Mode.HOLDING), "silent joint states"

    @precondition(lambda self: not self.keeps_exact)
    @rule(
        kind=st.sampled_from(
            ("value", "leap", "twice", "part", "short", "none", "reversed", "others", "stamp", "bent")
        ),
        joint=st.integers(0, 6),
        value=numbers,
        stamp_ns=st.sampled_from((0, 1, -NS, NS, 50_000_000, -50_000_000)),
        times=st.integers(1, 4),
        gap_ns=gaps_ns,
    )
    def odd_joint_state(self, kind: str, joint: int, value: float, stamp_ns: int, times: int, gap_ns: int) -> None:
        driver = self.driver
        driver.exact = False
        for _ in range(times):
            driver.advance(gap_ns)
            names, q, stamp = driver.robot.joints, driver.q.copy(), driver.now.ros_ns
            joint %= len(q)
            if kind == "value":
                q[joint] = value
            elif kind == "leap":
                q[joint] += value
            elif kind == "twice":
                names, q = (*names, names[joint]), np.append(q, value)
            elif kind == "part":
                names, q = names[joint : joint + 1], q[joint : joint + 1]
            elif kind == "short":
                q = q[:joint]
            elif kind == "none":
                q = q[:0]
            elif kind == "reversed":
                names, q = names[::-1], q[::-1].copy()
            elif kind == "others":
                names, q = ("gripper", *names, "wheel"), np.concatenate(([value], q, [value]))
            elif kind == "stamp":
                stamp = max(stamp + stamp_ns, 0) if stamp_ns else 0
            else:
                driver.q = q = q + 0.02 * np.sign(value if np.isfinite(value) else 1.0)
            message = make(
                INPUTS[CallKind.ON_JOINT_STATE].type_name,
                header=header("", stamp),
                name=list(names),
                position=q,
                velocity=np.empty(0),
                effort=np.empty(0),
            )
            driver.send(CallKind.ON_JOINT_STATE, serialize(message))

    # --- targets -----------------------------------------------------------------------------------------------------

    @rule(offset=offsets, turn=st.floats(-0.5, 0.5), count=st.integers(1, 12))
    def stream_of_poses(self, offset: list[float], turn: float, count: int) -> None:
        goal = self.near(offset, turn)
        for number in range(count):
            goal.position.x += 0.002 * number
            self.send_pose(goal, self.driver.robot.base_frame, self.driver.now.ros_ns)
            self.driver.run(5)

    @rule(pose=st.lists(numbers, min_size=7, max_size=7), frame=frames, age_ns=st.sampled_from((0, 1, NS, -NS, 10**7)))
    def odd_pose(self, pose: list[float], frame: str, age_ns: int) -> None:
        goal = pose_message(pose[0])
        goal.position.y, goal.position.z = pose[1], pose[2]
        goal.orientation = quaternion_message(*pose[3:])
        self.send_pose(goal, self.frame(frame), max(self.driver.now.ros_ns - age_ns, 0))

    def send_pose(self, pose: Any, frame: str, stamp_ns: int) -> None:
        place, turn = pose.position, pose.orientation
        numbers = np.array([place.x, place.y, place.z]), np.array([turn.x, turn.y, turn.z, turn.w])
        self.driver.send(CallKind.ON_TARGET_POSE, encode.encode_pose(frame, stamp_ns, *numbers))

    @rule(
        offsets=st.lists(offsets, max_size=6),
        frame=frames,
        period_ms=st.sampled_from((0, 0, -5, 1, 200)),
        odd=st.none() | numbers,
        periods=st.integers(0, 60),
    )
    def path(self, offsets: list[list[float]], frame: str, period_ms: int, odd: float | None, periods: int) -> None:
        poses = [self.near(offset) for offset in offsets]
        if poses and odd is not None:
            poses[-1].position.y = odd
        begin_ns = self.driver.now.ros_ns if period_ms else 0
        stamps = [begin_ns + number * period_ms * 1_000_000 for number in range(len(poses))]
        message = path_message(self.frame(frame), poses, stamps)
        self.driver.send(CallKind.ON_TARGET_PATH, serialize(message))
        self.driver.run(periods)

    @rule(
        offsets=st.lists(offsets, max_size=5),
        frame=frames,
        period_ms=st.sampled_from((0, 1, 100, 500)),
        with_twists=st.booleans(),
        odd=st.none() | numbers,
        periods=st.integers(0, 60),
    )
    def trajectory(
        self,
        offsets: list[list[float]],
        frame: str,
        period_ms: int,
        with_twists: bool,
        odd: float | None,
        periods: int,
    ) -> None:
        poses = [self.near(offset) for offset in offsets]
        if poses and odd is not None:
            poses[-1].orientation.w = odd
        message = trajectory_message(self.frame(frame), poses, period_ms * 1_000_000, with_twists)
        self.driver.send(CallKind.ON_TARGET_TRAJECTORY, serialize(message))
        self.driver.run(periods)

    @rule(twist=st.lists(numbers, min_size=6, max_size=6), frame=frames, count=st.integers(1, 10))
    def jog(self, twist: list[float], frame: str, count: int) -> None:
        for _ in range(count):
            data = encode.encode_twist(self.frame(frame), self.driver.now.ros_ns, np.array(twist))
            self.driver.send(CallKind.ON_TARGET_TWIST, data)
            self.driver.run(5)

    # --- the rest ----------------------------------------------------------------------------------------------------

    @rule(
        entries=st.lists(
            st.tuples(
                st.sampled_from(("", "shelf", "a/b")),
                st.integers(0, 3),
                st.sampled_from((1, 2, 3, 4, 10, 99)),
                st.sampled_from((0, 0, 0, 2, 3, 7)),
                offsets,
                st.sampled_from((0.05, 0.2, 1.0)) | numbers,
                st.sampled_from((0, 0, 1, NS)),
            ),
            max_size=4,
        ),
        frame=frames,
        periods=st.integers(0, 20),
    )
    def obstacles(self, entries: list[Any], frame: str, periods: int) -> None:
        made = [
            (space, number, kind, action, self.near(offset), size, lifetime)
            for space, number, kind, action, offset, size, lifetime in entries
        ]
        self.driver.send(CallKind.ON_OBSTACLES, serialize(markers_message(self.frame(frame), made)))
        self.driver.run(periods)

    @rule(data=st.data(), changes=st.integers(1, 3), periods=st.integers(0, 20))
    def parameters(self, data: st.DataObject, changes: int, periods: int) -> None:
        values = {}
        for about in data.draw(st.lists(st.sampled_from(CHANGEABLE), min_size=changes, max_size=changes)):
            if self.keeps_exact and about.name.startswith("limits."):
                continue
            values[about.name] = data.draw(_values(about, self.driver.robot.n))
        try:
            settings = self.driver.settings.with_values(values)
        except SettingsError:
            COUNTS["not decoded"] += 1
            return
        before = self.driver.controller.settings
        self.driver.call(CallKind.APPLY, settings)
        assert self.driver.controller.settings in (before, settings)
        self.driver.run(periods)

    @rule(
        kind=st.sampled_from((CallKind.PAUSE, CallKind.RESUME, CallKind.RESET)),
        gap_ns=gaps_ns,
        periods=st.integers(0, 30),
    )
    def request(self, kind: CallKind, gap_ns: int, periods: int) -> None:
        self.driver.advance(gap_ns)
        self.driver.call(kind, "paused by request" if kind is CallKind.PAUSE else None)
        self.driver.run(periods)

    @rule(
        kind=st.sampled_from(
            (CallKind.ON_LISTENERS, CallKind.ON_PUBLISHERS, CallKind.ON_INPUT_NOTE, CallKind.ON_TRANSFORM)
        ),
        text=st.sampled_from(
            ("0", "1", "camera 0.1 0.2 0.3 0 0 0 1", "camera 1 2", "camera nan 0 0 0 0 0 1", "x 1e200 0 0 0 0 0 1", "")
        ),
        periods=st.integers(0, 10),
    )
    def text(self, kind: CallKind, text: str, periods: int) -> None:
        assume(kind is not CallKind.ON_LISTENERS or text in ("0", "1"))
        self.driver.call(kind, text)
        self.driver.run(periods)

    @invariant()
    def has_a_status(self) -> None:
        if not hasattr(self, "driver"):
            return
        controller = self.driver.controller
        status = controller.status
        assert status.reason.isprintable(), f"not one line: {status.reason!r}"
        assert status.reason, f"no reason: {status}"
        assert status.mode is not Mode.FAULT, f"an input led to a fault: {status.reason}"
        assert not (controller.at_rest and self.driver.velocity.any()), f"a velocity stays: {status}"

    def teardown(self) -> None:
        try:
            if hasattr(self, "driver"):
                self.driver.finish()
        finally:
            if self.folder is not None:
                shutil.rmtree(self.folder, ignore_errors=True)


def _values(about: Any, n: int) -> st.SearchStrategy[Any]:
    """Values of a parameter: its choices, the ends of its range, and values between them."""
    if about.choices:
        return st.sampled_from(about.choices)
    if isinstance(about.default, bool):
        return st.booleans()
    if isinstance(about.default, str):
        return st.just(about.default)
    size = about.size or n
    low, high = (end[0] if isinstance(end, tuple) else end for end in (about.minimum, about.maximum))
    low, high = -3.0 if low is None else low, 20.0 if high is None else high
    one = st.sampled_from((low, high, 0.5 * (low + high))) | st.floats(low, min(high, low + 3.0))
    if not isinstance(about.default, tuple):
        return one | st.just(about.default)
    return one.map(lambda value: [value] * size) | st.just(about.default) | st.lists(one, min_size=size, max_size=size)


def example_driver(directory: Path | None = None, options: RecorderOptions | None = None) -> CallDriver:
    """A small arm after a call of every kind."""
    driver = CallDriver(Robot(URDF), np.array([0.3, 0.4]), Settings().with_values({"rate_hz": 100.0}))
    if directory is not None:
        driver.record(directory, options or RecorderOptions(own_thread=False))
    driver.run(2)
    poses = [pose_message(0.01 * number) for number in range(2)]
    for kind, data in (
        (
            CallKind.ON_TARGET_POSE,
            encode.encode_pose("base", 0, np.array([0.1, 0.0, 0.3]), np.array([0.0, 0.0, 0.0, 1.0])),
        ),
        (CallKind.ON_TARGET_PATH, serialize(path_message("base", poses, [0, 0]))),
        (CallKind.ON_TARGET_TRAJECTORY, serialize(trajectory_message("base", poses, NS, True))),
        (CallKind.ON_TARGET_TWIST, encode.encode_twist("base", 0, np.full(6, 0.01))),
        (CallKind.ON_OBSTACLES, serialize(markers_message("base", [("a", 1, 2, 0, poses[0], 0.1, 0)]))),
    ):
        driver.send(kind, data)
        driver.run(1)
    driver.call(CallKind.APPLY, driver.settings.with_values({"gain": (5.0, 5.0)}))
    driver.call(CallKind.ON_LISTENERS, "1")
    driver.call(CallKind.ON_TRANSFORM, "camera 0 0 0 0 0 0 1")
    driver.call(CallKind.PAUSE, "paused by request")
    driver.run(2)
    driver.call(CallKind.RESUME)
    driver.call(CallKind.RESET)
    driver.call(CallKind.ON_CLOCK)
    return driver


def recorded_example(directory: Path, options: RecorderOptions) -> None:
    """Records :func:`example_driver`."""
    example_driver(directory, options).finish()


def example_snapshot() -> ControllerSnapshot:
    """State of the controller after :func:`example_driver`."""
    return example_driver().controller.capture()
