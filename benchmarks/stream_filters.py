"""Filters from the literature for streamed poses, as baselines of ``ik_benchmark streams``.

Each has one parameter between smooth and close; the benchmark runs it over a range of values. Estimators that run at
each sample predict the target between samples; the tool then moves with the predicted velocity plus P control on the
predicted pose.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from benchmarks.stream_baselines import VelocityFollower
from ik_node.interfaces.clock import NS, Stamped
from ik_node.math.quaternion import (
    IDENTITY,
    ZERO,
    Quaternion,
    Vector,
    add,
    conjugate,
    difference,
    from_matrix,
    from_rotation_vector,
    length,
    multiply,
    normalised,
    scaled,
    to_rotation_vector,
)
from ik_node.math.types import Array
from ik_node.targets.stream.sampling_clock import SamplingClock, reset, updated

SPEED_CUTOFF_HZ = 1.0
"""Cut-off frequency of the speed in the one-euro filter; the value of its authors."""
SPEED_GAIN = (10.0, 2.0)
"""Cut-off frequency per speed of the one-euro filter [Hz/(m/s), Hz/(rad/s)]: 2 to 4 Hz at the speeds of a hand."""
FEEDBACK_GAIN = 20.0
"""Gain [1/s] with which the tool follows a predicted pose."""
LONGEST_PREDICTION_PERIODS = 2.0
"""Longest extrapolation, in sample periods."""
START_SAMPLES = 3
"""Samples until the estimators use their final gains."""


class OneEuro(VelocityFollower):
    """One-euro filter (Casiez, Roussel and Vogel, CHI 2012) at each control step on the held sample.

    A low-pass of first order whose cut-off frequency rises with the filtered speed.
    """

    def __init__(self, min_cutoff_hz: float) -> None:
        super().__init__()
        self._min_cutoff_hz = min_cutoff_hz
        self._speeds = [ZERO, ZERO]

    def command(self, position: Vector, orientation: Quaternion, time_ns: int, hold_s: float) -> tuple[Vector, Vector]:
        """Return the velocity that leads to the filtered pose."""
        errors = (
            difference(self._goal[0], position),
            to_rotation_vector(multiply(self._goal[1], conjugate(orientation))),
        )
        command = []
        for half, error in enumerate(errors):
            cutoff_hz = self._min_cutoff_hz + SPEED_GAIN[half] * length(self._speeds[half])
            velocity = scaled(error, _low_pass_part(cutoff_hz, hold_s) / hold_s)
            part = _low_pass_part(SPEED_CUTOFF_HZ, hold_s)
            self._speeds[half] = add(scaled(self._speeds[half], 1.0 - part), scaled(velocity, part))
            command.append(velocity)
        return command[0], command[1]


def _low_pass_part(cutoff_hz: float, dt: float) -> float:
    """Part of the error that a low-pass of first order removes in one step."""
    return dt / (dt + 1.0 / (2.0 * pi * cutoff_hz))


class State(NamedTuple):
    """Estimate at one time: pose, velocity and acceleration in {s}."""

    position: Vector = ZERO
    velocity: Vector = ZERO
    acceleration: Vector = ZERO
    orientation: Quaternion = IDENTITY
    rate: Vector = ZERO
    angular_acceleration: Vector = ZERO


class Estimator(VelocityFollower):
    """A recursive estimator of pose, velocity and acceleration; a subclass gives its gains."""

    def __init__(self) -> None:
        super().__init__()
        self._state: State | None = None
        self._count = 0
        self._clock = SamplingClock()

    def gains(self, dt: float, count: int) -> tuple[float, float, float]:
        """Return the gains of pose, velocity [1/s] and acceleration [1/s2] for the sample number ``count``."""
        raise NotImplementedError

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take the sample; older ones and repeated stamps are ignored."""
        x, y, z = pose_sd[:3, 3].tolist()
        orientation = from_matrix(pose_sd)
        if self._state is None:
            self._clock = reset(self._clock, stamped.time_ns)
            self._state, self._count = State((x, y, z), orientation=orientation), 1
            return
        if stamped.time_ns <= self._clock.time_ns:
            return
        dt = (stamped.time_ns - self._clock.time_ns) / NS
        self._clock = updated(self._clock, stamped.time_ns)
        self._count += 1
        g, h, k = self.gains(dt, self._count)
        predicted = _predicted(self._state, dt)
        error = difference((x, y, z), predicted.position)
        turn = to_rotation_vector(multiply(orientation, conjugate(predicted.orientation)))
        self._state = State(
            add(predicted.position, scaled(error, g)),
            add(predicted.velocity, scaled(error, h)),
            add(predicted.acceleration, scaled(error, k)),
            normalised(multiply(from_rotation_vector(scaled(turn, g)), predicted.orientation)),
            add(predicted.rate, scaled(turn, h)),
            add(predicted.angular_acceleration, scaled(turn, k)),
        )

    def command(self, position: Vector, orientation: Quaternion, time_ns: int, hold_s: float) -> tuple[Vector, Vector]:
        """Return the predicted velocity plus P control on the predicted pose."""
        if self._state is None:
            return ZERO, ZERO
        age_s = (time_ns - self._clock.time_ns) / NS
        goal = _predicted(self._state, min(age_s, LONGEST_PREDICTION_PERIODS * self._clock.period_s))
        turn = to_rotation_vector(multiply(goal.orientation, conjugate(orientation)))
        return (
            add(goal.velocity, scaled(difference(goal.position, position), FEEDBACK_GAIN)),
            add(goal.rate, scaled(turn, FEEDBACK_GAIN)),
        )


