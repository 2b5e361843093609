"""The controller as a state machine, with the simulated arm in one process.

Tested: every condition that stops the arm, every kind of input that must not move it, and that no sequence of calls
gives a command that is not finite or exceeds a limit. Not tested here: DDS and processes (test_node.py), the quality of
the target's reference (test_stream.py).
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.control.controller import Controller
from ik_node.errors import SettingsError, TargetRefused
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import JointSample, PathSample, PoseSample, TwistSample
from ik_node.interfaces.step import Level, Mode, Step
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.settings.groups import ArmSettings, Settings
from ik_node.trajectory.shapes import figure_of_eight


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def loop_of(robot: Robot, **values: object) -> Loop:
    """Return a loop at rest at the ready posture; parameters with __ for the dot."""
    settings = Settings().with_values({name.replace("__", "."): value for name, value in values.items()})
    loop = Loop(robot, READY["panda" if robot.n == 7 else "ur5"], settings)
    loop.run(0.05)
    return loop


def moving_loop(robot: Robot) -> Loop:
    """Return a loop in the middle of a figure of eight."""
    loop = loop_of(robot)
    loop.follow(figure_of_eight(loop.pose()).pose, 3.0, 100.0)
    assert np.abs(loop.steps[-1].joint_velocity).max() > 0.05
    return loop


@pytest.mark.parametrize(("name", "rate_hz"), [("panda", 50.0), ("panda", 500.0), ("ur5", 50.0)])
def test_a_stream_unknown_in_advance_is_tracked(name: str, rate_hz: float) -> None:
    loop = loop_of(make_robot(name))
    trajectory, begin_ns = figure_of_eight(loop.pose()), loop.time_ns
    loop.follow(trajectory.pose, trajectory.duration_s, rate_hz)
    after = [step for step in loop.steps if step.state_time_ns > begin_ns + NS]
    truth = [trajectory.pose((step.state_time_ns - begin_ns) / NS) for step in after]
    errors = np.array([se3.log(se3.inverse(s.pose_sb) @ pose) for s, pose in zip(after, truth, strict=True)])
    rms = np.sqrt((errors.reshape(-1, 2, 3) ** 2).sum(axis=2).mean(axis=0))
    assert rms[0] < 0.1e-3
    assert rms[1] < 0.3e-3


def test_without_a_target_nothing_moves(panda: Robot) -> None:
    loop = loop_of(panda)
    loop.run(1.0)
    assert loop.mode() is Mode.HOLDING
    assert max(np.abs(step.joint_velocity).max() for step in loop.steps) < 1e-10


def test_stale_joint_states_stop_the_arm_at_once_and_it_continues_without_a_jump(panda: Robot) -> None:
    loop = moving_loop(panda)
    silent_since = loop.time_ns
    step: Step | None = None
    while step is None:
        loop.time_ns += 10_000_000
        step = loop.take(loop.controller.on_clock(loop.now))
        assert loop.time_ns - silent_since < 0.2 * NS
    assert not step.joint_velocity.any()
    assert step.status.mode is Mode.STOPPED
    assert "no joint state for 0.1 s" in step.status.reason
    assert loop.controller.on_clock(loop.now) is None, "zero is commanded once; then another node may command the arm"
    loop.run(0.1)
    assert loop.mode() is Mode.HOLDING
    assert np.abs(loop.steps[-50].joint_velocity).max() < 1e-6, "continues from the measured position"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_joint_state_that_is_not_finite_stops_the_arm_at_once(panda: Robot, value: float) -> None:
    loop = moving_loop(panda)
    position = loop.position
    position[2] = value
    loop.time_ns += loop.period_ns
    step = loop.controller.on_joint_state(JointSample(loop.now.ros_ns, panda.joints, position), loop.now)
    assert step is not None
    assert not step.joint_velocity.any()
    assert step.status.level is Level.ERROR
    assert "panda_joint3" in step.status.reason


def test_names_and_positions_that_do_not_match_stop_the_arm(panda: Robot) -> None:
    loop = moving_loop(panda)
    step = loop.controller.on_joint_state(JointSample(0, panda.joints, np.zeros(6)), loop.now)
    assert step is not None
    assert not step.joint_velocity.any()
    assert "7 names but 6 positions" in step.status.reason


def test_states_of_other_joints_make_no_step_and_do_not_prevent_the_timeout(panda: Robot) -> None:
    loop = moving_loop(panda)
    gripper = ("finger_left", "finger_right")
    for _ in range(10):
        loop.time_ns += 10_000_000
        assert loop.controller.on_joint_state(JointSample(0, gripper, np.zeros(2)), loop.now) is None
    loop.time_ns += 10_000_000
    step = loop.controller.on_clock(loop.now)
    assert step is not None
    assert step.status.mode is Mode.STOPPED


def test_partial_and_shuffled_joint_states_are_merged(panda: Robot) -> None:
    whole, parts = loop_of(panda), loop_of(panda)
    pose = whole.pose()
    pose[0, 3] += 0.02
    for loop in (whole, parts):
        loop.target(pose)
    order = [6, 3, 5, 1]
    rest = [0, 2, 4]
    for _ in range(100):
        whole.tick()
        parts.time_ns += parts.period_ns
        position = parts.position
        first = JointSample(
            parts.now.ros_ns, ("finger", *(panda.joints[i] for i in order)), np.array([0.04, *position[order]])
        )
        assert parts.controller.on_joint_state(first, parts.now) is None
        second = JointSample(parts.now.ros_ns, tuple(panda.joints[i] for i in rest), position[rest])
        assert parts.take(parts.controller.on_joint_state(second, parts.now)) is not None
    assert np.array_equal(whole.steps[-1].joint_velocity, parts.steps[-1].joint_velocity)


def test_the_status_names_the_joints_without_a_state(panda: Robot) -> None:
    controller = Controller(panda, Settings())
    now = Instant(NS, NS)
    controller.on_joint_state(JointSample(0, panda.joints[:5], np.zeros(5)), now)
    assert controller.on_clock(now) is None
    assert controller.status.reason.endswith("panda_joint6, panda_joint7")


GOOD = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("position", "quaternion", "frame", "reason"),
    [
        ((np.nan, 0.0, 0.5), GOOD, "panda_link0", "not finite"),
        ((0.4, np.inf, 0.5), GOOD, "panda_link0", "not finite"),
        ((0.4, 0.0, 0.5), (0.0, 0.0, 0.0, 0.0), "panda_link0", "norm 0"),
        ((0.4, 0.0, 0.5), (0.0, 0.0, 0.0, 1.01), "panda_link0", "norm 1.01"),
        ((0.4, 0.0, 0.5), (np.nan, 0.0, 0.0, 1.0), "panda_link0", "not finite"),
        ((0.4, 0.0, 0.5), GOOD, "map", "unknown frame 'map'; valid: .*panda_hand_tcp"),
    ],
)
def test_an_invalid_target_is_refused_with_a_reason_and_the_next_valid_one_accepted(
    panda: Robot, position: tuple[float, ...], quaternion: tuple[float, ...], frame: str, reason: str
) -> None:
    loop = loop_of(panda)
    loop.target(loop.pose())
    loop.tick()
    bad = PoseSample(loop.now.ros_ns, frame, np.array(position), np.array(quaternion))
    with pytest.raises(TargetRefused, match=reason):
        loop.controller.on_target_pose(bad, loop.now)
    loop.tick()
    assert "target_pose refused" in loop.controller.status.reason
    assert loop.controller.status.level is Level.WARN
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-6
    pose = loop.pose()
    pose[2, 3] += 0.05
    for _ in range(100):
        loop.target(pose)
        loop.run(0.02)
    assert loop.controller.status.reason == "following target_pose"
    assert np.abs(loop.pose()[:3, 3] - pose[:3, 3]).max() < 1e-4


def test_the_reason_of_a_refused_twist_stays_while_another_input_is_accepted(panda: Robot) -> None:
    loop = loop_of(panda)
    loop.target(loop.pose())
    loop.tick()
    with pytest.raises(TargetRefused):
        loop.controller.on_target_twist(TwistSample(loop.now.ros_ns, "panda_link0", np.full(6, np.nan)), loop.now)
    loop.target(loop.pose())
    loop.tick()
    assert "target_twist refused: target twist is not finite" in loop.controller.status.reason
    loop.controller.reset()
    loop.tick()
    assert "refused" not in loop.controller.status.reason


def test_a_quaternion_with_a_small_norm_error_is_normalised(panda: Robot) -> None:
    loop = loop_of(panda)
    quaternion = 1.0005 * se3.quaternion_from_rotation(loop.pose()[:3, :3])
    sample = PoseSample(0, "panda_link0", loop.pose()[:3, 3], quaternion)
    loop.controller.on_target_pose(sample, loop.now)
    loop.run(0.2)
    assert loop.mode() is Mode.TRACKING


def test_pause_ramps_straight_to_zero_within_the_acceleration_limits(panda: Robot) -> None:
    loop = moving_loop(panda)
    limit = loop.settings.limits.acceleration[0]
    first = loop.steps[-1].joint_velocity
    loop.controller.pause(loop.now)
    begun = len(loop.steps)
    loop.run(1.0)
    ramp = np.array([first] + [step.joint_velocity for step in loop.steps[begun:]])
    rate = np.abs(np.diff(ramp, axis=0)).max() * NS / loop.period_ns
    assert rate <= limit * (1 + 1e-9)
    assert rate >= 0.99 * limit, "no slower than necessary"
    assert not ramp[-1].any()
    assert len(ramp) - 2 <= np.ceil(np.abs(first).max() / limit * NS / loop.period_ns), "no commands after the ramp"
    directions = ramp[:-2] / np.linalg.norm(ramp[:-2], axis=1)[:, None]
    assert np.abs(directions - directions[0]).max() < 1e-12, "the direction is constant"
    assert loop.mode() is Mode.PAUSED


def test_a_ramp_is_completed_without_joint_states(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.controller.pause(loop.now)
    for _ in range(100):
        loop.time_ns += 10_000_000
        loop.take(loop.controller.on_clock(loop.now))
    assert loop.controller.at_rest
    assert not loop.steps[-1].joint_velocity.any()


def test_resume_continues_from_the_measured_position(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.controller.pause(loop.now)
    loop.run(0.5)
    loop.controller.resume()
    loop.run(0.1)
    assert loop.mode() is Mode.HOLDING
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-9


def test_resume_during_the_ramp_finishes_the_ramp_first(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.controller.pause(loop.now)
    loop.run(0.01)
    loop.controller.resume()
    assert loop.mode() is Mode.RAMPING
    begun = len(loop.steps)
    loop.run(0.5)
    assert loop.mode() is Mode.HOLDING
    rate = np.abs(np.diff([step.joint_velocity for step in loop.steps[begun:]], axis=0)).max() * NS / loop.period_ns
    assert rate <= loop.settings.limits.acceleration[0] * (1 + 1e-9)


def test_a_robot_that_stands_still_is_detected_and_continues_without_a_jump(panda: Robot) -> None:
    """A protective stop: the robot ignores commands for a while. Commands ramp to zero, and restart without a jump."""
    loop = moving_loop(panda)
    trajectory, begin_ns = figure_of_eight(loop.pose()), loop.time_ns
    frozen = loop.position

    def stream() -> None:
        loop.target(trajectory.pose((loop.time_ns - begin_ns) / NS))

    class Standing:
        """Measures the positions at which it was stopped."""

        model = loop.arm.model

        def measure(self, time_ns: int) -> Array:
            del time_ns
            return np.array(frozen)

        def advance(self, time_ns: int) -> tuple[Array, Array]:
            del time_ns
            return np.array(frozen), np.zeros(7)

        def command(self, velocity: Array, time_ns: int) -> None:
            del velocity, time_ns

    arm, loop.arm = loop.arm, Standing()  # type: ignore[assignment]
    loop.run(1.2, stream)
    told = [step for step in loop.steps if "does not move" in step.status.reason]
    assert told, loop.controller.status.reason
    assert not loop.steps[-1].joint_velocity.any() or loop.mode() is not Mode.TRACKING
    loop.run(2.0, stream)
    loop.arm = SimulatedArm(frozen, panda.limits, loop.time_ns)
    count = len(loop.steps)
    loop.run(4.0, stream)
    assert loop.mode() is Mode.TRACKING
    rate = np.abs(np.diff([step.joint_velocity for step in loop.steps[count:]], axis=0)).max() * NS / loop.period_ns
    assert rate <= 10.0 * (1 + 1e-9)
    assert np.linalg.norm(loop.steps[-1].error_b[:3]) < 1e-3
    del arm


def test_an_arm_with_lag_or_reduced_speed_counts_as_following(panda: Robot) -> None:
    late = Loop(panda, READY["panda"], model=ArmModel(lag_s=0.03, delay_s=0.004, encoder_noise=1e-4))
    late.run(0.05)
    late.follow(figure_of_eight(late.pose()).pose, 10.0, 50.0)
    assert not any(step.status.mode is Mode.STOPPED for step in late.steps)


def test_without_a_subscriber_the_arm_is_stopped_with_this_reason(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.controller.on_listeners(0, loop.now)
    loop.run(1.0)
    assert loop.mode() is Mode.STOPPED
    assert loop.controller.status.reason == "no subscriber on the command topic"
    assert not loop.steps[-1].joint_velocity.any()
    loop.controller.on_listeners(1, loop.now)
    loop.run(0.1)
    assert loop.mode() is Mode.HOLDING


def test_an_exception_inside_is_a_fault_until_reset(panda: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = moving_loop(panda)
    with monkeypatch.context() as broken:
        broken.setattr(panda, "evaluate", lambda q: 1 / 0)
        step = loop.tick()
    assert step is not None
    assert not step.joint_velocity.any()
    assert step.status.mode is Mode.FAULT
    assert "ZeroDivisionError" in step.status.reason
    loop.run(0.1)
    assert loop.mode() is Mode.FAULT, "a fault persists"
    loop.controller.pause(loop.now)
    loop.controller.resume()
    assert loop.mode() is Mode.FAULT, "a pause does not end a fault"
    loop.controller.reset()
    loop.run(0.1)
    assert loop.mode() is Mode.HOLDING


def test_a_result_that_is_not_finite_is_a_fault(panda: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = moving_loop(panda)
    good = panda.evaluate
    with monkeypatch.context() as broken:
        broken.setattr(panda, "evaluate", lambda q: good(q)._replace(jacobian_b=np.full((6, 7), np.nan)))
        step = loop.tick()
    assert step is not None
    assert not step.joint_velocity.any()
    assert step.status.mode is Mode.FAULT


def test_the_end_of_the_stream_holds_the_last_pose(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.run(3.0)
    assert loop.mode() is Mode.HOLDING
    assert "stream has ended" in loop.controller.status.reason
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-6
    assert np.linalg.norm(loop.steps[-1].error_b) < 1e-6


def test_no_input_gives_a_command_above_a_limit_or_not_finite() -> None:
    for name, seed in (("panda", 1), ("ur5", 2)):
        robot, generator = make_robot(name), np.random.default_rng(seed)
        loop = loop_of(robot, limits__velocity_fraction=0.7)
        for _ in range(600):
            pose = np.eye(4)
            pose[:3, :3] = se3.exp_rotation(generator.normal(size=3) * 2.0)
            pose[:3, 3] = generator.normal(size=3) * generator.choice([0.1, 1.0, 10.0])
            try:
                loop.target(pose * (np.nan if generator.random() < 0.1 else 1.0))
            except TargetRefused:
                continue
            finally:
                loop.run(generator.integers(0, 8) / 500.0)
        commands = np.array([step.joint_velocity for step in loop.steps])
        assert len(commands) > 1500
        assert np.isfinite(commands).all()
        assert (np.abs(commands) <= 0.7 * robot.limits.velocity).all()
        assert any(step.scale < 1.0 for step in loop.steps), "the limits must be reached for this test to be valid"
        assert not any(step.status.mode is Mode.FAULT for step in loop.steps)


def test_the_velocity_limit_slows_the_tool_and_keeps_its_path(panda: Robot) -> None:
    loop = loop_of(panda, limits__velocity_fraction=0.05)
    loop.follow(figure_of_eight(loop.pose()).pose, 3.0, 100.0)
    slowed = [step for step in loop.steps if step.scale < 1.0]
    assert slowed
    for step in slowed[::50]:
        limits = 0.05 * panda.limits.velocity
        assert np.abs(step.joint_velocity / limits).max() == pytest.approx(1.0, abs=1e-12)
        assert step.binding[0].startswith("velocity panda_joint")
        jacobian = panda.evaluate(step.joint_position).jacobian_b
        twist = jacobian @ step.joint_velocity
        wanted = step.twist_b - step.truncated_b
        cosine = twist @ wanted / np.linalg.norm(twist) / np.linalg.norm(wanted)
        assert cosine > 1 - 1e-4, "up to the half step between measured and Jacobian position"


@pytest.mark.parametrize(("name", "reach"), [("panda", 1.5), ("ur5", 1.5)])
def test_an_unreachable_target_stretches_the_arm_and_it_returns(name: str, reach: float) -> None:
    robot = make_robot(name)
    loop = loop_of(robot)
    home = loop.pose()
    away = home.copy()
    away[:2, 3] *= reach / np.linalg.norm(home[:2, 3])
    for pose, duration_s in ((away, 6.0), (home, 8.0)):
        begin = loop.pose()
        for step in range(round(duration_s * 50)):
            part = min(step / (duration_s * 25), 1.0)
            goal = pose.copy()
            goal[:3, 3] = begin[:3, 3] + part * (pose[:3, 3] - begin[:3, 3])
            loop.target(goal)
            loop.run(0.02)
    assert min(step.singular_values[-1] for step in loop.steps) < 0.02, (
        "a singularity must be reached for this test to be valid"
    )
    assert any("singularity" in step.status.reason for step in loop.steps)
    assert np.abs(loop.pose()[:3, 3] - home[:3, 3]).max() < 1e-3, "the arm has returned"


@pytest.mark.parametrize(("state_rate_hz", "ticks"), [(1000.0, 500), (800.0, 500), (500.0, 500), (300.0, 300)])
def test_rate_hz_is_the_highest_rate(panda: Robot, state_rate_hz: float, ticks: int) -> None:
    loop = Loop(panda, READY["panda"])
    loop.period_ns = round(NS / state_rate_hz)
    loop.run(1.0)
    assert len(loop.steps) == pytest.approx(ticks, abs=3)


def test_joint_states_that_are_too_slow_stop_the_arm_with_the_reason(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.period_ns = round(NS / 100)
    loop.run(2.0)
    assert loop.mode() is Mode.STOPPED
    assert "slower than 150 Hz" in loop.controller.status.reason
    assert not loop.steps[-1].joint_velocity.any()
    loop.period_ns = round(NS / 500)
    loop.run(3.0)
    assert loop.mode() is Mode.HOLDING


def test_the_same_calls_give_the_same_bits(panda: Robot) -> None:
    runs = []
    for robot in (panda, make_robot("panda")):
        loop = loop_of(robot)
        loop.follow(figure_of_eight(loop.pose()).pose, 1.0, 73.0)
        runs.append(np.array([step.joint_velocity for step in loop.steps]).tobytes())
    assert runs[0] == runs[1]


def test_a_target_in_a_frame_of_the_arm_is_placed_where_that_frame_is(panda: Robot) -> None:
    loop = loop_of(panda)
    in_flange = se3.exp(np.array([0.03, 0.0, 0.02, 0.0, 0.1, 0.0]))
    goal = panda.frame_pose(loop.position, "panda_link8") @ in_flange
    quaternion = se3.quaternion_from_rotation(in_flange[:3, :3])
    sample = PoseSample(loop.now.ros_ns, "panda_link8", in_flange[:3, 3], quaternion)
    loop.controller.on_target_pose(sample, loop.now)
    loop.run(0.4)
    assert loop.steps[-1].status.mode is Mode.TRACKING
    loop.run(4.0)
    assert np.abs(loop.pose() - goal).max() < 1e-5


def test_stamps_of_another_clock_are_detected_and_the_time_of_arrival_is_used(panda: Robot) -> None:
    loop = loop_of(panda)
    pose = loop.pose()
    pose[1, 3] += 0.05
    for _ in range(100):
        loop.target(pose, stamp_ns=123 * NS)
        loop.run(0.02)
    assert "target stamps disagree with this clock" in loop.controller.status.reason
    assert np.abs(loop.pose()[:3, 3] - pose[:3, 3]).max() < 1e-4


def test_limits_that_do_not_fit_the_robot_are_refused(panda: Robot) -> None:
    controller = Controller(panda, Settings())
    changed = controller.settings.with_values({"limits.velocity": (1.0, 2.0)})
    with pytest.raises(SettingsError, match=r"limits.velocity has 2 values; expected 1 or 7, in the order panda"):
        controller.apply(changed)
    assert controller.settings == Settings()


def test_a_prefix_is_prepended_to_the_joint_names() -> None:
    robot = catalogue.robot_from_settings(ArmSettings(robot="ur5", joint_prefix="left_"))
    assert robot.joints[0] == "left_shoulder_pan_joint"
    loop = loop_of(robot)
    loop.run(0.1)
    assert loop.mode() is Mode.HOLDING


# --- paths, twists, integral action -----------------------------------------------------------------------------------


def path_through(loop: Loop, poses: list[Array], step_s: float, begin_s: float = 1.0) -> PathSample:
    stamps = tuple(loop.now.ros_ns + round((begin_s + index * step_s) * NS) for index in range(len(poses)))
    quaternions = np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses])
    positions = np.array([pose[:3, 3] for pose in poses])
    return PathSample((loop.robot.base_frame,) * len(poses), stamps, positions, quaternions)


def test_a_timed_path_is_followed_through_its_poses_and_then_held(panda: Robot) -> None:
    loop = loop_of(panda)
    trajectory = figure_of_eight(loop.pose())
    poses = [trajectory.pose(0.25 * index) for index in range(41)]
    path = path_through(loop, poses, 0.25)
    loop.controller.on_target_path(path, loop.now)
    loop.run(0.5)
    assert loop.controller.status.reason != "no target yet"
    loop.run(11.5)
    assert "target_path has ended" in loop.controller.status.reason
    assert loop.mode() is Mode.HOLDING
    assert np.abs(loop.pose() - poses[-1]).max() < 1e-5
    stamps = np.array(path.stamps_ns) - (loop.now.ros_ns - loop.now.monotonic_ns)
    times = np.array([step.state_time_ns for step in loop.steps])
    for stamp, pose in list(zip(stamps, poses, strict=True))[4:-4:4]:
        step = loop.steps[int(np.argmin(np.abs(times - stamp)))]
        assert np.abs(step.pose_sb[:3, 3] - pose[:3, 3]).max() < 5e-4, "at its poses at their times"
    assert max(step.path_distance for step in loop.steps[600:] if np.isfinite(step.path_distance)) < 1e-5


def test_a_path_slowed_by_limits_keeps_its_shape_and_takes_longer(panda: Robot) -> None:
    loop = loop_of(panda, limits__velocity_fraction=0.06)
    trajectory = figure_of_eight(loop.pose())
    loop.controller.on_target_path(path_through(loop, [trajectory.pose(0.25 * i) for i in range(41)], 0.25), loop.now)
    loop.run(40.0)
    assert "target_path has ended" in loop.controller.status.reason
    under_way = [step for step in loop.steps if 0.0 < step.progress < 1.0]
    duration_s = (under_way[-1].now.monotonic_ns - under_way[0].now.monotonic_ns) / NS
    assert duration_s > 10.5, "the stamps of the path span 10 s"
    distances = [step.path_distance for step in loop.steps if np.isfinite(step.path_distance)]
    assert max(distances) < 2e-4


def test_jogging_follows_the_twist_and_ends_when_no_twist_arrives(panda: Robot) -> None:
    loop = loop_of(panda)
    begin = loop.pose()
    turn = TwistSample(0, "panda_hand_tcp", np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5]))

    def jog() -> None:
        loop.controller.on_target_twist(turn, loop.now)

    loop.run(3.0, jog)
    assert loop.controller.status.reason == "jogging by target_twist"
    loop.run(2.0)
    assert loop.mode() is Mode.HOLDING
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-6
    turned = se3.log(se3.inverse(begin) @ loop.pose())
    assert turned[5] > 1.2
    assert max(float(np.linalg.norm(s.pose_sb[:3, 3] - begin[:3, 3])) for s in loop.steps) < 1e-4, (
        "the tool point stays"
    )


def test_a_path_is_refused_while_the_arm_is_paused(panda: Robot) -> None:
    loop = loop_of(panda)
    path = path_through(loop, [loop.pose(), loop.pose()], 1.0)
    loop.controller.pause(loop.now)
    loop.run(0.1)
    with pytest.raises(TargetRefused, match="the arm is paused"):
        loop.controller.on_target_path(path, loop.now)


def test_a_path_continues_when_the_robot_follows_again(panda: Robot) -> None:
    """No subscriber for some time: the path is paused, and completed later without a part missing."""
    loop = loop_of(panda)
    trajectory = figure_of_eight(loop.pose())
    loop.controller.on_target_path(path_through(loop, [trajectory.pose(0.5 * i) for i in range(21)], 0.5), loop.now)
    loop.run(5.0)
    before = loop.steps[-1].progress
    loop.controller.on_listeners(0, loop.now)
    loop.run(3.0)
    loop.controller.on_listeners(1, loop.now)
    loop.run(0.2)
    assert loop.mode() is Mode.TRACKING
    assert loop.steps[-1].progress == pytest.approx(before, abs=0.1)
    loop.run(12.0)
    assert "target_path has ended" in loop.controller.status.reason
    rate = np.abs(np.diff([step.joint_velocity for step in loop.steps], axis=0)).max() * NS / loop.period_ns
    assert rate <= 10.0 * (1 + 1e-9)


def test_integral_action_removes_the_error_of_a_biased_arm(panda: Robot) -> None:
    """An arm with constant drift: proportional feedback leaves a steady-state error, integral action none."""
    left = []
    for gain in (0.0, 10.0):
        loop = loop_of(panda, integral_gain=(gain, gain), follow__enabled=False)
        drift = 0.02 * np.array([1.0, -1.0, 0.5, 0.3, 0.0, 0.2, 0.0])
        loop.target(loop.pose())
        for _ in range(2500):
            step = loop.tick()
            assert step is not None
            loop.arm.command(step.joint_velocity + drift, loop.time_ns)
        left.append(float(np.linalg.norm(loop.steps[-1].error_b)))
    assert left[0] > 1e-3
    assert left[1] < 0.05 * left[0]
