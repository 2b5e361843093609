"""Streams of target poses for the benchmarks: generated from formulas or decimated from recordings; and their
transport."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.motion import Trajectory
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.trajectory.pose_file import load
from ik_node.trajectory.pose_file_format import PoseFileFormat
from ik_node.trajectory.sampled import SampledTrajectory


class Stream(NamedTuple):
    """Sampled poses and the true motion of the target."""

    name: str
    times_s: Array
    poses: Array
    """(N, 4, 4)"""
    truth: Trajectory


class StreamNoise(NamedTuple):
    """Disturbance of the samples by their transport."""

    name: str
    jitter: float = 0.0
    """Largest delay, in sample periods; uniform from 0."""
    lost: float = 0.0
    """Fraction of the samples."""
    repeated: float = 0.0
    overtaken: float = 0.0
    stamped: bool = True
    """False: the time of arrival is used instead of a stamp."""


CLEAN = StreamNoise("clean")
STAMPED = StreamNoise("jitter, stamped", 0.4, 0.03, 0.03, 0.01)
UNSTAMPED = StreamNoise("jitter, unstamped", 0.4, 0.03, 0.03, stamped=False)
AS_RECORDED = StreamNoise("as recorded", stamped=False)
FASTEST_TRANSPORT_S, SLOWEST_TRANSPORT_S = 0.0003, 0.003
"""Range of the transport delay without noise."""


def transported(stream: Stream, noise: StreamNoise, seed: int) -> list[tuple[Stamped, Array]]:
    """Return the samples of ``stream`` in order of arrival, disturbed by ``noise``."""
    rng = np.random.default_rng(seed)
    period_s = float(np.median(np.diff(stream.times_s)))
    messages: list[tuple[float, float, int]] = []
    for index, time_s in enumerate(stream.times_s.tolist()):
        if rng.uniform() < noise.lost:
            continue
        arrival_s = time_s + rng.uniform(0.0, noise.jitter * period_s)
        if noise is CLEAN:
            arrival_s = time_s + rng.uniform(FASTEST_TRANSPORT_S, SLOWEST_TRANSPORT_S)
        if rng.uniform() < noise.overtaken:
            arrival_s += period_s
        messages.append((time_s, arrival_s, index))
        if rng.uniform() < noise.repeated:
            messages.append((time_s, arrival_s + rng.uniform(0.0002, 0.3 * period_s), index))
    messages.sort(key=lambda message: message[1])
    return [
        (Stamped(round((time_s if noise.stamped else arrival_s) * NS), round(arrival_s * NS), 0), stream.poses[index])
        for time_s, arrival_s, index in messages
    ]


def eight(rate_hz: float, noise_m: float = 0.0, noise_rad: float = 0.0, seed: int = 0) -> Stream:
    """Return a figure of eight of 0.3 m x 0.15 m in 10 s with rotating tool, and noise on each sample."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 12.0, 1.0 / rate_hz)
    truth = FigureOfEight()
    poses = np.array([truth.pose(time) for time in times.tolist()])
    poses[:, :3, 3] += noise_m * rng.normal(size=(len(times), 3))
    for pose, turn in zip(poses, noise_rad * rng.normal(size=(len(times), 3)), strict=True):
        pose[:3, :3] = pose[:3, :3] @ se3.exp_rotation(turn)
    noisy = f", noise {1e3 * noise_m:g} mm" if noise_m else ""
    return Stream(f"eight {rate_hz:g} Hz{noisy}", times, poses, truth)


class FigureOfEight:
    """A figure of eight; accelerates in the first second."""

    duration_s = 12.0

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        s = time_s - 0.5 if time_s > 1.0 else 2.5 * time_s**4 - 3.0 * time_s**5 + time_s**6
        phase = 0.2 * np.pi * s
        pose = np.eye(4)
        pose[:3, :3] = se3.exp_rotation(np.array((0.4 * np.sin(phase), 0.4 * np.sin(2.0 * phase), 0.0)))
        pose[:3, 3] = (0.4 + 0.15 * np.sin(phase), 0.075 * np.sin(2.0 * phase), 0.5)
        return pose


