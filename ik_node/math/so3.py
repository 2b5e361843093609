"""Rotation vectors and their time derivatives, for the interpolation of rotations.

The right Jacobian J_r of SO(3) relates the derivative of a rotation vector theta to the angular velocity omega,
expressed in the rotated frame (Chirikjian, "Stochastic Models, Information Theory, and Lie Groups 2", 2012,
section 10.6)::

    R = exp(theta) ,    omega = J_r(theta) theta' ,    omega' = J_r theta'' + J_r' theta'
    J_r = 1 - A [theta] + B [theta]^2 ,    A = (1 - cos a) / a^2 ,    B = (a - sin a) / a^3 ,    a = |theta|

Near a = 0 the coefficients are computed by series that are exact to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin, sqrt

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import (
    Quaternion,
    Vector,
    add,
    cross,
    difference,
    dot,
    multiply,
    scaled,
    to_rotation_vector,
)
from ik_node.math.types import Array

SMALL = 1e-2
"""Squared angle, rad^2, below which the coefficients are computed by series."""


def relative_rotation_vectors(orientations: tuple[Quaternion, ...]) -> Array:
    """Rotation vectors (N - 1, 3) of the shortest rotation from each orientation to the next, in the former's frame."""
    return _relative_rotation_vectors(np.array(orientations))


@compiled
def _relative_rotation_vectors(quaternions: Array) -> Array:
    vectors = np.empty((len(quaternions) - 1, 3))
    for i in range(len(vectors)):
        (aw, ax, ay, az), (bw, bx, by, bz) = quaternions[i], quaternions[i + 1]
        vectors[i] = np.array(to_rotation_vector(multiply((aw, -ax, -ay, -az), (bw, bx, by, bz))))
    return vectors


def right_jacobian(theta: Array, vector: Array) -> Array:
    """J_r(theta) vector of each row, (N, 3)."""
    return _row_by_row(_jacobian_rows, theta, vector)


def inverse_right_jacobian(theta: Array, vector: Array) -> Array:
    """J_r(theta)^-1 vector of each row, (N, 3)."""
    return _row_by_row(_inverse_rows, theta, vector)


def right_jacobian_rate(theta: Array, slope: Array, vector: Array) -> Array:
    """(d/dt J_r(theta)) vector of each row, with theta' = ``slope``, (N, 3)."""
    return _row_by_row(_rate_rows, theta, slope, vector)


def _row_by_row(function: Callable[..., Array], *columns: Array) -> Array:
    return function(*(np.ascontiguousarray(column, dtype=np.float64) for column in columns))


@compiled
def _jacobian_rows(theta: Array, vector: Array) -> Array:
    result = np.empty_like(theta)
    for i in range(len(theta)):
        result[i] = np.array(right_jacobian_product(_row(theta, i), _row(vector, i)))
    return result


@compiled
def _inverse_rows(theta: Array, vector: Array) -> Array:
    result = np.empty_like(theta)
    for i in range(len(theta)):
        angle, v = _row(theta, i), _row(vector, i)
        once = cross(angle, v)
        twice = cross(angle, once)
        c = inverse_coefficient(dot(angle, angle))
        result[i] = np.array(add(v, add(scaled(once, 0.5), scaled(twice, c))))
    return result


@compiled
def _rate_rows(theta: Array, slope: Array, vector: Array) -> Array:
    result = np.empty_like(theta)
    for i in range(len(theta)):
        result[i] = np.array(right_jacobian_rate_product(_row(theta, i), _row(slope, i), _row(vector, i)))
    return result


@compiled
def _row(array: Array, i: int) -> Vector:
    return (array[i, 0], array[i, 1], array[i, 2])


@compiled
def right_jacobian_product(theta: Vector, v: Vector) -> Vector:
    """J_r(theta) v."""
    a, b = jacobian_coefficients(dot(theta, theta))
    once = cross(theta, v)
    return add(difference(v, scaled(once, a)), scaled(cross(theta, once), b))


@compiled
def right_jacobian_rate_product(theta: Vector, slope: Vector, v: Vector) -> Vector:
    """(d/dt J_r(theta)) v with theta' = ``slope``."""
    squared = dot(theta, theta)
    a, b = jacobian_coefficients(squared)
    a_rate, b_rate = _coefficient_rates(squared)
    along, once, turned = dot(theta, slope), cross(theta, v), cross(slope, v)
    first = difference(scaled(add(cross(slope, once), cross(theta, turned)), b), scaled(turned, a))
    second = difference(scaled(cross(theta, once), b_rate), scaled(once, a_rate))
    return add(first, scaled(second, along))


@compiled
def jacobian_coefficients(squared: float) -> tuple[float, float]:
    """A and B of the module's equation, for a squared angle in rad^2."""
    if squared < SMALL:
        return (
            0.5 + squared * (-1 / 24 + squared * (1 / 720 - squared / 40320)),
            1 / 6 + squared * (-1 / 120 + squared * (1 / 5040 - squared / 362880)),
        )
    angle = sqrt(squared)
    return (1.0 - cos(angle)) / squared, (angle - sin(angle)) / (squared * angle)


@compiled
def inverse_coefficient(squared: float) -> float:
    """C in J_r^-1 = 1 + [theta] / 2 + C [theta]^2:  C = 1 / a^2 - (1 + cos a) / (2 a sin a)."""
    if squared < SMALL:
        return 1 / 12 + squared * (1 / 720 + squared * (1 / 30240 + squared / 1209600))
    half = 0.5 * sqrt(squared)
    return (1.0 - half * cos(half) / sin(half)) / squared  # does not divide by sin a, which is 0 at a = pi


@compiled
def _coefficient_rates(squared: float) -> tuple[float, float]:
    """(dA/da) / a and (dB/da) / a."""
    x = squared
    if x < SMALL:
        return (
            -1 / 12 + x * (1 / 180 + x * (-1 / 6720 + x / 453600)),
            -1 / 60 + x * (1 / 1260 + x * (-1 / 60480 + x / 4989600)),
        )
    angle = sqrt(x)
    sine, cosine = sin(angle), cos(angle)
    return (
        (angle * sine - 2.0 * (1.0 - cosine)) / (x * x),
        (angle * (1.0 - cosine) - 3.0 * (angle - sine)) / (x * x * angle),
    )
