"""Stop the arm when ik_node was killed or hangs: a second ROS 2 node, in a process of its own.

A forward_command_controller keeps its last velocity. The watchdog subscribes to the joint velocity that ik_node
publishes with each command, and commands zero when none follows a non-zero one in time. It ignores other commanders.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ik_node.cli import ros_arguments
from ik_node.cli.entry import command_line, imports

EPILOG = """\
topics (in the namespace of the watchdog):
  ik_node/joint_velocity
                        sensor_msgs/JointState, subscribed
  ik_node/commands      std_msgs/Float64MultiArray; zeros are published there
  ik_node/watchdog, ~/status
                        diagnostic_msgs/DiagnosticStatus, latched, on each change; ik_node reads the first

parameters:
  timeout_s             longest time without a command after a non-zero one, s [0.1; 0.01 to 10]

example:
  ik_watchdog --ros-args -p timeout_s:=0.05 -r __ns:=/left -r ik_node/commands:=/left_arm_controller/commands

exit code: 0 after SIGINT or SIGTERM, 1 for an invalid parameter, 2 for an unknown option
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    return ros_arguments.node_parser("ik_watchdog", __doc__, EPILOG)


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the watchdog until a signal; return the exit code."""
    ros_arguments.parse(parser(), arguments)
    with imports():
        from ik_node.ros.spin import run
        from ik_node.ros.watchdog_node import WatchdogNode

    return run(lambda: WatchdogNode(arguments), WatchdogNode.finish, arguments)


if __name__ == "__main__":
    sys.exit(main())
