"""``ik_compile``: compile the control step at install time, so that the first start of the node does not."""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections.abc import Sequence

from ik_node.cli.entry import command_line

EPILOG = """\
NUMBA_CACHE_DIR sets the folder, which may be read-only afterwards. In an image for other
processors set NUMBA_CPU_NAME=generic and NUMBA_CPU_FEATURES to nothing, here and for the node.

example:
  ik_compile
  ik_compile --robot ur5

exit code: 0 everything is compiled, 1 the machine code cannot be stored, 2 the robot cannot be loaded
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_compile",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("--robot", default="panda", help="arm that is simulated meanwhile [%(default)s]")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Compile what is not compiled; return 1 when the machine code cannot be stored."""
    options = parser().parse_args(arguments)
    from ik_node.control.compilation import compile_and_warm_up
    from ik_node.errors import IkNodeError
    from ik_node.jit import cache_folder
    from ik_node.robot.catalogue import load_robot
    from ik_node.settings.groups import Settings

    folder, begin_s = cache_folder(), time.monotonic()
    if folder is None:
        print("error: the folder of the machine code cannot be written; set NUMBA_CACHE_DIR", file=sys.stderr)
        return 1
    try:
        count = compile_and_warm_up(load_robot(options.robot), Settings(), functools.partial(print, flush=True))
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{count} functions are compiled, after {time.monotonic() - begin_s:.0f} s, in {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