def _predicted(state: State, dt: float) -> State:
    """The estimate ``dt`` later, with constant acceleration."""
    mean = add(state.velocity, scaled(state.acceleration, 0.5 * dt))
    mean_rate = add(state.rate, scaled(state.angular_acceleration, 0.5 * dt))
    return State(
        add(state.position, scaled(mean, dt)),
        add(state.velocity, scaled(state.acceleration, dt)),
        state.acceleration,
        normalised(multiply(from_rotation_vector(scaled(mean_rate, dt)), state.orientation)),
        add(state.rate, scaled(state.angular_acceleration, dt)),
        state.angular_acceleration,
    )


class AlphaBeta(Estimator):
    """Alpha-beta filter with the gains of a critically damped one: beta = 2 (2 - alpha) - 4 sqrt(1 - alpha)."""

    def __init__(self, alpha: float) -> None:
        super().__init__()
        self._alpha, self._beta = alpha, 2.0 * (2.0 - alpha) - 4.0 * (1.0 - alpha) ** 0.5

    def gains(self, dt: float, count: int) -> tuple[float, float, float]:
        """Return constant gains; after two samples their line."""
        dt = max(dt, 0.25 * self._clock.period_s)
        return (1.0, 1.0 / dt, 0.0) if count == 2 else (self._alpha, self._beta / dt, 0.0)


class KalmanAcceleration(Estimator):
    """Kalman filter with a constant acceleration that white jerk disturbs; samples of equal noise.

    Only the ratio of the two matters. ``bandwidth`` [1/s] is its sixth root per sample period of 20 ms, about the
    frequency up to which the estimate follows.
    """

    def __init__(self, bandwidth: float) -> None:
        super().__init__()
        self._jerk = 0.02 * bandwidth**6
        self._covariance = np.diag((1.0, 1e4, 1e6))

    def gains(self, dt: float, count: int) -> tuple[float, float, float]:
        """Return the gains from the covariance, which is the same for every axis."""
        f = np.array(((1.0, dt, 0.5 * dt * dt), (0.0, 1.0, dt), (0.0, 0.0, 1.0)))
        g = np.array((dt**3 / 6.0, dt**2 / 2.0, dt))
        predicted = f @ self._covariance @ f.T + self._jerk / dt * np.outer(g, g)
        gain = predicted[:, 0] / (predicted[0, 0] + 1.0)
        self._covariance = predicted - np.outer(gain, predicted[0])
        return float(gain[0]), float(gain[1]), float(gain[2])
