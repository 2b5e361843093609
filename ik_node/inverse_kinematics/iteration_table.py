"""Iterates of root finding and inverse kinematics as the table of the lecture notes and as JSON documents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.inverse_kinematics.newton_raphson import PoseSolution, RootSolution, TerminationReason
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array

EXPLANATIONS = {
    TerminationReason.CONVERGED: "within the tolerances",
    TerminationReason.CAP: "the maximum number of iterations was reached",
    TerminationReason.STALLED: "no step reduces the error: out of reach, or a local minimum",
    TerminationReason.DIVERGED: "an iterate is not finite or too large",
    TerminationReason.SINGULAR: "the Jacobian has lost rank and permits no step",
    TerminationReason.LIMITS: "the pose is reached only outside the joint limits",
}
TWIST_ORDER = ("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z")
"""Names of the entries of a twist, linear part first."""


def pose_table(
    solution: PoseSolution, turning: Sequence[bool], *, planar: bool = False, digits: int = 4, partial: bool = False
) -> str:
    """The table of the lecture notes: i, theta in degrees (metres for prismatic joints), position, V_b, both norms.

    Args:
        solution: The result of inverse kinematics.
        turning: True for each revolute joint, (n,).
        planar: True for the columns of a planar arm: (x, y) and (omega_z, v_x, v_y).
        digits: Decimals.
        partial: True for a task with a tolerance: the error to the nearest pose within it, in the place of V_b.

    Returns:
        Lines of text; V_b has its angular part first, as in the notes.
    """
    chosen = [5, 0, 1] if planar else [3, 4, 5, 0, 1, 2]
    names = ["theta deg" if turns else "theta m" for turns in turning]
    units = "theta [deg]" if all(turning) else "theta [deg, m]"
    width = digits + 5
    twist = "V_b = (wz, vx, vy)" if planar else "V_b = (wx, wy, wz, vx, vy, vz)"
    twist = "error (rx, ry, rz, x, y, z)" if partial else twist
    head = [
        "i".rjust(3),
        units.center(width * len(names)),
        ("(x, y)" if planar else "(x, y, z)").center(width * (2 if planar else 3)),
        twist.center(width * len(chosen)),
        ("|r|" if partial else "|w_b|").rjust(10),
        ("|p|" if partial else "|v_b|").rjust(10),
    ]
    lines = ["  ".join(head)]
    for index, row in enumerate(solution.iterates):
        theta = np.where(turning, np.rad2deg(row.theta), row.theta)
        cells = [
            f"{index:3d}",
            _numbers(theta, width, digits - (2 if digits > 3 else 1)),
            _numbers(row.pose_sb[: 2 if planar else 3, 3], width, digits),
            _numbers(row.twist[chosen], width, digits),
            f"{row.norm_omega:10.{digits}f}" if planar else f"{row.norm_omega:10.3e}",
            f"{row.norm_v:10.{digits}f}" if planar else f"{row.norm_v:10.3e}",
        ]
        lines.append("  ".join(cells))
    return "\n".join(lines)


def root_table(root: RootSolution) -> str:
    """The table of a scalar equation: i, theta, g(theta)."""
    lines = [f"{'i':>3}  {'theta':>22}  {'x_d - f(theta)':>22}"]
    lines += [
        f"{index:3d}  {float(row.theta[0]):22.15g}  {float(row.value[0]):22.15g}"
        for index, row in enumerate(root.iterates)
    ]
    return "\n".join(lines)


def outcome_text(converged: bool, reason: TerminationReason) -> str:
    """Text: whether the iteration has converged, and the reason of its end."""
    return f"{'converged' if converged else 'not converged: ' + reason.value} ({EXPLANATIONS[reason]})"


def pose_document(solution: PoseSolution) -> dict[str, Any]:
    """A result of inverse kinematics as a JSON document; numbers are exact doubles.

    ``iterations`` has one entry per iterate; ``twist_order`` names the entries of ``twist``.
    """
    return {
        "converged": solution.converged,
        "reason": solution.reason.value,
        "explanation": EXPLANATIONS[solution.reason],
        "q": solution.q.tolist(),
        "searches": solution.searches,
        "total_iterations": solution.iterations,
        "twist_order": list(TWIST_ORDER),
        "iterations": [
            {
                "i": index,
                "theta": row.theta.tolist(),
                "position": row.pose_sb[:3, 3].tolist(),
                "twist": row.twist.tolist(),
                "norm_omega": row.norm_omega,
                "norm_v": row.norm_v,
            }
            for index, row in enumerate(solution.iterates)
        ],
    }


def pose_target_document(pose_sd: Array) -> dict[str, Any]:
    """A pose (4, 4) as position and quaternion."""
    return {
        "position": pose_sd[:3, 3].tolist(),
        "quaternion_xyzw": quaternion_from_rotation(pose_sd[:3, :3]).tolist(),
    }


def root_document(root: RootSolution) -> dict[str, Any]:
    """A result of root finding as a JSON document; values that are not finite are null."""
    return {
        "converged": root.converged,
        "reason": root.reason.value,
        "explanation": EXPLANATIONS[root.reason],
        "q": root.theta.tolist(),
        "iterations": [
            {
                "i": index,
                "theta": row.theta.tolist(),
                "value": [value if np.isfinite(value) else None for value in row.value.tolist()],
                "norm": row.norm if np.isfinite(row.norm) else None,
            }
            for index, row in enumerate(root.iterates)
        ],
    }


def _numbers(values: Array, width: int, digits: int) -> str:
    # Adding 0.0 converts a rounded -0.0 to 0.0.
    return "".join(f"{round(float(value), digits) + 0.0:{width}.{digits}f}" for value in values)
