"""Start the node, and the watchdog beside it: ``ros2 launch ik_node ik_node.launch.py robot:=panda``.

``--show-args`` lists the arguments. Without ``robot`` and ``urdf`` the node waits for the topic ``robot_description``.
"""

import os
import signal
import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ProcessExited, SignalProcess
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity

CONFIG = Path(__file__).resolve().parent.parent / "config"
"""Beside this file's folder in the source tree and in share/ik_node."""
ROBOTS = sorted(path.stem for path in CONFIG.glob("*.yaml"))
TRUTH = ("true", "false")
ARGUMENTS = {
    "robot": ("", f"Use the installed parameter file config/<robot>.yaml: {', '.join(ROBOTS)}."),
    "urdf": ("", "Use the arm of this URDF file; not together with robot. Default: topic robot_description."),
    "params_file": ("", "Parameter file, section ik_node, and ik_watchdog if it has one; overrides that of robot."),
    "namespace": ("", "Namespace of node, watchdog and their relative topics, joint_states among them."),
    "command_topic": ("", "Topic of the joint velocities, such as /forward_velocity_controller/commands."),
    "use_sim_time": ("false", "true: take the time of stamps from /clock."),
    "watchdog": ("true", "true: start ik_watchdog, which stops the arm if the node is killed or hangs."),
}
"""Name -> default value and description."""
LONGEST_RAMP_S = "600"
"""Time that launch leaves the processes to end after Ctrl-C; the default of 5 s and 5 s more ends in SIGKILL, which
leaves a velocity standing. A joint at 3 rad/s with an acceleration limit of 0.005 rad/s2 needs this long to stop."""


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return node and watchdog; raises RuntimeError for an argument that cannot be used."""
    refuse_unknown(context.argv)
    argument = {name: context.launch_configurations[name] for name in ARGUMENTS}
    for name in ("use_sim_time", "watchdog"):
        if argument[name] not in TRUTH:
            raise RuntimeError(f"{name} is '{argument[name]}'; valid: {', '.join(TRUTH)}")
    parameters = parameters_of(argument)
    common = {
        "package": "ik_node",
        "namespace": argument["namespace"] or None,
        "output": "screen",
        "sigterm_timeout": LONGEST_RAMP_S,
        "sigkill_timeout": LONGEST_RAMP_S,
        "additional_env": end_with_launch(context),
    }
    topic = argument["command_topic"]
    node = Node(
        executable="ik_node", parameters=parameters, remappings=[("~/commands", topic)] if topic else None, **common
    )
    if argument["watchdog"] == "false":
        return [node]
    own = argument["params_file"]
    watchdog = Node(
        executable="ik_watchdog",
        parameters=[own] if own and "ik_watchdog:" in Path(own).read_text() else None,
        remappings=[("ik_node/commands", topic)] if topic else None,
        **common,
    )
    end = EmitEvent(event=SignalProcess(signal_number=signal.SIGINT, process_matcher=matches_action(watchdog)))

    def end_watchdog(event: ProcessExited, context: LaunchContext) -> EmitEvent | None:
        """It continues until the commands are zero. In a shutdown it has the signal already."""
        del event
        return None if context.is_shutdown else end

    return [RegisterEventHandler(OnProcessExit(target_action=node, on_exit=end_watchdog)), watchdog, node]


def parameters_of(argument: dict[str, str]) -> list[object]:
    """Return parameter files and values of the node; later ones have priority."""
    robot, urdf, own = argument["robot"], argument["urdf"], argument["params_file"]
    if robot and urdf:
        raise RuntimeError("robot and urdf exclude each other; parameters of your own are set by params_file")
    parameters: list[object] = []
    if robot:
        if robot not in ROBOTS:
            raise RuntimeError(f"unknown robot '{robot}'; valid: {', '.join(ROBOTS)}")
        parameters.append(str(CONFIG / f"{robot}.yaml"))
    if own:
        parameters.append(str(existing("params_file", own)))
    if urdf:
        if urdf.endswith(".xacro"):
            raise RuntimeError(f"urdf: '{urdf}' is no URDF; write the URDF with: xacro {urdf} > arm.urdf")
        text = existing("urdf", urdf).read_text()
        parameters.append({"robot_description": ParameterValue(text, value_type=str)})
    if argument["use_sim_time"] == "true":
        parameters.append({"use_sim_time": True})
    return parameters


def existing(name: str, value: str) -> Path:
    """Return the file of an argument."""
    path = Path(value)
    if not path.is_file():
        raise RuntimeError(f"{name}: no file '{value}'")
    return path


def refuse_unknown(argv: list[str]) -> None:
    """Refuse names that launch would ignore, unless another launch file includes this one: they may be that file's."""
    if not any(Path(word).name == Path(__file__).name for word in sys.argv):
        return
    for word in argv:
        name = word.partition(":=")[0]
        if name not in ARGUMENTS and not name.startswith("launch-prefix"):
            raise RuntimeError(f"unknown argument '{name}'; valid: {', '.join(ARGUMENTS)}")


def end_with_launch(context: LaunchContext) -> dict[str, str] | None:
    """Return the environment with which a process gets SIGTERM when launch itself was killed.

    Not with a launch prefix: launch is not the parent then.
    """
    return None if "launch-prefix" in context.launch_configurations else {"IK_NODE_END_WITH_PARENT": str(os.getpid())}
