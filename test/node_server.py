"""Process that has loaded what nodes import, with the machine code, and starts each node by a fork of itself.

Loading takes most of the processor time of a test with one node. :mod:`warm_nodes` starts this and sends one request
per line: module, arguments, environment and log of a node, answered with its process id; or a process id, answered with
its exit code, null while it runs. rclpy is not loaded here, because it starts threads, which a fork would lose.
"""

from __future__ import annotations

import gc
import json
import os
import runpy
import sys
from pathlib import Path
from typing import Any

from ik_node.cli.entry import imports

with imports():  # two of them only so that they are loaded before the forks
    from loop import make_robot

    from ik_node.control.warm_up import warm_up
    from ik_node.recording import run_recorder  # noqa: F401
    from ik_node.replay import recorded_controller  # noqa: F401
    from ik_node.settings.groups import Settings


def answered_requests() -> dict[str, Any] | None:
    """Answer requests; return the one of a node in its new process, None in this one after the last request."""
    for line in sys.stdin:
        request = json.loads(line)
        if isinstance(request, int):
            ended, status = os.waitpid(request, os.WNOHANG)
            answer = os.waitstatus_to_exitcode(status) if ended else None
        else:
            if len(list(Path("/proc/self/task").iterdir())) > 1:
                raise RuntimeError("a fork of a process with several threads may hang")
            answer = os.fork()
            if answer == 0:
                return dict(request)
        print(json.dumps(answer), flush=True)
    return None


def become(request: dict[str, Any]) -> None:
    """Make this process what ``python -m module arguments`` with its output in the log is."""
    os.setsid()
    log = os.open(request["log"], os.O_WRONLY | os.O_APPEND)
    silent = os.open(os.devnull, os.O_RDONLY)
    for descriptor, number in ((silent, 0), (log, 1), (log, 2)):
        os.dup2(descriptor, number)
    os.close(log)
    os.close(silent)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    sys.argv = [request["module"], *request["arguments"]]
    runpy.run_module(request["module"], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    warm_up(make_robot("panda"), Settings())
    gc.collect()
    gc.freeze()
    if (request := answered_requests()) is not None:
        become(request)