class Screw:
    """Constant velocity, 0.1 m/s and 0.5 rad/s: the lag of P control is known in closed form."""

    duration_s = 6.0

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        pose = np.eye(4)
        pose[:3, :3] = se3.exp_rotation(np.array((0.0, 0.0, 0.5 * time_s)))
        pose[0, 3] = 0.1 * time_s
        return pose


def screw(rate_hz: float) -> Stream:
    """Poses of :class:`Screw`."""
    times, truth = np.arange(0.0, 6.0, 1.0 / rate_hz), Screw()
    return Stream(f"screw {rate_hz:g} Hz", times, np.array([truth.pose(time) for time in times.tolist()]), truth)


class RandomWalk:
    """An unpredictable motion, like that of a hand: sines of many frequencies up to 3 Hz in every direction."""

    duration_s = 12.0

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self._rates = 2.0 * np.pi * np.linspace(0.15, 3.0, 12)
        self._phases = rng.uniform(0.0, 2.0 * np.pi, (6, 12))
        # equal speeds in all frequencies: 0.02 m/s and 0.1 rad/s each
        self._sizes = np.repeat((0.02, 0.1), 3)[:, None] / self._rates

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        values = (self._sizes * np.sin(self._rates * time_s + self._phases)).sum(axis=1)
        pose = np.eye(4)
        pose[:3, :3] = se3.exp_rotation(values[3:])
        pose[:3, 3] = values[:3]
        return pose


def random_walk(rate_hz: float) -> Stream:
    """Return poses of :class:`RandomWalk`."""
    times, truth = np.arange(0.0, 12.0, 1.0 / rate_hz), RandomWalk()
    return Stream(f"random walk {rate_hz:g} Hz", times, np.array([truth.pose(time) for time in times.tolist()]), truth)


def decimated(name: str, recording: SampledTrajectory, rate_hz: float) -> Stream:
    """Return every n-th sample of a recording at about ``rate_hz``; the recording is the truth."""
    samples = recording.samples()
    times = np.array([sample.time_s for sample in samples])
    step = max(1, round(1.0 / (rate_hz * float(np.median(np.diff(times))))))
    poses = np.array([sample.pose for sample in samples])
    return Stream(f"{name} {rate_hz:g} Hz", times[::step], poses[::step], recording)


def without_edges(recording: SampledTrajectory, edge_s: float) -> SampledTrajectory:
    """Return a recording without ``edge_s`` at its start and its end."""
    if not edge_s:
        return recording
    samples = recording.samples()
    kept = [s for s in samples if edge_s <= s.time_s - samples[0].time_s <= recording.duration_s - edge_s]
    return SampledTrajectory(
        np.array([sample.time_s for sample in kept]) - kept[0].time_s, np.array([sample.pose for sample in kept])
    )


def first_seconds(stream: Stream, seconds: float) -> Stream:
    """Return the first ``seconds`` of a stream; all of it for 0."""
    count = int(np.searchsorted(stream.times_s, seconds, side="right")) if seconds else len(stream.times_s)
    return stream._replace(times_s=stream.times_s[:count], poses=stream.poses[:count])


