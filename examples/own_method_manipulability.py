"""An own method: the null space of a Panda that holds its tool goes to the best manipulability, beside plain.

h = -S log det(J J') / 2 (Yoshikawa 1985), rotations times 0.3 m; its gradient by central differences.
"""

from __future__ import annotations

import numpy as np

import ik_node

START = np.array((0.0, -0.785398, 0.6, -2.356194, 0.3, 1.570796, 0.785398))
ROW_SCALE = np.repeat((1.0, 0.3), 3)[:, None]
STRENGTH, STEP, PERIOD_NS = 2.0, 1e-6, 10_000_000  # N m, rad, ns


def potential(robot: ik_node.Robot, q: np.ndarray) -> float:
    """Return h(q)."""
    scaled = ROW_SCALE * robot.evaluate(q).jacobian_b
    return -0.5 * STRENGTH * float(np.linalg.slogdet(scaled @ scaled.T)[1])


def dexterity(robot: ik_node.Robot, q: np.ndarray) -> tuple[None, np.ndarray, float]:
    """Return the identity as W, grad h and h."""
    steps = STEP * np.eye(len(q))
    gradient = np.array([potential(robot, q + step) - potential(robot, q - step) for step in steps]) / (2.0 * STEP)
    return None, gradient, potential(robot, q)


def run(method: str) -> float:
    """Return the manipulability at the end relative to that of the start."""
    robot = ik_node.load_robot("panda")
    values = {"method": method, "extra_methods": ["dexterity"], "rate_hz": 100.0, "gradient_gain": 1.0}
    controller = ik_node.Controller(robot, ik_node.Settings().with_values(values), {"dexterity": dexterity})
    arm = ik_node.SimulatedArm(START, robot.limits, 0)
    for time_ns in range(PERIOD_NS, 5_000_000_000, PERIOD_NS):
        now = ik_node.Instant(time_ns, time_ns)
        q, _ = arm.advance(time_ns)
        step = controller.on_joint_state(ik_node.JointSample(time_ns, robot.joints, q), now)
        if step is not None:
            arm.command(step.joint_velocity, time_ns)
    ratio = np.exp((potential(robot, START) - potential(robot, q)) / STRENGTH)
    moved = 1e3 * np.linalg.norm(robot.pose(q)[:3, 3] - robot.pose(START)[:3, 3])
    print(f"{method:10} manipulability {ratio:.3f} times that of the start; the tool moved by {moved:.3f} mm")
    return float(ratio)


if __name__ == "__main__":
    run("plain")
    run("dexterity")
