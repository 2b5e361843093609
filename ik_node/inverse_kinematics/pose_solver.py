"""Inverse kinematics for production: joint positions within their limits for a pose, with restarts, in a stated time.

Each search is a damped Newton-Raphson iteration on the body twist of :mod:`ik_node.inverse_kinematics.newton_raphson`::

    theta <- theta + J' (J J' + lambda E I)^-1 V_b ,    E = V_b' V_b ,    lambda = 0.03

the Levenberg-Marquardt step of Chan and Lawrence (1988): short far away and at singularities, Newton's own near the
solution. Joints whose range is a full turn or more move freely and are brought back by turns of 2 pi at the end; the
others stop at their limits, and while they are pushed against one they take no part in the step. A search that no
longer gains is given up for the next start. Starts are the caller's seed, the middle of the range, and then points that
fill the range evenly (the additive recurrence of the generalised golden ratio): the same for every call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.inverse_kinematics.newton_raphson import PoseSolution, Reason, pose_iterate
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.screw_chain import KinematicChain, fold

DAMPING = 0.03
"""lambda: damping per squared length of the error twist."""
GAIN_WANTED = 0.9
"""A step gains when it brings E below this part of the lowest E so far."""
PATIENCE = 4
"""Steps in a row without a gain after which a search is given up."""
FULL_TURN = 2.0 * np.pi - 1e-6
"""Range from which a revolute joint reaches every angle (URDFs state pi with 8 digits or so)."""


class _Search(NamedTuple):
    """How one search ended."""

    reason: Reason
    q: Array
    """Its nearest joint positions, turns of 2 pi taken off."""
    error: float
    """Squared length of V_b there."""
    rows: list[tuple[Array, Array, Array]]
    """theta, T_sb, V_b of every iterate."""


class PoseSolver:
    """Solves for the joint positions of one arm. Keeps no state between calls: same question, same answer."""

    def __init__(
        self,
        chain: KinematicChain,
        *,
        eps_omega: float = 1e-6,
        eps_v: float = 1e-6,
        search_iterations: int = 30,
        max_iterations: int = 3000,
    ) -> None:
        """``chain``: a Robot or a ScrewChain. Solved means the rotation error is at most ``eps_omega`` [rad] and the
        position error at most ``eps_v`` [m]. One search takes at most ``search_iterations`` steps, all together at most
        ``max_iterations``. Raises InputError naming a tolerance or count that is not positive.
        """
        for name, value in (("eps_omega", eps_omega), ("eps_v", eps_v)):
            if not 0.0 < value < np.inf:
                raise InputError(f"{name} is {value}; expected a number > 0")
        for name, count in (("search_iterations", search_iterations), ("max_iterations", max_iterations)):
            if count < 1:
                raise InputError(f"{name} is {count}; expected a count >= 1")
        self.chain = chain
        self.eps_omega, self.eps_v = eps_omega, eps_v
        self.search_iterations, self.max_iterations = search_iterations, max_iterations
        lower, upper = chain.limits.lower, chain.limits.upper
        self._wide = chain.turning & (upper - lower >= FULL_TURN)
        self._lower, self._upper = np.where(self._wide, -np.inf, lower), np.where(self._wide, np.inf, upper)
        self._bounded = not bool(np.isinf(self._lower).all() and np.isinf(self._upper).all())
        # Starts: where a joint has no limits, one turn, or one metre to each side.
        reach = np.where(chain.turning, np.pi, 1.0)
        self._low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * reach, -reach))
        self._high = np.where(np.isfinite(upper), upper, self._low + 2.0 * reach)
        self._damping = DAMPING * np.eye(min(6, chain.n))
        self._stride = 1.0 / _golden_ratio(chain.n) ** np.arange(1, chain.n + 1)

    def solve(self, pose_sd: ArrayLike, seed: ArrayLike | None = None, *, restarts: int | None = None) -> PoseSolution:
        """Joint positions within their limits whose pose is ``pose_sd`` (4, 4).

        ``seed`` (n,): where the first search starts, else the middle of the range. ``restarts``: further starts at
        most; None goes on until ``max_iterations`` are used up. Not converged: the nearest pose that was found, with
        the reason that its search ended: Reason.STALLED at rest short of the target, or CAP.

        Raises InputError naming ``pose_sd`` (more than 1e-3 off SE(3), not finite), ``seed`` or ``restarts``.
        """
        target = se3.checked_pose(pose_sd, "pose_sd")
        first = None if seed is None else se3.vector(seed, self.chain.n, "seed")
        if restarts is not None and restarts < 0:
            raise InputError(f"restarts is {restarts}; expected a count >= 0")
        best = self._search(target, self.start(0) if first is None else first, self._allowance(0))
        used, searches = len(best.rows) - 1, 1
        while best.reason is not Reason.CONVERGED and used < self.max_iterations:
            if restarts is not None and searches > restarts:
                break
            start = self.start(searches if first is None else searches - 1)
            search = self._search(target, start, self._allowance(used))
            used += len(search.rows) - 1
            searches += 1
            if search.reason is Reason.CONVERGED or search.error < best.error:
                best = search
        iterates = tuple(pose_iterate(*row) for row in best.rows)
        return PoseSolution(best.reason is Reason.CONVERGED, best.reason, best.q, iterates, used, searches)

    def _allowance(self, used: int) -> int:
        return min(self.search_iterations, self.max_iterations - used)

    def start(self, index: int) -> Array:
        """The start of search ``index``, (n,): 0 is the middle of the range."""
        part = (0.5 + index * self._stride) % 1.0
        return np.asarray(self._low + (self._high - self._low) * part)

    def _search(self, target: Array, start: Array, iterations: int) -> _Search:
        evaluate, lower, upper, bounded = self.chain.evaluate, self._lower, self._upper, self._bounded
        limit = self.eps_omega**2 + self.eps_v**2
        q = np.minimum(np.maximum(start, lower), upper)
        rows: list[tuple[Array, Array, Array]] = []
        nearest, lowest, waited = q, np.inf, 0
        while True:
            pose, jacobian = evaluate(q)
            twist = se3.log(se3.inverse(pose) @ target)
            rows.append((q, pose, twist))
            error = float(twist @ twist)
            waited = 0 if error < GAIN_WANTED * lowest else waited + 1
            if error < lowest:
                nearest, lowest = q, error
            if error <= limit and self._solved(twist):
                nearest, reason = q, Reason.CONVERGED
                break
            if waited >= PATIENCE:
                reason = Reason.STALLED
                break
            if len(rows) > iterations:
                reason = Reason.CAP
                break
            if bounded:
                jacobian = _without_blocked(jacobian, twist, q, lower, upper)
            q = q + self._step(jacobian, twist, error)
            if bounded:
                q = np.minimum(np.maximum(q, lower), upper)
        folded, inside = fold(nearest, self.chain)
        if not inside:
            # A turn of 2 pi may miss a range of 2 pi by a last digit.
            folded = np.minimum(np.maximum(folded, self.chain.limits.lower), self.chain.limits.upper)
        if reason is Reason.CONVERGED:
            final = se3.log(se3.inverse(self.chain.pose(folded)) @ target)
            if not self._solved(final):
                reason = Reason.LIMITS
        return _Search(reason, folded, lowest, rows)

    def _step(self, jacobian: Array, twist: Array, error: float) -> Array:
        # The smallest damping only keeps the matrix regular on a singularity with the tightest tolerances.
        damping = max(error, 1e-14) * self._damping
        if self.chain.n >= 6:
            return np.asarray(np.linalg.solve(jacobian @ jacobian.T + damping, twist) @ jacobian)
        return np.asarray(np.linalg.solve(jacobian.T @ jacobian + damping, twist @ jacobian))

    def _solved(self, twist: Array) -> bool:
        v, omega = twist[:3], twist[3:]
        return float(v @ v) <= self.eps_v**2 and float(omega @ omega) <= self.eps_omega**2


def _without_blocked(jacobian: Array, twist: Array, q: Array, lower: Array, upper: Array) -> Array:
    """The Jacobian without the columns of joints that are pushed against a limit they stand at."""
    at_lower, at_upper = q <= lower, q >= upper
    if not (at_lower | at_upper).any():
        return jacobian
    push = twist @ jacobian
    return np.asarray(jacobian * ~((at_lower & (push < 0.0)) | (at_upper & (push > 0.0))))


def _golden_ratio(dimensions: int) -> float:
    """The root > 1 of x^(d+1) = x + 1, whose powers step through d dimensions most evenly."""
    root = 1.5
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return root
