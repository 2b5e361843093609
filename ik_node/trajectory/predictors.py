"""Where a streamed target is between its samples: several predictors, weighted by how well they have foretold.

Each predictor is a fading-memory polynomial (Morrison, Introduction to Sequential Smoothing and Prediction, 1969) of
degree 0, 1 or 2: least squares with weights that fade into the past, as a recursion. Short memories follow, long ones
smooth; which is better depends on the stream, and is measured: each sample is compared with what every predictor said
it would be. Each exists twice, once on the stamps as they are and once on the regular times of ``cadence.py``, and the
better of the two tells whether the stamps can be believed. Position and orientation choose apart.

Orientation is a rotation vector in {s} from the newest sample's orientation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.se3 import Array
from ik_node.trajectory.rotations import Quaternion, Vector, conjugate, difference, length, multiply, to_vector

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
"""Degree, and weight of the past per sample period."""
SHORTEST_HORIZON_S = 0.02
"""Memories fade, and predictions are scored, over at least this: the motion cannot use what is faster."""
SCORE_MEMORY = 0.94
"""Weight of the past in the scores, per scored sample."""
LATENCY_MEMORY = 0.98
"""The same in what says how predictable the target is: longer, lest the motion's latency change all the time."""
SMALL_STEP = np.array((1.5e-3, 5e-3)) ** 2
"""Added to the mean squared step [m2, rad2] that errors are compared with: errors far below that do not matter."""
LEARNING = 5
"""Scored samples after which that is begun: the first ones tell of the beginning, not of the target."""
LEARNING_REGULAR = 9
"""The same on the regular times, which have to be learnt first."""
SHARPNESS = 12
"""Weight of a predictor: mean squared error to the power of minus this."""
BENEFIT = 0.75
"""Factor on the mean squared error of the predictor that nothing moves: one step out of rest is no motion yet."""
PREFERENCE = 0.5
"""The other time base is taken when its error is below this part of that in use."""
FLOOR = np.array((1e-12, 1e-10))
"""Mean squared errors [m2, rad2] below which predictors count as equally good: a micrometre, 10 microradian."""

_N = len(PREDICTORS)
_DOUBT = np.array([[1.0 if degree > 0 else BENEFIT] for degree, _ in PREDICTORS])
_DEGREE = np.array([degree for degree, _ in PREDICTORS] * 2)
_FADE = np.array([fade for _, fade in PREDICTORS] * 2)
_MOVING = (_DEGREE[:_N] > 0) / np.count_nonzero(_DEGREE[:_N])


def variance_ratio(degree: int, fade: float) -> float:
    """Variance of a prediction one period ahead, per variance of the samples (Morrison 1969)."""
    series = ((1.0,), (5.0, 4.0, 1.0), (19.0, 24.0, 16.0, 6.0, 1.0))[degree]
    return (1.0 - fade) / (1.0 + fade) ** (2 * degree + 1) * sum(c * fade**i for i, c in enumerate(series))


_PART_OF_TARGET = np.array([1.0 - 1.0 / (1.0 + variance_ratio(*predictor)) for predictor in PREDICTORS])


class Polynomials(NamedTuple):
    """Every predictor's polynomial about one sample; arrays are never changed in place."""

    value: Array
    """(2 N, 6): position [m] in {s}, rotation vector [rad]."""
    slope: Array
    bend: Array
    position: Vector
    """Of the sample."""
    orientation: Quaternion
    """Of the sample; from here the rotation vectors count."""
    times: tuple[float, float]
    """Of the sample on the two time bases [s], from the first after the last jump or gap."""


class Bank(NamedTuple):
    """The predictors after the newest sample."""

    now: Polynomials
    scored: Polynomials
    """As they were when last compared with a sample."""
    known: int
    """Samples since the last jump or gap."""
    errors: Array
    """(2 N, 2): faded sums of squared errors of position and orientation."""
    weight: float
    """The same of 1."""
    long_errors: Array
    """(2 N, 2): as ``errors``, over a longer time."""
    long_steps: Array
    """(2,): the same of the way between scored samples."""
    long_weight: Array
    """(2,): the same of 1 while the target moves, of less while it rests."""
    long_count: int
    """Scored samples that these hold."""
    regular: bool
    """The regular times are in use."""

    @property
    def unpredictability(self) -> tuple[float, float]:
        """RMS error of the best predictor as part of the RMS step, of position and orientation; 0 unless known.

        The noise of the samples that the predictions are compared with is taken off, as if all error were noise.
        """
        if self.long_count < LEARNING:
            return (0.0, 0.0)
        errors = self.long_errors[self._used]
        best = errors.argmin(axis=0)
        way = self.long_steps + (1.0 + self.long_weight) * SMALL_STEP
        of_target = errors[best, (0, 1)] * _PART_OF_TARGET[best] / way
        position, orientation = np.sqrt(of_target).tolist()
        return (position, orientation)

    @property
    def _used(self) -> slice:
        return slice(_N, None) if self.regular else slice(0, _N)

    def curve(self) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
        """Position, rotation vector, and their derivatives at the newest sample, weighted over the predictors.

        In the order of ``curve.Curve``: position, velocity, acceleration, rotation vector, its two derivatives.
        """
        used = self._used
        if self.weight > 0.0:
            errors = (self.errors[used] + self.weight * FLOOR) * _DOUBT
            weights = (errors.min(axis=0) / errors) ** SHARPNESS
            weights /= weights.sum(axis=0)
        else:
            weights = np.stack((_MOVING, _MOVING), axis=1)
        spread = np.repeat(weights, 3, axis=1)
        now = self.now
        x = (spread * now.value[used]).sum(axis=0).tolist()
        v = (spread * now.slope[used]).sum(axis=0).tolist()
        a = (spread * now.bend[used]).sum(axis=0).tolist()
        return (
            (x[0], x[1], x[2]),
            (v[0], v[1], v[2]),
            (a[0], a[1], a[2]),
            (x[3], x[4], x[5]),
            (v[3], v[4], v[5]),
            (a[3], a[4], a[5]),
        )


