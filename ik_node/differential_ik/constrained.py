"""Differential inverse kinematics under limits: the problem of ``closed_form`` with bounds on qd and velocity dampers.

::

    minimise    1/2 qd' W qd + k grad_h' qd
    subject to  J qd = J qd_0 + (s - s_0) V_f ,      s in [0, 1] as near to s_wish as possible
                lo <= qd <= hi                       velocity, position and acceleration limits of this control step
                N qd >= c                            velocity dampers, if there are any

qd_0 is the point inside box and dampers that is nearest to the ray of joint velocities that move the tool along V_f:
the one of least ||J qd - s V_f||, s in [0, 1]. If the box contains zero, qd_0 = 0, s_0 = 0, and the constraint is
J qd = s V_f. If it does not (a moving arm cannot stop within one control step), the tool still moves along V_f, but
slower, if the box permits it, and otherwise along the nearest direction. (With the point nearest to zero velocity as
qd_0, all joints decelerate equally at each control step, and a tool that a limit slows down leaves its path, by 12
degrees in a test.)

If no constraint binds, the solution is that of :func:`ik_node.differential_ik.closed_form.resolve`. Otherwise the
singular value decomposition of J turns the equality into qd = qd_0 + (s - s_0) p + Z' z, with Z a basis of the null
space of J (rows), and there are two stages:

1. s: a linear program in (s, z);
2. z at that s: a quadratic program in the null space.

Both are solved in compiled code (:func:`ik_node.differential_ik.compiled_step.solve_limited`): null spaces of dimension
0 and 1 without bands by :mod:`ik_node.differential_ik.exact_program`, others by
:mod:`ik_node.differential_ik.active_set`. If the box has no multiple of V_f, or zero violates a damper, larger null
spaces are left to DAQP (:mod:`ik_node.differential_ik.quadratic_program`), whose answers are checked; if one fails its
check, the closed form is shortened towards qd_0 until it fits.

Bands of a task (:mod:`ik_node.differential_ik.task_rows`) are rows r_i qd >= s v_i: with s as one more coordinate of
qd they are rows of the same programs. At s = 0 they permit qd = 0, so that s decreases where limits contradict them.

When constraints conflict they are relaxed in this order, each by the least amount: the cost, s, the direction, the
dampers. The box is never relaxed; it is never empty (:mod:`ik_node.robot.joint_limits`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import quadratic_program
from ik_node.differential_ik.closed_form import IDENTITY, ClosedFormSolution, resolve
from ik_node.differential_ik.compiled_step import LIMITED, LOWER, POSITION, active_sides, solve_limited
from ik_node.differential_ik.exact_program import (
    BINDING,
    ROUNDING,
    ProgramSolution,
    TaskLine,
    cost_along,
    feasible_at_base,
    program_along,
    smallest_ratio,
    solve_exactly,
    task_line,
    unit_rows,
)
from ik_node.differential_ik.task_rows import TaskBands
from ik_node.errors import InputError
from ik_node.math.pseudoinverse import Decomposition, decompose
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, cause, relaxed

MIN_SLACK = 1e-9
"""Slack from which a damper counts as relaxed, m/s."""

MIN_OFF_DIRECTION = 1e-8
"""Components of J qd - s V_f up to this, m/s or rad/s, are rounding."""


class ConstrainedSolution(NamedTuple):
    """The optimum under limits, and the constraints that are active or relaxed."""

    joint_velocity: Array
    """qd, (n,), rad/s (m/s): exactly within the box."""
    task_scale: float
    """s: the fraction of V_f that is executed."""
    base_velocity: Array
    """qd_0, (n,)."""
    base_scale: float
    """s_0."""
    attained: Array
    """J qd, (m,)."""
    sides: NDArray[np.int8]
    """Active constraints, as in :class:`ik_node.differential_ik.compiled_step.LimitedSolution`."""
    damper_slack: Array
    """By how much each damper was relaxed, (k,), m/s; 0 nearly always."""
    fallback: bool
    """True if the solver's answer failed its check and the closed form was shortened."""
    unconstrained: ClosedFormSolution
    """The closed form without box and dampers: singular values, rank, multiplier, the gain that was used."""

    @property
    def binds(self) -> bool:
        """True if a limit or a damper changed the solution."""
        return bool(self.sides.any())

    def leaves_direction(self, twist: Array) -> bool:
        """True if the limits permit no multiple of ``twist`` (m,)."""
        return bool(np.abs(self.attained - self.task_scale * twist).max() > MIN_OFF_DIRECTION)

    def binding(
        self, bounds: JointBounds, joints: tuple[str, ...], dampers: VelocityDampers | None = None
    ) -> tuple[str, ...]:
        """Names of the active constraints, such as ``velocity panda_joint4`` or ``damper panda_link7 - post``."""
        return binding_names(self.sides, bounds, joints, () if dampers is None else dampers.names)


