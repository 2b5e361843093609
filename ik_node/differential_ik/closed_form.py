"""Differential inverse kinematics in closed form: the joint velocities of least cost for a twist, and the multiplier.

::

    minimise    1/2 qd' W qd + k grad_h' qd
    subject to  J qd = V_f ,   V_f = V without the part that a singularity truncates

At full row rank the solution is the closed form of the lecture notes (where W = M(q) and k = 1 s)::

    qd     = J_W^+ V + (I - J_W^+ J) W^-1 (-k grad_h) ,    J_W^+ = W^-1 J' (J W^-1 J')^-1
    lambda = (J W^-1 J')^-1 (V + J W^-1 k grad_h) ,        W qd + k grad_h = J' lambda

Neither J W^-1 J' nor its inverse is formed: that squares the condition number and costs 9 of 16 digits at a smallest
singular value of 1e-7. With D J = U S Y', D the row scale and N a basis of the null space of J::

    p         = Y S^-1 U' D V                      a velocity that gives the twist
    qd_task   = p - N (N' W N)^-1 N' W p           the one of least cost
    qd_null   =   - N (N' W N)^-1 N' k grad_h      the motion along the potential's descent in the null space
    lambda    = D U S^-1 Y' (W qd + k grad_h)

Meaning of the multiplier: the first term, ``multiplier_task``, is the task-space momentum that accelerates the arm from
rest to V (N s and N m s if W = M); the notes call it a force, which is an error. The second term,
``multiplier_potential``, divided by k is a wrench: the one that acts *on* the tool and holds the unpowered arm against
grad_h, as far as grad_h lies in the range of J' (entirely for a six-joint arm; in part for a redundant arm, where the
rest drives the null-space motion).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.numerics import (
    check_not_negative,
    checked_matrix,
    checked_positive_definite,
    checked_positive_vector,
    checked_vector,
    smoothstep,
    smoothstep_ratio,
)
from ik_node.math.pseudoinverse import Decomposition, decompose
from ik_node.math.types import Array

IDENTITY = np.zeros((0, 0))
"""Stands for the weight W = I of any size."""
NO_GRADIENT = np.zeros(0)
"""Stands for the gradient of no potential."""


class ClosedFormSolution(NamedTuple):
    """Joint velocities and their parts. Multipliers have the order of the rows of J: linear part first."""

    joint_velocity: Array
    """qd = ``task_velocity`` + ``null_velocity``, (n,), rad/s (m/s)."""
    multiplier: Array
    """lambda = ``multiplier_task`` + ``multiplier_potential``, (m,), dual to the rows of J."""
    multiplier_task: Array
    """First term, (m,): a momentum if W is a mass matrix, not a force."""
    multiplier_potential: Array
    """Second term, (m,): ``gain`` times a wrench."""
    rank: int
    """Numerical rank of J: number of singular values above rounding."""
    residual: Array
    """V - J qd, (m,): the part of the twist that is not executed, including rounding."""
    singular_values: Array
    """Of J with its rows times ``row_scale``, descending, (min(m, n),)."""
    attained: Array
    """V_f, (m,): the twist of the constraint; exactly V if nothing is truncated."""
    task_velocity: Array
    """The part of qd that gives the twist, (n,)."""
    null_velocity: Array
    """The part of qd that descends the potential and does not move the tool, (n,)."""
    gain: float
    """k that was used, s: the argument, or less because of ``null_space_cap``."""


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
    svd: Decomposition | None = None,
) -> ClosedFormSolution:
    """Joint velocities of least cost for a twist, without limits; see the module for the problem and its solution.

    With ``threshold`` = 0 the solution is undamped. A rank-deficient J is truncated: first the least \\|V - J qd\\|
    (rows scaled), second the least cost, and the shortest of all multipliers. A tall J (m > n) is the same least
    squares problem, and W does not influence qd.

    With ``threshold`` > 0 the directions below it fade out: V_f = sum phi(sigma_i / threshold) u_i u_i' V with phi the
    smoothstep, so that for W = I \\|qd\\| <= 9/8 \\|V\\| / threshold (rows scaled). Both terms of the multiplier fade
    equally. A fading direction remains in the constraint: the potential acts on it only at the singularity itself
    (below rounding), where it belongs to the null space of J. If every singular value reaches ``threshold``, the
    solution equals the undamped one bit for bit.

    Args:
        jacobian: J, (m, n), of any shape.
        twist: V, (m,), in the frame of J, m/s and rad/s.
        weight: W, (n, n), symmetric positive definite; None is the identity. :data:`ik_node.METHODS` has choices.
        gradient: grad_h, (n,), N m (N); None is zero.
        gain: k, >= 0, s.
        threshold: >= 0, in the unit of the singular values.
        row_scale: Factors of the rows of J and V, (m,), > 0, before singular values are computed, so that rotations are
            comparable with translations. Without influence on qd if J has full row rank and nothing fades.
        null_space_cap: One number or (n,), > 0, rad/s (m/s): k is lowered until no joint's ``null_velocity`` exceeds
            it. The solution is the exact optimum of the lower k.
        checked: True if all arrays are float arrays of the right shapes and W is positive definite; they are not
            checked again. NaN then results in NaN or in InputError, never in a finite number.
        svd: Decomposition of J with its rows times ``row_scale``, if it is known already.

    Raises:
        InputError: An argument, which is named, has the wrong shape, is not finite, not positive (definite) or
            negative.
    """
    if checked:
        matrix, wanted = np.ascontiguousarray(jacobian), np.asarray(twist)
        m, n = matrix.shape
        mass = IDENTITY if weight is None else np.ascontiguousarray(weight)
        slope = NO_GRADIENT if gradient is None else np.asarray(gradient)
        scale = np.ones(m) if row_scale is None else np.asarray(row_scale)
        cap = np.full(n, np.inf) if null_space_cap is None else np.asarray(null_space_cap)
    else:
        matrix = np.ascontiguousarray(checked_matrix(jacobian, "jacobian"))
        m, n = matrix.shape
        wanted = checked_vector(twist, m, "twist")
        mass = IDENTITY if weight is None else checked_positive_definite(weight, n, "weight")
        slope = NO_GRADIENT if gradient is None else checked_vector(gradient, n, "gradient")
        scale = np.ones(m) if row_scale is None else checked_positive_vector(row_scale, m, "row_scale")
        cap = (
            np.full(n, np.inf)
            if null_space_cap is None
            else checked_positive_vector(null_space_cap, n, "null_space_cap")
        )
        check_not_negative(gain=gain, threshold=threshold)
        if gain > 0.0 and gradient is None:
            raise InputError(f"gain is {gain} but there is no gradient")
    if svd is None:
        svd = decompose(scale[:, None] * matrix, "jacobian")
    return closed_form(matrix, wanted, mass, slope, float(gain), float(threshold), scale, cap, svd)


@compiled
def closed_form(
    jacobian: Array,
    twist: Array,
    weight: Array,
    gradient: Array,
    gain: float,
    threshold: float,
    row_scale: Array,
    cap: Array,
    svd: Decomposition,
) -> ClosedFormSolution:
    """:func:`resolve`, compiled, for checked C-contiguous arrays.

    ``weight`` may be :data:`IDENTITY` and ``gradient`` :data:`NO_GRADIENT`; ``svd`` is that of J with its rows times
    ``row_scale``.
    """
    m = len(jacobian)
    sigma, rank = svd.sigma, svd.rank
    left, rows, null = np.ascontiguousarray(svd.u[:, :rank]), svd.vt[:rank], svd.vt[rank:]
    fade, inverse = _filter(sigma, rank, threshold)
    along = (row_scale * twist) @ left

    # The velocity along a direction is fade / sigma times the twist along it; the multiplier has that factor twice.
    task, potential, k = _null_space((inverse * along) @ rows, weight, gradient, gain, null, cap)
    momentum = inverse * (rows @ (weight @ task)) if len(weight) else inverse * (inverse * along)
    multiplier_task = row_scale * (left @ momentum)
    multiplier_potential = np.zeros(m)
    if k > 0.0:
        pull = k * gradient + weight @ potential if len(weight) else k * gradient
        multiplier_potential = row_scale * (left @ (inverse * (rows @ pull)))

    attained = twist
    if m > len(sigma) or fade[-1] < 1.0:
        attained = (left @ (fade[:rank] * along)) / row_scale
    velocity = task + potential
    return ClosedFormSolution(
        velocity,
        multiplier_task + multiplier_potential,
        multiplier_task,
        multiplier_potential,
        rank,
        twist - jacobian @ velocity,
        sigma,
        attained,
        task,
        potential,
        k,
    )


@compiled
def _filter(sigma: Array, rank: int, threshold: float) -> tuple[Array, Array]:
    """phi of every singular value, and phi / sigma of the first ``rank`` (the directions of the constraint)."""
    fade, inverse = np.zeros(len(sigma)), np.empty(rank)
    for i in range(rank):
        if sigma[i] < threshold:
            x = sigma[i] / threshold
            # phi / sigma without a division by a vanishing sigma.
            fade[i], inverse[i] = smoothstep(x), smoothstep_ratio(x) / threshold
        else:
            fade[i], inverse[i] = 1.0, 1.0 / sigma[i]
    return fade, inverse


@compiled
def _null_space(
    particular: Array, weight: Array, gradient: Array, gain: float, null: Array, cap: Array
) -> tuple[Array, Array, float]:
    """Task velocity, null-space velocity and the gain that was used; ``null`` is a basis of the null space (rows)."""
    zero = np.zeros(len(particular))
    if len(null) == 0:
        return particular, zero, gain
    weighted = null @ weight if len(weight) else null
    if len(weight):
        particular = particular - _reduced_solve(weighted, null, weighted @ particular) @ null
    if gain <= 0.0 or len(gradient) == 0:
        return particular, zero, 0.0
    step = _reduced_solve(weighted, null, null @ gradient) @ null
    excess = 0.0
    for joint in range(len(step)):
        excess = max(excess, gain * abs(step[joint]) / cap[joint])
    if excess > 1.0:
        gain /= excess
    return particular, -gain * step, gain


@compiled
def _reduced_solve(weighted: Array, null: Array, right: Array) -> Array:
    """(N' W N)^-1 ``right``; a null space of one dimension, the usual case, needs no linear solver."""
    if len(null) == 1:
        return np.asarray(right / (weighted[0] @ null[0]))
    return np.asarray(np.linalg.solve(weighted @ null.T, right))
