"""Root finding and inverse kinematics by Newton-Raphson, as in the lecture notes, with a record of every iterate.

::

    g(theta) = 0 :               theta <- theta - J_g^+ g(theta)                      find_root
    x_d - f(theta) = 0 :         theta <- theta + J^+ (x_d - f(theta))                solve_coordinates
    T_sb(theta) = T_sd :         theta <- theta + J_b^+ log(T_sb(theta)^-1 T_sd)      solve_pose_newton

The notes compute the error once, before the loop, and do not bound the loop; here it is computed in every iteration,
and the number of iterations is bounded. Convergence is local: from a distant start the method may end at another root
or diverge, and the result states the reason. J^+ is truncated where J loses rank, so that an iterate at a singularity
continues in the remaining directions.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError, UnknownNameError
from ik_node.math import se3
from ik_node.math.numerics import check_count, check_positive, checked_vector
from ik_node.math.pseudoinverse import EPSILON, apply_pseudoinverse
from ik_node.math.types import Array
from ik_node.robot.screw_chain import KinematicChain, wrap_angle, wrap_into_limits

Function = Callable[[Array], ArrayLike]

DIVERGED_BEYOND = 1e8
"""An iterate with an entry beyond this, rad (m), has diverged."""
FORMS = ("body", "space")
"""Frames in which :func:`solve_pose_newton` expresses twist and Jacobian."""


class TerminationReason(Enum):
    """Why an iteration ended."""

    CONVERGED = "converged"
    CAP = "cap"
    """The maximum number of iterations was reached."""
    STALLED = "stalled"
    """No step reduces the error although J has full rank: the nearest reachable pose, or a local minimum."""
    DIVERGED = "diverged"
    """An iterate or a value of the function is not finite or too large."""
    SINGULAR = "singular"
    """J has lost rank and the error has no component in its range: there is no step."""
    LIMITS = "limits"
    """The pose is reached only by joint positions outside their limits."""


class RootIterate(NamedTuple):
    """One iterate of root finding."""

    theta: Array
    """theta^i, (n,)."""
    value: Array
    """g(theta^i), (m,)."""
    norm: float
    """2-norm of ``value``."""


class RootSolution(NamedTuple):
    """The result of root finding."""

    converged: bool
    reason: TerminationReason
    theta: Array
    """The last finite iterate, (n,), wrapped into -pi..pi where requested."""
    iterates: tuple[RootIterate, ...]
    """All iterates, the start first: the number of steps is ``len(iterates) - 1``."""


class PoseIterate(NamedTuple):
    """One iterate of inverse kinematics: a row of the notes' table."""

    theta: Array
    """theta^i, (n,), rad (m)."""
    pose_sb: Array
    """T_sb(theta^i), (4, 4)."""
    twist: Array
    """log(T_bd), (6,), linear part first: V_b, or V_s = Ad(T_sb) V_b in the space form. With a tolerance: the error to
    the nearest pose within it, in the axes of the tolerance.
    """
    norm_omega: float
    """Length of its angular part, rad."""
    norm_v: float
    """Length of its linear part, m."""


class PoseSolution(NamedTuple):
    """The result of inverse kinematics."""

    converged: bool
    """True if the pose of ``q`` has both accuracies and ``q`` is within the joint limits."""
    reason: TerminationReason
    q: Array
    """The solution, (n,), rad (m); multiples of 2 pi are added where a revolute joint needs them to be within its
    limits (or in -pi..pi without limits). If not converged: the best joint positions found.
    """
    iterates: tuple[PoseIterate, ...]
    """The iterates of the search that ended at ``q``, the start first, without wrapping."""
    iterations: int
    """Number of steps of all searches together."""
    searches: int
    """Number of searches."""


