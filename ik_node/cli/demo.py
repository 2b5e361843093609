"""``ik_demo``: node, simulated robot, a trajectory, a recording and a report, in one command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from ik_node import resources
from ik_node.cli.entry import command_line
from ik_node.cli.pose_file_options import add_options, format_from
from ik_node.errors import IkNodeError
from ik_node.settings.groups import METHODS
from ik_node.trajectory.shapes import SHAPES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="ik_demo", description=__doc__)
    result.add_argument("--robot", default="panda", help="name in example-robot-data [%(default)s]")
    result.add_argument("--config", type=Path, help="parameter file [config/<robot>.yaml]")
    result.add_argument("--method", choices=METHODS, help="how joint velocities are chosen [as configured]")
    first = next(iter(SHAPES))
    result.add_argument("--trajectory", default=first, help=f"{', '.join(SHAPES)}, or a file of poses [%(default)s]")
    result.add_argument("--target-rate", type=float, help="poses sent, Hz [a file's own times if it has any, else 50]")
    result.add_argument("--rate", type=float, help="joint states, and so ticks, per second [as configured]")
    result.add_argument("--out", type=Path, help="new folder for recording and report [ik_demo_<robot>_<time>]")
    result.add_argument("--scene", type=Path, help="YAML file of obstacles, e.g. config/scenes/ball.yaml")
    result.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="parameter of the node")
    result.add_argument("--headless", action="store_true", help="do not open the picture at the end")
    add_options(result.add_argument_group("file of poses"))
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the demonstration; 0 when it went to its end, 130 after Ctrl-C, 1 when it could not run."""
    options = parser().parse_args(arguments)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(resources.config_file("fastdds_quick_discovery.xml")))
    try:
        # Imported only now: the middleware reads the environment when it is loaded.
        from ik_node.ros.demo.demo import Demonstration, DemoOptions

        overrides = [value.replace("=", ":=", 1) for value in options.set]
        if options.scene is not None:
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
        return 1


if __name__ == "__main__":
    sys.exit(main())
