"""Streams over DDS: ``ik_demo`` runs node and simulator as processes; its recording is measured."""

from __future__ import annotations

import csv
import dataclasses
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import stream_data
from benchmarks.stream_data import RECORDINGS, Stream
from benchmarks.stream_metrics import TICK_S, ReferenceTrack, Track, counted, smoothness, stream_metrics
from benchmarks.tracking_rows import NODE, FollowerResult, LateInputs, Requirement
from benchmarks.tracking_targets import READY, panda, start_of_streams
from ik_node import resources
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.report import GROUND_TRUTH_FILE
from ik_node.report.ground_truth import GroundTruth, Poses, read_ground_truth
from ik_node.report.lateness import late_steps, late_targets
from ik_node.report.tracking import measured_poses
from ik_node.robot.catalogue import robot_from_settings
from ik_node.settings.parameter_file import read_settings
from ik_node.trajectory.pose_file import read
from ik_node.trajectory.pose_file_format import PoseFileFormat
from ik_node.trajectory.sampled import SampledTrajectory

RATE_HZ = 30.0
MADE = "wander"
"""Name of the generated stream."""


LETTER = PoseFileFormat(units="cm", duration_s=10.0)
MORE = (
    ("letter l", "handwriting/l.npy", LETTER),
    ("letter o", "handwriting/o.npy", LETTER),
    ("co-manipulation 1", "comanipulation/symbol17_rec1.csv", PoseFileFormat(relative=True, duration_s=5.471)),
    ("co-manipulation 2", "comanipulation/symbol17_rec2.csv", PoseFileFormat(relative=True, duration_s=8.647)),
)
"""Recordings that only this part runs: name, path below the folder of data, format."""
JOINT_POSITIONS, JOINT_ROBOT = "ur10e_excitation/ur-20_02_10-30sec_12harm.csv", "ur10"
"""Recorded joint positions without a header: time, then those of all joints; and the arm."""


class Sent(NamedTuple):
    """A stream that ik_demo sends."""

    name: str
    file: Path
    how: PoseFileFormat
    rate_hz: float | None
    """None: the times in the file."""
    arm: tuple[str, ...] = ("--robot", "panda")
    """Options of ik_demo."""


def part(
    data: Path, name: str, seconds: float, load: bool = False
) -> Iterator[tuple[str, list[FollowerResult], list[Requirement]]]:
    """Yield titles, rows and requirements; ``seconds`` of each stream, 0 for all of it.

    With ``load`` each stream is run again with one busy process per core; that run has no requirements.
    """
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch, "wander.csv")
        write_wander(made)
        for sent in (Sent(MADE, made, _placed(PoseFileFormat(relative=True)), RATE_HZ), *_real(data, Path(scratch))):
            if name not in sent.name:
                continue
            for is_busy in (False, True) if load else (False,):
                title = f"{sent.name}, over DDS, load {os.getloadavg()[0]:.1f} before"
                title += ", every core busy" if is_busy else ""
                out = Path(scratch, f"{sent.name.replace(' ', '_')}_{is_busy}")
                with busy_cores() if is_busy else nullcontext():
                    row, period_s = tracked(sent, out, seconds)
                yield title, [row], [] if is_busy else _demands(title, row, period_s)


@contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy with one process."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


def _real(data: Path, scratch: Path) -> Iterator[Sent]:
    """Yield the streams in the folder of real recordings; those that are absent are named."""
    board = Sent("task board", data / stream_data.TASK_BOARD, stream_data.task_board_format(data), None)
    recordings = (Sent(name, data / place, _placed(how), RATE_HZ) for name, place, how in (*RECORDINGS, *MORE))
    for sent in (board, *recordings):
        if sent.file.exists():
            yield sent
        else:
            print(f"{sent.name}: skipped, {data} does not hold it; '{MADE}' covers the same", file=sys.stderr)
    if (data / JOINT_POSITIONS).exists():
        yield joint_motion(data / JOINT_POSITIONS, scratch)
    else:
        print(f"joint excitation: skipped, {data} does not hold it", file=sys.stderr)


def joint_motion(file: Path, scratch: Path) -> Sent:
    """Return the tool poses of recorded joint positions, for the same arm from the same start."""
    table = np.loadtxt(file, delimiter=",", usecols=range(7))
    config = resources.config_file(f"{JOINT_ROBOT}.yaml")
    robot = robot_from_settings(read_settings(config).arm)
    poses = scratch / "joint_motion.csv"
    write_poses(poses, table[:, 0] - table[0, 0], [robot.pose(q) for q in table[:, 1:]])
    placed = scratch / config.name
    start = f"initial_position: {table[0, 1:].tolist()}"
    placed.write_text(re.sub(r"initial_position: .*", start, config.read_text(encoding="utf-8")), encoding="utf-8")
    return Sent("joint excitation", poses, PoseFileFormat(), None, ("--config", str(placed)))


def _placed(how: PoseFileFormat) -> PoseFileFormat:
    """Yield the streams; relative motions start at the same pose as in the other parts."""
    robot, _ = panda(1.0 / TICK_S)
    x, y, z = (start_of_streams(robot)[:3, 3] - robot.pose(READY)[:3, 3]).tolist()
    return dataclasses.replace(how, offset=(x, y, z)) if how.relative else how


def write_wander(path: Path) -> None:
    """Write a dense random walk to a file, from which ik_demo samples."""
    wander = stream_data.RandomWalk()
    times_s = np.arange(0.0, wander.duration_s, 0.01)
    write_poses(path, times_s, [wander.pose(time_s) for time_s in times_s.tolist()])


