"""Components of streamed targets: sampling clock, predictors and quaternions, each against an independent reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from ik_node.math import quaternion as quat
from ik_node.math.quaternion import IDENTITY, Vector
from ik_node.math.types import Array
from ik_node.targets.stream.predictors import PREDICTORS, PredictorBank, new_bank, updated_bank, variance_ratio
from ik_node.targets.stream.sampling_clock import SamplingClock, reset, updated


def triple(values: NDArray[Any]) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def test_quaternions_do_what_matrices_do() -> None:
    """Against Pinocchio's exponential and logarithm, from tiny rotations to nearly pi."""
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-12, 1e-6, 1e-4, 0.1, 1.0, 3.0, np.pi - 1e-6):
        axis = rng.normal(size=3)
        turn = size * axis / np.linalg.norm(axis)
        matrix = pin.exp3(turn)
        quaternion = quat.from_rotation_vector(triple(turn))
        np.testing.assert_allclose(quat.to_matrix(quaternion), matrix, atol=1e-15)
        np.testing.assert_allclose(quat.to_rotation_vector(quaternion), turn, atol=1e-9 if size > 3.1 else 1e-15)
        np.testing.assert_allclose(quat.to_matrix(quat.from_matrix(matrix)), matrix, atol=1e-15)
        v = rng.normal(size=3)
        np.testing.assert_allclose(quat.rotate_inverse(quaternion, triple(v)), matrix.T @ v, atol=1e-14)
        other = pin.exp3(rng.normal(size=3))
        product = quat.multiply(quaternion, quat.from_matrix(other))
        np.testing.assert_allclose(quat.to_matrix(product), matrix @ other, atol=1e-14)


@pytest.mark.parametrize("turn", [(np.pi, 0.0, 0.0), (0.0, np.pi, 0.0), (0.0, 0.0, np.pi)])
def test_half_turns_are_read_from_matrices(turn: Vector) -> None:
    """The trace is -1 there: each branch of the conversion is tested."""
    matrix = pin.exp3(np.array(turn))
    np.testing.assert_allclose(quat.to_matrix(quat.from_matrix(matrix)), matrix, atol=1e-15)


def rhythm(times_s: Array) -> list[SamplingClock]:
    steps = [reset(SamplingClock(), round(float(times_s[0]) * 1e9))]
    for time_s in times_s[1:].tolist():
        steps.append(updated(steps[-1], round(time_s * 1e9)))
    return steps


def test_a_regular_stream_has_its_own_rhythm() -> None:
    """Without jitter no stamp is corrected, with or without lost samples."""
    times = np.delete(np.arange(0.0, 4.0, 0.025), [30, 31, 60, 99])
    for cadence in rhythm(times)[2:]:
        assert cadence.period_s == pytest.approx(0.025, rel=1e-6)
        assert abs(cadence.offset_s) < 1e-8
        assert cadence.delay_s < 1e-7


@pytest.mark.parametrize("seed", range(5))
def test_jitter_is_taken_off(seed: int) -> None:
    """Delays spread over 0.4 periods, 3 % lost: the corrected times, less the mean delay, are near the true ones."""
    rng = np.random.default_rng(seed)
    sent = np.arange(0.0, 20.0, 0.05)
    sent = sent[rng.uniform(size=len(sent)) > 0.03]
    arrived = sent + rng.uniform(0.0, 0.02, len(sent))
    steps = rhythm(arrived)
    regular = arrived + [cadence.offset_s - cadence.delay_s for cadence in steps]
    assert np.std((regular - sent)[40:]) < 0.5 * np.std((arrived - sent)[40:])
    assert abs(np.mean((regular - sent)[40:])) < 0.002
    assert all(cadence.period_s == pytest.approx(0.05, rel=0.06) for cadence in steps[15:])


def test_a_new_rhythm_is_learnt() -> None:
    """From 20 to 50 Hz, and after a pause of a second."""
    times = np.concatenate(
        (np.arange(0.0, 2.0, 0.05), 2.0 + np.arange(0.0, 2.0, 0.02), 5.0 + np.arange(0.0, 1.0, 0.02))
    )
    steps = rhythm(times)
    for index in (40 + 30, len(times) - 1):
        assert steps[index].period_s == pytest.approx(0.02, rel=5e-3)
        assert abs(steps[index].offset_s) < 5e-4


def fed(times_s: NDArray[Any], positions: NDArray[Any], turns: NDArray[Any]) -> PredictorBank:
    bank = new_bank(triple(positions[0]), quat.from_rotation_vector(triple(turns[0])), None, False)
    for dt, position, turn in zip(np.diff(times_s), positions[1:], turns[1:], strict=True):
        bank = updated_bank(bank, triple(position), quat.from_rotation_vector(triple(turn)), (dt, dt), 0.05)
    return bank


