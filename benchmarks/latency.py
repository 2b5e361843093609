"""``ik_benchmark latency``: joint state out to command in over DDS, beside a rclpy node that echoes, in the same run.

This process is the driver of the arm. It publishes joint states at a rate, on a grid of stamps, and takes the time to
the next command; node and echo are processes of their own and take turns. A state without a command before the next
state counts as missed, and as an infinite latency in the percentiles.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array
from ik_node.ros.own_domain import use_own_domain

RATES_HZ = (250.0, 500.0, 1000.0)
SETTLE_S = 3.0
"""Not measured, after control has begun: discovery, and the first calls."""
BUSY_WAIT_S = 3e-4
"""Part of each period that is a busy loop, because waits are not exact."""
TIMEOUT_S = 60.0
JOINTS = tuple(f"panda_joint{index}" for index in range(1, 8))
START = (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)
CANDIDATES = ("echo", "node", "node, recording")
MAX_RATIO, MAX_CPU, MAX_START_S = 1.25, 0.4, 2.5
"""Aims: median beside the echo's at 1 kHz, share of a core, and from process start to the first command."""
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


class Row(NamedTuple):
    """Figures of one candidate at one rate."""

    rate_hz: float
    candidate: str
    sent: int
    missed: int
    median_us: float
    p99_us: float
    p999_us: float
    cpu: float
    """Share of a core."""
    start_s: float
    """From the start of the process to the first command."""


class Driver:
    """Publishes joint states of an arm at rest, and measures the time to the command."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("driver")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._arrived_ns = 0
        self._answers = 0

    def run(self, name: str, process: Any, begin_ns: int, rate_hz: float, seconds: float) -> Row:
        """Drives the node ``name``, a process that was started at ``begin_ns``, ns on the monotonic clock."""
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        from ik_node.ros import qos

        states = self._node.create_publisher(JointState, f"/{name}/joint_states", qos.OUTPUT)
        commands = self._node.create_subscription(
            Float64MultiArray, f"/{name}/commands", self._on_command, qos.COMMAND, raw=True
        )
        try:
            message = JointState(name=list(JOINTS), position=list(START), velocity=[0.0] * len(JOINTS))
            period_ns, latencies = round(NS / rate_hz), np.full(round(seconds * rate_hz), np.inf)
            stamp_ns, due_ns = time.time_ns(), time.monotonic_ns()
            count, cpu_s, start_s = 0, 0.0, 0.0
            gc.collect()
            gc.disable()
            while count < len(latencies):
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
                self._arrived_ns, sent_ns = 0, time.monotonic_ns()
                states.publish(message)
                due_ns, stamp_ns = due_ns + period_ns, stamp_ns + period_ns
                self._wait(due_ns)
                if not self._answers:
                    if process.exit_code is not None or sent_ns - begin_ns > TIMEOUT_S * NS:
                        raise IkNodeError(f"{name} does not answer:\n{process.log_tail()}")
                    settled_ns, start_s = sent_ns + round(SETTLE_S * NS), (time.monotonic_ns() - begin_ns) / NS
                elif sent_ns > settled_ns:
                    cpu_s = cpu_s or cpu_time_s(process.pid)
                    if self._arrived_ns:
                        latencies[count] = 1e-3 * (self._arrived_ns - sent_ns)
                    count += 1
            cpu = (cpu_time_s(process.pid) - cpu_s) / seconds
        finally:
            gc.enable()
            self._node.destroy_subscription(commands)
            self._node.destroy_publisher(states)
            self._answers = 0
        return row(rate_hz, latencies, cpu, start_s)

    def _on_command(self, data: bytes) -> None:
        del data
        self._arrived_ns = self._arrived_ns or time.monotonic_ns()
        self._answers += 1

    def _wait(self, due_ns: int) -> None:
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            self._executor.spin_once(max(left_ns / NS - BUSY_WAIT_S, 0.0))

    def close(self) -> None:
        """Ends the node."""
        import rclpy

        self._executor.shutdown(0.5)
        self._node.destroy_node()
        rclpy.try_shutdown()


def row(rate_hz: float, latencies: Array, cpu: float, start_s: float) -> Row:
    """Figures of latencies, us, infinite for missed ones."""
    median, p99, p999 = np.quantile(latencies, (0.5, 0.99, 0.999), method="higher").tolist()
    return Row(rate_hz, "", len(latencies), int(np.isinf(latencies).sum()), median, p99, p999, cpu, start_s)


def cpu_time_s(pid: int) -> float:
    """Time that a process has computed, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS


