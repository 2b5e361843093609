"""Arms with delay and lag: the predictor against the simulator, and the tracking error with and without prediction.

The simulator is independent of the predictor, which receives commands only. Closed loops run the real controller.
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.control.smith_predictor import SmithPredictor, SmithPredictorSnapshot
from ik_node.interfaces.clock import NS
from ik_node.interfaces.snapshot import capture, restore
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.kinematics import JointLimits
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.settings.groups import ControlSettings, Settings

LATE = ArmModel(lag_s=0.02, delay_s=0.002, encoder_noise=2e-5)
WIDE = JointLimits(np.full(3, -1e3), np.full(3, 1e3), np.full(3, 1e3))


@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.02, 0.002), (0.02, 0.0), (0.0, 0.013), (0.1, 0.05), (0.0, 0.0)])
def test_the_predicted_offset_is_the_motion_after_a_stop_command(lag_s: float, delay_s: float) -> None:
    """Random commands at uneven times, then zero: the simulated arm comes to rest at the prediction, to rounding."""
    rng = np.random.default_rng(1)
    arm = SimulatedArm(np.zeros(3), WIDE, 0, ArmModel(lag_s=lag_s, delay_s=delay_s))
    late = SmithPredictor(3, ControlSettings(arm_lag_s=lag_s, arm_delay_s=delay_s))
    time_ns = 0
    for _ in range(200):
        time_ns += int(rng.integers(1, 8_000_000))
        command = rng.normal(size=3)
        arm.command(command, time_ns)
        late.command(command, time_ns)
    time_ns += 3_000_000
    offset, position = late.predicted_offset(time_ns).copy(), arm.advance(time_ns)[0]
    arm.command(np.zeros(3), time_ns)
    rest = arm.advance(time_ns + 10 * NS)[0]
    assert rest - position == pytest.approx(offset, abs=1e-9)
    assert bool(offset.any()) == (lag_s + delay_s > 0.0)
    late.command(np.zeros(3), time_ns)
    assert np.abs(late.predicted_offset(time_ns + 10 * NS)).max() < 1e-9, "the offset is zero at rest"


def test_a_snapshot_is_restored_in_another_object() -> None:
    rng, late = np.random.default_rng(2), SmithPredictor(3, ControlSettings(arm_lag_s=0.03, arm_delay_s=0.01))
    for tick in range(50):
        late.command(rng.normal(size=3), tick * 2_000_000)
    other = SmithPredictor(3, ControlSettings(arm_lag_s=0.03, arm_delay_s=0.01))
    restore(other, capture(late, SmithPredictorSnapshot))
    assert (other.predicted_offset(200_000_000) == late.predicted_offset(200_000_000)).all()


def circle(home: Array, time_s: float) -> Array:
    """Circle of 0.24 m diameter at 0.15 m/s, from rest."""
    angle = 1.25 * (time_s - 0.5 * np.tanh(2.0 * time_s))
    around = np.array([0.12 * np.sin(angle), 0.12 * (1.0 - np.cos(angle)), 0.0, 0.0, 0.0, 0.0])
    return np.asarray(home @ se3.exp(around))


def errors(**values: float) -> tuple[Array, Loop]:
    loop = Loop(make_robot("panda"), READY["panda"], Settings().with_values(values), LATE)
    loop.run(0.05)
    home = loop.pose()
    loop.follow(lambda time_s: circle(home, time_s), 5.0, 100.0)
    return np.array([np.linalg.norm(step.error_b[:3]) for step in loop.steps])[1000:], loop


def test_prediction_reduces_the_tracking_error_of_an_arm_with_lag() -> None:
    """At the default gains, to less than a fifth; the changes of the command are less than twice as large."""
    without, before = errors()
    predicted, after = errors(arm_lag_s=0.02, arm_delay_s=0.002)
    assert np.sqrt((predicted**2).mean()) < 0.2 * np.sqrt((without**2).mean())
    changes = [np.abs(np.diff([s.joint_velocity for s in loop.steps[1000:]], axis=0)).max() for loop in (before, after)]
    assert changes[1] < 2.0 * changes[0]


def test_an_arm_with_lag_that_reverses_often_counts_as_following() -> None:
    """The end points of the short window differ much from the commanded ones; the motion between them does not."""
    loop = Loop(make_robot("panda"), READY["panda"], None, LATE)
    loop.run(0.05)
    home = loop.pose()

    def to_and_fro(time_s: float) -> Array:
        pose: Array = home.copy()
        pose[1, 3] += 0.03 * np.sin(2.0 * np.pi * 1.7 * time_s)
        pose[2, 3] += 0.02 * np.sin(2.0 * np.pi * 2.3 * time_s)
        return pose

    loop.follow(to_and_fro, 6.0, 60.0)
    assert {step.status.mode for step in loop.steps[10:]} <= {Mode.TRACKING, Mode.HOLDING}


@pytest.mark.parametrize("ratio", [0.0, 0.3])
def test_a_robot_that_does_not_follow_a_reversing_motion_is_detected(ratio: float) -> None:
    """Standing still, or at 30 % of the speed: stopped within a second, with the reason."""
    loop = Loop(make_robot("panda"), READY["panda"])
    loop.run(0.05)
    home = loop.pose()
    arm, command = loop.arm, loop.arm.command
    arm.command = lambda velocity, time_ns: command(ratio * velocity, time_ns)  # type: ignore[method-assign]

    def to_and_fro(time_s: float) -> Array:
        pose: Array = home.copy()
        pose[1, 3] += 0.05 * np.sin(2.0 * np.pi * 0.7 * time_s)
        return pose

    loop.follow(to_and_fro, 1.0, 60.0)
    reasons = [step.status.reason for step in loop.steps if step.status.mode is Mode.STOPPED]
    assert reasons
    assert ("does not move" if ratio == 0.0 else "moves less than commanded") in reasons[-1]
