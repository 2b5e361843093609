"""The optimum under limits: the problem of ``resolution`` with a box on qd and dampers, answered on every input.

::

    minimise    1/2 qd' W qd + k grad_h' qd
    subject to  J qd = J qd_0 + (s - s_0) V_f ,      s in [s_0, 1] as large as possible
                lo <= qd <= hi                       velocity, position and acceleration limits of this tick
                N qd >= c                            approach dampers, if there are any

qd_0 is the point of the box (and of the dampers) nearest to the ray of joint velocities that move the tool along V_f:
that of the smallest norm of J qd - s V_f, s in [0, 1]. Where the box contains rest, qd_0 = 0, s_0 = 0 and the
constraint is J qd = s V_f. Where it does not (an arm that moves cannot stop within a tick) the tool still moves along
V_f, slower, whenever the box lets it, and otherwise as nearly so as it can. (A base nearest to rest instead shrinks
every joint by the same acceleration at every tick, and a tool that is slowed down by a limit leaves its path: by 12
degrees in a test.)

While nothing binds the answer is that of :func:`ik_node.differential_ik.closed_form.resolve`. Otherwise it is found in two stages, after
the singular value decomposition of J has turned the equality into qd = qd_0 + (s - s_0) p + Z' z, with Z a basis of the
null space of J (rows):

1. s, a linear program in (s, z);
2. z for that s, a quadratic program in the null space alone.

Without a null space the first is a smallest ratio, with one dimension it is a pairwise elimination of z; both are exact
and there is no solver to fail. Two and more dimensions go to DAQP (Arnstroem, Bemporad, Axehill, IEEE TAC 2022), whose
answers are checked here; where one does not pass, the closed form is shortened towards qd_0 until it fits.

When constraints conflict they give way in this order, each by the least amount: the cost, s, the dampers. The box does
not: it is made so that it is never empty (:mod:`ik_node.robot.joint_limits`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import quadratic_program
from ik_node.differential_ik.closed_form import IDENTITY, Resolution, resolve
from ik_node.differential_ik.exact_program import (
    BINDING,
    DAMPER_BINDING,
    ROUNDING,
    Found,
    Line,
    at_the_base,
    cost_along,
    line_of,
    program_along,
    search,
    smallest_ratio,
    unit_rows,
)
from ik_node.errors import InputError
from ik_node.math.pseudoinverse import Decomposition, decompose
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, cause

Flags = NDArray[np.bool_]


class Bounded(NamedTuple):
    """The optimum, and what it had to give up."""

    joint_velocity: Array
    """qd, (n,): within the box to the last bit."""
    scale: float
    """s: the part of V_f that is done."""
    base_velocity: Array
    """qd_0, (n,)."""
    base_scale: float
    """s_0."""
    attained: Array
    """J qd, (m,)."""
    at_lower: Flags
    """Joints at the lower end of the box, (n,), bool; all False where nothing binds."""
    at_upper: Flags
    """Joints at the upper end of the box, (n,), bool; all False where nothing binds."""
    damper_active: Flags
    """Dampers that bind, (k,), bool."""
    damper_slack: Array
    """By how much each damper gave way to the box, (k,), m/s; 0 nearly always."""
    fallback: bool
    """True where the solver's answer was not good enough and the shortened closed form was taken."""
    unbounded: Resolution
    """The closed form without the box: singular values, rank, multiplier, the gain that was used."""

    @property
    def binds(self) -> bool:
        """True where a limit or a damper changed the answer."""
        return bool(self.at_lower.any() or self.at_upper.any() or self.damper_active.any())

    def binding(self, bounds: JointBounds, joints: tuple[str, ...], dampers: VelocityDampers | None = None) -> tuple[str, ...]:
        """What bound, by name: ``velocity panda_joint4``, ``acceleration ...``, ``position ...``, ``damper ...``."""
        names = () if dampers is None else dampers.names
        return names_of_binding(self.at_lower, self.at_upper, self.damper_active, bounds, joints, names)


