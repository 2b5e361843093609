"""The experiment of Haviland and Corke on numerical inverse kinematics (Manipulator Differential Kinematics, 1 and 2).

Their protocol: random problems and 100 random starts are drawn with a fixed seed, uniformly within the limits. The
error is (p_d - p, rotation vector of R_d R') in base axes, E = 1/2 e'e; a problem is solved when E < 1e-6. A search
takes up to 31 steps (or 501); then the next start follows. Optionally, solutions that violate a joint limit after
wrapping into -pi..pi do not count.

All problems are computed in one batch; only the forward kinematics is a loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.robot import Robot

TOLERANCE = 1e-6
"""Tolerance of E."""


class SearchMethod(NamedTuple):
    """Name in the tables, and step for k problems: (J (k, 6, n), e (k, 6), E (k,)) -> (k, n)."""

    name: str
    step: Callable[[Array, Array, Array], Array]


class SearchStatistics(NamedTuple):
    """A row of the published tables."""

    mean_iterations: float
    median_iterations: float
    infeasible_percent: float
    mean_searches: float
    max_searches: int
    outside_percent: float
    """Solutions outside the joint limits, if those are accepted."""


def newton(jacobian: Array, error: Array, energy: Array) -> Array:
    """J^-1 e; square arms only."""
    return np.asarray(np.linalg.solve(jacobian, error[..., None])[..., 0])


def newton_pinv(jacobian: Array, error: Array, energy: Array) -> Array:
    """J^+ e."""
    return np.asarray((np.linalg.pinv(jacobian) @ error[..., None])[..., 0])


def gauss_newton(jacobian: Array, error: Array, energy: Array) -> Array:
    """(J'J)^-1 J'e; square arms only."""
    transposed = np.swapaxes(jacobian, -1, -2)
    return np.asarray(np.linalg.solve(transposed @ jacobian, transposed @ error[..., None])[..., 0])


def gauss_newton_pinv(jacobian: Array, error: Array, energy: Array) -> Array:
    """(J'J)^+ J'e."""
    transposed = np.swapaxes(jacobian, -1, -2)
    return np.asarray((np.linalg.pinv(transposed @ jacobian) @ transposed @ error[..., None])[..., 0])


def damped(of_energy: Callable[[Array], Array]) -> Callable[[Array, Array, Array], Array]:
    """(J'J + d I)^-1 J'e with d = ``of_energy`` (E)."""

    def step(jacobian: Array, error: Array, energy: Array) -> Array:
        transposed = np.swapaxes(jacobian, -1, -2)
        damping = of_energy(energy)[:, None, None] * np.eye(jacobian.shape[-1])
        return np.asarray(np.linalg.solve(transposed @ jacobian + damping, transposed @ error[..., None])[..., 0])

    return step


def levenberg_marquardt(kind: str, factor: float) -> SearchMethod:
    """Return a damping of the tables: Wampler constant, Chan proportional to E, Sugihara E plus a constant."""
    dampings: dict[str, Callable[[Array], Array]] = {
        "Wampler": lambda energy: np.full(len(energy), factor),
        "Chan": lambda energy: factor * energy,
        "Sugihara": lambda energy: energy + factor,
    }
    return SearchMethod(f"LM {kind} {factor:g}", damped(dampings[kind]))


def run(
    robot: Robot, method: SearchMethod, *, seed: int, problems: int, steps: int, searches: int, refuse_outside: bool
) -> SearchStatistics:
    """Run the experiment with ``problems`` poses, at most ``steps`` + 1 steps per search and ``searches`` searches."""
    lower, upper = robot.limits.lower, robot.limits.upper
    # The published figures use numpy's legacy generator; a separate RandomState gives the same numbers.
    random = np.random.RandomState(seed)
    targets = random.uniform(size=(problems, robot.n)) * (upper - lower) + lower
    starts = random.uniform(size=(100, robot.n)) * (upper - lower) + lower
    goals = np.array([robot.pose(q) for q in targets])
    q = np.tile(starts[0], (problems, 1))
    search = np.zeros(problems, dtype=np.int64)
    step = np.zeros(problems, dtype=np.int64)
    total = np.zeros(problems, dtype=np.int64)
    solved = np.zeros(problems, dtype=bool)
    outside = np.zeros(problems, dtype=bool)
    active = np.arange(problems)
    while len(active):
        jacobian, error = _evaluate(robot, q[active], goals[active])
        energy = 0.5 * np.einsum("ki,ki->k", error, error)
        q[active] += _step(method, jacobian, error, energy)
        step[active] += 1
        total[active] += 1
        arrived = energy < TOLERANCE
        wrapped = (q[active] + np.pi) % (2.0 * np.pi) - np.pi
        violates = ((wrapped < lower) | (wrapped > upper)).any(axis=1)
        accepted = arrived & ~violates if refuse_outside else arrived
        solved[active] = accepted
        outside[active] = accepted & violates
        ended = ~accepted & (arrived | (step[active] > steps) | ~np.isfinite(q[active]).all(axis=1))
        over = active[ended]
        search[over] += 1
        step[over] = 0
        again = over[search[over] < searches]
        q[again] = starts[search[again]]
        active = active[~accepted & (search[active] < searches)]
    return SearchStatistics(
        float(total[solved].mean()),
        float(np.median(total[solved])),
        100.0 * float((~solved).mean()),
        float((search[solved] + 1).mean()),
        int((search[solved] + 1).max()),
        100.0 * float(outside.mean()),
    )


def _step(method: SearchMethod, jacobian: Array, error: Array, energy: Array) -> Array:
    try:
        return method.step(jacobian, error, energy)
    except np.linalg.LinAlgError:
        # One exactly singular matrix makes the whole stack fail: solve one by one, and end the searches that fail.
        steps = np.full((len(error), jacobian.shape[2]), np.nan)
        for index in range(len(error)):
            one = slice(index, index + 1)
            try:
                steps[one] = method.step(jacobian[one], error[one], energy[one])
            except np.linalg.LinAlgError:
                continue
        return steps


def _evaluate(robot: Robot, q: Array, goals: Array) -> tuple[Array, Array]:
    """Return Jacobians (k, 6, n) and errors (k, 6) in base axes."""
    count = len(q)
    poses, jacobians = np.empty((count, 4, 4)), np.empty((count, 6, robot.n))
    for index in range(count):
        poses[index], jacobians[index] = robot.evaluate(q[index])
    turn = poses[:, :3, :3]
    aligned = np.concatenate((turn @ jacobians[:, :3], turn @ jacobians[:, 3:]), axis=1)
    rotation = _rotation_vectors(goals[:, :3, :3] @ np.swapaxes(turn, -1, -2))
    return aligned, np.concatenate((goals[:, :3, 3] - poses[:, :3, 3], rotation), axis=1)


def _rotation_vectors(rotations: Array) -> Array:
    """Return rotation vectors (k, 3) of matrices (k, 3, 3), by the formula of the published code."""
    r = rotations
    axis: Array = np.stack((r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]), axis=1)
    length: Array = np.sqrt(np.einsum("ki,ki->k", axis, axis))
    trace: Array = np.einsum("kii->k", r)
    small = length < 1e-12
    factor = np.arctan2(length, trace - 1.0) / np.where(small, 1.0, length)
    half_turn = (np.pi / 2.0) * (np.einsum("kii->ki", r) + 1.0) * (trace < 0.0)[:, None]
    return np.asarray(np.where(small[:, None], half_turn, axis * factor[:, None]))
