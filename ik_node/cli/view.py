"""Show a recorded run, or a running node, in 3-D in the browser."""

from __future__ import annotations

import argparse
import signal
import sys
import time
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError

UNUSABLE = 2
PERIOD_S = 1.0 / 30.0
LOCAL = "127.0.0.1"
MAX_PORT = 65535

EPILOG = """\
examples:
  ik_view my_run/bag --open
  ik_view --live
  ik_view --live --node /left/ik_node --ros-args -r joint_states:=/left/joint_states

With --live it subscribes to joint_states, robot_description, and the outputs, targets and obstacles of the node.
exit code: 0 ended by Ctrl-C, 2 there is nothing to show
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_view", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("bag", type=Path, nargs="?", help="folder or file of a recording")
    result.add_argument("--live", action="store_true", help="show a running node instead")
    result.add_argument("--node", default="", help="full name of the node [the only one recorded; live: /ik_node]")
    result.add_argument("--port", type=int, default=8080, help="port of the page, or the next free one [%(default)s]")
    result.add_argument(
        "--host", default=LOCAL, help="address to listen on; 0.0.0.0: reachable from other computers [%(default)s]"
    )
    result.add_argument("--open", action="store_true", help="open the page in the browser")
    result.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="with --live: arguments for ROS, e.g. remappings"
    )
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until Ctrl-C or SIGTERM, then return 0; 2 when there is nothing to show."""
    options = parser().parse_args(arguments)
    if not 0 <= options.port <= MAX_PORT:
        print(f"error: --port is {options.port}; valid: 0 to {MAX_PORT}", file=sys.stderr)
        return UNUSABLE
    if (options.bag is None) != options.live:
        print("error: expected a recording, or --live for a running node", file=sys.stderr)
        return UNUSABLE
    for number in (signal.SIGINT, signal.SIGTERM):  # SIGINT too: a background job of a shell starts with it ignored
        signal.signal(number, _interrupt)
    try:
        if options.live:
            _view_live(options)
        else:
            _view_bag(options)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        pass
    return 0


def _view_bag(options: argparse.Namespace) -> None:
    from ik_node.recording.run_reader import load_run
    from ik_node.report import compute_metrics
    from ik_node.report.recorded_scene import read_obstacles
    from ik_node.report.reported_run import stored_truth
    from ik_node.viewer.open_run import open_run
    from ik_node.viewer.server import serve

    run, obstacles = load_run(options.bag, options.node), read_obstacles(options.bag, options.node)
    metrics = compute_metrics(run, stored_truth(options.bag), obstacles=obstacles)
    server = serve(options.port, options.host)
    try:
        page = open_run(server, run, str(options.bag), obstacles, metrics)
        _announce(options)(server)
        last_s = time.monotonic()
        while True:
            time.sleep(PERIOD_S)
            now_s = time.monotonic()
            page.update(now_s - last_s)
            last_s = now_s
    finally:
        server.stop()


def _view_live(options: argparse.Namespace) -> None:
    from ik_node.viewer.server import serve

    try:
        from ik_node.ros.live_view.app import view_live
    except ImportError as error:
        raise IkNodeError(f"--live needs ROS 2, which is not installed: {error}") from error
    ros_arguments = ["--ros-args", *options.ros_args] if options.ros_args else []
    view_live(options.node or "/ik_node", lambda: serve(options.port, options.host), _announce(options), ros_arguments)


def _announce(options: argparse.Namespace) -> Callable[[Any], None]:
    from ik_node.viewer.server import url_of

    def announce(server: Any) -> None:
        print(f"{url_of(server)}  (Ctrl-C ends it)", flush=True)
        if options.open:
            webbrowser.open(url_of(server))

    return announce


def _interrupt(number: int, frame: FrameType | None) -> None:
    del number, frame
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