def names_of_binding(
    at_lower: Flags,
    at_upper: Flags,
    damper_active: Flags,
    bounds: JointBounds,
    joints: tuple[str, ...],
    dampers: tuple[str, ...],
) -> tuple[str, ...]:
    """What bound, by name; of a joint whose box is a point, the lower side."""
    sides = enumerate(zip(at_lower.tolist(), at_upper.tolist(), strict=True))
    names = [f"{cause(bounds, joint, not low)} {joints[joint]}" for joint, (low, high) in sides if low or high]
    names += [f"damper {name}" for name, active in zip(dampers, damper_active.tolist(), strict=False) if active]
    return tuple(names)


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
    free: Resolution | None = None,
    parts: Decomposition | None = None,
) -> Bounded:
    """The optimum of the module's problem. Arguments as in :func:`ik_node.differential_ik.closed_form.resolve`, unchecked, and the box.

    ``jacobian`` J (m, n), ``twist`` V_f (m,) in one frame; ``lo``, ``hi`` (n,), lo <= hi, rad/s (m/s), may be infinite;
    ``gradient`` grad_h (n,), ``gain`` k in s, lowered until no joint's part of the null-space velocity exceeds
    ``null_space_cap``. V_f is projected on the range of J where it does not lie in it. ``free`` and ``parts``, where
    the caller has them: the answer without the box, and the decomposition of J with its rows times ``row_scale``.

    Raises InputError when the box is empty, or when what went in is so far from finite that nothing can be said.
    """
    if not (lo <= hi).all():
        raise InputError(f"the box of joint velocities is empty: {lo.tolist()} to {hi.tolist()}")
    scale = np.ones(len(jacobian)) if row_scale is None else row_scale
    if parts is None:
        parts = decompose(scale[:, None] * jacobian, "jacobian")
    if free is None:
        free = resolve(
            jacobian,
            twist,
            weight,
            gradient,
            gain,
            row_scale=scale,
            null_space_cap=null_space_cap,
            checked=True,
            parts=parts,
        )
    qd = free.joint_velocity
    if (qd >= lo).all() and (qd <= hi).all() and (dampers is None or (dampers.rows @ qd >= dampers.least).all()):
        return _unbound(free, jacobian, lo, hi, dampers)
    return _bound(free, parts, jacobian, twist, lo, hi, weight, gradient, scale, dampers)


def _unbound(free: Resolution, jacobian: Array, lo: Array, hi: Array, dampers: VelocityDampers | None) -> Bounded:
    nothing = np.zeros(len(lo), dtype=bool)
    count = 0 if dampers is None else len(dampers.least)
    return Bounded(
        free.joint_velocity,
        1.0,
        np.zeros(len(lo)),
        0.0,
        jacobian @ free.joint_velocity,
        nothing,
        nothing,
        np.zeros(count, dtype=bool),
        np.zeros(count),
        False,
        free,
    )


def _bound(
    free: Resolution,
    parts: Decomposition,
    jacobian: Array,
    twist: Array,
    lo: Array,
    hi: Array,
    weight: Array | None,
    gradient: Array | None,
    row_scale: Array,
    dampers: VelocityDampers | None,
) -> Bounded:
    n = len(lo)
    base, slack = np.minimum(np.maximum(0.0, lo), hi), np.zeros(0)
    rows, least = np.zeros((0, n)), np.zeros(0)
    if dampers is not None and len(dampers.least):
        base, slack = quadratic_program.nearest_to_rest(base, lo, hi, dampers.rows, dampers.least)
        rows, least = unit_rows(dampers.rows, dampers.least - slack)

    scaled_twist = row_scale * twist
    line = line_of(parts, scaled_twist, float(np.abs(twist).max()))
    mass = IDENTITY if weight is None else weight
    pull = np.zeros(n) if gradient is None else free.gain * gradient
    searched = search if len(line.null) <= 1 else _search_with_solver
    base_scale = np.nan if base.any() else 0.0
    found = searched(line, lo, hi, rows, least, base, base_scale, mass, pull, free.joint_velocity)
    if np.isnan(found.scale):
        scaled = row_scale[:, None] * jacobian
        base, base_scale = quadratic_program.nearest_to_ray(scaled, scaled_twist, lo, hi, rows, least, base)
        found = searched(line, lo, hi, rows, least, base, base_scale, mass, pull, free.joint_velocity)
    qd = np.minimum(np.maximum(found.joint_velocity, lo), hi)
    if not np.isfinite(qd).all():
        raise InputError("the bounded problem holds numbers that are not finite")
    return Bounded(
        qd,
        found.scale,
        found.base_velocity,
        found.base_scale,
        jacobian @ qd,
        qd <= lo + BINDING,
        qd >= hi - BINDING,
        rows @ qd <= least + DAMPER_BINDING,
        slack,
        found.fallback,
        free,
    )


def _search_with_solver(
    line: Line,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    base: Array,
    base_scale: float,
    weight: Array,
    pull: Array,
    free: Array,
) -> Found:
    """:func:`ik_node.differential_ik.exact_program.search` with any number of z; ``free`` (n,): the closed form, in case of need."""
    if np.isnan(base_scale):
        program = program_along(line.ray, line.null, np.zeros(len(lo)), lo, hi, rows, least, ROUNDING)
        entry = quadratic_program.entry(program)
        if entry is None:
            return Found(free, np.nan, base, np.nan, False)
        base_scale = entry[0]
        base = np.minimum(np.maximum(base_scale * line.ray + entry[1] @ line.null, lo), hi)
    direction = (1.0 - base_scale) * line.ray
    program = at_the_base(program_along(direction, line.null, base, lo, hi, rows, least, line.rounding))
    found = quadratic_program.best(program, cost_along(line.null, weight, base, direction, pull))
    if found is None:
        whole = program_along(free - base, line.null, base, lo, hi, rows, least, BINDING)
        part = smallest_ratio(whole.alpha, program.beta, BINDING)
        qd = base + part * (free - base)
    else:
        part, z = found
        qd = base + part * direction + z @ line.null
    return Found(qd, base_scale + part * (1.0 - base_scale), base, base_scale, found is None)
