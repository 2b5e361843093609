"""Faults of the process and of the clock while an arm moves: signals, a kill with ``ik_watchdog``, simulated time.

Columns as in test_motion_faults.py; the way back is a new start of the node, also through ``bootstrap.py``.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fault import ENDED, FAULT, METHODS, RESET, START, STOPPED, TIMEOUT_S, Fault, Right, choose, chosen_methods
from fault_table import Row, failures
from loop import READY, make_robot
from rig import NS, Rig
from ros_peer import peer_in_own_domain
from session import BootstrapProcess, Session, session, start_broken
from support import PROJECT

WATCHDOG_S = 0.1


def send(number: int, times: int = 1) -> Callable[[Rig], None]:
    """A cause: a signal to the node."""

    def cause(rig: Rig) -> None:
        for _ in range(times):
            os.kill(rig.peer.processes[-1].pid, number)

    return cause


def slow_ramp(number: int) -> Callable[[Rig], None]:
    """A cause: a signal while the acceleration limit makes the ramp long, without joint states in it."""

    def cause(rig: Rig) -> None:
        rig.set(limits__acceleration=[0.4])
        rig.mark()
        send(number)(rig)
        rig.states = lambda message: ()

    return cause


def silence_first(number: int) -> Callable[[Rig], None]:
    """A cause: the joint states end, and a signal follows when the arm has been stopped."""

    def cause(rig: Rig) -> None:
        rig.states = lambda message: ()
        rig.until(lambda: rig.peer.mode == STOPPED)
        send(number)(rig)

    return cause


RAMPED = Right(ENDED, "", 0.5, back=START)
SIGNAL_FAULTS = (
    Fault("SIGINT", send(signal.SIGINT), RAMPED),
    Fault("SIGTERM", send(signal.SIGTERM), RAMPED),
    Fault("SIGHUP", send(signal.SIGHUP), RAMPED),
    Fault("SIGINT three times", send(signal.SIGINT, 3), RAMPED),
    Fault("SIGTERM, joint states end in the ramp", slow_ramp(signal.SIGTERM), RAMPED._replace(zero_s=2.5)),
    Fault(
        "joint states end, then SIGINT", silence_first(signal.SIGINT), RAMPED._replace(zero_s=TIMEOUT_S, at_once=True)
    ),
)


def killed(rig: Rig) -> None:
    os.kill(rig.peer.processes[-1].pid, signal.SIGKILL)


def hang(rig: Rig) -> None:
    """SIGSTOP until the watchdog has published zeros."""
    pid, count = rig.peer.processes[-1].pid, len(rig.peer.commands)
    os.kill(pid, signal.SIGSTOP)
    rig.until(lambda: len(rig.peer.commands) > count and not rig.peer.commands[-1].any())
    zero_ns = rig.peer.command_times_ns[-1]
    rig.spin(TIMEOUT_S + 0.3)
    rig.answer = f"zeros of the watchdog after {(zero_ns - rig.fault_ns) / NS:.3f} s"
    os.kill(pid, signal.SIGCONT)


WATCHDOG_FAULTS = (
    Fault(
        "SIGSTOP with ik_watchdog, SIGCONT", hang, Right(STOPPED, "held up for", TIMEOUT_S + 0.5, at_once=True), "F09"
    ),
    Fault("SIGKILL with ik_watchdog", killed, Right(ENDED, "", WATCHDOG_S, at_once=True, back=START), "F+"),
)


def clock_ends(rig: Rig) -> None:
    """The simulator dies: neither clock nor joint states."""
    rig.clock_runs = False
    rig.states = lambda message: ()


def jump_then_silence(jump_s: float) -> Callable[[Rig], None]:
    """A cause: the clock jumps; later the joint states end while the clock runs."""

    def cause(rig: Rig) -> None:
        rig.offset_ns += round(jump_s * NS)
        rig.spin(0.5)
        rig.until_moving()
        rig.mark()
        rig.states = lambda message: ()

    return cause


def clock_jumps(jump_s: float) -> Callable[[Rig], None]:
    def cause(rig: Rig) -> None:
        rig.offset_ns += round(jump_s * NS)

    return cause


def clock_stands(rig: Rig) -> None:
    rig.clock_runs = False


def pause_and_rewind(rig: Rig) -> None:
    """The simulator pauses for a second and begins an hour earlier."""
    rig.clock_runs = False
    rig.states = lambda message: ()
    rig.until(lambda: rig.peer.mode == STOPPED)
    rig.spin(0.5)
    rig.offset_ns -= 3600 * NS


def clock_ends_then_signal(rig: Rig) -> None:
    clock_ends(rig)
    rig.until(lambda: rig.peer.mode == STOPPED)
    send(signal.SIGINT)(rig)


STALE = Right(STOPPED, "no joint state for", TIMEOUT_S, at_once=True)
CLOCK_FAULTS = (
    Fault("clock and joint states end", clock_ends, STALE, "F02"),
    Fault("clock stands, joint states go on", clock_stands, Right(), "F02"),
    Fault("clock 1 h back", clock_jumps(-3600.0), Right(), "F03"),
    Fault("clock 1 h ahead", clock_jumps(3600.0), Right(), "F03"),
    Fault("clock 1 h back, then joint states end", jump_then_silence(-3600.0), STALE, "F03"),
    Fault("clock 0.3 s back, then joint states end", jump_then_silence(-0.3), STALE, "F03"),
    Fault("clock 1 h ahead, then joint states end", jump_then_silence(3600.0), STALE, "F03"),
    Fault("simulator pauses, 1 h earlier", pause_and_rewind, STALE, "F03"),
    Fault(
        "clock and joint states end, then SIGINT",
        clock_ends_then_signal,
        RAMPED._replace(zero_s=TIMEOUT_S, at_once=True),
        "F02",
    ),
)


BROKEN = Right(FAULT, "stopped until reset", 0.1, at_once=True, back=RESET)
CODE_FAULTS = (
    Fault("exception in a control step", send(signal.SIGUSR1), BROKEN._replace(text="an error in the code")),
    Fault("result that is not finite", send(signal.SIGUSR2), BROKEN),
)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "method" in metafunc.fixturenames:
        metafunc.parametrize("method", chosen_methods(metafunc.config, metafunc.function.__name__))


def finish(node: Session, record_property: Callable[[str, object], None]) -> None:
    rows = node.rows()
    record_property("fault_rows", [list(row) for row in rows])
    assert not failures(rows), "\n".join(failures(rows))


def test_signals(
    method: str, tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]
) -> None:
    with session(tmp_path, method) as node:
        for fault in choose(pytestconfig, "signals", SIGNAL_FAULTS, 1):
            node.run(fault)
        finish(node, record_property)


def test_clocks(
    method: str, tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]
) -> None:
    with peer_in_own_domain() as peer:
        rig = Rig(peer, make_robot("panda"), READY["panda"], simulated_time=True)
        node = Session(peer, tmp_path, method, ["use_sim_time:=true"], rig)
        for fault in choose(pytestconfig, "clocks", CLOCK_FAULTS, 2):
            node.run(fault)
        finish(node, record_property)


def test_watchdog(
    method: str, tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]
) -> None:
    with peer_in_own_domain() as peer:
        watchdog = peer.start("watchdog", tmp_path, ["-p", f"timeout_s:={WATCHDOG_S}"])
        node = Session(peer, tmp_path, method)
        node.rig.until(lambda: "ready" in watchdog.log.read_text())
        for fault in choose(pytestconfig, "watchdog", WATCHDOG_FAULTS, 1):
            node.run(fault)
        finish(node, record_property)


def test_errors_in_the_code(
    method: str, tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]
) -> None:
    with peer_in_own_domain() as peer:
        node = Session(peer, tmp_path, method, start=start_broken)
        for fault in choose(pytestconfig, "code", CODE_FAULTS, 1):
            node.run(fault)
        finish(node, record_property)


def test_signals_to_bootstrap(
    tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]
) -> None:
    """``bootstrap.py ik_node`` as the process that gets the signal, for the whole group and for itself only."""
    if not (PROJECT / ".venv" / "bin" / "ik_node").is_file():
        pytest.skip("needs the .venv that bootstrap.py makes in this checkout")
    faults = (
        Fault(
            "Ctrl-C in bootstrap.py ik_node",
            lambda rig: os.killpg(rig.peer.processes[-1].pid, signal.SIGINT),
            RAMPED,
            "W19",
        ),
        Fault("SIGTERM to bootstrap.py ik_node", send(signal.SIGTERM), RAMPED, "W18"),
    )
    with peer_in_own_domain() as peer:
        node = Session(peer, tmp_path, METHODS[0], start=BootstrapProcess)
        for fault in choose(pytestconfig, "bootstrap", faults, 1):
            node.run(fault)
        finish(node, record_property)


def test_ctrl_c_in_the_demonstration(
    tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]
) -> None:
    """W12: Ctrl-C in ``bootstrap.py demo`` while the arm moves: the report of the run so far is made."""
    if not (pytestconfig.getoption("--exhaustive") and (PROJECT / ".venv" / "bin" / "ik_node").is_file()):
        pytest.skip("runs with --exhaustive, in the .venv that bootstrap.py makes")
    with peer_in_own_domain() as peer, (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, str(PROJECT / "bootstrap.py"), "demo", "--headless", "--out", str(tmp_path / "run")],
            env={**os.environ, "ROS_DOMAIN_ID": str(peer.domain)},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            peer.until("motion", lambda: bool(peer.commands) and bool(abs(peer.commands[-1]).max() > 0.05))
            os.killpg(process.pid, signal.SIGINT)
            peer.until("the end", lambda: process.poll() is not None)
            assert not peer.commands[-1].any()
            assert (tmp_path / "run" / "report.json").is_file(), (tmp_path / "log").read_text()
            end = ("report of the run so far", f"exit {process.returncode}", "")
            row = Row("Ctrl-C in bootstrap.py demo", "W12", "plain", "-", "-", "-", "zeros", *end)
            record_property("fault_rows", [list(row)])
        finally:
            process.kill()
            process.wait()
