"""Records of an arm: kinematics and dynamics at one position, and joint limits. They need no Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ik_node.math.types import Array


class Kinematics(NamedTuple):
    """Kinematics of the tool at one q."""

    pose_sb: Array
    """T_sb, (4, 4): pose of the tool in the base frame."""
    jacobian_b: Array
    """Body Jacobian J_b, (6, n), linear rows first: body twist of the tool = J_b qd."""


class Dynamics(NamedTuple):
    """Dynamics at one q."""

    mass_matrix: Array
    """M(q), (n, n), symmetric positive definite."""
    gravity: Array
    """Gradient of the gravitational potential energy, (n,): N m (N for prismatic joints)."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of the controlled joints in the URDF, including those of their mimic joints; infinite for no limit.

    Position limits in rad (m), velocity limits in rad/s (m/s), (n,) each.
    """

    lower: Array
    upper: Array
    velocity: Array
