"""``ik_benchmark soak``: node, watchdog, simulated arm and a moving target over DDS for minutes, with a recording.

A row per minute: control steps, missed ones by their cause, resident memory, threads, open files, files in /dev/shm.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node import resources
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.ros.own_domain import use_own_domain

MEMORY_ALLOWED_MB_MIN = 0.2
"""Growth of a process after its first third: 0.1 GB in eight hours."""
WARM_UP = 1 / 3
"""Part of the run before memory, threads and files are compared: buffers and caches fill in it."""
FREQUENCY_HZ, SWING_M = 0.2, 0.05
"""The target moves up and down."""
TARGET_HZ = 50.0
LATE_PERIODS = 1.5
"""A longer time between two commands, in control periods, has missed steps."""
SHM = Path("/dev/shm")
SEGMENT = re.compile(r".*/fastrtps_[0-9a-f]+")
"""Memory of one process; files of ports are kept by Fast DDS for the next process."""
TICK_MS = 1e3 / os.sysconf("SC_CLK_TCK")
"""Resolution of :func:`stolen_ms`."""
MOVING = ("tracking", "holding")
CAUSES = ("arm", "machine", "stopped", "node")
"""Causes of missed steps: the joint states had the same gap; a thread of the node waited for a processor, also one of
DDS, which receives the joint states; the node had stopped the arm, for a reason that its log has; none of them."""


class Process(NamedTuple):
    """State of a process."""

    memory_mb: float
    threads: int
    descriptors: int


class Minute(NamedTuple):
    """One row."""

    steps: int
    missed: dict[str, int]
    """Cause -> number of control steps."""
    stolen_ms: float
    """Time that the host of this virtual machine took from its processors."""
    longest_ms: float
    processes: dict[str, Process]
    shm_files: int
    recorded_mb: float


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_benchmark soak", description=__doc__)
    result.add_argument("--minutes", type=float, default=15.0, help="duration [%(default)s]")
    result.add_argument("--rate", type=float, default=500.0, help="control rate, Hz [%(default)s]")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 when memory, threads or files grow, or the node missed steps by itself."""
    options = parser().parse_args(arguments)
    use_own_domain()
    from ik_node.ros.child_process import NodeProcess  # the middleware reads the environment when it is loaded

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        rate = f"rate_hz:={options.rate!r}"
        config = ["--params-file", str(resources.config_file("panda.yaml"))]
        record = ["recording.enabled:=true", f"recording.directory:={folder / 'bag'}", rate]
        given = {
            "simulator": [*config, "-p", rate],
            "watchdog": [],
            "node": [*config, *(part for value in record for part in ("-p", value))],
        }
        processes: dict[str, Any] = {}
        try:
            for name, values in given.items():
                processes[name] = NodeProcess(f"ik_node.cli.{name}", values, {}, folder / f"{name}.log")
            minutes = measure(processes, folder / "bag", options.minutes, options.rate)
            shared = shared_files(processes)
        finally:
            codes = {name: process.stop(signal.SIGINT) for name, process in reversed(processes.items())}
        print(f"exit codes: {', '.join(f'{name} {code}' for name, code in codes.items())}")
    faults = verdict(minutes, options) if minutes else ["nothing was measured"]
    left = sorted(name for name in shared if SEGMENT.fullmatch(name) and Path(name).exists())
    faults += [f"files left in /dev/shm: {', '.join(left)}"] if left else []
    faults += [f"{name} ended with {code}" for name, code in codes.items() if code]
    lines = [f"wrong: {fault}" for fault in faults] or ["right: nothing grows, and the node missed no step by itself"]
    print("\n".join(lines))
    return 1 if faults else 0


