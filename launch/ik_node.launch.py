"""Start the node with the parameter file of a robot: ``ros2 launch ik_node ik_node.launch.py robot:=panda``."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    robot = LaunchConfiguration("robot")
    config = PathJoinSubstitution([FindPackageShare("ik_node"), "config", [robot, ".yaml"]])
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="panda", description="Parameter file config/<robot>.yaml."),
            Node(package="ik_node", executable="ik_node", parameters=[config], output="screen"),
        ]
    )
