"""Rotation vectors and their rates, one by one and many at once: what interpolation of rotations needs.

Rates of a rotation vector theta and of the body are tied by the right Jacobian of SO(3) (Chirikjian, "Stochastic
Models, Information Theory, and Lie Groups 2", 2012, section 10.6) ::

    R = exp(theta) ,    omega = J_r(theta) theta' ,    omega' = J_r theta'' + J_r' theta'
    J_r = 1 - A [theta] + B [theta]^2 ,    A = (1 - cos a) / a^2 ,    B = (a - sin a) / a^3 ,    a = |theta|

with omega written in the turned frame. Near a = 0 the coefficients are series, exact to rounding.
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
    from_matrix,
    multiply,
    scaled,
    to_vector,
)
from ik_node.math.types import Array

SMALL = 1e-2
"""Squared angles below which series stand for the coefficients, exact to rounding."""


def orientations_of(rotations: Array) -> tuple[Quaternion, ...]:
    """Quaternions of rotation matrices (N, 3, 3)."""
    return tuple(from_matrix(rotation) for rotation in rotations)


def turns_between(orientations: tuple[Quaternion, ...]) -> Array:
    """Rotation vectors (N - 1, 3) of the shortest turns from each orientation to the next, in the former's frame."""
    return _turns(np.array(orientations))


@compiled
def _turns(quaternions: Array) -> Array:
    turns = np.empty((len(quaternions) - 1, 3))
    for i in range(len(turns)):
        (aw, ax, ay, az), (bw, bx, by, bz) = quaternions[i], quaternions[i + 1]
        turns[i] = np.array(to_vector(multiply((aw, -ax, -ay, -az), (bw, bx, by, bz))))
    return turns


def right_jacobian(theta: Array, vector: Array) -> Array:
    """J_r(theta) vector, row by row, (N, 3)."""
    return _row_by_row(_jacobian_rows, theta, vector)


def inverse_right_jacobian(theta: Array, vector: Array) -> Array:
    """J_r(theta)^-1 vector, row by row, (N, 3)."""
    return _row_by_row(_inverse_rows, theta, vector)


def right_jacobian_rate(theta: Array, slope: Array, vector: Array) -> Array:
    """(d/dt J_r(theta)) vector for theta' = ``slope``, row by row, (N, 3)."""
    return _row_by_row(_rate_rows, theta, slope, vector)


def _row_by_row(function: Callable[..., Array], *columns: Array) -> Array:
    return function(*(np.ascontiguousarray(column, dtype=np.float64) for column in columns))


@compiled
def _jacobian_rows(theta: Array, vector: Array) -> Array:
    result = np.empty_like(theta)
    for i in range(len(theta)):
        result[i] = np.array(turned_jacobian(_row(theta, i), _row(vector, i)))
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
        result[i] = np.array(turned_jacobian_rate(_row(theta, i), _row(slope, i), _row(vector, i)))
    return result


@compiled
def _row(array: Array, i: int) -> Vector:
    return (array[i, 0], array[i, 1], array[i, 2])


@compiled
def turned_jacobian(theta: Vector, v: Vector) -> Vector:
    """J_r(theta) v."""
    a, b = jacobian_coefficients(dot(theta, theta))
    once = cross(theta, v)
    return add(difference(v, scaled(once, a)), scaled(cross(theta, once), b))


@compiled
def turned_jacobian_rate(theta: Vector, slope: Vector, v: Vector) -> Vector:
    """(d/dt J_r(theta)) v for theta' = ``slope``."""
    squared = dot(theta, theta)
    a, b = jacobian_coefficients(squared)
    a_rate, b_rate = _coefficient_rates(squared)
    along, once, turned = dot(theta, slope), cross(theta, v), cross(slope, v)
    first = difference(scaled(add(cross(slope, once), cross(theta, turned)), b), scaled(turned, a))
    second = difference(scaled(cross(theta, once), b_rate), scaled(once, a_rate))
    return add(first, scaled(second, along))


@compiled
def jacobian_coefficients(squared: float) -> tuple[float, float]:
    """A and B, from the squared angle."""
    if squared < SMALL:
        return (
            0.5 + squared * (-1 / 24 + squared * (1 / 720 - squared / 40320)),
            1 / 6 + squared * (-1 / 120 + squared * (1 / 5040 - squared / 362880)),
        )
    angle = sqrt(squared)
    return (1.0 - cos(angle)) / squared, (angle - sin(angle)) / (squared * angle)


@compiled
def inverse_coefficient(squared: float) -> float:
    """C in J_r^-1 = 1 + [theta] / 2 + C [theta]^2, which is 1 / a^2 - (1 + cos a) / (2 a sin a)."""
    if squared < SMALL:
        return 1 / 12 + squared * (1 / 720 + squared * (1 / 30240 + squared / 1209600))
    half = 0.5 * sqrt(squared)
    return (1.0 - half * cos(half) / sin(half)) / squared  # no division by sin a, which is 0 at half a turn


@compiled
def _coefficient_rates(squared: float) -> tuple[float, float]:
    """Derivatives of A and B by the angle, over the angle."""
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