def write_poses(path: Path, times_s: Array, poses: Sequence[Array]) -> None:
    """Write poses (4, 4) at times (N,) to a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "x", "y", "z", "qx", "qy", "qz", "qw"))
        for time_s, pose in zip(times_s.tolist(), poses, strict=True):
            writer.writerow((time_s, *pose[:3, 3], *se3.quaternion_from_rotation(pose[:3, :3])))


def tracked(sent: Sent, out: Path, seconds: float) -> tuple[FollowerResult, float]:
    """Return the node's row from a recording made in the folder ``out``, and the sample period in s.

    Raises IkNodeError with the output of ik_demo when ik_demo fails.
    """
    command = [sys.executable, "-m", "ik_node.cli.demo", "--headless", *sent.arm, "--out", str(out)]
    command += ["--trajectory", str(sent.file), *_arguments(sent.how)]
    if seconds and seconds < read(sent.file, sent.how).times_s[-1]:
        command += ["--end", str(seconds)]
    if sent.rate_hz is not None:
        command += ["--target-rate", str(sent.rate_hz)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise IkNodeError(f"ik_demo ended with {done.returncode}:\n{done.stdout[-1000:]}{done.stderr[-1000:]}")
    return measured(load_run(out / "bag"), read_ground_truth(out / GROUND_TRUTH_FILE))


def _arguments(how: PoseFileFormat) -> list[str]:
    given: list[str] = []
    for field in dataclasses.fields(how):
        value = getattr(how, field.name)
        if value != field.default:
            given += ["--" + field.name.removesuffix("_s").replace("_", "-")]
            values = value if isinstance(value, tuple) else (value,)
            given += [] if value is True else [str(entry) for entry in values]
    return given


def measured(run: Run, truth: GroundTruth) -> tuple[FollowerResult, float]:
    """Return the row of the node on an even grid, and the median period of the targets, s."""
    begin_ns, duration_s = int(truth.ros_ns[0]), (int(truth.ros_ns[-1]) - int(truth.ros_ns[0])) / NS
    grid = TICK_S * np.arange(int(duration_s / TICK_S), dtype=np.float64)
    sent = run.targets.stamp_ns >= begin_ns
    times_s = (run.targets.stamp_ns[sent] - begin_ns) / NS
    targets = _matrices(Poses(run.targets.position[sent], run.targets.quaternion_xyzw[sent]))
    stream = Stream("recorded", times_s, targets, SampledTrajectory(times_s, targets))
    tool, ros_ns, _ = measured_poses(run)
    inside = ros_ns >= begin_ns
    moments_s = (ros_ns[inside] - begin_ns) / NS
    moved = SampledTrajectory(moments_s - moments_s[0], _matrices(tool)[inside])
    poses = np.array([moved.pose(time_s) for time_s in (grid - moments_s[0]).tolist()])
    known = ReferenceTrack(_matrices(truth.at(begin_ns + np.round(grid * NS).astype(np.int64))), counted(stream, grid))
    linear, angular = stream_metrics(Track(poses, np.zeros((len(grid), 6))), stream, known)
    commanded = np.isfinite(run.joint_velocity).all(axis=1)
    even = np.arange(run.times_s[commanded][0], run.times_s[commanded][-1], TICK_S)
    velocity = [np.interp(even, run.times_s[commanded], joint[commanded]) for joint in run.joint_velocity.T]
    longest_ms = 1e3 * float(np.diff(run.times_s[commanded]).max())
    name = f"{NODE}, ticks to {longest_ms:.0f} ms"
    begin_s = float(run.times_s[np.searchsorted(run.ros_ns, begin_ns)])
    slowed_s = TICK_S * float(np.count_nonzero(run.scale[commanded] < 1.0))
    stopped_s = _stopped_s(run, begin_s, begin_s + duration_s)
    row = FollowerResult(name, linear, angular, smoothness(np.stack(velocity, axis=1), TICK_S), (), slowed_s, stopped_s)
    late = LateInputs(len(run.targets.times_s), late_targets(run), late_steps(run))
    return row._replace(late=late), float(np.median(np.diff(times_s)))


def _stopped_s(run: Run, begin_s: float, end_s: float) -> float:
    """Return the time without control between two times, s."""
    times = [min(max(change.time_s, begin_s), end_s) for change in run.status_changes]
    ends = [*times[1:], end_s]
    at_work = (Mode.TRACKING, Mode.HOLDING)
    modes = [change.status.mode for change in run.status_changes]
    return sum(end - time for time, end, mode in zip(times, ends, modes, strict=True) if mode not in at_work)


def _matrices(poses: Poses) -> Array:
    """Return pose matrices, (m, 4, 4)."""
    result = np.repeat(np.eye(4)[None], len(poses.position), axis=0)
    result[:, :3, 3] = poses.position
    result[:, :3, :3] = [se3.rotation_from_quaternion(quaternion) for quaternion in poses.quaternion]
    return result


def _demands(of: str, row: FollowerResult, period_s: float) -> list[Requirement]:
    """Return the requirements that need no baseline in the same run."""
    return [
        Requirement(of, "position lag, ms", row.linear.lag_ms, max(30.0, 1e3 * period_s)),
        Requirement(of, "rotation lag, ms", row.angular.lag_ms, 1.5e3 * period_s),
    ]
