"""Nodes as child processes that need not load modules and machine code: forks of :mod:`node_server`."""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ik_node.ros.child_process import END_WITH_PARENT, NodeProcess

MODULES = ("ik_node.cli.node", "ik_node.cli.simulator", "ik_node.cli.watchdog")
OWN_TO_EACH_TEST = ("ROS_DOMAIN_ID", "PYTEST_CURRENT_TEST")
"""Environment variables that may differ from those of the server: nothing reads them while it is imported."""
POLL_S = 0.005


class Server:
    """The server of this test process; it ends with it."""

    def __init__(self) -> None:
        self.environment = _environment()
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("node_server.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def ask(self, request: object) -> int | None:
        """Send a request and return the answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        assert answer is None or isinstance(answer, int)
        return answer

    def close(self) -> None:
        """End the server."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


class ForkedProcess:
    """What :class:`NodeProcess` uses of a :class:`subprocess.Popen`."""

    def __init__(self, server: Server, pid: int) -> None:
        self.pid = pid
        self._server = server
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code; None while the process runs."""
        if self._code is None:
            self._code = self._server.ask(self.pid)
        return self._code

    def wait(self, timeout_s: float | None = None) -> int:
        """Wait for the end; raises TimeoutExpired."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        while (code := self.poll()) is None:
            if until is not None and time.monotonic() > until:
                raise subprocess.TimeoutExpired("node", timeout_s or 0.0)
            time.sleep(POLL_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal unless the process has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


class WarmNode(NodeProcess):
    """A node started by a fork, in a session of its own."""

    def __init__(self, module: str, arguments: Sequence[str], environment: dict[str, str], log: Path) -> None:
        self.module, self.log = module, log
        log.write_bytes(b"")  # a test may read it before the node has started
        server = _server()
        request = {
            "module": module,
            "arguments": ["--ros-args", *arguments],
            "environment": {**os.environ, **environment, END_WITH_PARENT: str(server.pid)},
            "log": str(log.absolute()),
            "folder": str(Path.cwd()),
        }
        pid = server.ask(request)
        assert pid is not None
        self._process = ForkedProcess(server, pid)  # type: ignore[assignment]  # has what NodeProcess uses of a Popen


def start_node(module: str, arguments: Sequence[str], environment: dict[str, str], log: Path) -> NodeProcess:
    """Start a node: by a fork, or as a new process where a test has changed the environment of imports."""
    is_warm = module in MODULES and _environment() == _server().environment
    return (WarmNode if is_warm else NodeProcess)(module, arguments, environment, log)


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in OWN_TO_EACH_TEST}


@cache
def _server() -> Server:
    server = Server()
    atexit.register(server.close)
    return server