def binding_names(
    sides: NDArray[np.int8], bounds: JointBounds, joints: tuple[str, ...], dampers: tuple[str, ...]
) -> tuple[str, ...]:
    """Names of active constraints: ``velocity``, ``acceleration`` or ``position`` and a joint, ``damper`` and a pair.

    For a joint whose box is a single point the limit of the lower end is named.
    """
    active, n = np.flatnonzero(sides).tolist(), len(joints)
    limits = [
        "position" if sides[joint] & POSITION else cause(bounds, joint, not sides[joint] & LOWER)
        for joint in active
        if joint < n
    ]
    names = [f"{limit} {joints[joint]}" for limit, joint in zip(limits, active, strict=False)]
    return (*names, *(f"damper {dampers[row - n]}" for row in active if row >= n))


def relaxed_names(
    limited: ConstrainedSolution, bounds: JointBounds, joints: tuple[str, ...], dampers: VelocityDampers | None
) -> tuple[str, ...]:
    """Names of the limits and dampers that were relaxed because stronger ones contradict them.

    Args:
        limited: The solution.
        bounds: Limits of this control step.
        joints: Names of the joints.
        dampers: Velocity dampers.
    """
    names = relaxed(bounds, joints)
    if dampers is None:
        return names
    indices = np.flatnonzero(limited.damper_slack > MIN_SLACK).tolist()
    return (*names, *(f"damper {dampers.names[index]}" for index in indices))


def solve(
    jacobian: Array,
    twist: Array,
    lo: Array,
    hi: Array,
    weight: Array | None = None,
    gradient: Array | None = None,
    gain: float = 0.0,
    *,
    row_scale: Array | None = None,
    null_space_cap: Array | None = None,
    dampers: VelocityDampers | None = None,
    svd: Decomposition | None = None,
    wish: float = 1.0,
    bands: TaskBands | None = None,
) -> ConstrainedSolution:
    """Joint velocities for a twist under limits: the optimum of the module's problem.

    Args:
        jacobian: J, (m, n).
        twist: V_f, (m,), in the frame of J, m/s and rad/s; projected onto the range of J if it is not in it.
        lo: Lower bounds of the joint velocities, (n,), rad/s (m/s); may be -inf.
        hi: Upper bounds, (n,), hi >= lo; may be inf.
        weight: W, (n, n), symmetric positive definite; None is the identity.
        gradient: grad_h, (n,), N m (N); None is zero.
        gain: k, s; lowered until the null-space velocity is within ``null_space_cap``.
        row_scale: Factors of the rows of J, (m,), > 0, as in :func:`ik_node.differential_ik.closed_form.resolve`.
        null_space_cap: Largest null-space velocity of each joint, (n,), > 0, rad/s (m/s).
        dampers: Velocity dampers.
        svd: Decomposition of J with its rows times ``row_scale``, if it is known already.
        wish: s_wish, 0 to 1. The box may permit a smaller s only; a larger one is chosen if only that keeps the
            direction, or comes nearest to it.
        bands: Bands of the task.

    Returns:
        The solution. The arrays passed in are not checked.

    Raises:
        InputError: ``lo`` exceeds ``hi``, or the input is so far from finite that there is no solution.
    """
    if not (lo <= hi).all():
        raise InputError(f"the box of joint velocities is empty: {lo.tolist()} to {hi.tolist()}")
    scale = np.ones(len(jacobian)) if row_scale is None else row_scale
    if svd is None:
        svd = decompose(scale[:, None] * jacobian, "jacobian")
    unconstrained = resolve(
        jacobian,
        wish * twist,
        weight,
        gradient,
        gain,
        row_scale=scale,
        null_space_cap=null_space_cap,
        checked=True,
        svd=svd,
    )
    rows, least = (np.zeros((0, len(lo))), np.zeros(0)) if dampers is None else dampers[:2]
    free, scaled_twist = unconstrained.joint_velocity, scale * twist
    mass = IDENTITY if weight is None else weight
    pull = np.zeros(len(lo)) if gradient is None else unconstrained.gain * gradient
    band_rows, band_least = (np.zeros((0, len(lo))), np.zeros(0)) if bands is None else bands[:2]
    found = solve_limited(
        svd,
        scaled_twist,
        float(np.abs(twist).max()),
        free,
        wish,
        lo,
        hi,
        rows,
        least,
        band_rows,
        band_least,
        mass,
        pull,
    )
    if found.status <= LIMITED:
        return ConstrainedSolution(
            found.joint_velocity,
            found.task_scale,
            found.base_velocity,
            found.base_scale,
            jacobian @ found.joint_velocity,
            found.sides,
            np.zeros(len(least)),
            False,
            unconstrained,
        )
    return _solve_iteratively(unconstrained, svd, jacobian, twist, lo, hi, mass, pull, scale, rows, least, wish, bands)


