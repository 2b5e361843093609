"""Start the node with the parameter file of a robot: ``ros2 launch ik_node ik_node.launch.py robot:=panda``."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

LONGEST_RAMP_S = "600"
"""Time in which launch leaves the node to ramp to zero after Ctrl-C; the default of 5 s and 5 s more ends in SIGKILL,
which leaves a velocity standing. A joint at 3 rad/s with an acceleration limit of 0.005 rad/s2 needs this long."""


def generate_launch_description() -> LaunchDescription:
    robot = LaunchConfiguration("robot")
    config = PathJoinSubstitution([FindPackageShare("ik_node"), "config", [robot, ".yaml"]])
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="panda", description="Parameter file config/<robot>.yaml."),
            Node(
                package="ik_node",
                executable="ik_node",
                parameters=[config],
                output="screen",
                sigterm_timeout=LONGEST_RAMP_S,
                sigkill_timeout=LONGEST_RAMP_S,
            ),
        ]
    )
