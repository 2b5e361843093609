"""Solve inverse kinematics for one pose of a Panda, within its joint limits, and check the result."""

from __future__ import annotations

import numpy as np

import ik_node


def main() -> None:
    """Print the joint positions and the remaining error."""
    robot = ik_node.load_robot("panda")
    pose_sd = np.eye(4)  # desired pose of the tool {b} in the base frame {s}
    pose_sd[:3, :3] = np.diag([1.0, -1.0, -1.0])  # pointing down
    pose_sd[:3, 3] = 0.4, 0.1, 0.5

    solution = ik_node.solve_pose(robot, pose_sd)

    error = robot.pose(solution.q) - pose_sd
    print(f"converged: {solution.converged} after {solution.iterations} iterations")
    for joint, q, lower, upper in zip(robot.joints, solution.q, robot.limits.lower, robot.limits.upper, strict=True):
        print(f"{joint:14} {q:8.4f} rad in [{lower:7.4f}, {upper:7.4f}]")
    print(f"largest error of the pose matrix: {np.abs(error).max():.1e}")


if __name__ == "__main__":
    main()