def begun(position: Vector, orientation: Quaternion, earlier: Bank | None, regular: bool) -> Bank:
    """Predictors that know one sample, and of what came before a jump or gap only who foretold it well.

    ``regular`` says which times to begin with when there was nothing before.
    """
    value = np.zeros((2 * _N, 6))
    value[:, :3] = position
    zero = np.zeros((2 * _N, 6))
    now = Polynomials(value, zero, zero, position, orientation, (0.0, 0.0))
    if earlier is None:
        errors = np.zeros((2 * _N, 2))
        return Bank(now, now, 1, errors, 0.0, errors, np.zeros(2), np.zeros(2), 0, regular)
    return earlier._replace(now=now, scored=now, known=1)


def updated(
    bank: Bank, position: Vector, orientation: Quaternion, elapsed_s: tuple[float, float], period_s: float
) -> Bank:
    """The predictors with one more sample, ``elapsed_s`` after the newest on the stamps and on the regular times."""
    before = bank.now
    horizon_s = max(period_s, SHORTEST_HORIZON_S)
    raw_s, regular_s = max(elapsed_s[0], 1e-4), max(elapsed_s[1], 1e-4)
    dt = np.repeat((raw_s, regular_s), _N)
    turn = to_vector(multiply(orientation, conjugate(before.orientation)))
    sample = np.array((*position, *turn))
    value, slope = _extrapolated(before, dt)
    error = sample - value
    g, h, k = _gains(dt, horizon_s, bank.known + 1)
    value = value + g[:, None] * error
    value[:, 3:] -= turn
    times = (before.times[0] + raw_s, before.times[1] + regular_s)
    now = Polynomials(value, slope + h[:, None] * error, before.bend + k[:, None] * error, position, orientation, times)
    count = bank.known + 1
    if count <= 2:  # a single sample foretells nothing
        return bank._replace(now=now, scored=now, known=count)
    bank = bank._replace(now=now, known=count)
    return bank if times[0] - bank.scored.times[0] < 0.75 * horizon_s else _scored(bank)


def _extrapolated(polynomials: Polynomials, dt: Array) -> tuple[Array, Array]:
    t = dt[:, None]
    change = t * polynomials.bend
    return polynomials.value + t * (polynomials.slope + 0.5 * change), polynomials.slope + change


def _gains(dt: Array, horizon_s: float, n: int) -> tuple[Array, Array, Array]:
    """Of value, slope and bend for the n-th sample: growing memory until the memory is long enough, fading then."""
    line, parabola = n > 1, n > 2  # what n samples can determine
    fade = _FADE ** (dt / horizon_s)
    rest = 1.0 - fade
    ones = np.ones_like(fade)
    pairs = n * (n + 1.0)
    triples = pairs * (n + 2.0)
    g = np.choose(
        _DEGREE,
        (
            np.maximum(rest, 1.0 / n),
            np.maximum(1.0 - fade**2, (4.0 * n - 2.0) / pairs),
            np.maximum(1.0 - fade**3, (9.0 * n * n - 9.0 * n + 6.0) / triples) if parabola else ones,
        ),
    )
    h = np.choose(
        _DEGREE,
        (
            0.0 * rest,
            np.maximum(rest**2, 6.0 / pairs),
            np.maximum(1.5 * rest**2 * (1.0 + fade), (36.0 * n - 18.0) / triples) if parabola else ones,
        ),
    )
    k = np.where(_DEGREE == 2, np.maximum(rest**3, 60.0 / triples) if parabola else 0.0, 0.0)
    return g, h / dt if line else 0.0 * h, k / dt**2


def _scored(bank: Bank) -> Bank:
    then, now = bank.scored, bank.now
    turn = to_vector(multiply(now.orientation, conjugate(then.orientation)))
    dt = np.repeat((now.times[0] - then.times[0], now.times[1] - then.times[1]), _N)
    value, _ = _extrapolated(then, dt)
    squared = ((np.array((*now.position, *turn)) - value) ** 2).reshape(2 * _N, 2, 3).sum(axis=2)
    errors = SCORE_MEMORY * bank.errors + squared
    weight = SCORE_MEMORY * bank.weight + 1.0
    floored = errors + weight * FLOOR
    raw, regular = floored[:_N].min(axis=0).prod(), floored[_N:].min(axis=0).prod()
    changes = bool((raw < PREFERENCE * regular) if bank.regular else (regular < PREFERENCE * raw))
    step = np.square((length(difference(now.position, then.position)), length(turn)))
    bank = bank._replace(scored=now, errors=errors, weight=weight, regular=bank.regular != changes)
    if bank.known <= (LEARNING_REGULAR if bank.regular else LEARNING):
        return bank
    moving = step / (step + SMALL_STEP)  # at rest nothing is forgotten
    kept = 1.0 - (1.0 - LATENCY_MEMORY) * moving
    return bank._replace(
        long_errors=kept * bank.long_errors + squared,
        long_steps=kept * bank.long_steps + step,
        long_weight=kept * bank.long_weight + moving,
        long_count=bank.long_count + 1,
    )
