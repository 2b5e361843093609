"""Print a parameter file for an arm that is given as a URDF file.

It has the joints, the tool frame, the limits with their sources, and a start posture for the simulated arm.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError

EPILOG = """\
example:
  ik_config my_arm.urdf > my_arm.yaml        read it, and replace what is marked as assumed
  ik_demo --config my_arm.yaml               simulation, recording and report
  ik_node --ros-args --params-file my_arm.yaml

A xacro file is no URDF: xacro my_arm.urdf.xacro > my_arm.urdf
docs/your_arm.md: from the URDF to the topics of your driver.
exit code: 0 printed, 2 the file is no URDF of an arm
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_config", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("urdf", type=Path, metavar="FILE", help="URDF file")
    result.add_argument("--base", default="", help="frame {s} of the targets [the root of the model]")
    result.add_argument("--tip", default="", help="tool frame {b} [end of the longest chain, without a gripper]")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Print the file; return 0, or 2 when the URDF cannot be used."""
    options = parser().parse_args(arguments)
    from ik_node.control.arm_configuration import arm_configuration

    try:
        text = arm_configuration(options.urdf, options.base, options.tip)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    sys.stdout.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
