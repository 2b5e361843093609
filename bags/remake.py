"""Records the runs in this folder again: the real node and the simulated arm over DDS, one after the other."""

from __future__ import annotations

import argparse
import csv
import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import yaml

from ik_node.recording.mcap.metadata import Qos
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.mcap.writer import Recorder, RecorderOptions

FOLDER = Path(__file__).resolve().parent
COMMON = ("--headless", "--rate", "100")
"""A low rate keeps the files small."""
SCENE, POSES, RUN = "scene.yaml", "poses.csv", "run"
"""Files in the folder of ``ik_demo``; relative, because parameters are recorded as they are given."""
LEFT_OUT = ("joint_velocity", "current_pose", "desired_pose", "twist_error", "task", "potential", "diagnostics")
"""Outputs whose content is also in the Steps."""

Row = tuple[float, float, float, float, float, float]
"""Time, x, y, z, rotation about x, rotation about z, relative to the initial pose; s, m, rad."""


def swing(time_s: float, duration_s: float) -> float:
    """From 0 to 1 and back to 0, at rest at both ends."""
    return 0.5 - 0.5 * math.cos(2.0 * math.pi * min(time_s, duration_s) / duration_s)


def stretched() -> Iterable[Row]:
    """Outwards beyond the reach of the arm, so that the elbow is straight, and back."""
    for index in range(126):
        part = swing(0.02 * index, 2.5)
        yield 0.02 * index, 0.55 * part, 0.0, 0.1 * part, 0.0, 0.0


def there_and_back() -> Iterable[Row]:
    """Sideways with a rotation of the tool, and back."""
    for index in range(101):
        part = swing(0.02 * index, 2.0)
        yield 0.02 * index, 0.0, 0.15 * part, 0.05 * part, 0.2 * part, 0.4 * part


def turned() -> Iterable[Row]:
    """Rotation of the tool about its own axis beyond the limit of its joint, and back."""
    for index in range(126):
        part = swing(0.02 * index, 2.5)
        yield 0.02 * index, 0.05 * part, 0.02 * part, 0.03 * part, 0.0, -1.5 * part


def with_gaps() -> Iterable[Row]:
    """A circle with missing samples."""
    for index in range(151):
        time_s = 0.02 * index
        if 0.8 < time_s < 0.95 or 1.8 < time_s < 2.5:
            continue
        angle = 2.0 * math.pi * swing(time_s, 6.0)
        yield time_s, 0.0, 0.06 * math.sin(angle), 0.06 * (1.0 - math.cos(angle)), 0.0, 0.0


class Case(NamedTuple):
    """One recording."""

    arguments: tuple[str, ...]
    """For ``ik_demo``."""
    rows: Callable[[], Iterable[Row]] = there_and_back
    """Its targets."""


CASES = {
    **{
        method: Case(("--method", method))
        for method in ("plain", "inertia_weighted", "obstacle_gradient", "gravity_gradient")
    },
    "ik_difference": Case(("--robot", "ur5", "--set", "control_law=ik_difference")),
    "singularity": Case((), stretched),
    "limit": Case(("--set", "limits.position_upper=[2.8, 1.7, 2.8, -0.1, 2.8, 3.7, 1.2]"), turned),
    "gaps": Case((), with_gaps),
    "obstacle": Case(("--method", "obstacle_gradient", "--set", f"obstacles.scene={SCENE}")),
}


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Poses as a file that ``ik_demo`` reads."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "x", "y", "z", "qx", "qy", "qz", "qw"))
        for time_s, x, y, z, about_x, about_z in rows:
            sx, cx = math.sin(0.5 * about_x), math.cos(0.5 * about_x)
            sz, cz = math.sin(0.5 * about_z), math.cos(0.5 * about_z)
            writer.writerow((time_s, x, y, z, cz * sx, sz * sx, sz * cx, cz * cx))


def compact(source: Path, target: Path) -> None:
    """Copies what a replay needs, in few large chunks: a live recording has one chunk per 0.1 s."""
    recorder = Recorder(target, RecorderOptions(flush_period_s=3600.0))
    about = yaml.safe_load((source / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    channels = {}
    for entry in about["topics_with_message_count"]:
        topic = entry["topic_metadata"]
        if topic["name"].rpartition("/")[2] in LEFT_OUT:
            continue
        latched = topic["offered_qos_profiles"][0]["durability"] == "transient_local"
        channels[topic["name"]] = recorder.channel(
            topic["name"], topic["type"], Qos(1 if latched else 10, True, latched)
        )
    for message in Recording(source).messages(set(channels)):
        recorder.write(
            channels[message.topic], message.data, message.log_time_ns, message.publish_time_ns, message.sequence
        )
    recorder.close()
    if recorder.error or recorder.dropped:
        sys.exit(f"{target}: {recorder.error or 'messages were left out'}")


def arguments_of(case: Case) -> list[str]:
    """Arguments of ``ik_demo``."""
    return ["--out", RUN, *COMMON, *case.arguments, "--trajectory", POSES, "--relative"]


def remake(name: str) -> None:
    """Runs one case and stores its recording in this folder."""
    case = CASES[name]
    with tempfile.TemporaryDirectory() as scratch:
        write_rows(Path(scratch, POSES), case.rows())
        shutil.copy(FOLDER / SCENE, scratch)
        command = [sys.executable, "-m", "ik_node.cli.demo", *arguments_of(case)]
        print(f"{name} ...", flush=True)
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=scratch)
        if done.returncode:
            sys.exit(f"{name}: ik_demo ended with {done.returncode}\n{done.stdout}{done.stderr}")
        shutil.rmtree(FOLDER / name, ignore_errors=True)
        compact(Path(scratch, RUN, "bag"), FOLDER / name)


def main() -> None:
    """Records the named cases, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"recordings to make [all: {', '.join(CASES)}]")
    names = parser.parse_args().names or list(CASES)
    unknown = [name for name in names if name not in CASES]
    if unknown:
        parser.error(f"no recording {', '.join(unknown)}; valid: {', '.join(CASES)}")
    for name in names:
        remake(name)
    size = sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file())
    print(f"{size / 1e6:.2f} MB in {FOLDER}")


if __name__ == "__main__":
    main()
