"""Executables of this package as processes of their own, that are stopped whatever happens to us."""

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
"""Set in the environment of a process that must not outlive the one that started it."""
PR_SET_PDEATHSIG = 1


def end_with_parent_if_asked() -> None:
    """Asks Linux to interrupt this process when its parent dies, so that no arm is driven by an orphan."""
    if os.environ.get(END_WITH_PARENT) == "1" and sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)


class NodeProcess:
    """A node in a process of its own, in a session of its own: a Ctrl-C reaches it through us, in our order."""

    def __init__(self, module: str, arguments: Sequence[str], environment: dict[str, str], log: Path) -> None:
        self.module = module
        self.log = log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", *arguments],
                env={**os.environ, **environment, END_WITH_PARENT: "1"},
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def stop(self, signal_number: int = signal.SIGINT, timeout_s: float = 15.0) -> int:
        """Asks it to end, insists after ``timeout_s``; returns its exit code."""
        if self._process.poll() is None:
            self._process.send_signal(signal_number)
            try:
                self._process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
        return self._process.wait()

    def last_words(self) -> str:
        """The end of what it printed."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-10:])

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