def find_root(
    function: Function,
    start: ArrayLike,
    jacobian: Function | None = None,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
    cutoff: float = 0.0,
    damping: float = 0.0,
    wrapped: ArrayLike | None = None,
) -> RootSolution:
    """Solves g(theta) = 0 by theta <- theta - J_g^+ g (lecture notes, section 2.1).

    Args:
        function: g, from theta (n,) to (m,); m and n are arbitrary.
        start: The first iterate, (n,).
        jacobian: J_g, from theta to (m, n); central differences if None.
        tolerance: 2-norm of g at which the iteration has converged.
        max_iterations: Maximum number of steps.
        cutoff: Singular values up to this one are truncated in the step.
        damping: > 0 for a damped step, in the unit of J_g.
        wrapped: (n,), True for entries of the result that are wrapped into -pi..pi; the iterates are not.

    Raises:
        InputError: ``start``, ``tolerance`` or ``max_iterations`` is invalid, or a function has the wrong shape. A
            value that is not finite is not an error but TerminationReason.DIVERGED.
    """
    theta = _start(start)
    check_positive(tolerance=tolerance)
    check_count(max_iterations=max_iterations)
    slope = jacobian or _central_differences(function)
    iterates: list[RootIterate] = []
    while True:
        value = _value(function, theta)
        norm = float(np.linalg.norm(value))
        iterates.append(RootIterate(theta, value, norm))
        if norm <= tolerance:
            reason = TerminationReason.CONVERGED
            break
        if not np.isfinite(norm) or np.abs(theta).max() > DIVERGED_BEYOND:
            reason = TerminationReason.DIVERGED
            break
        if len(iterates) > max_iterations:
            reason = TerminationReason.CAP
            break
        matrix = np.asarray(slope(theta), dtype=np.float64)
        matrix = matrix.reshape(1, 1) if matrix.size == 1 else matrix
        if matrix.shape != (len(value), len(theta)):
            raise InputError(f"jacobian has shape {matrix.shape}, expected ({len(value)}, {len(theta)})")
        following, stopped = _newton_step(theta, matrix, -value, cutoff, damping)
        if stopped is not None:
            reason = stopped
            break
        theta = following
    if wrapped is not None:
        theta = np.where(np.asarray(wrapped, dtype=bool), wrap_angle(theta), theta)
    return RootSolution(reason is TerminationReason.CONVERGED, reason, theta, tuple(iterates))


def solve_coordinates(
    x_d: ArrayLike, forward: Function, start: ArrayLike, jacobian: Function | None = None, *, tolerance: float = 1e-10,
    max_iterations: int = 100, wrapped: ArrayLike | None = None,
) -> RootSolution:  # fmt: skip
    """Solves f(theta) = x_d by theta <- theta + J^+ (x_d - f) (lecture notes, section 2.2, coordinate form).

    Args:
        x_d: Desired coordinates, (m,).
        forward: f, from theta (n,) to (m,).
        start: The first iterate, (n,).
        jacobian: J of f, (m, n); central differences if None.
        tolerance: As in :func:`find_root`.
        max_iterations: As in :func:`find_root`.
        wrapped: As in :func:`find_root`.

    Returns:
        The result; ``value`` of its iterates is e = x_d - f(theta).

    Raises:
        InputError: As in :func:`find_root`, or ``x_d`` is invalid.
    """
    wanted = np.atleast_1d(np.asarray(x_d, dtype=np.float64))
    if wanted.ndim != 1 or not np.isfinite(wanted).all():
        raise InputError(f"x_d is {wanted.tolist()}; expected finite numbers (m,)")

    def error(theta: Array) -> Array:
        reached = _value(forward, theta)
        if reached.shape != wanted.shape:
            raise InputError(f"f(theta) has shape {reached.shape}, x_d {wanted.shape}")
        return np.asarray(wanted - reached)

    slope = jacobian or _central_differences(forward)
    return find_root(
        error, start, lambda theta: -np.asarray(slope(theta), dtype=np.float64), tolerance=tolerance,
        max_iterations=max_iterations, wrapped=wrapped,
    )  # fmt: skip


