"""One node with an arm: runs faults one after another, and makes their rows from the recording of the run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from fault import BETWEEN_SILENCES_S, ENDED, GOES_ON, HOLDS, MARGIN_S, RESET, START, TIMEOUT_S, UNPAUSE, Fault
from fault_table import Row
from loop import READY, make_robot
from measure import Command, HoldUp, held_up_between, measure, read_commands, read_hold_ups
from rig import Rig
from ros_peer import Peer, peer_in_own_domain
from support import PROJECT

from ik_node.ros.child_process import NodeProcess

ARGUMENTS = (
    *("robot:=panda", "base_frame:=panda_link0", "tip_frame:=panda_hand_tcp", "rate_hz:=100.0"),
    *("limits.acceleration:=[4.0]", f"state.timeout_s:={TIMEOUT_S}", "recording.enabled:=true"),
)
EXPECTED_S = 60.0
"""Longest wait for the expected status, also on a busy machine."""
FAST = 0.25
"""Speed of the fastest joint, rad/s, at which faults begin: it is not stopped within one control step."""
FAR = 0.5
"""Distance of a joint from its start, rad, from which the arm is moved back."""
ATTEMPTS = 5
"""A fault is measured again when this process itself was late with the joint states meanwhile, or the machine held up
the node."""
WATCHED_S = 0.3
"""Time for which an arm that has to go on is watched after the status."""
MACHINE = ("no joint state for", "held up", "this machine", "slower than", "held for longer")
"""Texts that a busy machine causes."""


Start = Callable[[int, Sequence[str], Path], NodeProcess]
"""Starts the node in a ROS domain, with options and a file for its output."""


class Cell(NamedTuple):
    """What was seen of one fault while it lasted; times are monotonic."""

    fault: Fault
    node: int
    begin_ns: int
    fault_ns: int
    end_ns: int
    wire_zero_s: float | None
    """Time from the fault to the arrival of the first zero command."""
    held_up_s: float
    """For how long this process was held up between the fault and the expected status."""
    wire_not_finite: int
    status: str
    back: str
    wrong: tuple[str, ...]


class BootstrapProcess(NodeProcess):
    """``bootstrap.py ik_node`` in a session of its own."""

    def __init__(self, domain: int, options: Sequence[str], log: Path) -> None:
        self.module, self.log = "bootstrap", log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, str(PROJECT / "bootstrap.py"), "ik_node", "--ros-args", *options],
                env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )


def start_broken(domain: int, options: Sequence[str], log: Path) -> NodeProcess:
    """Start the node of ``broken_node.py``."""
    folders = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    return NodeProcess("broken_node", options, {"ROS_DOMAIN_ID": str(domain), "PYTHONPATH": folders}, log)


class Session:
    """Several faults at one node."""

    def __init__(
        self,
        peer: Peer,
        folder: Path,
        method: str,
        arguments: Sequence[str] = (),
        rig: Rig | None = None,
        start: Start | None = None,
    ) -> None:
        self._start = start
        self.peer, self.folder, self.method = peer, folder, method
        self.arguments = (*ARGUMENTS, f"method:={method}", *arguments)
        self.rig = rig or Rig(peer, make_robot("panda"), READY["panda"])
        self.cells: list[Cell] = []
        self._silence_s = 0.0
        self.bags: list[Path] = []
        self.start_node()

    @property
    def node(self) -> NodeProcess:
        """The process of the node."""
        return self.peer.processes[-1]

    def start_node(self) -> bool:
        """Start a node, and drive the arm until it moves; False when it does not."""
        self.bags.append(self.folder / f"bag_{self.method}_{len(self.bags)}")
        given = [*self.arguments, f"recording.directory:={self.bags[-1]}"]
        self.peer.statuses.clear()
        self.rig.position = self.rig.start.copy()
        self.rig.restore()
        self.peer.commands.append(np.zeros(self.rig.robot.n))
        self.peer.command_times_ns.append(time.monotonic_ns())
        options = [part for value in given for part in ("-p", value)]
        if self._start is None:
            self.peer.start("node", self.folder, options)
        else:
            log = self.folder / f"other_{len(self.bags)}.log"
            self.peer.processes.append(self._start(self.peer.domain, options, log))
        return self.rig.until(lambda: self.peer.mode == GOES_ON and self.rig.moving, 120.0)

    # --- one fault ---------------------------------------------------------------------------------------------------

    def run(self, fault: Fault) -> None:
        """Cause a fault, check what follows and the way back; measured again when this process was late."""
        for attempt in range(ATTEMPTS):
            if fault.right.is_silence:
                self.rig.spin(max(self._silence_s + BETWEEN_SILENCES_S - time.monotonic(), 0.0))
            self.rig.longest_gap_s = 0.0
            cell = self._run(fault)
            if fault.right.is_silence or self.rig.longest_gap_s > TIMEOUT_S:
                self._silence_s = time.monotonic()
            seen = "; ".join((cell.status, *cell.wrong))
            late = self.rig.longest_gap_s > 0.5 * TIMEOUT_S or any(text in seen for text in MACHINE)
            if not (cell.wrong and late) or attempt == ATTEMPTS - 1:
                break
        self.cells.append(cell)
        if self.node.exit_code is not None and fault.right.back != START:
            self.start_node()

    def _run(self, fault: Fault) -> Cell:
        rig, peer, right = self.rig, self.peer, fault.right
        wrong: list[str] = []
        self._recentre()
        if not rig.until_moving() and not (self._stop_node() and self.start_node()):
            wrong.append(f"no motion before: {peer.mode}: {peer.reason}")
        rig.until(lambda: np.abs(peer.commands[-1]).max() > FAST, 5.0)
        begin_ns, rig.answer = time.monotonic_ns(), ""
        rig.mark()
        fault.cause(rig)
        if not rig.until(lambda: self._as_expected(fault), EXPECTED_S):
            wrong.append(f"expected {right.mode} '{right.text}', found {self._seen()}")
        status = self._status(fault)
        if right.mode == GOES_ON:
            rig.spin(WATCHED_S)
            stops = [entry for entry in peer.statuses[rig.first_status :] if entry[0] not in (GOES_ON, HOLDS)]
            if stops:
                wrong.append(f"the arm does not go on: {stops[0]}")
        fault_ns, first, held_up_s = rig.fault_ns, rig.first_command, rig.held_up_s
        rig.restore()
        if fault.undo is not None:
            fault.undo(rig)
        node = len(self.bags) - 1
        back = self._way_back(right.back)
        if not back:
            wrong.append(f"no way back: {peer.mode}: {peer.reason}")
        wire = list(zip(peer.command_times_ns[first:], peer.commands[first:], strict=True))
        zero_s = next(((at - fault_ns) * 1e-9 for at, velocity in wire if not velocity.any()), None)
        bad = sum(not np.isfinite(command).all() for _, command in wire)
        end_ns = time.monotonic_ns()
        return Cell(fault, node, begin_ns, fault_ns, end_ns, zero_s, held_up_s, bad, status, back, tuple(wrong))

    def _recentre(self) -> None:
        """Move the arm back to its start while it is not measured, when faults have moved it far from there."""
        rig = self.rig
        if np.abs(rig.position - rig.start).max() > FAR:
            rig.spin(max(self._silence_s + BETWEEN_SILENCES_S - time.monotonic(), 0.0))
            rig.states = lambda message: ()
            rig.spin(TIMEOUT_S + 1.0)
            self._silence_s = time.monotonic()
            rig.position = rig.start.copy()
            rig.restore()

    def _stop_node(self) -> bool:
        self.node.stop(signal.SIGTERM, 30.0)
        return True

    def _as_expected(self, fault: Fault) -> bool:
        right, peer = fault.right, self.peer
        if right.mode == ENDED:
            return self.node.exit_code is not None and not peer.commands[-1].any()
        if right.text and right.text in self.rig.answer and right.mode == GOES_ON:
            return True
        if right.mode not in (GOES_ON, HOLDS) and peer.commands[-1].any():
            return False
        is_silent = right.mode == GOES_ON and not right.text
        seen = peer.statuses[self.rig.first_status - is_silent :]
        return any(mode == right.mode and right.text in reason for mode, reason in seen)

    def _status(self, fault: Fault) -> str:
        text = fault.right.text
        if text and text in self.rig.answer:
            return f"({self.rig.answer})"
        for _, reason in self.peer.statuses[self.rig.first_status :]:
            if text and text in reason:
                at = reason.index(text)
                end = reason.find("; ", at + len(text))
                return reason[reason.rfind("; ", 0, at) + 1 : end if end > 0 else None].strip()
        return self.peer.reason

    def _seen(self) -> str:
        statuses = self.peer.statuses[self.rig.first_status :]
        found = list(dict.fromkeys(f"{mode}: {reason}" for mode, reason in statuses))
        return f"{' | '.join(found[-3:])} {self.rig.answer} {self._ending()}"

    def _ending(self) -> str:
        code = self.node.exit_code
        return "" if code is None else f"exit code {code}: {self.node.log_tail()}"

    def _way_back(self, back: str) -> str:
        """The way back when it leads to motion, else empty."""
        actions: dict[str, Callable[[], object]] = {UNPAUSE: lambda: self.rig.pause(False), RESET: self.rig.reset}
        if back in actions:
            self.rig.spin(0.2)
            if self.rig.moving:
                return ""
            actions[back]()
        if back == START:
            return f"{back} (exit {self.node.exit_code})" if self.start_node() else ""
        return back if self.rig.until_moving() else ""

    # --- the rows ----------------------------------------------------------------------------------------------------

    def rows(self) -> list[Row]:
        """Stop the node; the rows of all faults, measured from the recordings."""
        self._stop_node()
        found = [(read_commands(bag, self.rig.robot), read_hold_ups(bag)) for bag in self.bags]
        return [self._row(cell, *found[cell.node]) for cell in self.cells]

    def _row(self, cell: Cell, commands: list[Command], hold_ups: list[HoldUp]) -> Row:
        right, wrong = cell.fault.right, list(cell.wrong)
        if not commands and right.mode != ENDED:
            wrong.append("the recording holds no run")
        found = measure(commands, cell.begin_ns, cell.fault_ns, cell.end_ns, right.mode, right.text)
        not_finite = found.not_finite + cell.wire_not_finite
        # Without a Step with zeros, those of another process (the watchdog) count.
        zero_s = found.zero_s if found.zero_s is not None else cell.wire_zero_s
        if not found.over <= 1.0 + 1e-9:
            wrong.append(f"{found.over:.3f} of the velocity limit")
        if not_finite:
            wrong.append(f"{not_finite} commands are not finite")
        if not found.acceleration <= 1.0 + 1e-6:
            wrong.append(f"{found.acceleration:.3f} of the acceleration limit")
        if found.at_once and not right.at_once:
            wrong.append("zero without a ramp")
        in_closed_loop = right.mode in (GOES_ON, HOLDS)
        seen_s = found.state_s if in_closed_loop else zero_s
        zero = "-" if seen_s is None else f"{seen_s:.3f}"
        if right.mode == GOES_ON and not right.text:
            zero = "-"
        if found.at_once:
            zero += " at once"
        if right.zero_s is not None:
            until_ns = cell.end_ns if seen_s is None else cell.fault_ns + round(seen_s * 1e9)
            held_up_s = cell.held_up_s + held_up_between(hold_ups, cell.fault_ns, until_ns)
            longest_s = right.zero_s + MARGIN_S + held_up_s
            if seen_s is None or seen_s > longest_s:
                wrong.append(f"{right.mode} after {zero} s; at most {longest_s:g}")
        return Row(
            cell.fault.name,
            cell.fault.case,
            self.method,
            f"{found.over:.3f}",
            str(not_finite),
            f"{found.acceleration:.3f}",
            zero,
            cell.status,
            cell.back or "none",
            "; ".join(wrong),
        )


@contextmanager
def session(folder: Path, method: str, arguments: Sequence[str] = ()) -> Iterator[Session]:
    """A session in a domain of its own."""
    with peer_in_own_domain() as peer:
        yield Session(peer, folder, method, arguments)