@pytest.mark.parametrize("index", range(len(PREDICTORS)))
def test_each_predictor_is_a_polynomial_fit_that_forgets(index: int) -> None:
    """Against numpy's least squares with weights fade^(2 k): the recursion converges to that fit."""
    degree, fade = PREDICTORS[index]
    rng = np.random.default_rng(index)
    times = 0.05 * np.arange(300)
    positions = np.outer(0.1 * np.sin(times), (1.0, 0.5, -0.3)) + 1e-3 * rng.normal(size=(300, 3))
    now = fed(times, positions, np.zeros((300, 3))).now
    ages = times - times[-1]
    # numpy applies weights to residuals, not to their squares
    weights = np.maximum(fade, 1e-9) ** (0.5 * np.arange(299, -1, -1.0))
    expected = np.polynomial.polynomial.polyfit(ages, positions, degree, w=weights) if fade > 0.0 else positions[-1:]
    np.testing.assert_allclose(now.value[index, :3], expected[0], atol=1e-9)
    if degree > 0:
        np.testing.assert_allclose(now.slope[index, :3], expected[1], atol=1e-7)
    if degree > 1:
        np.testing.assert_allclose(now.bend[index, :3], 2.0 * expected[2], atol=1e-6)


def test_the_noise_of_predictions_is_the_one_of_their_fit() -> None:
    """Variance ratio against the weights of numpy's fit, determined sample by sample."""
    ages = np.arange(-150.0, 1.0)
    for degree, fade in PREDICTORS[1:]:
        powers = np.vander(ages, degree + 1, increasing=True)
        weights = fade ** (-ages)
        gains = np.linalg.solve(powers.T @ (weights[:, None] * powers), (weights[:, None] * powers).T)
        assert variance_ratio(degree, fade) == pytest.approx(float(np.sum(gains.sum(axis=0) ** 2)), rel=1e-6)


def test_parabolas_are_foretold_from_the_fourth_sample_on_at_any_intervals() -> None:
    """Exact for constant acceleration, also while the memory still grows and when samples are lost."""
    times = np.array((0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.35, 0.5))
    positions = np.outer(times**2, (1.0, -2.0, 0.5)) + np.outer(times, (0.3, 0.0, 0.1))
    parabolas = [index for index, (degree, _) in enumerate(PREDICTORS) if degree == 2]
    for count in range(3, len(times) + 1):
        now = fed(times[:count], positions[:count], np.zeros((count, 3))).now
        for index in parabolas:
            np.testing.assert_allclose(now.value[index, :3], positions[count - 1], atol=1e-12)
            np.testing.assert_allclose(
                now.slope[index, :3], 2 * times[count - 1] * np.array((1, -2, 0.5)) + (0.3, 0, 0.1), atol=1e-10
            )


def test_turning_at_constant_rate_is_foretold() -> None:
    """The rotation vector is relative to the newest sample; a constant rate remains constant for any rotation."""
    times = 0.05 * np.arange(100)
    turns = np.outer(times, (0.4, 1.0, -0.2))
    now = fed(times, np.zeros((100, 3)), turns).now
    for index, (degree, _) in enumerate(PREDICTORS):
        if degree > 0:
            np.testing.assert_allclose(now.slope[index, 3:], (0.4, 1.0, -0.2), atol=1e-9)
            np.testing.assert_allclose(now.value[index, 3:], 0.0, atol=1e-9)


def test_noise_makes_a_target_unpredictable_and_rest_does_not() -> None:
    """The quantity that determines the latency: a fraction of the motion between samples."""
    rng = np.random.default_rng(0)
    times = 0.05 * np.arange(200)
    line, still = np.outer(times, (0.1, 0.0, 0.0)), np.zeros((200, 3))
    noise = rng.normal(size=(200, 3))
    assert fed(times, line, still).unpredictability == pytest.approx((0.0, 0.0), abs=1e-3)
    assert fed(times, still, still).unpredictability == pytest.approx((0.0, 0.0), abs=1e-3)
    assert fed(times, line + 1e-3 * noise, still).unpredictability[0] > 0.1
    assert fed(times, line, 5e-3 * noise).unpredictability[1] > 0.3


def test_a_jump_forgets_the_motion_but_not_who_foretold_it() -> None:
    """After a jump the target counts as at rest until two samples show a motion."""
    times = 0.05 * np.arange(50)
    before = fed(times, np.outer(times, (0.1, 0.0, 0.0)), np.zeros((50, 3)))
    after = new_bank((1.0, 0.0, 0.0), IDENTITY, before, False)
    position, velocity, *_ = after.curve()
    assert position == pytest.approx((1.0, 0.0, 0.0))
    assert velocity == pytest.approx((0.0, 0.0, 0.0))
    assert np.array_equal(after.errors, before.errors)
