"""Bounds at which joints near their position limits can still stop along the direction of the twist."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from ik_node.differential_ik.viable_bounds import braking_ratio, viable_bounds
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, joint_bounds

TICK_S = 0.002
NO_NULL_SPACE = np.zeros((0, 3))


def limits(acceleration: tuple[float, ...]) -> MotionLimits:
    """Joints from -1 to 1 rad with 2 rad/s."""
    n = len(acceleration)
    return MotionLimits(np.full(n, -1.0), np.ones(n), np.full(n, 2.0), np.array(acceleration), TICK_S, 0.1)


def bounds_of(
    q: Array, speed: Array, limit: MotionLimits, null: Array = NO_NULL_SPACE
) -> tuple[JointBounds, JointBounds]:
    """Those of the control step, and the narrower ones, of an arm that moves along its direction."""
    own = joint_bounds(limit, q, speed, TICK_S)
    return own, viable_bounds(own, speed, null, q, speed, limit, TICK_S)


@pytest.mark.parametrize("dimension", [0, 1])
def test_the_ratio_is_the_optimum_of_the_linear_program(dimension: int) -> None:
    rng, attained = np.random.default_rng(dimension), 0
    for _ in range(300):
        n = 6 + dimension
        p, null = rng.normal(size=n), rng.normal(size=(dimension, n))
        previous = rng.uniform(0.2, 0.9) * p + (0.3 * rng.normal() * null[0] if dimension else 0.0)
        change = rng.uniform(0.01, 0.1, n)
        joints, falls = rng.permutation(n)[: rng.integers(1, 4)], rng.uniform(0.01, 0.1, 3)
        falls = falls[: len(joints)]
        found = braking_ratio(p, null, previous - change, previous + change, previous, joints, falls)
        # Unknowns s, w, k; sign(previous) qd + k falls <= |previous|.
        rows = np.column_stack((p, *null))
        signs = np.sign(previous[joints])
        result = linprog(
            [0.0] * (1 + dimension) + [-1.0],
            A_ub=np.vstack(
                (
                    np.column_stack((signs[:, None] * rows[joints], falls)),
                    np.column_stack((rows, np.zeros(n))),
                    np.column_stack((-rows, np.zeros(n))),
                )
            ),
            b_ub=np.concatenate((np.abs(previous[joints]), previous + change, change - previous)),
            bounds=[(0.0, 1.0)] + [(None, None)] * dimension + [(0.0, None)],
        )
        assert result.success
        assert found == pytest.approx(result.x[-1], abs=1e-6)
        attained += found > 0.0
    assert attained > 150


def test_joints_far_from_their_limits_keep_the_bounds_of_the_control_step() -> None:
    own, narrow = bounds_of(np.zeros(3), np.array([0.5, -0.4, 0.3]), limits((10.0, 10.0, 10.0)))
    for before, after in zip(own, narrow, strict=True):
        assert before.tobytes() == after.tobytes()


def test_a_joint_brakes_earlier_if_another_one_has_to_brake_more_slowly() -> None:
    """Along (1, 0.5, 0) the second joint permits a third of the deceleration of the first one."""
    q, speed, limit = np.array([0.85, 0.0, 0.0]), np.array([1.0, 0.5, 0.0]), limits((10.0, 5.0 / 3.0, 10.0))
    own, narrow = bounds_of(q, speed, limit)
    assert own.hi[0] > 1.0
    assert narrow.hi[0] < 1.0
    assert narrow.hi[0] >= 1.0 - TICK_S * 10.0 / 3.0, "the second joint can follow"
    assert narrow.position_hi[0] == narrow.hi[0], "the status names a position limit"


def test_the_null_space_takes_the_place_of_the_slow_joint() -> None:
    """The same arm, whose third joint moves the tool as the first one does."""
    q, speed, limit = np.array([0.85, 0.0, 0.0]), np.array([1.0, 0.5, 0.0]), limits((10.0, 5.0 / 3.0, 10.0))
    own, narrow = bounds_of(q, speed, limit, np.array([[1.0, 0.0, -1.0]]) / np.sqrt(2.0))
    assert own.hi[0] > 1.0
    assert narrow.hi[0] > 1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("slow", [3.0, 10.0])
def test_an_arm_stops_at_a_limit_without_leaving_its_direction(sign: float, slow: float) -> None:
    direction, limit = sign * np.array([1.0, 0.5, -0.7]), limits((10.0, slow, 10.0))
    q, scale = np.zeros(3), 0.0
    for _ in range(3000):
        speed = scale * direction
        _, box = bounds_of(q, speed, limit)
        least, most = (
            np.minimum(box.lo / direction, box.hi / direction),
            np.maximum(box.lo / direction, box.hi / direction),
        )
        assert least.max() <= most.min() + 1e-9, "a multiple of the direction is within the bounds"
        scale = min(1.0, float(most.min()))
        q = q + TICK_S * scale * direction
    assert 0.999 < sign * q[0] <= 1.0
