"""Joint states that are no measurement: ignored one by one, zeros when they last, with the name of the joint.

Each test drives a moving arm, so that a wrong measurement that is used would swing it.
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.control.joint_states import CONTRADICTION
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Level, Mode, Step
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def moving_loop(robot: Robot, **values: object) -> Loop:
    """A loop in the middle of a figure of eight."""
    settings = Settings().with_values({name.replace("__", "."): value for name, value in values.items()})
    loop = Loop(robot, READY["panda" if robot.n == 7 else "ur5"], settings)
    loop.run(0.05)
    loop.follow(figure_of_eight(loop.pose()).pose, 3.0, 100.0)
    assert np.abs(loop.steps[-1].joint_velocity).max() > 0.05
    return loop


def send(loop: Loop, position: Array, names: tuple[str, ...] | None = None) -> Step | None:
    """Sends one joint state at the present time, and the command to the arm."""
    sample = JointSample(loop.now.ros_ns, names or loop.robot.joints, np.asarray(position))
    return loop.take(loop.controller.on_joint_state(sample, loop.now))


def shifted(loop: Loop, joint: int, by: float) -> Array:
    position = loop.position
    position[joint] = position[joint] + by
    return position


def send_until_stopped(loop: Loop, position: Array, names: tuple[str, ...] | None = None) -> float:
    """Sends it each period; returns the time until zeros were commanded, s."""
    begin_ns = loop.time_ns
    while loop.steps[-1].joint_velocity.any():
        loop.time_ns += loop.period_ns
        send(loop, position, names)
        loop.take(loop.controller.on_clock(loop.now))
        assert loop.time_ns < begin_ns + NS
    return (loop.time_ns - begin_ns) / NS


@pytest.mark.parametrize("by", [0.3, 3.0, -3.0, 1e6, 1e308])
def test_one_outlier_makes_no_step_and_is_named(panda: Robot, by: float) -> None:
    loop = moving_loop(panda)
    steps, before = len(loop.steps), loop.steps[-1].joint_velocity
    loop.time_ns += loop.period_ns
    assert send(loop, shifted(loop, 1, by)) is None
    assert len(loop.steps) == steps
    loop.run(0.004)
    assert np.abs(loop.steps[-1].joint_velocity - before).max() < 10.0 * 0.007
    assert loop.controller.status.level.value == Level.WARN.value
    assert "joint state ignored" in loop.controller.status.reason
    assert "panda_joint2" in loop.controller.status.reason
    loop.run(1.0)
    assert loop.controller.status.level is Level.OK
    assert loop.mode() in (Mode.HOLDING, Mode.TRACKING)


@pytest.mark.parametrize(("by", "reason"), [(1.0, "jumped by 1, "), (1e308, "far outside its limits"), (-9.0, "far")])
def test_outliers_that_last_end_in_zeros_with_their_reason(panda: Robot, by: float, reason: str) -> None:
    loop = moving_loop(panda)
    assert send_until_stopped(loop, shifted(loop, 1, by)) <= loop.settings.state.timeout_s + 0.01
    status = loop.controller.status
    assert (status.mode, status.level) == (Mode.STOPPED, Level.ERROR)
    assert reason in status.reason
    assert "panda_joint2" in status.reason


@pytest.mark.parametrize(("by", "timeout_s"), [(0.25, 0.1), (0.8, 0.4), (1.2, 0.5)])
def test_a_jump_does_not_become_possible_with_the_time_since_it(panda: Robot, by: float, timeout_s: float) -> None:
    """Within the time-out a joint could have moved that far, but the positions in between contradict that."""
    loop = moving_loop(panda, state__timeout_s=timeout_s)
    steps = len(loop.steps)
    assert send_until_stopped(loop, shifted(loop, 1, by)) <= timeout_s + 0.01
    assert len(loop.steps) == steps + 1, "no position after the jump was used"
    assert loop.mode() is Mode.STOPPED
    assert "panda_joint2" in loop.controller.status.reason
    assert "jumped" in loop.controller.status.reason


def test_positions_that_no_arm_has_are_never_accepted(panda: Robot) -> None:
    loop = moving_loop(panda)
    far = shifted(loop, 1, 1e6)
    send_until_stopped(loop, far)
    begun = len(loop.steps)
    for _ in range(500):
        loop.time_ns += loop.period_ns
        send(loop, far)
        loop.take(loop.controller.on_clock(loop.now))
    assert len(loop.steps) == begun
    assert "far outside" in loop.controller.status.reason


def test_an_arm_that_starts_far_outside_says_why_it_waits(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"])
    far = np.array(READY["panda"])
    far[3] = 40.0
    for _ in range(200):
        loop.time_ns += loop.period_ns
        assert send(loop, far) is None
        assert loop.controller.on_clock(loop.now) is None
    assert loop.controller.status.level is Level.ERROR
    assert "panda_joint4" in loop.controller.status.reason


def test_an_arm_that_was_moved_during_a_silence_is_used_again(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.time_ns += 120_000_000
    loop.take(loop.controller.on_clock(loop.now))
    assert loop.mode() is Mode.STOPPED
    moved = loop.position + 0.9
    moved[3] = -1.3
    loop.arm = SimulatedArm(moved, panda.limits, loop.time_ns)
    loop.run(0.05)
    assert loop.mode() is Mode.STOPPED
    loop.run(0.1)
    assert loop.mode() is Mode.HOLDING
    loop.run(0.5)
    assert np.abs(loop.position - moved).max() < 1e-6


def test_a_jump_that_lasts_stops_the_moving_arm_before_it_is_used(panda: Robot) -> None:
    """Without calls of the clock the new position becomes valid while the arm moves."""
    loop = moving_loop(panda)
    position = shifted(loop, 1, 0.5)
    for _ in range(60):
        loop.time_ns += loop.period_ns
        step = send(loop, position)
        if step is not None:
            break
    assert step is not None
    assert not step.joint_velocity.any()
    assert step.status.mode is Mode.STOPPED
    assert "panda_joint2" in step.status.reason
    assert "jumped" in step.status.reason


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 100.0])
def test_a_second_source_of_joint_states_stops_the_arm(rate_hz: float) -> None:
    loop = moving_loop(make_robot("ur5"))
    begin_ns, sent, most = loop.time_ns, 0, 0.0
    commands = len(loop.steps)
    while loop.time_ns < begin_ns + 2 * NS:
        loop.tick()
        if (loop.time_ns - begin_ns) / NS >= sent / rate_hz:
            send(loop, np.zeros(6))
            sent += 1
        if sent > 2:
            most = max(most, np.abs(loop.steps[-1].joint_velocity).max())
    assert most == 0.0
    velocities = np.array([step.joint_velocity for step in loop.steps[commands - 1 :]])
    changes = np.abs(np.diff(velocities, axis=0)).max(axis=1)
    assert (changes[velocities[1:].any(axis=1)] < 10.0 * 0.005).all(), "only the stop exceeds the acceleration limit"
    status = loop.controller.status
    assert (status.mode, status.level) == (Mode.STOPPED, Level.ERROR)
    for part in ("contradict", "shoulder_", "jumped", "second publisher"):
        assert part in status.reason
    assert CONTRADICTION in status.reason
    loop.run(1.5)
    assert loop.mode() is Mode.HOLDING, "continues when the second source is gone"


def test_a_joint_that_is_named_twice_with_different_positions(panda: Robot) -> None:
    loop = moving_loop(panda)
    names = (*panda.joints, "panda_joint4")
    before = loop.position
    assert send_until_stopped(loop, np.array([*before, 0.0]), names) <= loop.settings.state.timeout_s + 0.01
    assert "'panda_joint4' stands twice" in loop.controller.status.reason
    assert loop.controller.status.level is Level.ERROR


def test_a_joint_that_is_named_twice_with_one_position_is_measured(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.time_ns += loop.period_ns
    position = loop.position
    assert send(loop, np.array([*position, position[3]]), (*panda.joints, "panda_joint4")) is not None


@pytest.mark.parametrize("count", [0, 1])
def test_a_message_of_other_joints_is_not_judged(panda: Robot, count: int) -> None:
    """Velocities alone, or fewer positions than names: it is not about this arm."""
    loop = moving_loop(panda)
    for _ in range(50):
        loop.tick()
        assert send(loop, np.zeros(count), ("wheel_left", "wheel_right")) is None
        assert loop.steps[-1].joint_velocity.any()
    assert "joint state" not in loop.controller.status.reason
    assert loop.controller.states_refused == 0


def test_a_message_with_velocities_only_is_a_warning(panda: Robot) -> None:
    loop = moving_loop(panda)
    for _ in range(50):
        loop.tick()
        assert send(loop, np.zeros(0), panda.joints[:2]) is None
        assert loop.steps[-1].joint_velocity.any()
    assert loop.controller.status.level is Level.WARN
    assert "without positions for panda_joint1, panda_joint2" in loop.controller.status.reason


def test_a_joint_that_goes_missing_is_named(panda: Robot) -> None:
    loop = moving_loop(panda)
    stop_s = send_until_stopped(loop, loop.position[:6], panda.joints[:6])
    assert stop_s <= loop.settings.state.timeout_s + 0.01
    assert loop.controller.status.reason == "no joint state for 0.1 s of panda_joint7"


def test_a_continuous_joint_may_turn_over_its_range() -> None:
    robot = make_robot("kinova")
    loop = Loop(robot, np.array([3.1, 3.0, 1.5, 0.0, 2.0, 0.0]))
    loop.run(0.1)
    position = loop.position
    position[0] = position[0] - 2.0 * np.pi
    loop.time_ns += loop.period_ns
    assert send(loop, position) is not None
    assert loop.controller.status.level is Level.OK
