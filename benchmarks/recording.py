"""``ik_benchmark recording``: cost of recording for the control loop, loss by a kill, a long run."""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real_time_loop import ProcessRecording, RealTimeLoop, StepTimes
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.mcap.repair import repair
from ik_node.recording.run_recorder import RunRecording
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource

LOSS_ALLOWED_S = 0.25
MODES = ("off", "thread", "process")
SHARES = (50, 90, 99, 99.9, 100)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_benchmark recording", description=__doc__)
    result.add_argument("--only", choices=("cost", "kills", "long"), help="one part [all]")
    result.add_argument("--rate", type=float, default=1000.0, help="control rate, Hz [%(default)s]")
    result.add_argument(
        "--seconds", type=float, default=5.0, help="duration of each run of the first part, s [%(default)s]"
    )
    result.add_argument("--rounds", type=int, default=6, help="runs of each kind [%(default)s]")
    result.add_argument("--kills", type=int, default=20, help="number of kills [%(default)s]")
    result.add_argument("--minutes", type=float, default=5.0, help="duration of the long run [%(default)s]")
    result.add_argument("--json", action="store_true", help="print JSON")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 when messages were dropped or a kill lost more than allowed."""
    options = parser().parse_args(arguments)
    document: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if options.only in (None, "cost"):
            document["cost"] = cost(folder, options.rate, options.seconds, options.rounds)
        if options.only in (None, "kills"):
            document["kills"] = kills(folder, options.kills)
        if options.only in (None, "long"):
            document["long"] = long_run(folder, options.rate, options.minutes)
    print(json.dumps(document, indent=1) if options.json else _text(document))
    dropped = [part["dropped"] for part in (*document.get("cost", ()), document.get("long", {})) if "dropped" in part]
    worst = document.get("kills", {}).get("worst_s", 0.0)
    return 0 if not any(dropped) and worst <= LOSS_ALLOWED_S else 1


# --- cost for the control loop ---------------------------------------------------------------------------------------


def cost(folder: Path, rate_hz: float, seconds: float, rounds: int) -> list[dict[str, Any]]:
    """Time control steps without recording, with a writer thread and with a writer process, alternately in one loop."""
    loop = RealTimeLoop(rate_hz)
    loop.run(2.0, None)
    found: dict[str, list[StepTimes]] = {mode: [] for mode in MODES}
    sizes, dropped = dict.fromkeys(MODES, 0), dict.fromkeys(MODES, 0)
    for number in range(rounds):
        for mode in MODES if number % 2 == 0 else MODES[::-1]:
            directory = folder / f"{mode}{number}"
            kind = {"thread": RunRecording, "process": ProcessRecording}.get(mode)
            recording = None if kind is None else kind(directory, loop.setup(), loop.now())
            found[mode].append(loop.run(seconds, recording))
            if recording is not None:
                recording.close()
                sizes[mode] += _size(directory)
                dropped[mode] += recording.dropped
    return [
        {
            "mode": mode,
            "tick_us": _percentiles([times.tick for times in found[mode]]),
            "cycle_us": _percentiles([times.cycle for times in found[mode]]),
            "late_us": _percentiles([times.late for times in found[mode]]),
            "dropped": dropped[mode],
            "mb_per_minute": sizes[mode] / 1e6 / (rounds * seconds / 60.0),
        }
        for mode in MODES
    ]


def _percentiles(values: list[Any]) -> list[float]:
    return [float(value) for value in np.percentile(np.concatenate(values), SHARES)]


def _size(directory: Path) -> int:
    return sum(path.stat().st_size for path in directory.iterdir())


# --- loss by a kill --------------------------------------------------------------------------------------------------


@contextmanager
def _process(module: str, arguments: Sequence[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        **os.environ,
    }
    command = [sys.executable, "-m", module, *arguments]
    with log.open("ab") as output:
        process = subprocess.Popen(command, env=environment, stdout=output, stderr=output, stdin=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30.0)


def kills(folder: Path, count: int) -> dict[str, Any]:
    """Kill the node at random times while it records a simulated arm at 500 Hz; repair and replay the recordings."""
    draw = random.Random(1)
    losses, repaired = [], 0
    arm = ["--ros-args", "-p", "robot:=panda", "-p", "rate_hz:=500.0"]
    start = "[0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]"
    with _process("ik_node.cli.simulator", [*arm, "-p", f"initial_position:={start}"], folder / "simulator.log"):
        for number in range(count):
            directory = folder / f"killed{number}"
            arguments = ["--ros-args", "-p", "robot:=panda", "-p", "recording.enabled:=true"]
            arguments += ["-p", f"recording.directory:={directory}"]
            with _process("ik_node.cli.node", arguments, folder / "node.log") as node:
                _wait_for_ticks(directory, node)
                time.sleep(draw.uniform(0.0, 2.0))
                killed_ns = time.time_ns()
                node.kill()
                node.wait()
            newest_ns = max(message.log_time_ns for message in Recording(directory).messages())
            losses.append((killed_ns - newest_ns) / NS)
            repair(directory)
            repaired += Recording(directory).complete and replay(RecordingSource(directory)).identical
    return {"kills": count, "worst_s": max(losses), "median_s": float(np.median(losses)), "whole_after": repaired}


def _wait_for_ticks(directory: Path, node: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + 60.0
    while time.monotonic() < until and node.poll() is None:
        time.sleep(0.1)
        if directory.is_dir() and sum(topic.name.endswith("/step") for topic in _filled(directory)):
            return
    raise IkNodeError("the node did not record within 60 s")


def _filled(directory: Path) -> list[Any]:
    return [topic for topic, messages in Recording(directory).counts().items() if messages]


# --- the long run ----------------------------------------------------------------------------------------------------


def long_run(folder: Path, rate_hz: float, minutes: float) -> dict[str, Any]:
    """Run the demonstration over DDS for minutes and measure the memory of the node."""
    poses, out = folder / "poses.csv", folder / "long"
    duration_s = 60.0 * minutes
    with poses.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "x", "y", "z", "qx", "qy", "qz", "qw"))
        for index in range(int(50.0 * duration_s) + 1):
            angle = 2.0 * np.pi * index / 500.0
            writer.writerow((index / 50.0, 0.0, 0.1 * np.sin(angle), 0.05 * np.sin(2.0 * angle), 0.0, 0.0, 0.0, 1.0))
    arguments = ["--headless", "--rate", str(rate_hz), "--out", str(out), "--trajectory", str(poses), "--relative"]
    memory: list[float] = []
    with _process("ik_node.cli.demo", arguments, folder / "demo.log") as demo:
        while demo.poll() is None:
            time.sleep(1.0)
            resident = _resident_mb(_child(demo.pid, "ik_node.cli.node"))
            if resident:
                memory.append(resident)
    if demo.returncode:
        raise IkNodeError(f"ik_demo ended with {demo.returncode}:\n{(folder / 'demo.log').read_text()[-2000:]}")
    recording = Recording(out / "bag")
    counts = {topic.name: count for topic, count in recording.counts().items()}
    ticks = counts["/ik_node/step"]
    settled = memory[len(memory) // 10 + 2 :]  # after the recording's queue and the caches have filled
    return {
        "minutes": minutes,
        "ticks": ticks,
        "rate_hz": ticks / duration_s,
        "dropped": int(recording.custom["dropped"]),
        "messages": sum(counts.values()),
        "mb_per_minute": _size(out / "bag") / 1e6 / minutes,
        "memory_mb": {"first": settled[0], "last": settled[-1], "most": max(settled)},
        "memory_mb_per_minute": float(np.polyfit(np.arange(len(settled)) / 60.0, settled, 1)[0]),
    }


def _child(parent: int, module: str) -> int:
    """Return the process id of the child of ``parent`` that runs ``module``; 0 when there is none."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            stat = (entry / "stat").read_text().rpartition(")")[2].split()
            command = (entry / "cmdline").read_bytes().decode(errors="replace")
        except OSError:  # the process has ended
            continue
        if int(stat[1]) == parent and module in command:
            return int(entry.name)
    return 0


