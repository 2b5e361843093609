"""Motion off the direction of the twist: which limits cause it.

The arm moves along V_f if the limits of the control step permit a multiple of it. If they permit none, r = J qd - s V_f
remains, of least \\|D r\\|. Its gradient J' D^2 r is zero for the joints inside their bounds; a bound whose gradient
points outwards is one that a smaller r would need to exceed.
"""

from __future__ import annotations

import numpy as np

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik.constrained import MIN_OFF_DIRECTION, ConstrainedSolution
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, cause

MIN_EFFECT = 1e-3
"""A limit whose gradient is a smaller fraction of the largest one is not named."""


def limits_off_direction(
    off_direction: Array,
    limited: ConstrainedSolution,
    jacobian: Array,
    row_scale: Array,
    bounds: JointBounds,
    joints: tuple[str, ...],
    dampers: VelocityDampers | None,
) -> tuple[str, ...]:
    """Names of the active limits that cause the motion off the direction, the most effective first, then dampers.

    All active limits if none of them does, as when the direction was released.

    Args:
        off_direction: r = J qd - s V_f, (6,).
        limited: The solution under limits.
        jacobian: J, (6, n).
        row_scale: D, (6,).
        bounds: Limits of this control step.
        joints: Names of the joints.
        dampers: Velocity dampers.
    """
    if not limited.binds or np.abs(off_direction).max() <= MIN_OFF_DIRECTION:
        return ()
    scaled_jacobian = row_scale[:, None] * jacobian
    gradient = scaled_jacobian.T @ (row_scale * off_direction)
    sides = limited.sides[: len(joints)]
    effect = np.choose(sides, (0.0, gradient, -gradient, np.abs(gradient)))
    order = np.argsort(-effect, kind="stable").tolist()
    least = MIN_EFFECT * float(np.abs(gradient).max())
    names = [
        f"{cause(bounds, joint, gradient[joint] < 0.0)} {joints[joint]}" for joint in order if effect[joint] > least
    ]
    if dampers is not None:
        names += [f"damper {dampers.names[index]}" for index in np.flatnonzero(limited.sides[len(joints) :]).tolist()]
    return tuple(names) or limited.binding(bounds, joints, dampers)