def measure(processes: dict[str, Any], bag: Path, minutes: float, rate_hz: float) -> list[Minute]:
    """Run and print a row per minute; raises IkNodeError when a process ends."""
    import rclpy
    from rclpy.experimental.events_executor import EventsExecutor
    from rclpy.signals import SignalHandlerOptions

    from ik_node.ros.demo.target_streamer import TargetStreamer

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor()
    streamer = TargetStreamer(robot(), executor)

    def check() -> None:
        for name, process in processes.items():
            if process.exit_code is not None:
                raise IkNodeError(f"{name} ended with {process.exit_code}:\n{process.log_tail()}")

    rows: list[Minute] = []
    try:
        streamer.wait_until_ready(600.0, check)
        steps = StepGaps(streamer, processes["node"].pid, rate_hz)
        start, length_s = streamer.measured_pose(), min(60.0, 60.0 * minutes)
        print(HEAD, flush=True)
        begin_s = next_s = time.monotonic()

        def targets() -> Any:
            for index in range(int(60.0 * minutes * TARGET_HZ)):
                pose = start.copy()
                pose[2, 3] += SWING_M * np.sin(2.0 * np.pi * FREQUENCY_HZ * index / TARGET_HZ)
                yield index / TARGET_HZ, pose

        def each(time_s: float) -> bool:
            nonlocal next_s
            del time_s
            if time.monotonic() >= begin_s + (len(rows) + 1) * length_s:
                rows.append(minute(steps, processes, bag))
                print(row(len(rows), rows[-1]), flush=True)
                check()
            return True

        streamer.stream(targets(), each)
        if len(rows) < round(60.0 * minutes / length_s):
            rows.append(minute(steps, processes, bag))
            print(row(len(rows), rows[-1]), flush=True)
    finally:
        executor.shutdown(0.5)
        streamer.destroy_node()
        rclpy.try_shutdown()
    return rows


def robot() -> Any:
    """The arm of the parameter file."""
    from ik_node.robot.catalogue import robot_from_settings
    from ik_node.settings.parameter_file import read_settings

    return robot_from_settings(read_settings(resources.config_file("panda.yaml")).arm)


class StepGaps:
    """Counts control steps by the stamps of joint_velocity, and missed ones by their cause."""

    def __init__(self, node: Any, pid: int, rate_hz: float) -> None:
        from sensor_msgs.msg import JointState

        from ik_node.ros import qos

        self._streamer, self._mode = node, MOVING[0]
        self._threads = Path(f"/proc/{pid}/task")
        self._period_s = 1.0 / rate_hz
        self._before: dict[str, int] = {}
        self._waited_s: dict[str, float] = {}
        self._arm_gap_s = 0.0
        self.restart()
        profile = qos.OUTPUT
        node.create_subscription(JointState, "/ik_node/joint_velocity", self._on_step, profile, raw=True)
        node.create_subscription(JointState, "/joint_states", self._on_state, profile, raw=True)

    def restart(self) -> None:
        """Count from now on."""
        self.steps = 0
        self.missed = dict.fromkeys(CAUSES, 0)
        self.longest_s = 0.0
        self._stolen_ms = stolen_ms()

    @property
    def stolen_ms(self) -> float:
        """:func:`stolen_ms` since the last restart."""
        return stolen_ms() - self._stolen_ms

    def _gap_s(self, name: str, data: bytes) -> float:
        """Time between the stamps of this message and of the one before."""
        from ik_node.messages.cdr import stamp_at

        stamp_ns = stamp_at(data)
        gap_s = (stamp_ns - self._before.get(name, stamp_ns)) / NS
        self._before[name] = stamp_ns
        return gap_s

    def _on_state(self, data: bytes) -> None:
        self._arm_gap_s = max(self._arm_gap_s, self._gap_s("arm", data))

    def _on_step(self, data: bytes) -> None:
        gap_s = self._gap_s("node", data)
        self.steps += 1
        self.longest_s = max(self.longest_s, gap_s)
        if gap_s > LATE_PERIODS * self._period_s:
            before_s, self._waited_s = self._waited_s, waiting_s(self._threads)
            longest_s = max(time_s - before_s.get(thread, time_s) for thread, time_s in self._waited_s.items())
            is_arm = self._arm_gap_s > 0.5 * gap_s
            mode, _ = self._streamer.status
            is_machine = longest_s > 0.5 * (gap_s - self._period_s)
            cause = "arm" if is_arm else "machine" if is_machine else "node"
            if self._mode not in MOVING or mode not in MOVING:
                cause = "stopped"
            self._mode = mode
            self.missed[cause] += round(gap_s / self._period_s) - 1
        elif self.steps % 10 == 0:
            self._waited_s = waiting_s(self._threads)
        self._arm_gap_s = 0.0