def _resident_mb(process: int) -> float:
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


# --- text ------------------------------------------------------------------------------------------------------------


def _text(document: dict[str, Any]) -> str:
    lines = []
    if "cost" in document:
        lines.append(f"us at {', '.join(f'{share:g}' for share in SHARES)} % of the ticks")
        off = document["cost"][0]["tick_us"][0]
        for part in document["cost"]:
            lines.append(
                f"{part['mode']:<8} tick  {_row(part['tick_us'])}   median {part['tick_us'][0] / off - 1:+.1%}"
            )
            lines.append(f"{'':<8} cycle {_row(part['cycle_us'])}")
            lines.append(f"{'':<8} late  {_row(part['late_us'])}")
            if part["mode"] != "off":
                lines.append(f"{'':<8} dropped {part['dropped']}, {part['mb_per_minute']:.1f} MB per minute")
    if "kills" in document:
        found = document["kills"]
        lines.append(
            f"{found['kills']} kills: lost {found['worst_s']:.3f} s at most, {found['median_s']:.3f} s median;"
            f" {found['whole_after']} whole and replayed bit for bit after repair"
        )
    if "long" in document:
        found = document["long"]
        memory = found["memory_mb"]
        lines.append(
            f"{found['minutes']:g} minutes of the node: {found['ticks']} ticks ({found['rate_hz']:.0f} Hz),"
            f" {found['messages']} messages, {found['dropped']} dropped, {found['mb_per_minute']:.1f} MB per minute"
        )
        lines.append(
            f"memory {memory['first']:.1f} MB first, {memory['last']:.1f} last, {memory['most']:.1f} most;"
            f" trend {found['memory_mb_per_minute']:+.2f} MB per minute"
        )
    return "\n".join(lines)


def _row(values: list[float]) -> str:
    return " ".join(f"{value:8.0f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
