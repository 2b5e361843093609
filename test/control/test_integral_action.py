"""Integral action: no steady-state error under a constant disturbance; no windup while the arm cannot follow.

The plant is the error itself: e' = disturbance - K_p e - K_i z, stepped at 500 Hz. Kinematics and limits are tested
elsewhere.
"""

from __future__ import annotations

import numpy as np
import pytest

from ik_node.control.integral_action import MAX_INTEGRAL_TWIST, IntegralAction, IntegralSnapshot
from ik_node.interfaces.snapshot import capture, restore
from ik_node.math.types import Array
from ik_node.settings.groups import ControlSettings

STEP_S = 0.002
CONTROL = ControlSettings(integral_gain=(20.0, 20.0))
DISTURBANCE = np.array([0.004, -0.002, 0.001, 0.01, 0.02, -0.01])


def run(control: ControlSettings, duration_s: float, frozen: bool = False, start: Array | None = None) -> Array:
    """The error over time, (ticks, 6)."""
    action, error, found = IntegralAction(), np.zeros(6) if start is None else start, []
    gains = np.repeat(control.gain, 3)
    for _ in range(round(duration_s / STEP_S)):
        feedback = gains * error + action.twist(error, STEP_S, frozen, control)
        error = error + STEP_S * (DISTURBANCE - feedback)
        found.append(error)
    return np.array(found)


def test_a_constant_disturbance_leaves_no_error() -> None:
    with_it, without = run(CONTROL, 5.0), run(ControlSettings(), 5.0)
    assert np.abs(without[-1] - DISTURBANCE / 10.0).max() < 1e-9
    assert np.abs(with_it[-1]).max() < 1e-8


def test_up_to_a_quarter_of_the_squared_gain_it_does_not_oscillate() -> None:
    """From an initial error, the overshoot is exp(-2) of the initial error, once, due to the integral term."""
    control = ControlSettings(integral_gain=(25.0, 25.0))
    start = np.array([0.01, 0.0, 0.0, 0.0, 0.02, 0.0])
    response = (run(control, 4.0, start=start) - run(control, 4.0))[:, 0] / start[0]
    assert response.min() == pytest.approx(-np.exp(-2.0), abs=0.01)
    assert (np.diff(np.sign(response[np.abs(response) > 1e-6])) != 0).sum() == 1


def test_by_default_there_is_none() -> None:
    action = IntegralAction()
    assert not action.twist(np.ones(6), 1.0, False, ControlSettings()).any()
    assert not action.value.any()


@pytest.mark.parametrize("frozen", [False, True])
def test_z_is_constant_while_frozen(frozen: bool) -> None:
    action = IntegralAction()
    error = np.array([0.01, 0.0, 0.0, 0.0, 0.01, 0.0])
    before = action.twist(error, 0.1, False, CONTROL)
    after = action.twist(error, 0.1, frozen, CONTROL)
    assert np.array_equal(before, after) == frozen


def test_z_is_constant_while_the_feedback_is_saturated_for_each_part_separately() -> None:
    action = IntegralAction()
    far = np.array([0.2, 0.0, 0.0, 0.0, 0.01, 0.0])
    twist = action.twist(far, 0.1, False, CONTROL)
    assert not twist[:3].any()
    assert twist[4] > 0.0


def test_the_integral_twist_is_bounded() -> None:
    action = IntegralAction()
    for _ in range(10_000):
        twist = action.twist(np.array([0.03, 0.04, 0.0, 0.0, 0.0, -0.1]), STEP_S, False, CONTROL)
    assert np.abs(twist[:3] - MAX_INTEGRAL_TWIST[0] * np.array([0.6, 0.8, 0.0])).max() < 1e-12
    assert twist[5] == pytest.approx(-MAX_INTEGRAL_TWIST[1])
    action.reset()
    assert not action.value.any()


def test_a_snapshot_is_restored_in_another_object() -> None:
    one, other = IntegralAction(), IntegralAction()
    one.twist(np.full(6, 0.01), 0.1, False, CONTROL)
    restore(other, capture(one, IntegralSnapshot))
    error = np.full(6, -0.003)
    assert np.array_equal(one.twist(error, 0.1, False, CONTROL), other.twist(error, 0.1, False, CONTROL))