RECORDINGS = (
    ("camera", "hand_held_camera/freiburg1_xyz-groundtruth.txt", PoseFileFormat(relative=True, scale=0.45)),
    ("letter h", "handwriting/h.npy", PoseFileFormat(units="cm", duration_s=10.0)),
    ("letter e", "handwriting/e.npy", PoseFileFormat(units="cm", duration_s=10.0)),
    ("co-manipulation", "comanipulation/symbol17_rec0.csv", PoseFileFormat(relative=True, duration_s=5.519)),
    ("open box", "robottasks/openbox.npy", PoseFileFormat(units="cm", duration_s=10.0, order="wxyz")),
    ("bottle to shelf", "robottasks/bottle2shelf.npy", PoseFileFormat(units="cm", duration_s=10.0, order="wxyz")),
)
"""Dense recordings to decimate: name, path below the folder of data, format."""
MORE_RECORDINGS = (
    ("letter l", "handwriting/l.npy", PoseFileFormat(units="cm", duration_s=10.0)),
    ("letter o", "handwriting/o.npy", PoseFileFormat(units="cm", duration_s=10.0, demo=5)),
    ("co-manipulation 1", "comanipulation/symbol17_rec1.csv", PoseFileFormat(relative=True, duration_s=5.492)),
    ("co-manipulation 2", "comanipulation/symbol17_rec2.csv", PoseFileFormat(relative=True, duration_s=8.729)),
    ("open box 3", "robottasks/openbox.npy", PoseFileFormat(units="cm", duration_s=10.0, order="wxyz", demo=3)),
    (
        "bottle to shelf 4",
        "robottasks/bottle2shelf.npy",
        PoseFileFormat(units="cm", duration_s=10.0, order="wxyz", demo=4),
    ),
)
"""Further ones, for the frontier."""
HELD_OUT = ("letter e", "letter o", "bottle to shelf", "co-manipulation 1", "co-manipulation 2", "task board, measured")
"""Beginnings of the names of recordings on which the stream handling was not tuned."""
COMPUTED_EDGES_S = {"robottasks": 1.0}
"""Start and end of the recordings of a folder that are left out: polynomials from a smoothing filter, whose sixth
differences are 1e-13 of those in between; such a motion is not measured."""
TASK_BOARD = "taskboard_20hz/data_trial1.csv"
"""Target poses that were sent to a robot."""


def task_board_format(data: Path) -> PoseFileFormat:
    """Return the format of :data:`TASK_BOARD` below ``data``."""
    stamps = (data / TASK_BOARD).with_name("seq_trial1.csv")
    return PoseFileFormat(prefix="goal", time="pose_header_seq", time_unit="ms", time_file=str(stamps))


def task_board(data: Path) -> Stream:
    """Return the targets of the task board in ``data``; their interpolation is the truth."""
    goals = load(data / TASK_BOARD, task_board_format(data))
    times = np.array([sample.time_s for sample in goals.samples()])
    return Stream("task board", times, np.array([sample.pose for sample in goals.samples()]), goals)


def task_board_measured(data: Path) -> Stream:
    """Return the poses that the arm of the task board measured, with their interpolation as the truth."""
    measured = load(data / TASK_BOARD, replace(task_board_format(data), prefix="current"))
    times = np.array([sample.time_s for sample in measured.samples()])
    return Stream("task board, measured", times, np.array([sample.pose for sample in measured.samples()]), measured)


def held_out(name: str) -> bool:
    """Return whether the stream handling was not tuned on the stream of this name."""
    return name.startswith(HELD_OUT)


def absent(data: Path) -> tuple[str, ...]:
    """Return the names of the real streams that are missing in ``data``."""
    paths = {"task board": TASK_BOARD} | {name: path for name, path, _ in RECORDINGS}
    return tuple(name for name, path in paths.items() if not (data / path).exists())


def real(
    data: Path, rates_hz: Sequence[float], start_pose: Array | None = None, more: bool = False
) -> Iterator[tuple[Stream, tuple[StreamNoise, ...]]]:
    """Yield the recordings in ``data``, as sent or decimated to the rates, with the noises to apply.

    ``start_pose`` (4, 4) replaces missing parts of a recording: orientation, height, or start. ``more`` also yields
    :data:`MORE_RECORDINGS`, and only different rates of each.
    """
    missing = absent(data)
    if "task board" not in missing:
        yield task_board(data), (AS_RECORDED,)
        if more:
            yield task_board_measured(data), (AS_RECORDED,)
    start = np.eye(4)
    start[:3, 3] = (0.4, 0.0, 0.4)
    for name, path, file_format in (*RECORDINGS, *(MORE_RECORDINGS if more else ())):
        if name not in missing and (data / path).exists():
            whole = load(data / path, file_format, start if start_pose is None else start_pose)
            recording = without_edges(whole, COMPUTED_EDGES_S.get(path.split("/")[0], 0.0))
            counts = set()
            for rate_hz in rates_hz:
                stream = decimated(name, recording, rate_hz)
                if not more or len(stream.times_s) not in counts:
                    yield stream, (CLEAN, STAMPED, UNSTAMPED)
                counts.add(len(stream.times_s))
