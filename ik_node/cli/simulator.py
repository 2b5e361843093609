"""Run a simulated robot arm as a ROS 2 node.

It behaves as ros2_control with a forward_command_controller (velocity) and a joint_state_broadcaster, and subscribes
where ik_node publishes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ik_node.cli import ros_arguments
from ik_node.cli.entry import command_line, imports

EPILOG = """\
topics (in the namespace of the simulator):
  ik_node/commands      std_msgs/Float64MultiArray, subscribed: joint velocities, rad/s (m/s)
  joint_states          sensor_msgs/JointState, published at rate_hz
  robot_description     std_msgs/String, published once, transient local

parameters (read at the start):
  robot                 name in example-robot-data [panda]
  robot_description     URDF, as text or as path of a file, instead of robot
  base_frame, tip_frame, joint_prefix
                        as for ik_node
  rate_hz               rate of the joint states, Hz [500]
  initial_position      joint positions at the start, rad (m) [chosen: not singular,
                        away from joint limits and collisions; the log lists them]
  lag_s                 time constant of the joints' first-order lag, s [0]
  delay_s               time between a command and the start of its effect, s [0]
  encoder_noise         standard deviation of the measured positions, rad (m) [0]
  dropout               fraction of joint states that are not published [0]
  seed                  seed of noise and dropouts [0]

examples:
  ik_simulator --ros-args --params-file config/panda.yaml
  ik_simulator --ros-args -p robot_description:=my_arm.urdf -r ik_node/commands:=/my_controller/commands

exit code: 0 after SIGINT or SIGTERM, 1 for an invalid parameter or a robot that cannot be loaded, 2 for an unknown
option
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    return ros_arguments.node_parser("ik_simulator", __doc__, EPILOG)


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulated robot until a signal; return the exit code."""
    ros_arguments.parse(parser(), arguments)
    with imports():
        from ik_node.ros.simulator_node import SimulatorNode
        from ik_node.ros.spin import run

    return run(lambda: SimulatorNode(arguments), SimulatorNode.finish, arguments)


if __name__ == "__main__":
    sys.exit(main())
