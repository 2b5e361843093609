"""Inverse velocity kinematics: joint velocities for a twist, the cheapest ones, and the multiplier that goes with them.

::

    minimise    1/2 qd' W qd + k grad_h' qd
    subject to  J qd = V_f ,   V_f = V with what a singularity has lost taken out

At full row rank the answer is the closed form of the notes (W = M(q) there, and k = 1 s)::

    qd     = J_W^+ V + (I - J_W^+ J) W^-1 (-k grad_h) ,    J_W^+ = W^-1 J' (J W^-1 J')^-1
    lambda = (J W^-1 J')^-1 (V + J W^-1 k grad_h) ,        W qd + k grad_h = J' lambda

Neither J W^-1 J' nor its inverse is formed: that squares the condition number (it costs 9 of 16 digits at a smallest
singular value of 1e-7). With D J = U S Y', D the row scale, N a basis of the null space of J::

    p         = Y S^-1 U' D V                      a velocity that gives the twist, from the singular values alone
    qd_task   = p - N (N' W N)^-1 N' W p           the cheapest of its kind
    qd_null   =   - N (N' W N)^-1 N' k grad_h      what the potential does with the freedom that is left
    lambda    = D U S^-1 Y' (W qd + k grad_h)

What the multiplier is: its first term, ``multiplier_task``, is the task-space momentum that takes the arm from rest to
V (N s and N m s where W = M); the notes call it a force, which it is not. Its second term, ``multiplier_potential``,
divided by k is a wrench: the one that acts *on* the tool and holds the unpowered arm against grad_h, as far as grad_h
lies in the range of J' (a six-joint arm: wholly; a redundant arm: in part, the rest drives the null-space motion).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled, elementwise
from ik_node.math.pseudoinverse import Decomposition, decompose, finite_matrix, positive_definite
from ik_node.math.se3 import vector
from ik_node.math.types import Array

IDENTITY = np.zeros((0, 0))
"""A weight W = I, of any size."""
NO_GRADIENT = np.zeros(0)
"""Where there is no potential."""


class Resolution(NamedTuple):
    """Joint velocities and what they were made of. Rows and multipliers follow the rows of J: linear part first."""

    joint_velocity: Array
    """qd = ``task_velocity`` + ``null_velocity``, (n,), rad/s (m/s)."""
    multiplier: Array
    """lambda = ``multiplier_task`` + ``multiplier_potential``, (m,), dual to the rows of J."""
    multiplier_task: Array
    """First term, (m,): a momentum where W is a mass matrix, not a force."""
    multiplier_potential: Array
    """Second term, (m,): ``gain`` times a wrench."""
    rank: int
    """Numerical rank of J: singular values above rounding."""
    residual: Array
    """V - J qd, (m,): what of the twist is not done, rounding included."""
    singular_values: Array
    """Of J with its rows times ``row_scale``, descending, (min(m, n),)."""
    fade: Array
    """phi, (min(m, n),): the part of V along each singular direction that was kept; 1 away from singularities."""
    attained: Array
    """V_f, (m,): the twist solved for, V exactly where nothing was lost."""
    task_velocity: Array
    """The part of qd that makes the twist, (n,)."""
    null_velocity: Array
    """The part of qd that follows the potential downhill and does not move the tool, (n,)."""
    gain: float
    """k that was used, s: the caller's, or less where ``null_space_cap`` asked for it."""


@compiled
def _smooth_fade(ratio: float) -> float:
    x = min(ratio, 1.0)
    return x * x * (3.0 - 2.0 * x)


_smooth_fades = elementwise(_smooth_fade)


def smooth_fade(ratio: Array) -> Array:
    """phi(x) = x^2 (3 - 2 x) for x < 1, 1 beyond: goes to 0 and 1 with zero slope. phi(x) / x <= 9/8."""
    return np.asarray(_smooth_fades(ratio))


