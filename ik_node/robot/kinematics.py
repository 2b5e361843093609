"""Records of an arm: kinematics and dynamics at one position, and joint limits. They need no Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ik_node.math.types import Array


class Kinematics(NamedTuple):
    """What holds at one q."""

    pose_sb: Array
    """T_sb, (4, 4): tool seen from the base frame."""
    jacobian_b: Array
    """Body Jacobian J_b, (6, n), linear rows first: body twist of the tool = J_b qd."""


class Dynamics(NamedTuple):
    """What depends on masses at one q."""

    mass_matrix: Array
    """M(q), (n, n), symmetric positive definite."""
    gravity: Array
    """Gradient of the gravitational potential energy, (n,): N m (N for prismatic joints)."""


@dataclass(frozen=True)
class JointLimits:
    """Limits per controlled joint, as the URDF states them for it and for those that mimic it; infinite where it
    states none."""

    lower: Array
    upper: Array
    velocity: Array
