"""Jerk-limited filter: a rigid motion with bounded speed, acceleration and jerk that follows a moving goal.

The motion is in R^3 x SO(3): the origin of {d} and its orientation relative to {s}, each with velocity and
acceleration. It is a chain of three integrators with a jerk that is constant over a control interval, so acceleration
is continuous for any goal. The jerk comes from a cascade ::

    desired velocity      v_w = v_goal + sat(gain e)
    desired acceleration  a_w = sat(a_goal + omega (v_w - v))
    jerk                  j   = sat(3 omega (a_w - a))

where e is the pose error and each level saturates at its own bound: a smooth variant of the nonlinear filters of
Zanasi, Guarino Lo Bianco and Tonielli ("Nonlinear filters for the generation of smooth trajectories", Automatica 36,
2000). Vectors saturate by length, so that an approach from rest is a straight line. Without saturation the error obeys
e''' + 3 omega e'' + 3 omega^2 e' + 3 omega^2 gain e = jerk of the goal: goals of constant acceleration are followed
without error. With gain = omega / 3 there is a triple pole at -omega; a smaller gain corrects errors more slowly at the
same response to the velocity of the goal.

Why not the library Ruckig: the filter is compiled into the control step, its bounds change during the motion, it bounds
the length of vectors instead of each axis, and a replay must reproduce its results bit for bit.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import (
    IDENTITY,
    ZERO,
    Quaternion,
    Vector,
    conjugate,
    difference,
    from_rotation_vector,
    multiply,
    normalised,
    rotate_inverse,
    to_matrix,
    to_rotation_vector,
)
from ik_node.math.types import Array

KEEP_AXIS_ANGLE = 170.0 / 180.0 * pi
"""Above this angle [rad] an orientation error keeps its direction: the shortest one flips near pi."""


class RigidMotion(NamedTuple):
    """Pose, velocity and acceleration of a frame {d} relative to {s}."""

    position: Vector = ZERO
    """[m]"""
    velocity: Vector = ZERO
    """[m/s], of the origin of {d}, in {s}."""
    acceleration: Vector = ZERO
    """[m/s2]"""
    orientation: Quaternion = IDENTITY
    """R_sd, (w, x, y, z)."""
    rate: Vector = ZERO
    """Angular velocity [rad/s], in {s}."""
    angular_acceleration: Vector = ZERO
    """[rad/s2], in {s}."""


class Bounds(NamedTuple):
    """Bounds on the lengths of three derivatives of a vector."""

    speed: float
    acceleration: float
    jerk: float
    catch_up: float
    """Largest speed that the error alone may command."""


class MotionBounds(NamedTuple):
    """Bounds of the two halves of a motion."""

    linear: Bounds
    angular: Bounds


class Jerk(NamedTuple):
    """Constant jerk of a rigid motion."""

    linear: Vector
    """[m/s3], in {s}."""
    angular: Vector
    """[rad/s3], in {s}."""
    duration_s: float


@compiled
def integrate(motion: RigidMotion, jerk: Jerk, duration_s: float) -> RigidMotion:
    """Integrates a motion.

    Args:
        motion: Initial motion.
        jerk: Constant jerk.
        duration_s: Time.

    Returns:
        The motion after ``duration_s``, exact except for terms O(dt^3) of rotating axes.
    """
    moved, velocity, acceleration = _polynomial_step(motion.velocity, motion.acceleration, jerk.linear, duration_s)
    turned, rate, angular_acceleration = _polynomial_step(
        motion.rate, motion.angular_acceleration, jerk.angular, duration_s
    )
    x, y, z = motion.position
    return RigidMotion(
        (x + moved[0], y + moved[1], z + moved[2]),
        velocity,
        acceleration,
        normalised(multiply(from_rotation_vector(turned), motion.orientation)),
        rate,
        angular_acceleration,
    )


@compiled
def _polynomial_step(v: Vector, a: Vector, j: Vector, dt: float) -> tuple[Vector, Vector, Vector]:
    half, sixth = 0.5 * dt, dt * dt / 6.0
    ax, ay, az = a
    jx, jy, jz = j
    vx, vy, vz = v
    return (
        (
            dt * (vx + half * ax + sixth * jx),
            dt * (vy + half * ay + sixth * jy),
            dt * (vz + half * az + sixth * jz),
        ),
        (vx + dt * (ax + half * jx), vy + dt * (ay + half * jy), vz + dt * (az + half * jz)),
        (ax + dt * jx, ay + dt * jy, az + dt * jz),
    )


@compiled
def orientation_error(goal: Quaternion, orientation: Quaternion, previous: Vector) -> Vector:
    """The orientation error: the rotation vector [rad] in {s} from ``orientation`` to ``goal``.

    It is the shortest one, except above ``KEEP_AXIS_ANGLE``: there it keeps the direction of ``previous``, the error
    one interval ago, even if that is up to 20 degrees longer, so that it does not flip at each interval.
    """
    turn = to_rotation_vector(multiply(goal, conjugate(orientation)))
    x, y, z = turn
    angle = sqrt(x * x + y * y + z * z)
    if angle > KEEP_AXIS_ANGLE and x * previous[0] + y * previous[1] + z * previous[2] < 0.0:
        factor = 1.0 - 2.0 * pi / angle
        return (x * factor, y * factor, z * factor)
    return turn


@compiled
def cascade_jerk(
    error: Vector,
    velocity: Vector,
    acceleration: Vector,
    goal_velocity: Vector,
    goal_acceleration: Vector,
    gain: float,
    omega: float,
    bounds: Bounds,
    dt: float,
) -> Vector:
    """The jerk of the cascade for one 3-vector, constant for ``dt`` (3 omega dt <= 1).

    If speed and acceleration start within ``bounds`` they stay within, for any goal: acceleration because it only moves
    towards a value within its bound, speed because a jerk after which the acceleration could not end in time is
    replaced by the one that ends it soonest.

    Args:
        error: Error of position [m] or orientation [rad].
        velocity: Present velocity.
        acceleration: Present acceleration.
        goal_velocity: Velocity of the goal.
        goal_acceleration: Acceleration of the goal.
        gain: Gain of the error [1/s].
        omega: Gain of the velocity [1/s], at least ``gain``; a third of that of the acceleration.
        bounds: Bounds.
        dt: Control interval [s].

    Returns:
        The jerk.
    """
    ex, ey, ez = error
    size = sqrt(ex * ex + ey * ey + ez * ez)
    # an acceleration that the jerk can build up and end while the error decreases: larger ones overshoot
    strongest = min(bounds.acceleration, bounds.jerk / (3.0 * gain))
    if size > 0.0:
        # sqrt(a e) is the speed from which half the acceleration stops within e
        gain = min(gain, bounds.catch_up / size, sqrt(strongest / size))
    gx, gy, gz = goal_velocity
    wx, wy, wz = _cut(gx + gain * ex, gy + gain * ey, gz + gain * ez, bounds.speed)
    vx, vy, vz = velocity
    ax, ay, az = acceleration
    bx, by, bz = goal_acceleration
    bx, by, bz = _cut(bx + omega * (wx - vx), by + omega * (wy - vy), bz + omega * (wz - vz), bounds.acceleration)
    rate = 3.0 * omega
    jerk = _cut(rate * (bx - ax), rate * (by - ay), rate * (bz - az), bounds.jerk)
    return _within_speed(velocity, acceleration, jerk, bounds, dt)


@compiled
def _cut(x: float, y: float, z: float, length: float) -> Vector:
    squared = x * x + y * y + z * z
    if squared <= length * length:
        return (x, y, z)
    factor = length / sqrt(squared)
    return (x * factor, y * factor, z * factor)


@compiled
def _within_speed(v: Vector, a: Vector, jerk: Vector, bounds: Bounds, dt: float) -> Vector:
    """``jerk``, or the one that ends the acceleration soonest if ``jerk`` would lead past the speed bound."""
    now = _speed_left(v, a, bounds.jerk, dt)
    _, v_next, a_next = _polynomial_step(v, a, jerk, dt)
    allowed = bounds.speed * bounds.speed
    if _speed_left(v_next, a_next, bounds.jerk, dt) <= allowed or _speed_left(v_next, a_next, bounds.jerk, dt) <= now:
        return jerk
    size = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    factor = -min(1.0 / dt, bounds.jerk / size) if size > 0.0 else 0.0
    return (a[0] * factor, a[1] * factor, a[2] * factor)


@compiled
def _speed_left(v: Vector, a: Vector, jerk: float, dt: float) -> float:
    """Squared speed after the acceleration has been ended with ``jerk``, in whole steps of ``dt``."""
    ax, ay, az = a
    time = 0.5 * (sqrt(ax * ax + ay * ay + az * az) / jerk + dt)
    x, y, z = v[0] + time * ax, v[1] + time * ay, v[2] + time * az
    return x * x + y * y + z * z


@compiled
def pose_matrix(motion: RigidMotion) -> Array:
    """T_sd (4, 4)."""
    pose, rows = np.empty((4, 4)), to_matrix(motion.orientation)
    for i in range(3):
        pose[i, 0], pose[i, 1], pose[i, 2] = rows[i]
        pose[i, 3] = motion.position[i]
    pose[3, 0], pose[3, 1], pose[3, 2], pose[3, 3] = 0.0, 0.0, 0.0, 1.0
    return pose


@compiled
def mean_twist(start: RigidMotion, end: RigidMotion, duration_s: float) -> Array:
    """log(T_start^-1 T_end) / duration: the body twist (v, omega) that leads from one pose to the other."""
    x, y, z = to_rotation_vector(multiply(conjugate(start.orientation), end.orientation))
    a, b, c = rotate_inverse(start.orientation, difference(end.position, start.position))
    # inverse of the left Jacobian of SO(3) by its series, exact to rounding for the turn of one interval
    squared = x * x + y * y + z * z
    k = 1.0 / 12.0 + squared / 720.0 + squared * squared / 30240.0
    ux, uy, uz = y * c - z * b, z * a - x * c, x * b - y * a
    wx, wy, wz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    s = 1.0 / duration_s
    return np.array(
        (s * (a - 0.5 * ux + k * wx), s * (b - 0.5 * uy + k * wy), s * (c - 0.5 * uz + k * wz), s * x, s * y, s * z)
    )
