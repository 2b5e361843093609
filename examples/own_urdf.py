"""Load a robot from a URDF of one's own: a planar arm of two links, with joint limits."""

from __future__ import annotations

import numpy as np

import ik_node

LINK = """<link name="{0}"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" velocity="2" effort="10"/></joint>"""
TOOL = '<joint name="flange" type="fixed"><parent link="forearm"/><child link="tool"/><origin xyz="0.8 0 0"/></joint>'
URDF = "\n".join((
    '<robot name="planar">',
    *(LINK.format(name) for name in ("base", "upper_arm", "forearm", "tool")),
    JOINT.format("shoulder", "base", "upper_arm", "0"),
    JOINT.format("elbow", "upper_arm", "forearm", "1"),
    TOOL,
    "</robot>",
))  # fmt: skip


def main() -> None:
    """Print the closed-form position and Jacobian beside those of the model."""
    robot = ik_node.load_robot(URDF, base_frame="base", tip_frame="tool")
    q = np.array((0.3, 0.9))
    kinematics = robot.evaluate(q)
    expected = np.array((np.cos(q[0]) + 0.8 * np.cos(q.sum()), np.sin(q[0]) + 0.8 * np.sin(q.sum())))
    print(f"joints: {', '.join(robot.joints)}; velocity limits: {robot.limits.velocity} rad/s")
    print(f"position of the tool: {kinematics.pose_sb[:2, 3]}, in closed form: {expected}")
    print(f"body Jacobian, rows v_x, v_y, omega_z:\n{kinematics.jacobian_b[[0, 1, 5]].round(6)}")
    qd = ik_node.resolve(kinematics.jacobian_b[:2], (0.1, 0.0)).joint_velocity
    print(f"joint velocity for 0.1 m/s along the tool's x axis: {qd.round(6)} rad/s")


if __name__ == "__main__":
    main()
