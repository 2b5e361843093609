"""Control a simulated Panda in closed loop beside an obstacle, and draw the distance over time."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import ik_node

START = np.array((0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398))
SCENE = Path(__file__).resolve().parent.parent / "config" / "scenes" / "ball.yaml"
VALUES = {"obstacles.scene": str(SCENE), "obstacles.self_collision": False}
PERIOD_NS = 2_000_000


def run(method: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times (k,) in s and distances (k,) in m of a tool that moves 0.2 m to the side and back."""
    robot = ik_node.load_robot("panda")
    controller = ik_node.Controller(robot, ik_node.Settings().with_values({"method": method, **VALUES}))
    arm = ik_node.SimulatedArm(START, robot.limits, 0)
    start = robot.pose(START)
    downwards = np.array((1.0, 0.0, 0.0, 0.0))  # quaternion x y z w
    steps = []
    for time_ns in range(PERIOD_NS, 6_000_000_000, PERIOD_NS):
        now = ik_node.Instant(time_ns, time_ns)
        q, _ = arm.advance(time_ns)
        if time_ns % (10 * PERIOD_NS) == 0:
            target = start[:3, 3] + (0.0, 0.1 * (1.0 - np.cos(np.pi / 3.0 * time_ns * 1e-9)), 0.0)
            controller.on_target_pose(ik_node.PoseSample(time_ns, robot.base_frame, target, downwards), now)
        step = controller.on_joint_state(ik_node.JointSample(time_ns, robot.joints, q), now)
        if step is not None:
            arm.command(step.joint_velocity, time_ns)
            steps.append(step)
    return np.array([step.now.monotonic_ns * 1e-9 for step in steps]), np.array([step.clearance for step in steps])


def main(picture: str = "closed_loop_obstacle.png") -> None:
    """Run with and without the gradient of the obstacles' potential; write ``picture``."""
    for method in ("inertia_weighted", "obstacle_gradient"):
        times, distances = run(method)
        print(f"{method:18} smallest distance {1e3 * np.nanmin(distances):5.1f} mm")
        plt.plot(times, 1e3 * distances, label=method)
    plt.xlabel("time [s]"), plt.ylabel("distance of the closest pair [mm]"), plt.legend()
    plt.savefig(picture)


if __name__ == "__main__":
    main()