def resolve(
    jacobian: ArrayLike,
    twist: ArrayLike,
    weight: ArrayLike | None = None,
    gradient: ArrayLike | None = None,
    gain: float = 0.0,
    *,
    threshold: float = 0.0,
    row_scale: ArrayLike | None = None,
    null_space_cap: ArrayLike | None = None,
    checked: bool = False,
    parts: Decomposition | None = None,
) -> Resolution:
    """Joint velocities qd that give ``twist`` V through ``jacobian`` J at the least cost; see the module.

    ``jacobian`` (m, n) and ``twist`` (m,) in one frame, any m and n. ``weight`` W (n, n), symmetric positive definite;
    None is the identity. ``gradient`` grad_h (n,) and ``gain`` k in s, >= 0. Methods of the node: ``plain`` W = None;
    ``inertia_weighted`` W = M(q); ``gravity_gradient`` and ``obstacle_gradient`` W = M(q) with their gradient.

    ``row_scale`` (m,), > 0: what the rows of J (and V) are multiplied with before singular values are taken, so that
    rotations compare with translations. It has no influence on qd where J has full row rank and nothing fades.

    ``threshold`` = 0: undamped. A rank-deficient J is truncated: the least V - J qd (rows scaled) first, least cost
    among those second, and of all multipliers the shortest. Tall J (m > n) is the same least squares problem; W then
    has no influence on qd.

    ``threshold`` > 0, in the unit of the singular values: directions below it fade out smoothly, so that
    V_f = sum phi(sigma_i / threshold) u_i u_i' V, and the length of qd is at most 9/8 of that of V over ``threshold``
    for ``plain`` (rows scaled). Both terms of the multiplier fade alike. A fading direction stays under the constraint:
    the potential gets it only at the singularity itself (below rounding), where it belongs to the null space of J.
    Where every singular value reaches ``threshold`` the answer is the undamped one, bit for bit.

    ``null_space_cap``, one or (n,), > 0, rad/s (m/s): k is lowered until no joint's ``null_velocity`` exceeds it. The
    answer is still the exact optimum, of the lower k.

    ``checked``: the arrays are float arrays of the right shapes and W is known to be positive definite; nothing is
    looked at again. NaN then comes out as NaN or as an InputError, never as a number. ``parts``: the decomposition of J
    with its rows times ``row_scale``, where the caller has it.

    Raises InputError naming the argument that has the wrong shape, is not finite, not positive (definite), or negative.
    """
    if checked:
        matrix, wanted = np.ascontiguousarray(jacobian), np.asarray(twist)
        m, n = matrix.shape
        mass = IDENTITY if weight is None else np.ascontiguousarray(weight)
        slope = NO_GRADIENT if gradient is None else np.asarray(gradient)
        scale = np.ones(m) if row_scale is None else np.asarray(row_scale)
        cap = np.full(n, np.inf) if null_space_cap is None else np.asarray(null_space_cap)
    else:
        matrix = np.ascontiguousarray(finite_matrix(jacobian, "jacobian"))
        m, n = matrix.shape
        wanted = vector(twist, m, "twist")
        mass = IDENTITY if weight is None else positive_definite(weight, n, "weight")
        slope = NO_GRADIENT if gradient is None else vector(gradient, n, "gradient")
        scale = np.ones(m) if row_scale is None else _positive(row_scale, m, "row_scale")
        cap = np.full(n, np.inf) if null_space_cap is None else _positive(null_space_cap, n, "null_space_cap")
        for name, number in (("gain", gain), ("threshold", threshold)):
            if not 0.0 <= number < np.inf:
                raise InputError(f"{name} is {number}; expected a number >= 0")
        if gain > 0.0 and gradient is None:
            raise InputError(f"gain is {gain} but there is no gradient")
    if parts is None:
        parts = decompose(scale[:, None] * matrix, "jacobian")
    return solution(matrix, wanted, mass, slope, float(gain), float(threshold), scale, cap, parts)


