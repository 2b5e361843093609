"""An own method: a camera that follows a path by its position keeps an object in its view, beside plain.

h = S (1 - cos) of the angle between the line of sight (z of the tool) and the object.
"""

from __future__ import annotations

import numpy as np

import ik_node

START = np.array((0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398))
OBJECT = np.array((0.5, 0.0, 0.0))  # m, in the base frame
STRENGTH, PERIOD_NS, POSITION = 2.0, 10_000_000, (0.0, 0.0, 0.0, np.inf, np.inf, np.inf)


def look(robot: ik_node.Robot, q: np.ndarray) -> tuple[None, np.ndarray, float]:
    """Return the identity as W, grad h and h."""
    pose, jacobian = robot.evaluate(q)
    away = pose[:3, :3].T @ (OBJECT - pose[:3, 3])  # in the tool frame
    u, z = away / np.linalg.norm(away), np.array((0.0, 0.0, 1.0))
    gradient = ((z - u[2] * u) / np.linalg.norm(away)) @ jacobian[:3] + np.cross(u, z) @ jacobian[3:]
    return None, STRENGTH * gradient, STRENGTH * (1.0 - u[2])


def run(method: str) -> float:
    """Return the largest angle between the line of sight and the object, deg, after the first second."""
    robot = ik_node.load_robot("panda")
    values = {"method": method, "extra_methods": ["look"], "rate_hz": 100.0, "gradient_gain": 1.0}
    values |= {"task.tolerance": POSITION, "null_space_speed": 4.0, "obstacles.geometry": "none"}
    controller = ik_node.Controller(robot, ik_node.Settings().with_values(values), {"look": look})
    arm = ik_node.SimulatedArm(START, robot.limits, 0)
    start, downwards, angles = robot.pose(START)[:3, 3], np.array((1.0, 0.0, 0.0, 0.0)), []
    for time_ns in range(PERIOD_NS, 6_000_000_000, PERIOD_NS):
        now = ik_node.Instant(time_ns, time_ns)
        q, _ = arm.advance(time_ns)
        point = start + np.array((0.0, 0.2 * np.sin(time_ns * 1e-9), 0.0))
        controller.on_target_pose(ik_node.PoseSample(time_ns, robot.base_frame, point, downwards), now)
        step = controller.on_joint_state(ik_node.JointSample(time_ns, robot.joints, q), now)
        if step is not None:
            arm.command(step.joint_velocity, time_ns)
            angles.append(float(np.degrees(np.arccos(1.0 - look(robot, q)[2] / STRENGTH))))
            error = 1e3 * np.linalg.norm(step.error_b[:3])
    print(f"{method:6} largest angle {max(angles[100:]):.1f} deg, error {error:.3f} mm")
    return max(angles[100:])


if __name__ == "__main__":
    run("plain")
    run("look")
