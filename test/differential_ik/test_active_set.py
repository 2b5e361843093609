"""The optimum under limits where a joint hardly moves in the null space, as by angles of a URDF with six digits."""

from __future__ import annotations

import numpy as np
import pytest

from ik_node.differential_ik import constrained
from ik_node.math.types import Array

JOINTS = 7
ROUNDED = 5e-7
"""Motion of joint 6 in the null space."""


class Case:
    """A task whose first row is the velocity of joint 6, but for rounded angles."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        rows = int(rng.integers(2, 6))
        self.jacobian = rng.normal(size=(rows, JOINTS))
        self.jacobian[0] = np.append(rng.normal(size=JOINTS - 1) * ROUNDED, 1.0)
        self.lo, self.hi = -rng.uniform(0.05, 1.0, JOINTS), rng.uniform(0.05, 1.0, JOINTS)
        self.twist = rng.normal(size=rows) * 10.0 ** rng.uniform(-1.0, 1.0)
        root = rng.normal(size=(JOINTS, JOINTS))
        self.weight: Array | None = root @ root.T + 0.1 * np.eye(JOINTS) if seed % 2 else None

    def solve(self, turned: float = 0.0) -> constrained.ConstrainedSolution:
        twist = self.twist * (1.0 + turned * np.resize((1.0, -1.0), len(self.twist)))
        return constrained.solve(self.jacobian, twist, self.lo, self.hi, self.weight)


@pytest.mark.parametrize("part", range(4))
def test_the_direction_is_exact_and_rounding_does_not_turn_the_answer(part: int) -> None:
    limited = 0
    for seed in range(100 * part, 100 * part + 100):
        case = Case(seed)
        found, beside = case.solve(), case.solve(1e-12)
        qd = found.joint_velocity
        assert (qd >= case.lo).all()
        assert (qd <= case.hi).all()
        assert np.abs(case.jacobian @ qd - found.task_scale * case.twist).max() < 1e-11
        assert not found.fallback
        assert np.abs(beside.joint_velocity - qd).max() < 1e-7
        limited += found.task_scale < 1.0
    assert limited > 30