def _positive(values: ArrayLike, size: int, name: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    array = vector(np.full(size, array) if array.ndim == 0 else array, size, name)
    if array.min() <= 0.0:
        raise InputError(f"{name} is {array.tolist()}; expected numbers > 0")
    return array


@compiled
def solution(
    jacobian: Array,
    twist: Array,
    weight: Array,
    gradient: Array,
    gain: float,
    threshold: float,
    row_scale: Array,
    cap: Array,
    parts: Decomposition,
) -> Resolution:
    """:func:`resolve` of C-contiguous arrays that were checked. ``weight`` may be :data:`IDENTITY`, ``gradient``
    :data:`NO_GRADIENT`; ``parts`` are those of J with its rows times ``row_scale``."""
    m = len(jacobian)
    sigma, rank = parts.sigma, parts.rank
    left, rows, null = np.ascontiguousarray(parts.u[:, :rank]), parts.vt[:rank], parts.vt[rank:]
    fade, inverse = _filter(sigma, rank, threshold)
    along = (row_scale * twist) @ left

    # A direction's velocity is fade / sigma times the twist along it; its multiplier takes the same factor once more.
    task, potential, k = _null_space((inverse * along) @ rows, weight, gradient, gain, null, cap)
    moment = inverse * (rows @ (weight @ task)) if len(weight) else inverse * (inverse * along)
    multiplier_task = row_scale * (left @ moment)
    multiplier_potential = np.zeros(m)
    if k > 0.0:
        pull = k * gradient + weight @ potential if len(weight) else k * gradient
        multiplier_potential = row_scale * (left @ (inverse * (rows @ pull)))

    attained = twist
    if m > len(sigma) or fade[-1] < 1.0:
        attained = (left @ (fade[:rank] * along)) / row_scale
    velocity = task + potential
    return Resolution(
        velocity,
        multiplier_task + multiplier_potential,
        multiplier_task,
        multiplier_potential,
        rank,
        twist - jacobian @ velocity,
        sigma,
        fade,
        attained,
        task,
        potential,
        k,
    )


@compiled
def _filter(sigma: Array, rank: int, threshold: float) -> tuple[Array, Array]:
    """phi of every singular value, and phi / sigma of the first ``rank``: the directions under the constraint."""
    fade, inverse = np.zeros(len(sigma)), np.empty(rank)
    for i in range(rank):
        if sigma[i] < threshold:
            x = sigma[i] / threshold
            # phi / sigma without a division by a vanishing sigma.
            fade[i], inverse[i] = _smooth_fade(x), x * (3.0 - 2.0 * x) / threshold
        else:
            fade[i], inverse[i] = 1.0, 1.0 / sigma[i]
    return fade, inverse


@compiled
def _null_space(
    particular: Array, weight: Array, gradient: Array, gain: float, null: Array, cap: Array
) -> tuple[Array, Array, float]:
    """Task velocity, null-space velocity and the gain used; ``null`` holds a basis of the null space as rows."""
    still = np.zeros(len(particular))
    if len(null) == 0:
        return particular, still, gain
    weighted = null @ weight if len(weight) else null
    if len(weight):
        particular = particular - _reduced(weighted, null, weighted @ particular) @ null
    if gain <= 0.0 or len(gradient) == 0:
        return particular, still, 0.0
    step = _reduced(weighted, null, null @ gradient) @ null
    excess = 0.0
    for joint in range(len(step)):
        excess = max(excess, gain * abs(step[joint]) / cap[joint])
    if excess > 1.0:
        gain /= excess
    return particular, -gain * step, gain


@compiled
def _reduced(weighted: Array, null: Array, right: Array) -> Array:
    """(N' W N)^-1 ``right``; one dimension, the usual case, without the cost of a solver."""
    if len(null) == 1:
        return np.asarray(right / (weighted[0] @ null[0]))
    return np.asarray(np.linalg.solve(weighted @ null.T, right))
