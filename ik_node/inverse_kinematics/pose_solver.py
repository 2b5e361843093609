"""Inverse kinematics for applications: joint positions within their limits for a pose, with restarts, in bounded time.

Each search is a damped Newton-Raphson iteration on the body twist of
:mod:`ik_node.inverse_kinematics.newton_raphson`::

    theta <- theta + J' (J J' + lambda E I)^-1 V_b ,    E = V_b' V_b ,    lambda = 0.03

This is the Levenberg-Marquardt step of Chan and Lawrence (1988): short at a distance and at singularities, Newton's
step near the solution. Joints with a range of a full turn or more move freely, and multiples of 2 pi are subtracted at
the end. The other joints stop at their limits, and while they are pushed against one their columns of J are zero. A
search without sufficient decrease is ended. Starts are the seed, the middle of the joint range, and low-discrepancy
points in the joint range, the same for every call.

With a tolerance (:mod:`ik_node.math.task_tolerance`) V_b is the error to the nearest pose within it, and J has its
rows: those of free components and of bands that contain the tool are zero. A pose is then reached by many joint
positions; from a seed, the solution of several searches is taken that is nearest to the seed, each of them moved
towards the seed as far as the task permits (:mod:`ik_node.inverse_kinematics.least_motion`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_node.errors import InputError
from ik_node.inverse_kinematics.least_motion import moved_towards, nearest_turns
from ik_node.inverse_kinematics.newton_raphson import PoseSolution, TerminationReason, pose_iterate
from ik_node.math import se3
from ik_node.math.numerics import check_count, check_positive, checked_vector, low_discrepancy_points
from ik_node.math.quaternion import Vector
from ik_node.math.task_error import NO_DIRECTION, excess, task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.locked_chain import LockedChain, free_joints
from ik_node.robot.screw_chain import KinematicChain, finite_range, wrap_into_limits

DAMPING = 0.03
"""lambda: damping per squared length of the error twist."""
REQUIRED_DECREASE = 0.9
"""A step decreases E sufficiently if it is below this fraction of the least E so far."""
MAX_STEPS_WITHOUT_DECREASE = 4
"""Number of successive steps without sufficient decrease after which a search is ended."""
FULL_TURN = 2.0 * np.pi - 1e-6
"""Range from which a revolute joint reaches every angle, rad (URDFs state pi with about 8 digits)."""
COMPARED_SEARCHES = 4
"""Number of converged searches of which the solution nearest to the seed is taken, for a task with a tolerance."""
WHOLE_POSE = TaskTolerance()
"""Tolerance of a task in which the whole pose is followed."""


class _Search(NamedTuple):
    """Result of one search."""

    reason: TerminationReason
    q: Array
    """Its best joint positions, (n,), wrapped into the limits."""
    error: float
    """Squared norm of V_b at the best joint positions."""
    rows: list[tuple[Array, Array, Array]]
    """theta, T_sb, V_b of every iterate."""


class PoseSolver:
    """Inverse kinematics of one arm. It has no state between calls: equal arguments give equal results."""

    def __init__(
        self,
        chain: KinematicChain,
        *,
        eps_omega: float = 1e-6,
        eps_v: float = 1e-6,
        search_iterations: int = 30,
        max_iterations: int = 3000,
        tolerance: TaskTolerance = WHOLE_POSE,
        compared_searches: int = COMPARED_SEARCHES,
        locked: Sequence[str] = (),
    ) -> None:
        """Prepares the searches.

        Args:
            chain: A Robot or a ScrewChain.
            eps_omega: Accuracy of the rotation, rad.
            eps_v: Accuracy of the position, m.
            search_iterations: Maximum number of steps of one search.
            max_iterations: Maximum number of steps of all searches of a call; with a tolerance and a seed up to 50 more
                for each solution that is compared.
            tolerance: Which part of the pose matters; default: the whole pose.
            compared_searches: Number of solutions that are compared, with a tolerance and a seed; 1 takes the first
                one as it is, for a control loop.
            locked: Names of joints that stay at the positions of the seed.

        Raises:
            InputError: An accuracy or count is not positive, or joints are to be locked and the chain has no names.
            SettingsError: ``locked`` has the name of no joint, or all of them.
        """
        check_positive(eps_omega=eps_omega, eps_v=eps_v)
        check_count(
            1, search_iterations=search_iterations, max_iterations=max_iterations, compared_searches=compared_searches
        )
        if locked and not hasattr(chain, "joints"):
            raise InputError("locked joints are given by name, which only a Robot has")
        self._free = free_joints(chain.joints, locked) if locked else None  # type: ignore[attr-defined]
        self.chain = chain
        self.eps_omega, self.eps_v = eps_omega, eps_v
        self.search_iterations, self.max_iterations = search_iterations, max_iterations
        self._compared_searches = compared_searches
        self.tolerance, self._form = tolerance, None if tolerance.is_exact else tolerance.form
        lower, upper = chain.limits.lower, chain.limits.upper
        wide = chain.turning & (upper - lower >= FULL_TURN)
        self._lower, self._upper = np.where(wide, -np.inf, lower), np.where(wide, np.inf, upper)
        self._bounded = not bool(np.isinf(self._lower).all() and np.isinf(self._upper).all())
        self._start_low, self._start_high = finite_range(chain)
        self._damping_of_rows, self._damping_of_joints = DAMPING * np.eye(6), DAMPING * np.eye(chain.n)

    def solve(self, pose_sd: ArrayLike, seed: ArrayLike | None = None, *, restarts: int | None = None) -> PoseSolution:
        """Joint positions within their limits for a pose.

        Args:
            pose_sd: T_sd, (4, 4).
            seed: Start of the first search, (n,), rad (m); None is the middle of the joint range.
            restarts: Maximum number of further searches; None restarts until ``max_iterations``.

        Returns:
            The result; it has converged when the pose is within the tolerance. If not: the pose nearest to ``pose_sd``
            that was found, and the reason for which its search ended, TerminationReason.STALLED, CAP or LIMITS.

        Raises:
            InputError: ``pose_sd`` is more than 1e-3 away from SE(3) or not finite, or ``seed`` or ``restarts`` is
                invalid.
        """
        target = se3.checked_pose(pose_sd, "pose_sd")
        first = None if seed is None else checked_vector(seed, self.chain.n, "seed")
        check_count(restarts=restarts or 0)
        if self._free is not None:
            return self._solve_locked(self._free, target, first, restarts)
        best = self._search(target, self.start(0) if first is None else first, self._allowance(0))
        used, searches = len(best.rows) - 1, 1
        compared = self._compared_searches if first is not None and self._form is not None else 1
        found: list[_Search] = [best] if best.reason is TerminationReason.CONVERGED else []
        while len(found) < compared and used < self.max_iterations:
            if restarts is not None and searches > restarts:
                break
            start = self.start(searches if first is None else searches - 1)
            search = self._search(target, start, self._allowance(used))
            used += len(search.rows) - 1
            searches += 1
            if search.reason is TerminationReason.CONVERGED:
                found.append(search)
            if search.reason is TerminationReason.CONVERGED or search.error < best.error:
                best = search
        if found and first is not None and compared > 1:
            best, steps = self._least_motion(target, first, found)
            used += steps
        iterates = tuple(pose_iterate(*row) for row in best.rows)
        return PoseSolution(best.reason is TerminationReason.CONVERGED, best.reason, best.q, iterates, used, searches)

    def _solve_locked(
        self, free: NDArray[np.intp], target: Array, seed: Array | None, restarts: int | None
    ) -> PoseSolution:
        """The solution for the joints that are not locked, with the others at the seed."""
        if seed is None:
            raise InputError("locked joints need a seed, at whose positions they stay")
        chain = LockedChain(self.chain, free, seed)
        solver = PoseSolver(
            chain,
            eps_omega=self.eps_omega,
            eps_v=self.eps_v,
            search_iterations=self.search_iterations,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            compared_searches=self._compared_searches,
        )
        found = solver.solve(target, seed[free], restarts=restarts)
        iterates = tuple(entry._replace(theta=chain.all_joints(entry.theta)) for entry in found.iterates)
        return found._replace(q=chain.all_joints(found.q), iterates=iterates)

    def _allowance(self, used: int) -> int:
        return min(self.search_iterations, self.max_iterations - used)

    def start(self, index: int) -> Array:
        """Start of the search ``index``, (n,); 0 is the middle of the joint range."""
        return np.asarray(
            self._start_low + (self._start_high - self._start_low) * low_discrepancy_points(index, self.chain.n)
        )

    def _search(self, target: Array, start: Array, iterations: int) -> _Search:
        evaluate, lower, upper, bounded = self.chain.evaluate, self._lower, self._upper, self._bounded
        limit = self.eps_omega**2 + self.eps_v**2
        q = np.minimum(np.maximum(start, lower), upper)
        rows: list[tuple[Array, Array, Array]] = []
        best, least_error, steps_without_decrease, direction = q, np.inf, 0, NO_DIRECTION
        while True:
            pose, jacobian = evaluate(q)
            twist, jacobian, direction = self._error(pose, jacobian, target, direction)
            rows.append((q, pose, twist))
            error = float(twist @ twist)
            steps_without_decrease = 0 if error < REQUIRED_DECREASE * least_error else steps_without_decrease + 1
            if error < least_error:
                best, least_error = q, error
            if error <= limit and self._solved(twist):
                best, reason = q, TerminationReason.CONVERGED
                break
            if steps_without_decrease >= MAX_STEPS_WITHOUT_DECREASE:
                reason = TerminationReason.STALLED
                break
            if len(rows) > iterations:
                reason = TerminationReason.CAP
                break
            if bounded:
                jacobian = _without_blocked_joints(jacobian, twist, q, lower, upper)
            q = q + self._step(jacobian, twist, error)
            if bounded:
                q = np.minimum(np.maximum(q, lower), upper)
        wrapped, inside = wrap_into_limits(best, self.chain)
        if not inside:
            # With a range of 2 pi a multiple of 2 pi may exceed a limit by rounding.
            wrapped = np.minimum(np.maximum(wrapped, self.chain.limits.lower), self.chain.limits.upper)
        if reason is TerminationReason.CONVERGED:
            final, _, _ = self._error(*evaluate(wrapped), target, direction)
            if not self._solved(final):
                reason = TerminationReason.LIMITS
        return _Search(reason, wrapped, least_error, rows)

    def _error(
        self, pose: Array, jacobian: Array, target: Array, swing_direction: Vector
    ) -> tuple[Array, Array, Vector]:
        """The error that is to become zero, (6,), its Jacobian, (6, n), and the direction of the swing."""
        if self._form is None:
            return se3.log(se3.inverse(pose) @ target), jacobian, swing_direction
        deviation = task_deviation(self._form, pose, target, swing_direction)
        error = excess(deviation.components, self._form.half_widths)
        counts = (self._form.half_widths == 0.0) | (error != 0.0)
        return error, (deviation.rows_b @ jacobian) * counts[:, None], deviation.swing_direction

    def _least_motion(self, target: Array, seed: Array, found: list[_Search]) -> tuple[_Search, int]:
        """The solution nearest to the seed, from the results of converged searches, and the number of steps to it."""
        best, least, steps = found[0], np.inf, 0
        for search in found:
            path = moved_towards(seed, search.q, self.chain, target, self.tolerance)
            end = self._search(target, path[-1], self.search_iterations)
            steps += len(path) + len(end.rows) - 2
            if end.reason is TerminationReason.CONVERGED:
                end = end._replace(rows=search.rows + end.rows)
            else:
                end = search._replace(q=wrap_into_limits(path[0], self.chain)[0])
            motion = float(np.linalg.norm(nearest_turns(end.q, seed, self.chain) - seed))
            if motion < least:
                best, least = end, motion
        return best, steps

    def _step(self, jacobian: Array, twist: Array, error: float) -> Array:
        # The least damping keeps the matrix regular at a singularity with the tightest tolerances.
        damping = max(error, 1e-14)
        rows = 6 if self._form is None else np.count_nonzero(twist)
        if rows <= self.chain.n:
            matrix = jacobian @ jacobian.T + damping * self._damping_of_rows
            return np.asarray(np.linalg.solve(matrix, twist) @ jacobian)
        matrix = jacobian.T @ jacobian + damping * self._damping_of_joints
        return np.asarray(np.linalg.solve(matrix, twist @ jacobian))

    def _solved(self, twist: Array) -> bool:
        v, omega = twist[:3], twist[3:]
        return float(v @ v) <= self.eps_v**2 and float(omega @ omega) <= self.eps_omega**2


def _without_blocked_joints(jacobian: Array, twist: Array, q: Array, lower: Array, upper: Array) -> Array:
    """The Jacobian with zero columns for joints that are at a limit and pushed against it."""
    at_lower, at_upper = q <= lower, q >= upper
    if not (at_lower | at_upper).any():
        return jacobian
    push = twist @ jacobian
    return np.asarray(jacobian * ~((at_lower & (push < 0.0)) | (at_upper & (push > 0.0))))


def solve_pose(
    chain: KinematicChain,
    pose_sd: ArrayLike,
    seed: ArrayLike | None = None,
    *,
    restarts: int | None = None,
    eps_omega: float = 1e-6,
    eps_v: float = 1e-6,
    tolerance: TaskTolerance = WHOLE_POSE,
    locked: Sequence[str] = (),
) -> PoseSolution:
    """Joint positions within their limits for a pose; :class:`PoseSolver` is faster for many poses of one arm.

    Args:
        chain: A Robot or a ScrewChain.
        pose_sd: T_sd, (4, 4): the desired pose of the tool in the base frame.
        seed: Start of the first search, (n,), rad (m); None is the middle of the joint range.
        restarts: Maximum number of further searches; None restarts until the solver's maximum number of iterations.
        eps_omega: Accuracy of the rotation, rad.
        eps_v: Accuracy of the position, m.
        tolerance: Which part of the pose matters; default: the whole pose. With a seed, the solution of least motion
            from it among several searches is returned.
        locked: Names of joints that stay at the positions of the seed.

    Returns:
        The result; ``converged`` states whether ``q`` reaches the pose within the tolerance.

    Raises:
        InputError: ``pose_sd`` is more than 1e-3 away from SE(3) or not finite, or another argument is invalid.
        SettingsError: ``locked`` has the name of no joint, or all of them.
    """
    solver = PoseSolver(chain, eps_omega=eps_omega, eps_v=eps_v, tolerance=tolerance, locked=locked)
    return solver.solve(pose_sd, seed, restarts=restarts)
