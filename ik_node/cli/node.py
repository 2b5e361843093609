"""Run the velocity controller of a robot arm as a ROS 2 lifecycle node.

It subscribes to joint states and to targets of the tool, and publishes joint velocities.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ik_node.cli import ros_arguments
from ik_node.cli.entry import command_line, imports

EPILOG = """\
subscribed topics (~ is the name of the node):
  joint_states          sensor_msgs/JointState; each one may start a control step
  robot_description     std_msgs/String; used without the parameters robot and robot_description
  ~/target_pose         geometry_msgs/PoseStamped, a stream
  ~/target_path         nav_msgs/Path
  ~/target_trajectory   trajectory_msgs/MultiDOFJointTrajectory
  ~/target_twist        geometry_msgs/TwistStamped, jogging
  ~/obstacles           visualization_msgs/MarkerArray

published topics:
  ~/commands            std_msgs/Float64MultiArray, joint velocities, rad/s (m/s)
  ~/joint_velocity      sensor_msgs/JointState, the same with names and stamp
  ~/current_pose, ~/desired_pose, ~/twist_error, ~/multiplier/task, ~/multiplier/potential
  ~/status              diagnostic_msgs/DiagnosticStatus, on each change
  ~/markers             visualization_msgs/MarkerArray, for RViz
  /diagnostics          diagnostic_msgs/DiagnosticArray, 1 Hz

services:
  ~/pause, ~/record     std_srvs/SetBool
  ~/reset               std_srvs/Trigger

parameters:
  docs/parameters.md; of a running node: ros2 param describe /ik_node NAME
  config/ has a file for each robot

example:
  ik_node --ros-args --params-file config/panda.yaml -p method:=inertia_weighted

exit code: 0 after SIGINT or SIGTERM, 1 when the node cannot be configured, 2 for an unknown option or
arguments that ROS cannot read
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    return ros_arguments.node_parser("ik_node", __doc__, EPILOG)


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until a signal; return the exit code."""
    ros_arguments.parse(parser(), arguments)
    with imports():
        from ik_node.ros.node import IkNode
        from ik_node.ros.spin import run

    return run(lambda: IkNode(arguments), IkNode.finish, arguments)


if __name__ == "__main__":
    sys.exit(main())
