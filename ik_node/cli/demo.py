"""Run node and simulated robot on a trajectory, record the run and report on it, in one command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from ik_node import resources
from ik_node.cli.entry import UNUSABLE, command_line
from ik_node.cli.pose_file_options import add_options, format_from
from ik_node.errors import IkNodeError, SceneError, SettingsError, TrajectoryFileError
from ik_node.settings.groups import METHOD_NAMES

FILE_ERRORS = (SceneError, SettingsError, TrajectoryFileError)
"""Of the files and options that are given."""
SHAPES = ("figure_of_eight", "circle", "line", "hold")
"""Keys of :data:`ik_node.trajectory.shapes.SHAPES`, which would load NumPy and numba; a test compares them."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_demo", description=__doc__)
    result.add_argument("--robot", default="panda", help="name in example-robot-data [%(default)s]")
    result.add_argument("--config", type=Path, help="parameter file [config/<robot>.yaml]")
    result.add_argument("--method", choices=METHOD_NAMES, help="method that resolves redundancy [as configured]")
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
    result.add_argument("--headless", action="store_true", help="do not open the picture of the report")
    add_options(result.add_argument_group("file of poses"))
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; return 0, 130 after Ctrl-C, 1 when it cannot run, 2 for an invalid option or file."""
    options = parser().parse_args(arguments)
    from ik_node.settings.parameter_file import parse_assignment

    for assignment in options.set:
        try:
            parse_assignment(assignment)
        except IkNodeError as error:
            print(f"error: --set {assignment}: {error}", file=sys.stderr)
            return UNUSABLE
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(resources.config_file("fastdds_quick_discovery.xml")))
    try:
        # Imported after the environment is set: the middleware reads it when it is loaded.
        import numpy as np

        from ik_node.collision.scene import read_scene
        from ik_node.ros.demo.demo import Demonstration, DemoOptions

        overrides = [value.replace("=", ":=", 1) for value in options.set]
        if options.scene is not None:
            read_scene(options.scene, lambda frame: np.eye(4))  # the node resolves the frames
            overrides.append(f"obstacles.scene:={options.scene.resolve()}")
        if options.method:
            overrides.append(f"method:={options.method}")
        demonstration = Demonstration(
            DemoOptions(
                robot=options.robot,
                config=options.config,
                trajectory=options.trajectory,
                file_format=format_from(options),
                target_rate_hz=options.target_rate,
                rate_hz=options.rate,
                overrides=tuple(overrides),
                out=options.out or Path(f"ik_demo_{options.robot}_{datetime.now():%Y%m%d-%H%M%S}"),
                show=not options.headless,
            )
        )
        return demonstration.run()
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE if isinstance(error, FILE_ERRORS) else 1


if __name__ == "__main__":
    sys.exit(main())