def stolen_ms() -> float:
    """Time that the host has taken from the processors of this virtual machine since its start, in whole ticks."""
    ticks = Path("/proc/stat").read_text().splitlines()[0].split()[8]
    return int(ticks) * TICK_MS


def waiting_s(threads: Path) -> dict[str, float]:
    """For how long each thread of a process has waited for a processor, s, from the scheduler of Linux."""
    return {entry.name: 1e-9 * int((entry / "schedstat").read_text().split()[1]) for entry in threads.iterdir()}


def minute(steps: StepGaps, processes: dict[str, Any], bag: Path) -> Minute:
    """The present row; counting starts again."""
    found = Minute(
        steps.steps,
        steps.missed,
        steps.stolen_ms,
        1e3 * steps.longest_s,
        {name: state_of(process.pid) for name, process in processes.items()},
        len(shared_files(processes)),
        sum(file.stat().st_size for file in bag.glob("*.mcap")) / 1e6,
    )
    steps.restart()
    return found


def shared_files(processes: dict[str, Any]) -> set[str]:
    """Files in /dev/shm that these processes have mapped; other processes of the machine have files there, too."""
    maps = [Path(f"/proc/{process.pid}/maps").read_text() for process in processes.values()]
    lines = "\n".join(maps).splitlines()
    return {line.split(maxsplit=5)[5].strip() for line in lines if f" {SHM}/" in line}


def state_of(pid: int) -> Process:
    """Memory, threads and open files of a process, from /proc."""
    folder = Path(f"/proc/{pid}")
    fields = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines() if ":" in line)
    memory_kb, threads = int(fields["VmRSS"].split()[0]), int(fields["Threads"])
    return Process(memory_kb / 1024.0, threads, sum(1 for _ in (folder / "fd").iterdir()))


HEAD = (
    "min   steps  missed by:"
    + "".join(f"{cause:>8}" for cause in CAUSES)
    + "  stolen ms  longest ms   "
    + "  ".join(f"{name}: MB threads files" for name in ("simulator", "watchdog", "node"))
)
HEAD += "  /dev/shm  recorded MB"


def row(number: int, found: Minute) -> str:
    """One line of the table."""
    parts = "  ".join(
        f"{process.memory_mb:{len(name) + 4}.1f} {process.threads:7} {process.descriptors:5}"
        for name, process in found.processes.items()
    )
    missed = "".join(f"{found.missed[cause]:8}" for cause in CAUSES)
    text = f"{number:3} {found.steps:7}            {missed}{found.stolen_ms:11.0f}{found.longest_ms:12.1f}   {parts}"
    return f"{text}  {found.shm_files:8}  {found.recorded_mb:11.1f}"


def verdict(rows: list[Minute], options: argparse.Namespace) -> list[str]:
    """What is wrong; empty when nothing is. Steps that the node missed while the host had taken a processor are not."""
    length_min, period_ms = options.minutes / len(rows), 1e3 / options.rate
    faults = []
    late = rows[int(WARM_UP * len(rows)) :]
    for name in rows[0].processes:
        found = [entry.processes[name] for entry in late]
        if len(found) > 2:
            times = length_min * np.arange(len(found))
            slope = float(np.polyfit(times, [process.memory_mb for process in found], 1)[0])
            print(f"{name}: memory {slope:+.3f} MB/min after the first third")
            if slope > MEMORY_ALLOWED_MB_MIN:
                faults.append(f"memory of {name} grows by {slope:.2f} MB/min")
        for what in ("threads", "descriptors"):
            counts = [getattr(process, what) for process in found]
            if max(counts) != min(counts):
                faults.append(f"{what} of {name}: {min(counts)} to {max(counts)}")
    files = [entry.shm_files for entry in late]
    if files and files[-1] > files[0]:
        faults.append(f"files in /dev/shm: {files[0]} to {files[-1]}")
    totals = {cause: sum(entry.missed[cause] for entry in rows) for cause in rows[0].missed}
    print(f"steps {sum(entry.steps for entry in rows)}, missed by cause {totals}")
    for number, entry in enumerate(rows, start=1):
        if entry.missed["node"] * period_ms > entry.stolen_ms + TICK_MS:
            faults.append(f"{entry.missed['node']} steps missed by the node itself in minute {number}")
    return faults


if __name__ == "__main__":
    sys.exit(main())