def solve_pose_newton(
    chain: KinematicChain,
    pose_sd: ArrayLike,
    start: ArrayLike,
    *,
    eps_omega: float = 1e-3,
    eps_v: float = 1e-4,
    max_iterations: int = 100,
    form: str = "body",
    cutoff: float = 0.0,
) -> PoseSolution:
    """Solves T_sb(theta) = T_sd by full Newton-Raphson steps (lecture notes, section 2.2, body-twist form).

    Joint limits do not influence the steps. :func:`ik_node.inverse_kinematics.pose_solver.solve_pose` respects them, is
    faster, and restarts.

    Args:
        chain: A Robot or a ScrewChain.
        pose_sd: T_sd, (4, 4).
        start: The first iterate, (n,), rad (m).
        eps_omega: Tolerance of the angular part of V_b, rad; the default is that of Example 6.1.
        eps_v: Tolerance of the linear part of V_b, m.
        max_iterations: Maximum number of steps.
        form: ``body``; or ``space``, which uses J_s^+ and V_s and applies the tolerances to V_s. The steps are equal if
            J has full row rank, and differ for n < 6, where least squares depend on the frame.
        cutoff: Singular values up to this one are truncated in the step.

    Returns:
        The result; outside the joint limits it is not converged (TerminationReason.LIMITS).

    Raises:
        InputError: ``pose_sd`` is more than 1e-3 away from SE(3) or not finite; ``start``, a tolerance or
            ``max_iterations`` is invalid.
        UnknownNameError: ``form`` is unknown.
    """
    target = se3.checked_pose(pose_sd, "pose_sd")
    theta = checked_vector(start, chain.n, "start")
    check_positive(eps_omega=eps_omega, eps_v=eps_v)
    check_count(max_iterations=max_iterations)
    if form not in FORMS:
        raise UnknownNameError("form", form, FORMS)
    iterates: list[PoseIterate] = []
    while True:
        pose, jacobian = chain.evaluate(theta)
        twist = se3.log(se3.inverse(pose) @ target)
        if form == "space":
            to_space = se3.adjoint(pose)
            twist, jacobian = to_space @ twist, to_space @ jacobian
        iterates.append(pose_iterate(theta, pose, twist))
        if iterates[-1].norm_omega <= eps_omega and iterates[-1].norm_v <= eps_v:
            reason = TerminationReason.CONVERGED
            break
        if np.abs(theta).max() > DIVERGED_BEYOND:
            reason = TerminationReason.DIVERGED
            break
        if len(iterates) > max_iterations:
            reason = TerminationReason.CAP
            break
        following, stopped = _newton_step(theta, jacobian, twist, cutoff, 0.0)
        if stopped is not None:
            reason = stopped
            break
        theta = following
    q, inside = wrap_into_limits(theta, chain)
    if reason is TerminationReason.CONVERGED and not inside:
        reason = TerminationReason.LIMITS
    return PoseSolution(reason is TerminationReason.CONVERGED, reason, q, tuple(iterates), len(iterates) - 1, 1)


def pose_iterate(theta: Array, pose_sb: Array, twist: Array) -> PoseIterate:
    """An iterate with the norms of its twist."""
    v, omega = twist[:3], twist[3:]
    return PoseIterate(theta, pose_sb, twist, float(np.sqrt(omega @ omega)), float(np.sqrt(v @ v)))


def _newton_step(
    theta: Array, matrix: Array, error: Array, cutoff: float, damping: float
) -> tuple[Array, TerminationReason | None]:
    """theta + J^+ error; or the unchanged theta and the reason why there is no step."""
    if not np.isfinite(matrix).all():
        return theta, TerminationReason.DIVERGED
    step, rank = apply_pseudoinverse(matrix, error, cutoff=cutoff, damping=damping)
    following = theta + step
    if not np.isfinite(following).all():
        return theta, TerminationReason.DIVERGED
    if np.abs(step).max() <= 4.0 * EPSILON * max(1.0, float(np.abs(theta).max())):
        return theta, TerminationReason.STALLED if rank == min(matrix.shape) else TerminationReason.SINGULAR
    return following, None


def _start(values: ArrayLike) -> Array:
    theta = np.atleast_1d(np.array(values, dtype=np.float64))
    if theta.ndim != 1 or theta.size == 0 or not np.isfinite(theta).all():
        raise InputError(f"start is {theta.tolist()}; expected finite numbers (n,)")
    return theta


def _value(function: Function, theta: Array) -> Array:
    value = np.atleast_1d(np.asarray(function(theta), dtype=np.float64))
    if value.ndim != 1:
        raise InputError(f"g(theta) has shape {value.shape}, expected (m,)")
    return value


def _central_differences(function: Function) -> Callable[[Array], Array]:
    """The Jacobian of ``function`` by central differences; the error is about 1e-10 of the function's scale."""

    def slope(theta: Array) -> Array:
        columns = []
        for index in range(len(theta)):
            step = np.zeros(len(theta))
            step[index] = EPSILON ** (1.0 / 3.0) * max(1.0, abs(float(theta[index])))
            columns.append((_value(function, theta + step) - _value(function, theta - step)) / (2.0 * step[index]))
        return np.stack(columns, axis=1)

    return slope