def _solve_iteratively(
    unconstrained: ClosedFormSolution,
    svd: Decomposition,
    jacobian: Array,
    twist: Array,
    lo: Array,
    hi: Array,
    weight: Array,
    pull: Array,
    row_scale: Array,
    rows: Array,
    least: Array,
    wish: float,
    bands: TaskBands | None,
) -> ConstrainedSolution:
    """:func:`solve` for what :func:`ik_node.differential_ik.compiled_step.solve_limited` does not solve."""
    base, slack = np.minimum(np.maximum(0.0, lo), hi), np.zeros(0)
    if len(least):
        base, slack = quadratic_program.nearest_to_rest(base, lo, hi, rows, least)
        rows, least = unit_rows(rows, least - slack)
    scaled_twist = row_scale * twist
    line = task_line(svd, scaled_twist, float(np.abs(twist).max()))
    program = (line, lo, hi, rows, least, weight, pull, unconstrained.joint_velocity, wish, bands)
    base_scale = np.nan if base.any() else 0.0
    solution = _solve_program(*program, base, base_scale)
    if np.isnan(solution.scale):
        scaled = row_scale[:, None] * jacobian
        nearest = quadratic_program.nearest_to_ray(scaled, scaled_twist, lo, hi, rows, least, base)
        if bands is not None:  # bands that the base violates are relaxed, so that it must be unique
            nearest = quadratic_program.least_motion(scaled, scaled_twist, lo, hi, rows, least, nearest)
        base, base_scale = nearest
        solution = _solve_program(*program, base, base_scale)
    qd = np.minimum(np.maximum(solution.joint_velocity, lo), hi)
    if not np.isfinite(qd).all():
        raise InputError("the constrained problem contains numbers that are not finite")
    return ConstrainedSolution(
        qd,
        solution.scale,
        solution.base_velocity,
        solution.base_scale,
        jacobian @ qd,
        active_sides(qd, lo, hi, rows, least),
        slack,
        solution.fallback,
        unconstrained,
    )


def _solve_program(
    line: TaskLine,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    weight: Array,
    pull: Array,
    free: Array,
    wish: float,
    bands: TaskBands | None,
    base: Array,
    base_scale: float,
) -> ProgramSolution:
    """:func:`ik_node.differential_ik.exact_program.solve_exactly` for a null space of any dimension, and bands."""
    solve_line = solve_exactly if len(line.null) <= 1 else _solve_by_daqp
    if bands is None:
        return solve_line(line, lo, hi, rows, least, base, base_scale, weight, pull, free, wish)
    n = len(lo)
    size = np.maximum(np.sqrt((bands.rows * bands.rows).sum(axis=1)), ROUNDING)
    band_rows = np.column_stack((bands.rows, -bands.least)) / size[:, None]
    damper_rows = np.column_stack((rows, np.zeros(len(least))))
    line = TaskLine(np.append(line.ray, 1.0), np.column_stack((line.null, np.zeros(len(line.null)))), line.rounding)
    if len(weight):
        weight = np.pad(weight, (0, 1))
        weight[n, n] = 1.0
    solution = solve_line(
        line,
        np.append(lo, 0.0),
        np.append(hi, 1.0),
        np.concatenate((damper_rows, band_rows)),
        np.concatenate((least, np.zeros(len(band_rows)))),
        np.append(base, 0.0 if np.isnan(base_scale) else base_scale),
        base_scale,
        weight,
        np.append(pull, 0.0),
        np.append(free, wish),
        wish,
    )
    return solution._replace(
        joint_velocity=solution.joint_velocity[:n], base_velocity=np.ascontiguousarray(solution.base_velocity[:n])
    )


def _solve_by_daqp(
    line: TaskLine,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    base: Array,
    base_scale: float,
    weight: Array,
    pull: Array,
    free: Array,
    wish: float,
) -> ProgramSolution:
    """:func:`ik_node.differential_ik.exact_program.solve_exactly` for a null space of any dimension."""
    if np.isnan(base_scale):
        program = program_along(line.ray, line.null, np.zeros(len(lo)), lo, hi, rows, least, ROUNDING)
        entry = quadratic_program.smallest_scale(program)
        if entry is None:
            return ProgramSolution(free, np.nan, base, np.nan, False)
        base_scale = entry[0]
        base = np.minimum(np.maximum(base_scale * line.ray + entry[1] @ line.null, lo), hi)
    direction = (wish - base_scale) * line.ray
    program = feasible_at_base(program_along(direction, line.null, base, lo, hi, rows, least, line.rounding))
    optimum = quadratic_program.largest_scale(program, cost_along(line.null, weight, base, direction, pull))
    if optimum is None:
        whole = program_along(free - base, line.null, base, lo, hi, rows, least, BINDING)
        ratio = smallest_ratio(whole.alpha, program.beta, BINDING)
        qd = base + ratio * (free - base)
    else:
        ratio, z = optimum
        qd = base + ratio * direction + z @ line.null
    return ProgramSolution(qd, base_scale + ratio * (wish - base_scale), base, base_scale, optimum is None)
