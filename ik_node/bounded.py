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

While nothing binds the answer is that of :func:`ik_node.resolution.resolve`. Otherwise it is found in two stages, after
the singular value decomposition of J has turned the equality into qd = qd_0 + (s - s_0) p + Z' z, with Z a basis of the
null space of J (rows):

1. s, a linear program in (s, z);
2. z for that s, a quadratic program in the null space alone.

Without a null space the first is a smallest ratio, with one dimension it is a pairwise elimination of z; both are exact
and there is no solver to fail. Two and more dimensions go to DAQP (Arnstroem, Bemporad, Axehill, IEEE TAC 2022), whose
answers are checked here; where one does not pass, the closed form is shortened towards qd_0 until it fits.

When constraints conflict they give way in this order, each by the least amount: the cost, s, the dampers. The box does
not: it is made so that it is never empty (:mod:`ik_node.limits`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node import small_programs
from ik_node.compiled import compiled
from ik_node.errors import InputError
from ik_node.limits import JointBounds, cause
from ik_node.pseudoinverse import EPSILON, Decomposition, decompose
from ik_node.resolution import IDENTITY, Resolution, resolve
from ik_node.se3 import Array

Flags = NDArray[np.bool_]

ROUNDING = 1e-12
"""By how much a constraint may be exceeded before it counts as binding, rad/s (m/s); answers are clipped to it."""

MOST_ROUNDING = 1e-10
"""The same near singularities, where rounding is larger."""


class Dampers(NamedTuple):
    """Linear constraints ``rows`` qd >= ``least`` that keep the speed of approach to obstacles low."""

    rows: Array
    """(k, n), m per rad (m per m)."""
    least: Array
    """(k,), m/s."""
    names: tuple[str, ...]
    """What each one is about, k of them."""


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

    def binding(self, bounds: JointBounds, joints: tuple[str, ...], dampers: Dampers | None = None) -> tuple[str, ...]:
        """What bound, by name: ``velocity panda_joint4``, ``acceleration ...``, ``position ...``, ``damper ...``."""
        if not self.binds:
            return ()
        sides = [(joint, False) for joint in np.flatnonzero(self.at_lower).tolist()]
        sides += [(joint, True) for joint in np.flatnonzero(self.at_upper & ~self.at_lower).tolist()]
        names = [f"{cause(bounds, joint, upper)} {joints[joint]}" for joint, upper in sorted(sides)]
        if dampers is not None:
            names += [f"damper {dampers.names[index]}" for index in np.flatnonzero(self.damper_active).tolist()]
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
    dampers: Dampers | None = None,
    free: Resolution | None = None,
    parts: Decomposition | None = None,
) -> Bounded:
    """The optimum of the module's problem. Arguments as in :func:`ik_node.resolution.resolve`, unchecked, and the box.

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


def _unbound(free: Resolution, jacobian: Array, lo: Array, hi: Array, dampers: Dampers | None) -> Bounded:
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
    dampers: Dampers | None,
) -> Bounded:
    n = len(lo)
    base, slack = np.minimum(np.maximum(0.0, lo), hi), np.zeros(0)
    rows, least = np.zeros((0, n)), np.zeros(0)
    if dampers is not None and len(dampers.least):
        base, slack = small_programs.nearest_to_rest(base, lo, hi, dampers.rows, dampers.least)
        # Unit rows, so that one tolerance serves all. A row that no joint moves says nothing any more.
        size = np.sqrt(np.einsum("ij,ij->i", dampers.rows, dampers.rows))
        moved = size > ROUNDING
        size = np.where(moved, size, 1.0)
        rows = np.where(moved[:, None], dampers.rows / size[:, None], 0.0)
        least = np.where(moved, (dampers.least - slack) / size, -1.0)

    scaled_twist = row_scale * twist
    ray, null, rounding = _ray(parts, scaled_twist, float(np.abs(twist).max()))
    base_scale = 0.0
    if base.any():
        program = _program(ray, null, np.zeros(n), lo, hi, rows, least, small_programs.ROUNDING)
        entry = small_programs.entry(program)
        if entry is None:
            scaled = row_scale[:, None] * jacobian
            base, base_scale = small_programs.nearest_to_ray(scaled, scaled_twist, lo, hi, rows, least, base)
        else:
            base_scale = entry[0]
            base = np.minimum(np.maximum(base_scale * ray + entry[1] @ null, lo), hi)
    direction = (1.0 - base_scale) * ray
    program = _program(direction, null, base, lo, hi, rows, least, rounding)
    # At the base point (no further along the ray, z = 0) all of them hold.
    program = program._replace(beta=np.maximum(program.beta, 0.0))
    mass = IDENTITY if weight is None else weight
    pull = np.zeros(n) if gradient is None else free.gain * gradient
    found = small_programs.optimum(program, _cost(null, mass, base, direction, pull))
    if found is None:
        whole = _program(free.joint_velocity - base, null, base, lo, hi, rows, least, ROUNDING)
        scale = small_programs.smallest_ratio(whole.alpha, program.beta, ROUNDING)
        qd, fallback = base + scale * (free.joint_velocity - base), True
    else:
        scale, coordinates = found
        qd, fallback = base + scale * direction + coordinates @ null, False
    qd = np.minimum(np.maximum(qd, lo), hi)
    if not np.isfinite(qd).all():
        raise InputError("the bounded problem holds numbers that are not finite")
    return Bounded(
        qd,
        base_scale + scale * (1.0 - base_scale),
        base,
        base_scale,
        jacobian @ qd,
        qd <= lo + ROUNDING,
        qd >= hi - ROUNDING,
        rows @ qd <= least + 1e-9,
        slack,
        fallback,
        free,
    )


@compiled
def _ray(parts: Decomposition, scaled_twist: Array, fastest: float) -> tuple[Array, Array, float]:
    """The joint velocity of the twist, (n,), the null space as rows, and how well the first is known, rad/s (m/s).

    ``fastest``: the largest entry of the twist.
    """
    rank = parts.rank
    along = scaled_twist @ np.ascontiguousarray(parts.u[:, :rank])
    # Near a singularity the direction itself is known no better than this.
    smallest = parts.sigma[rank - 1] if rank else 1.0
    rounding = min(max(ROUNDING, 4.0 * EPSILON * fastest / smallest), MOST_ROUNDING)
    return (along / parts.sigma[:rank]) @ parts.vt[:rank], parts.vt[rank:], rounding


@compiled
def _program(
    direction: Array, null: Array, base: Array, lo: Array, hi: Array, rows: Array, least: Array, rounding: float
) -> small_programs.Program:
    """Box and dampers for qd = ``base`` + s ``direction`` + z' ``null``, as  alpha s + zeta z <= beta ."""
    n, d, k = len(base), len(null), len(least)
    alpha, zeta, beta = np.empty(2 * n + k), np.empty((2 * n + k, d)), np.empty(2 * n + k)
    for i in range(n):
        alpha[i], alpha[n + i] = direction[i], -direction[i]
        beta[i], beta[n + i] = hi[i] - base[i], base[i] - lo[i]
        for j in range(d):
            zeta[i, j], zeta[n + i, j] = null[j, i], -null[j, i]
    for r in range(k):
        alpha[2 * n + r], beta[2 * n + r] = -(rows[r] @ direction), rows[r] @ base - least[r]
        for j in range(d):
            zeta[2 * n + r, j] = -(rows[r] @ null[j])
    return small_programs.Program(alpha, zeta, beta, rounding)


@compiled
def _cost(null: Array, weight: Array, base: Array, direction: Array, pull: Array) -> small_programs.Cost:
    """1/2 qd' W qd + ``pull``' qd for qd = ``base`` + s ``direction`` + z' ``null``, as far as it hangs on z."""
    weighted = null @ weight if len(weight) else null
    return small_programs.Cost(weighted @ null.T, weighted @ base + null @ pull, weighted @ direction)
