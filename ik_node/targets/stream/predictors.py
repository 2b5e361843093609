"""Prediction of a streamed target between its samples by several predictors, weighted by their past errors.

Each predictor is a fading-memory polynomial (Morrison, Introduction to Sequential Smoothing and Prediction, 1969) of
degree 0, 1 or 2: recursive least squares with exponentially decreasing weights. Short memories follow, long ones
smooth; which is better depends on the stream and is measured by comparing each sample with its predictions. Each
predictor exists twice, once on the stamps and once on the regular times of ``sampling_clock.py``; the smaller error of
the two selects the time base. Position and orientation are weighted separately.

Orientation is a rotation vector in {s} from the newest sample's orientation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import Quaternion, Vector, conjugate, difference, length, multiply, to_rotation_vector
from ik_node.math.types import Array

PREDICTORS = (
    (0, 0.0),
    (1, 0.2),
    (1, 0.4),
    (1, 0.6),
    (1, 0.8),
    (2, 0.15),
    (2, 0.3),
    (2, 0.45),
    (2, 0.6),
    (2, 0.75),
)
"""Degree and forgetting factor per sample period."""
SHORTEST_HORIZON_S = 0.02
"""Smallest time scale of forgetting and of scoring; the motion cannot use faster predictions."""
SCORE_MEMORY = 0.94
"""Forgetting factor of the scores, per scored sample."""
LATENCY_MEMORY = 0.98
"""Forgetting factor of the predictability; longer, so that the delay of the motion changes seldom."""
SMALL_STEP = np.array((1.5e-3, 5e-3)) ** 2
"""Added to the mean squared step [m2, rad2] to which errors are compared, so that much smaller errors do not count."""
LEARNING = 5
"""Number of scored samples after which predictability is estimated; the first ones depend on the initial state."""
LEARNING_REGULAR = 9
"""The same on the regular times, which must be estimated first."""
SHARPNESS = 12
"""The weight of a predictor is its mean squared error to the power of minus this."""
BENEFIT = 0.75
"""Factor on the mean squared error of the predictor of degree 0: one step out of rest is no motion yet."""
LONG_MEMORY = 0.25
"""The mean squared error of a predictor is increased by this fraction of its forgetting factor: among equally good ones
a short memory follows the next change of the motion sooner."""
PREFERENCE = 0.5
"""The time base changes when the error on the other one is below this fraction of the present one."""
FLOOR = np.array((1e-12, 1e-10))
"""Mean squared errors [m2, rad2] below which predictors count as equally good: a micrometre, 10 microradian."""

_N = len(PREDICTORS)
_DOUBT = np.array([1.0 + LONG_MEMORY * fade if degree > 0 else BENEFIT for degree, fade in PREDICTORS])
_DEGREE = np.array([degree for degree, _ in PREDICTORS] * 2)
_FADE = np.array([fade for _, fade in PREDICTORS] * 2)
_MOVING = (_DEGREE[:_N] > 0) / np.count_nonzero(_DEGREE[:_N])


def variance_ratio(degree: int, fade: float) -> float:
    """Variance of a prediction one period ahead, per variance of the samples (Morrison 1969)."""
    series = ((1.0,), (5.0, 4.0, 1.0), (19.0, 24.0, 16.0, 6.0, 1.0))[degree]
    return (1.0 - fade) / (1.0 + fade) ** (2 * degree + 1) * sum(c * fade**i for i, c in enumerate(series))


_PART_OF_TARGET = np.array([1.0 - 1.0 / (1.0 + variance_ratio(*predictor)) for predictor in PREDICTORS])


class Polynomials(NamedTuple):
    """The polynomials of all predictors about one sample; the arrays are never modified in place."""

    value: Array
    """(2 N, 6): position [m] in {s}, rotation vector [rad]."""
    slope: Array
    bend: Array
    position: Vector
    """Of the sample."""
    orientation: Quaternion
    """Of the sample; origin of the rotation vectors."""
    times: tuple[float, float]
    """Times of the sample on the two time bases [s], from the first sample after the last jump or gap."""


class PredictorBank(NamedTuple):
    """The predictors after the newest sample."""

    now: Polynomials
    scored: Polynomials
    """As they were when they were last compared with a sample."""
    sample_count: int
    """Number of samples since the last jump or gap."""
    errors: Array
    """(2 N, 2): weighted sums of squared errors of position and orientation."""
    weight: float
    """Sum of the weights."""
    long_errors: Array
    """(2 N, 2): as ``errors``, with the longer memory."""
    long_steps: Array
    """(2,): weighted sums of squared steps between scored samples."""
    long_weight: Array
    """(2,): sums of the weights; a sample of a target at rest counts less."""
    long_count: int
    """Number of scored samples in these sums."""
    regular: bool
    """True if the regular times are in use, False for the stamps."""

    @property
    def unpredictability(self) -> tuple[float, float]:
        """RMS error of the best predictor relative to the RMS step, for position and orientation; 0 until estimated.

        The noise of the compared samples is subtracted, as if all error were noise.
        """
        return _unpredictability(self.long_errors, self.long_steps, self.long_weight, self.long_count, self.regular)

    def curve(self) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
        """Position, rotation vector, and their derivatives at the newest sample, weighted over the predictors.

        In the order of :class:`TargetCurve`: position, velocity, acceleration, rotation vector, its two derivatives.
        """
        now = self.now
        return _curve(now.value, now.slope, now.bend, self.errors, self.weight, self.regular)


def new_bank(position: Vector, orientation: Quaternion, earlier: PredictorBank | None, regular: bool) -> PredictorBank:
    """The predictors after the first sample, or the first one after a jump or gap.

    Args:
        position: Position of the sample [m].
        orientation: Orientation of the sample.
        earlier: Predictors before the jump or gap, whose scores are kept; None at the start.
        regular: Initial time base if there is no ``earlier``.
    """
    value = np.zeros((2 * _N, 6))
    value[:, :3] = position
    zero = np.zeros((2 * _N, 6))
    now = Polynomials(value, zero, zero, position, orientation, (0.0, 0.0))
    if earlier is None:
        errors = np.zeros((2 * _N, 2))
        return PredictorBank(now, now, 1, errors, 0.0, errors, np.zeros(2), np.zeros(2), 0, regular)
    return earlier._replace(now=now, scored=now, sample_count=1)


@compiled
def updated_bank(
    bank: PredictorBank, position: Vector, orientation: Quaternion, elapsed_s: tuple[float, float], period_s: float
) -> PredictorBank:
    """The predictors after one more sample, ``elapsed_s`` after the newest by its stamp and by its regular time."""
    before, count = bank.now, bank.sample_count + 1
    horizon_s = max(period_s, SHORTEST_HORIZON_S)
    dt = (max(elapsed_s[0], 1e-4), max(elapsed_s[1], 1e-4))
    turn = to_rotation_vector(multiply(orientation, conjugate(before.orientation)))
    sample = (position[0], position[1], position[2], turn[0], turn[1], turn[2])
    value, slope, bend = np.empty((2 * _N, 6)), np.empty((2 * _N, 6)), np.empty((2 * _N, 6))
    for i in range(2 * _N):
        t = dt[i // _N]
        g, h, k = _gains(_DEGREE[i], _FADE[i], t, horizon_s, float(count))
        for j in range(6):
            expected = _extrapolated(before, i, j, t)
            error = sample[j] - expected
            value[i, j] = expected + g * error
            if j >= 3:
                value[i, j] -= turn[j - 3]
            slope[i, j] = before.slope[i, j] + t * before.bend[i, j] + h * error
            bend[i, j] = before.bend[i, j] + k * error
    times = (before.times[0] + dt[0], before.times[1] + dt[1])
    now = Polynomials(value, slope, bend, position, orientation, times)
    if count > 2 and times[0] - bank.scored.times[0] >= 0.75 * horizon_s:
        return _scored(bank, now, count)
    return PredictorBank(
        now,
        bank.scored if count > 2 else now,  # a single sample predicts nothing
        count,
        bank.errors,
        bank.weight,
        bank.long_errors,
        bank.long_steps,
        bank.long_weight,
        bank.long_count,
        bank.regular,
    )


@compiled
def _extrapolated(polynomials: Polynomials, predictor: int, axis: int, t: float) -> float:
    value, slope, bend = polynomials.value, polynomials.slope, polynomials.bend
    return float(value[predictor, axis] + t * (slope[predictor, axis] + 0.5 * (t * bend[predictor, axis])))


@compiled
def _gains(degree: int, fade_per_period: float, dt: float, horizon_s: float, n: float) -> tuple[float, float, float]:
    """Gains of value, slope and bend for the n-th sample, n >= 2: growing memory first, then fading memory."""
    fade = fade_per_period ** (dt / horizon_s)
    rest = 1.0 - fade
    pairs = n * (n + 1.0)
    triples = pairs * (n + 2.0)
    if degree == 0:
        return max(rest, 1.0 / n), 0.0, 0.0
    if degree == 1:
        return max(1.0 - fade * fade, (4.0 * n - 2.0) / pairs), max(rest * rest, 6.0 / pairs) / dt, 0.0
    if n <= 2.0:  # two samples determine a line
        return 1.0, 1.0 / dt, 0.0
    return (
        max(1.0 - fade * fade * fade, (9.0 * n * n - 9.0 * n + 6.0) / triples),
        max(1.5 * rest * rest * (1.0 + fade), (36.0 * n - 18.0) / triples) / dt,
        max(rest * rest * rest, 60.0 / triples) / (dt * dt),
    )


@compiled
def _scored(bank: PredictorBank, now: Polynomials, sample_count: int) -> PredictorBank:
    """``bank`` with the predictors ``now``, after the comparison of ``bank.scored`` with the sample."""
    then = bank.scored
    turn = to_rotation_vector(multiply(now.orientation, conjugate(then.orientation)))
    sample = (now.position[0], now.position[1], now.position[2], turn[0], turn[1], turn[2])
    squared = np.zeros((2 * _N, 2))
    for i in range(2 * _N):
        t = now.times[i // _N] - then.times[i // _N]
        for j in range(6):
            error = sample[j] - _extrapolated(then, i, j, t)
            squared[i, j // 3] += error * error
    errors = SCORE_MEMORY * bank.errors + squared
    weight = SCORE_MEMORY * bank.weight + 1.0
    raw, regular = _least_error(errors, weight, 0), _least_error(errors, weight, _N)
    changes = raw < PREFERENCE * regular if bank.regular else regular < PREFERENCE * raw
    in_use = bank.regular != changes
    if sample_count <= (LEARNING_REGULAR if in_use else LEARNING):
        return PredictorBank(
            now,
            now,
            sample_count,
            errors,
            weight,
            bank.long_errors,
            bank.long_steps,
            bank.long_weight,
            bank.long_count,
            in_use,
        )
    step = np.array((length(difference(now.position, then.position)), length(turn))) ** 2
    moving = step / (step + SMALL_STEP)  # no forgetting at rest
    kept = 1.0 - (1.0 - LATENCY_MEMORY) * moving
    return PredictorBank(
        now,
        now,
        sample_count,
        errors,
        weight,
        kept * bank.long_errors + squared,
        kept * bank.long_steps + step,
        kept * bank.long_weight + moving,
        bank.long_count + 1,
        in_use,
    )


@compiled
def _least_error(errors: Array, weight: float, first: int) -> float:
    """Smallest error of position times smallest error of orientation, over the predictors on one time base."""
    product = 1.0
    for half in range(2):
        product *= (errors[first : first + _N, half] + weight * FLOOR[half]).min()
    return product


@compiled
def _curve(
    value: Array, slope: Array, bend: Array, errors: Array, weight: float, regular: bool
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
    """:meth:`PredictorBank.curve`."""
    first = _N if regular else 0
    found = np.zeros((3, 6))
    for half in range(2):
        weights = _MOVING
        if weight > 0.0:
            doubted = (errors[first : first + _N, half] + weight * FLOOR[half]) * _DOUBT
            weights = (doubted.min() / doubted) ** SHARPNESS
            weights = weights / weights.sum()
        for i in range(_N):
            for j in range(3 * half, 3 * half + 3):
                found[0, j] += weights[i] * value[first + i, j]
                found[1, j] += weights[i] * slope[first + i, j]
                found[2, j] += weights[i] * bend[first + i, j]
    x, v, a = found
    return (
        (x[0], x[1], x[2]),
        (v[0], v[1], v[2]),
        (a[0], a[1], a[2]),
        (x[3], x[4], x[5]),
        (v[3], v[4], v[5]),
        (a[3], a[4], a[5]),
    )


@compiled
def _unpredictability(errors: Array, steps: Array, weights: Array, count: int, regular: bool) -> tuple[float, float]:
    """:attr:`PredictorBank.unpredictability`."""
    if count < LEARNING:
        return (0.0, 0.0)
    first = _N if regular else 0
    parts = np.empty(2)
    for half in range(2):
        best = errors[first : first + _N, half].argmin()
        way = steps[half] + (1.0 + weights[half]) * SMALL_STEP[half]
        parts[half] = np.sqrt(errors[first + best, half] * _PART_OF_TARGET[best] / way)
    return (parts[0], parts[1])
