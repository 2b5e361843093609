"""Root finding and inverse kinematics by Newton-Raphson, as in the notes, with an honest account of every iterate.

::

    g(theta) = 0 :               theta <- theta - J_g^+ g(theta)                      find_root
    x_d - f(theta) = 0 :         theta <- theta + J^+ (x_d - f(theta))                solve_coordinates
    T_sb(theta) = T_sd :         theta <- theta + J_b^+ log(T_sb(theta)^-1 T_sd)      solve_pose

The notes set the error once, before the loop, and give the loop no end; here it is computed anew in every iteration and
iterations are capped. Convergence is local: from a start that is not close, the method may end at another root or
nowhere, and the result then says which. J^+ is truncated where J loses rank, so that an iterate on a singularity goes
on in the directions that are left.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError, UnknownNameError
from ik_node.math import se3
from ik_node.math.pseudoinverse import EPSILON, apply
from ik_node.math.types import Array
from ik_node.robot.screw_chain import KinematicChain, fold, wrap_angle

Function = Callable[[Array], ArrayLike]

DIVERGED_BEYOND = 1e8
"""An iterate with an entry beyond this (rad, m) has diverged."""
FORMS = ("body", "space")
"""In which frame :func:`solve_pose` writes twist and Jacobian."""


class Reason(Enum):
    """Why an iteration ended."""

    CONVERGED = "converged"
    CAP = "cap"
    """The iterations allowed were used up."""
    STALLED = "stalled"
    """No step reduces the error though J has full rank: the nearest that can be reached, or a local minimum."""
    DIVERGED = "diverged"
    """The iterates, or the function's values, left every bound."""
    SINGULAR = "singular"
    """J has lost rank and nothing of the error is left in its range: no step to take."""
    LIMITS = "limits"
    """The pose is reached, but only by joint positions outside their limits."""


class Iterate(NamedTuple):
    """One row of the iteration table."""

    theta: Array
    """theta^i, (n,)."""
    value: Array
    """g(theta^i), (m,)."""
    norm: float
    """Its 2-norm."""


class Root(NamedTuple):
    """What root finding came to."""

    converged: bool
    reason: Reason
    theta: Array
    """The last finite iterate, (n,); turns of 2 pi taken off where asked for."""
    iterates: tuple[Iterate, ...]
    """Every one, the start first: ``len(iterates) - 1`` steps were taken."""


class PoseIterate(NamedTuple):
    """One row of the notes' table."""

    theta: Array
    """theta^i, (n,), rad (m)."""
    pose_sb: Array
    """T_sb(theta^i), (4, 4)."""
    twist: Array
    """log(T_bd), (6,), linear part first: V_b, or V_s = Ad(T_sb) V_b in the space form."""
    norm_omega: float
    """Length of its angular part, rad."""
    norm_v: float
    """Length of its linear part, m."""


class PoseSolution(NamedTuple):
    """What inverse kinematics came to."""

    converged: bool
    """The pose of ``q`` is within both tolerances and ``q`` within the joint limits."""
    reason: Reason
    q: Array
    """The solution, (n,): turns of 2 pi added where a revolute joint needs them to be within its limits (or in
    -pi..pi without limits). Not converged: the best that was found."""
    iterates: tuple[PoseIterate, ...]
    """Those of the search that ended at ``q``, the start first; joint positions as they came, without wrapping."""
    iterations: int
    """Steps taken in all searches together."""
    searches: int
    """Starts used."""


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
) -> Root:
    """theta (n,) with g(theta) = 0 from ``start`` by theta <- theta - J_g^+ g (notes 2.1), g of any size m.

    ``function`` g; ``jacobian`` of g (m, n), by central differences when None. Converged: 2-norm of g <= ``tolerance``.
    ``cutoff`` leaves out singular values up to it (the truncated step), ``damping`` > 0 takes the damped one. Where
    ``wrapped`` (n,) is True the result is brought into -pi..pi; the iterates are not.

    Raises InputError naming ``start``, ``tolerance``, ``max_iterations``, or the function whose shape does not fit. A
    value that is not finite is no error but Reason.DIVERGED.
    """
    theta = _start(start)
    _check_number("tolerance", tolerance)
    _check_count("max_iterations", max_iterations)
    slope = jacobian or _central_differences(function)
    iterates: list[Iterate] = []
    while True:
        value = _value(function, theta)
        norm = float(np.linalg.norm(value))
        iterates.append(Iterate(theta, value, norm))
        if norm <= tolerance:
            reason = Reason.CONVERGED
            break
        if not np.isfinite(norm) or np.abs(theta).max() > DIVERGED_BEYOND:
            reason = Reason.DIVERGED
            break
        if len(iterates) > max_iterations:
            reason = Reason.CAP
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
    return Root(reason is Reason.CONVERGED, reason, theta, tuple(iterates))