def measure(driver: Driver, candidate: str, rate_hz: float, seconds: float, folder: Path) -> Row:
    """One candidate in a process of its own."""
    from ik_node.ros.child_process import NodeProcess

    log = folder / f"{candidate}_{rate_hz:g}.log"
    if candidate == "echo":
        module, name, arguments = "benchmarks.latency_echo", "echo", list[str]()
    else:
        module, name = "ik_node.cli.node", "ik_node"
        values = [f"rate_hz:={rate_hz}", "robot:=panda", "follow.enabled:=false"]
        if candidate != "node":
            values += ["recording.enabled:=true", f"recording.directory:={folder / f'bag_{rate_hz:g}'}"]
        arguments = [part for value in values for part in ("-p", value)]
        arguments += ["-r", "joint_states:=/ik_node/joint_states"]
    begin_ns = time.monotonic_ns()
    with NodeProcess(module, arguments, {}, log) as process:
        return driver.run(name, process, begin_ns, rate_hz, seconds)._replace(candidate=candidate)


def parser() -> argparse.ArgumentParser:
    """Returns the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_benchmark latency", description=__doc__)
    result.add_argument("--rates", type=float, nargs="+", default=RATES_HZ, help="Hz [250 500 1000]")
    result.add_argument("--seconds", type=float, default=60.0, help="duration of each row, s [%(default)s]")
    result.add_argument("--json", type=Path, help="also write the figures to a file")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table; returns 1 when an aim is missed."""
    options = parser().parse_args(arguments)
    use_own_domain()
    rows: list[Row] = []
    figures = f"{'median':>9}{'99 %':>9}{'99.9 %':>9} us{'CPU':>7}{'start':>9}"
    print(f"{'Hz':>6}  {'candidate':16}{'sent':>8}{'missed':>8}{figures}")
    with tempfile.TemporaryDirectory() as scratch:
        driver = Driver()
        try:
            for rate_hz in options.rates:
                for candidate in CANDIDATES:
                    found = measure(driver, candidate, rate_hz, options.seconds, Path(scratch))
                    rows.append(found)
                    times = f"{found.median_us:9.0f}{found.p99_us:9.0f}{found.p999_us:9.0f}"
                    head = f"{rate_hz:6g}  {candidate:16}{found.sent:8}{found.missed:8}"
                    print(f"{head}{times}   {found.cpu:6.1%}{found.start_s:7.2f} s", flush=True)
        finally:
            driver.close()
    echo = {entry.rate_hz: entry.median_us for entry in rows if entry.candidate == "echo"}
    missed = [name for name, wrong in aims(rows, echo).items() if wrong]
    for entry in rows:
        if entry.candidate != "echo":
            print(f"{entry.candidate} at {entry.rate_hz:g} Hz / echo: {entry.median_us / echo[entry.rate_hz]:.2f}")
    print("\n".join(f"missed: {name}" for name in missed) or "all aims are met")
    if options.json:
        machine = {"processor": platform.processor() or platform.machine(), "python": platform.python_version()}
        options.json.write_text(json.dumps({"machine": machine, "rows": [entry._asdict() for entry in rows]}, indent=1))
    return 1 if missed else 0


def aims(rows: Sequence[Row], echo: dict[float, float]) -> dict[str, bool]:
    """Aims at the highest rate -> whether one is missed."""
    highest = max(echo)
    found = {
        f"{entry.candidate} at {entry.rate_hz:g} Hz: {MAX_START_S} s to the first command": entry.start_s > MAX_START_S
        for entry in rows
    }
    for entry in rows:
        if entry.rate_hz == highest and entry.candidate != "echo":
            where = f"{entry.candidate} at {highest:g} Hz"
            found[f"{where}: median at most {MAX_RATIO} of the echo's"] = entry.median_us > MAX_RATIO * echo[highest]
            found[f"{where}: no state without a command"] = entry.missed > 0
            found[f"{where}: at most {MAX_CPU:.0%} of a core"] = entry.cpu > MAX_CPU
    return found


if __name__ == "__main__":
    sys.exit(main())
