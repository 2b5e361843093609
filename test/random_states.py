"""Random control steps of an arm: joint positions anywhere, beside position limits and beside singularities, present
commands that the limits permit, twists from 1 mm/s to many times what an arm can do.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from arms import random_position
from independent_kinematics import Kinematics

from ik_node.differential_ik.solution import ArmState, DifferentialIkSolution
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

PERIOD_S = 0.002
LONGEST_RUN = 5
"""Control steps from one random state."""


class Case(NamedTuple):
    """One control step."""

    state: ArmState
    twist: Array
    velocity_wanted: Array | None
    """The joint velocity of ``ik_difference``; None for a twist."""


def cases(
    robot: Robot, kinematics: Kinematics, solver: DifferentialIkSolver, rng: np.random.Generator
) -> Generator[Case, Array, None]:
    """Random control steps without end; a few follow each other with the command of the one before."""
    lower, upper = solver.limits.lower, solver.limits.upper
    time_ns = 0
    while True:
        q = random_position(robot, rng)
        beside = rng.uniform(size=robot.n) < rng.choice([0.0, 0.2])
        sides = np.where(rng.uniform(size=robot.n) < 0.5, lower, upper)
        q = np.where(beside & np.isfinite(sides), sides + rng.normal(size=robot.n) * 0.01, q)
        if rng.uniform() < 0.4:  # many arms are singular where a joint is at zero
            q[rng.integers(robot.n)] = rng.choice([0.0, 1e-9, 1e-3, 0.02, -0.05])
        speed = solver.limits.velocity * rng.choice([0.0, 0.05, 0.5, 1.0])
        previous = np.where(np.isfinite(speed), speed, 1.0) * rng.uniform(-1.0, 1.0, robot.n)
        twist = rng.normal(size=6) * rng.choice([0.0, 1e-3, 0.1, 0.5, 3.0])
        for _ in range(rng.integers(1, LONGEST_RUN + 1)):
            time_ns += 2_000_000
            middle = q + 0.5 * PERIOD_S * previous
            elapsed_s = PERIOD_S * rng.choice([1.0, 0.5, 1.5])
            wanted: Array | None = None
            if rng.uniform() < 0.2:
                wanted = previous + rng.normal(size=robot.n) * rng.choice([0.01, 1.0])
                twist = kinematics.jacobian(middle) @ wanted
            command = yield Case(ArmState(q, middle, previous, elapsed_s, time_ns), twist, wanted)
            q, previous = q + PERIOD_S * command, command


def solve(solver: DifferentialIkSolver, case: Case) -> DifferentialIkSolution:
    if case.velocity_wanted is not None:
        return solver.solve_velocity(case.state, case.velocity_wanted)
    return solver.solve_twist(case.state, case.twist)
