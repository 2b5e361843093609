"""An own method: weights that keep a Panda away from its joint limits (Chan and Dubey 1995), beside plain.

W = diag(1 + |dH/dq|) with H = sum (upper - lower)^2 / (4 (upper - q) (q - lower)): a joint near its limit moves little.
"""

from __future__ import annotations

import numpy as np

import ik_node

START = np.array((0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398))
PERIOD_NS = 10_000_000
LARGEST_WEIGHT = 1e4


def avoid_limits(robot: ik_node.Robot, q: np.ndarray) -> tuple[np.ndarray, None]:
    """Return W(q) and no gradient."""
    lower, upper = robot.limits.lower, robot.limits.upper
    above, below = np.maximum(q - lower, 1e-3), np.maximum(upper - q, 1e-3)
    slope = (upper - lower) ** 2 * (2.0 * q - upper - lower) / (4.0 * (below * above) ** 2)
    return np.diag(np.minimum(1.0 + np.abs(slope), LARGEST_WEIGHT)), None


def run(method: str) -> float:
    """Return the smallest distance of a joint from its limits, rad, while the tool moves 0.35 m towards the base."""
    robot = ik_node.load_robot("panda")
    values = {"method": method, "extra_methods": ["avoid_limits"], "rate_hz": 100.0, "obstacles.self_collision": False}
    controller = ik_node.Controller(robot, ik_node.Settings().with_values(values), {"avoid_limits": avoid_limits})
    arm = ik_node.SimulatedArm(START, robot.limits, 0)
    pose, downwards, margin = robot.pose(START), np.array((1.0, 0.0, 0.0, 0.0)), np.inf
    for time_ns in range(PERIOD_NS, 6_000_000_000, PERIOD_NS):
        now = ik_node.Instant(time_ns, time_ns)
        q, _ = arm.advance(time_ns)
        point = pose[:3, 3] + 0.5 * (1.0 - np.cos(0.5 * time_ns * 1e-9)) * np.array((-0.15, 0.2, -0.25))
        controller.on_target_pose(ik_node.PoseSample(time_ns, robot.base_frame, point, downwards), now)
        step = controller.on_joint_state(ik_node.JointSample(time_ns, robot.joints, q), now)
        if step is not None:
            arm.command(step.joint_velocity, time_ns)
            margin = min(margin, *(q - robot.limits.lower), *(robot.limits.upper - q))
            error = 1e3 * np.linalg.norm(step.error_b[:3])
    print(f"{method:13} smallest distance from a limit {margin:.3f} rad, error {error:.3f} mm")
    return float(margin)


if __name__ == "__main__":
    run("plain")
    run("avoid_limits")
