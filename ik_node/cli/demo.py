"""Run node and simulated robot on a trajectory, record the run and report on it, in one command."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ik_node.cli.entry import command_line
from ik_node.cli.pose_file_options import add_options, format_from, refuse_given
from ik_node.errors import IkNodeError, MissingPackageError, SettingsError
from ik_node.ros.own_domain import use_own_domain
from ik_node.settings.method_names import ALL_METHODS, METHOD_NAMES

if TYPE_CHECKING:
    from ik_node.ros.demo.options import DemoOptions

FAILED, UNUSABLE = 1, 2
MAX_TARGET_RATE_HZ = 2000.0
"""Highest rate of target poses: that of control steps."""
SHAPES = ("figure_of_eight", "circle", "line", "hold")
"""Keys of :data:`ik_node.trajectory.shapes.SHAPES`, which would load NumPy and numba; a test compares them."""

EPILOG = """\
examples:
  ik_demo --robot ur5 --target-rate 500 --out my_run
  ik_demo --urdf my_arm.urdf                         an arm of your own; ik_config my_arm.urdf prints its parameters
  ik_demo --config my_arm.yaml --trajectory circle
  ik_demo --no-ros --method inertia_weighted         without ROS, faster than real time
  ik_demo --no-ros --method all                      energies, multipliers, null-space motion of all methods
  ik_demo --trajectory poses.csv --units mm          a file of poses

exit code: 0 done; 1 a process failed; 2 an argument or file cannot be used, nothing was started; 130 ended by Ctrl-C
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_demo",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("--robot", help="name in example-robot-data [that of --config, else panda]")
    result.add_argument(
        "--urdf", type=Path, help="URDF file of an arm, instead of --robot; ik_config prints its parameters"
    )
    result.add_argument("--base", help="frame {s} of the targets [as configured, else the root of the model]")
    result.add_argument("--tip", help="tool frame {b} [as configured, else the end of the arm, without a gripper]")
    result.add_argument("--config", type=Path, help="parameter file [config/<robot>.yaml, or made from --urdf]")
    names = f"{', '.join(METHOD_NAMES)}, or package.module:name; with --no-ros also {ALL_METHODS}: side by side"
    result.add_argument("--method", help=f"method that resolves redundancy: {names} [as configured]")
    result.add_argument(
        "--trajectory", default=SHAPES[0], help=f"{', '.join(SHAPES)}, or a file of poses [%(default)s]"
    )
    result.add_argument(
        "--target-rate", type=float, help="rate of the published poses, Hz [times in the file, else 50]"
    )
    result.add_argument("--rate", type=float, help="rate of joint states and control steps, Hz [as configured]")
    result.add_argument("--out", type=Path, help="new folder for recording and report [ik_demo_<robot>_<time>]")
    result.add_argument("--scene", type=Path, help="YAML file of obstacles, e.g. config/scenes/ball.yaml")
    result.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="parameter of the node; may be repeated"
    )
    result.add_argument(
        "--no-ros", action="store_true", help="controller and simulated arm in one process, in simulated time"
    )
    result.add_argument("--headless", action="store_true", help="do not open the picture of the report")
    add_options(result.add_argument_group("file of poses"))
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; the exit code is that of --help."""
    options = parser().parse_args(arguments)
    use_own_domain()
    code = UNUSABLE
    try:
        options_of_run = checked_options(options)
        if options.no_ros:
            from ik_node.ros.demo.in_process import run_in_process

            return run_in_process(options_of_run)
        # Imported after the environment is set: the middleware reads it when it is loaded.
        from ik_node.ros.demo.demo import Demonstration

        demonstration = Demonstration(options_of_run)
        code = FAILED
        return demonstration.run()
    except ModuleNotFoundError as error:
        if error.name != "rclpy":
            raise
        print(f"error: {MissingPackageError(error)}; or give --no-ros", file=sys.stderr)
        return UNUSABLE
    except SettingsError as error:  # also a folder that cannot be created
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return code


def checked_options(options: argparse.Namespace) -> DemoOptions:
    """Return the options of the run; raises an IkNodeError for one that is invalid, given twice or without effect."""
    from ik_node.ros.demo.options import DemoOptions, checked_overrides

    assignments = list(options.set)
    compares_methods = options.method == ALL_METHODS
    if compares_methods and not options.no_ros:
        raise SettingsError(f"--method {ALL_METHODS} simulates each method in this process; expected --no-ros")
    for name, flag, value in (
        ("method", "--method", options.method),
        ("rate_hz", "--rate", options.rate),
        ("obstacles.scene", "--scene", options.scene and json.dumps(str(options.scene.absolute()))),
        ("robot", "--robot", options.robot),
        ("base_frame", "--base", options.base),
        ("tip_frame", "--tip", options.tip),
        ("robot_description", "--urdf", options.config and options.urdf and json.dumps(str(options.urdf.absolute()))),
    ):
        if value is not None:
            double = [each for each in options.set if each.partition("=")[0] == name]
            if double:
                raise SettingsError(f"{flag} and --set {double[0]} set the same; expected one of them")
            if (name, value) != ("method", ALL_METHODS):
                assignments.append(f"{name}={value}")
    if options.urdf is not None:
        others = [flag for flag, value in (("--robot", options.robot),) if value is not None]
        others += [f"--set {each}" for each in options.set if each.partition("=")[0] in ("robot", "robot_description")]
        if others:
            raise SettingsError(f"--urdf and {others[0]} exclude each other; expected one of them")
    file_format = format_from(options)
    if options.trajectory in SHAPES:
        refuse_given(file_format, f"'{options.trajectory}' is no file of poses")
    if options.target_rate is not None and not 0.0 < options.target_rate <= MAX_TARGET_RATE_HZ:
        raise SettingsError(f"--target-rate is {options.target_rate:g}; valid: above 0 to {MAX_TARGET_RATE_HZ:g} Hz")
    return DemoOptions(
        config=options.config,
        urdf=options.urdf,
        overrides=checked_overrides(assignments),
        trajectory=options.trajectory,
        file_format=file_format,
        target_rate_hz=options.target_rate,
        out=options.out,
        show=not options.headless,
        compares_methods=compares_methods,
    )


if __name__ == "__main__":
    sys.exit(main())
