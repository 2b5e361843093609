"""A trajectory through recorded poses, smooth between them and without overshoot at pauses."""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.math import se3
from ik_node.math.numerics import smoothstep
from ik_node.math.types import Array


class TimedPose(NamedTuple):
    """One recorded pose."""

    time_s: float
    """Seconds from the first sample."""
    pose: Array
    """(4, 4)."""


class SampledTrajectory:
    """Cubic interpolation through samples, with a continuous velocity (C1).

    Between two samples, with u from 0 to 1, step h and velocities m (linear) and w (body angular) at their ends::

        p(u) = p_0 + b1 m_0 h/3 + b2 (p_1 - m_1 h/3 - p_0 - m_0 h/3) + b3 m_1 h/3
        R(u) = R_0 exp(b1 w_0 h/3) exp(b2 log(A' B)) exp(b3 w_1 h/3),  A = R_0 exp(w_0 h/3),  B = R_1 exp(-w_1 h/3)
        b1 = 1 - (1-u)^3,  b2 = 3 u^2 - 2 u^3,  b3 = u^3

    (the cumulative Bezier curve of Kim, Kim and Shin, SIGGRAPH 1995; for positions it is the Hermite cubic). The
    velocity at a sample is van Albada's mean of the slopes before and after it: close to the smaller one, 0 next to a
    repeated sample, so that the curve does not overshoot at steps and pauses. It rests at both ends.
    """

    def __init__(self, times_s: ArrayLike, poses: ArrayLike) -> None:
        """Interpolates samples.

        Args:
            times_s: Times (N,) [s], from 0, not decreasing; the last of several samples at one time is used.
            poses: Poses (N, 4, 4).

        Raises:
            InputError: Wrong shapes, fewer than two different times, decreasing times, or values that are not finite.
        """
        self._times = np.asarray(times_s, dtype=np.float64)
        self._poses = np.asarray(poses, dtype=np.float64)
        count = len(self._times)
        if self._times.shape != (count,) or self._poses.shape != (count, 4, 4):
            raise InputError(
                f"times have shape {self._times.shape}, poses {self._poses.shape}; expected (N,), (N, 4, 4)"
            )
        if not (np.isfinite(self._times).all() and np.isfinite(self._poses).all()):
            raise InputError("times and poses must be finite")
        if count < 2 or self._times[0] != 0.0 or (np.diff(self._times) < 0.0).any() or self._times[-1] <= 0.0:
            raise InputError("times must begin at 0, not decrease, and hold at least two moments")
        last = np.append(np.diff(self._times) > 0.0, True)
        self._knots: list[float] = self._times[last].tolist()
        self._positions = self._poses[last, :3, 3]
        self._rotations = np.ascontiguousarray(self._poses[last, :3, :3])
        self._prepare()

    def _prepare(self) -> None:
        """Control vectors of every interval: three each for position and for rotation."""
        steps = np.diff(self._knots)[:, None]
        moves = np.diff(self._positions, axis=0)
        turns = np.array(
            [se3.log_rotation(a.T @ b) for a, b in zip(self._rotations, self._rotations[1:], strict=False)]
        )
        linear, angular = _velocities(moves / steps), _velocities(turns / steps)
        first, last = linear[:-1] * steps / 3.0, linear[1:] * steps / 3.0
        self._legs = np.stack((first, moves - first - last, last), axis=1)
        first, last = angular[:-1] * steps / 3.0, angular[1:] * steps / 3.0
        middle = np.empty_like(turns)
        for index, turn in enumerate(turns):
            inner = se3.exp_rotation(-first[index]) @ se3.exp_rotation(turn) @ se3.exp_rotation(-last[index])
            middle[index] = se3.log_rotation(inner)
        self._turns = np.stack((first, middle, last), axis=1)

    @property
    def duration_s(self) -> float:
        """Time of the last sample, s."""
        return self._knots[-1]

    def samples(self) -> tuple[TimedPose, ...]:
        """The samples as given, including repeated ones."""
        return tuple(TimedPose(time, pose.copy()) for time, pose in zip(self._times.tolist(), self._poses, strict=True))

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); constant outside 0..duration_s."""
        index = min(max(bisect_right(self._knots, time_s) - 1, 0), len(self._knots) - 2)
        begin, end = self._knots[index], self._knots[index + 1]
        u = min(max((time_s - begin) / (end - begin), 0.0), 1.0)
        weights = (1.0 - (1.0 - u) ** 3, smoothstep(u), u**3)
        pose = np.eye(4)
        pose[:3, 3] = self._positions[index] + weights @ self._legs[index]
        rotation = self._rotations[index]
        for weight, turn in zip(weights, self._turns[index], strict=True):
            rotation = rotation @ se3.exp_rotation(weight * turn)
        pose[:3, :3] = rotation
        return pose


def _velocities(slopes: Array) -> Array:
    """Velocities at the knots (N+1, 3) from the slopes between them (N, 3): van Albada's mean, 0 at both ends."""
    before, after = slopes[:-1], slopes[1:]
    square_before, square_after = (before**2).sum(1, keepdims=True), (after**2).sum(1, keepdims=True)
    total = square_before + square_after
    mean = (before * square_after + after * square_before) / np.where(total > 0.0, total, 1.0)
    rest = np.zeros((1, slopes.shape[1]))
    return np.concatenate((rest, mean, rest))