def solve_coordinates(
    x_d: ArrayLike, forward: Function, start: ArrayLike, jacobian: Function | None = None, *, tolerance: float = 1e-10,
    max_iterations: int = 100, wrapped: ArrayLike | None = None,
) -> Root:  # fmt: skip
    """theta (n,) with f(theta) = ``x_d`` (m,) by theta <- theta + J^+ (x_d - f) (notes 2.2, coordinate form).

    ``forward`` f and its ``jacobian`` J (m, n), by central differences when None; the rest as in :func:`find_root`. In
    the iterates ``value`` is e = x_d - f(theta).
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


def solve_pose(
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
    """theta with T_sb(theta) = ``pose_sd`` by full Newton-Raphson steps from ``start`` (notes 2.2, body-twist form).

    Steps while the angular part of V_b is longer than ``eps_omega`` [rad] or the linear part than ``eps_v`` [m]; the
    defaults are those of Example 6.1. ``form`` ``space`` takes J_s^+ and V_s instead, and measures V_s: the same steps
    where J has full row rank, others for n < 6, where least squares depend on the frame. ``cutoff`` leaves out singular
    values up to it. Limits have no say in the steps; a result outside them is not converged (Reason.LIMITS).

    Raises InputError naming ``pose_sd`` (more than 1e-3 off SE(3), not finite), ``start``, a tolerance or a cap, and
    UnknownNameError for ``form``. :func:`ik_node.inverse_kinematics.pose_solver.solve` is the robust, faster relative of this.
    """
    target = se3.checked_pose(pose_sd, "pose_sd")
    theta = se3.vector(start, chain.n, "start")
    _check_number("eps_omega", eps_omega)
    _check_number("eps_v", eps_v)
    _check_count("max_iterations", max_iterations)
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
            reason = Reason.CONVERGED
            break
        if np.abs(theta).max() > DIVERGED_BEYOND:
            reason = Reason.DIVERGED
            break
        if len(iterates) > max_iterations:
            reason = Reason.CAP
            break
        following, stopped = _newton_step(theta, jacobian, twist, cutoff, 0.0)
        if stopped is not None:
            reason = stopped
            break
        theta = following
    q, inside = fold(theta, chain)
    if reason is Reason.CONVERGED and not inside:
        reason = Reason.LIMITS
    return PoseSolution(reason is Reason.CONVERGED, reason, q, tuple(iterates), len(iterates) - 1, 1)


def pose_iterate(theta: Array, pose_sb: Array, twist: Array) -> PoseIterate:
    """A row of the table with its norms."""
    v, omega = twist[:3], twist[3:]
    return PoseIterate(theta, pose_sb, twist, float(np.sqrt(omega @ omega)), float(np.sqrt(v @ v)))


def _newton_step(
    theta: Array, matrix: Array, error: Array, cutoff: float, damping: float
) -> tuple[Array, Reason | None]:
    """theta + J^+ error; or theta as it was, with the reason, where that leads nowhere."""
    if not np.isfinite(matrix).all():
        return theta, Reason.DIVERGED
    step, rank = apply(matrix, error, cutoff=cutoff, damping=damping)
    following = theta + step
    if not np.isfinite(following).all():
        return theta, Reason.DIVERGED
    if np.abs(step).max() <= 4.0 * EPSILON * max(1.0, float(np.abs(theta).max())):
        return theta, Reason.STALLED if rank == min(matrix.shape) else Reason.SINGULAR
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
    """The Jacobian of ``function`` by central differences: error about 1e-10 of the function's scale."""

    def slope(theta: Array) -> Array:
        columns = []
        for index in range(len(theta)):
            step = np.zeros(len(theta))
            step[index] = EPSILON ** (1.0 / 3.0) * max(1.0, abs(float(theta[index])))
            columns.append((_value(function, theta + step) - _value(function, theta - step)) / (2.0 * step[index]))
        return np.stack(columns, axis=1)

    return slope


def _check_number(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise InputError(f"{name} is {value}; expected a number > 0")


def _check_count(name: str, value: int) -> None:
    if value < 0:
        raise InputError(f"{name} is {value}; expected a count >= 0")
