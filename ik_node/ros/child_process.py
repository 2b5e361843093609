"""Nodes of this package as child processes that end with their parent."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

END_WITH_PARENT = "IK_NODE_END_WITH_PARENT"
"""Environment variable of a process that must end with its parent: the process id of the parent."""
PR_SET_PDEATHSIG = 1


def end_with_parent_if_requested() -> None:
    """Let Linux send SIGTERM to this process when its parent ends, so that no orphan moves an arm.

    Raises:
        SystemExit: The parent had ended before Linux was asked.
    """
    parent = os.environ.get(END_WITH_PARENT, "")
    if parent and sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if str(os.getppid()) != parent:
            raise SystemExit("error: the parent process has ended")


class NodeProcess:
    """A node in a child process with a session of its own: Ctrl-C in the terminal reaches the parent only."""

    def __init__(self, module: str, arguments: Sequence[str], environment: dict[str, str], log: Path) -> None:
        """Start ``python -m module --ros-args arguments``; its output goes to ``log``."""
        self.module = module
        self.log = log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", *arguments],
                env={**os.environ, **environment, END_WITH_PARENT: str(os.getpid())},
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while the process runs."""
        return self._process.poll()

    def stop(self, signal_number: int = signal.SIGTERM, timeout_s: float | None = None) -> int:
        """Send a signal, and wait for the end however long a ramp to zero takes.

        Args:
            signal_number: SIGINT or SIGTERM; a node ramps to zero, whatever that takes. A background job of a shell
                ignores SIGINT, and so do its children until they handle it themselves.
            timeout_s: For tests only: SIGKILL after this time. A node that is killed leaves a velocity standing.

        Returns:
            The exit code.
        """
        if self._process.poll() is None:
            self._process.send_signal(signal_number)
            try:
                self._process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
        return self._process.wait()

    def log_tail(self) -> str:
        """Return the last lines of the output."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-10:])

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
