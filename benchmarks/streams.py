"""``ik_benchmark streams``: how well streamed poses are followed, on made and on real streams, beside rivals.

In process, with an ideal tool, against the densest truth there is at the same time. Acceleration is the difference of
the commanded velocity over one tick, written in {s}; jerk the difference of that. The lag is the delay of the truth
that leaves the least RMS error, in whole ticks; "after lag" is that error. Two seconds after a step of the target
faster than the reference may move (and 0.3 s before) are left out of errors and lag, not of accelerations.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.stream_baselines import Follower, LastSlope, Proportional
from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.motion import Trajectory
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.stream.stream import StreamedPoses
from ik_node.trajectory.pose_file import PoseFileFormat, load
from ik_node.trajectory.sampled import SampledTrajectory

TICK_S = 0.002
LONGEST_LAG_S = 0.2
SKIPPED_S = 0.5
"""At the begin of each stream: the rivals start without knowing it."""
GAIN = 10.0
"""Of the P control that figures are compared with, 1/s."""


class Stream(NamedTuple):
    """Poses as they were taken, and where the target really was."""

    name: str
    times_s: Array
    poses: Array
    """(N, 4, 4)"""
    truth: Trajectory


class Dirt(NamedTuple):
    """What happens to samples on their way."""

    name: str
    jitter: float = 0.0
    """Largest delay, in sample periods; evenly spread from 0."""
    lost: float = 0.0
    """Part of the samples."""
    repeated: float = 0.0
    overtaken: float = 0.0
    stamped: bool = True
    """Else the arrival is all there is."""


CLEAN = Dirt("clean")
STAMPED = Dirt("jitter, stamped", 0.4, 0.03, 0.03, 0.01)
UNSTAMPED = Dirt("jitter, unstamped", 0.4, 0.03, 0.03, stamped=False)
AS_RECORDED = Dirt("as recorded", stamped=False)
FASTEST_TRANSPORT_S, SLOWEST_TRANSPORT_S = 0.0003, 0.003
"""What a clean sample takes to arrive."""


def sent(stream: Stream, dirt: Dirt, seed: int) -> list[tuple[Stamped, Array]]:
    """The stream's samples in the order of their arrival."""
    rng = np.random.default_rng(seed)
    period_s = float(np.median(np.diff(stream.times_s)))
    messages: list[tuple[float, float, int]] = []
    for index, time_s in enumerate(stream.times_s.tolist()):
        if rng.uniform() < dirt.lost:
            continue
        arrival_s = time_s + rng.uniform(0.0, dirt.jitter * period_s)
        if dirt is CLEAN:
            arrival_s = time_s + rng.uniform(FASTEST_TRANSPORT_S, SLOWEST_TRANSPORT_S)
        if rng.uniform() < dirt.overtaken:
            arrival_s += period_s
        messages.append((time_s, arrival_s, index))
        if rng.uniform() < dirt.repeated:
            messages.append((time_s, arrival_s + rng.uniform(0.0002, 0.3 * period_s), index))
    messages.sort(key=lambda message: message[1])
    return [
        (Stamped(round((time_s if dirt.stamped else arrival_s) * NS), round(arrival_s * NS), 0), stream.poses[index])
        for time_s, arrival_s, index in messages
    ]


class Track(NamedTuple):
    """What a follower did, tick by tick."""

    poses: Array
    """(N, 4, 4)"""
    twists_s: Array
    """(N, 6): commanded velocity of the tool point and angular velocity, written in {s}."""
    tick_s: float = TICK_S


def follow(
    follower: Follower, stream: Stream, samples: Sequence[tuple[Stamped, Array]], tick_s: float = TICK_S
) -> Track:
    """Runs a follower from rest at the first pose over the whole stream."""
    ticks = int(stream.times_s[-1] / tick_s)
    poses, twists = np.empty((ticks, 4, 4)), np.empty((ticks, 6))
    follower.start(stream.poses[0], 0)
    waiting = iter(samples)
    coming = next(waiting, None)
    for tick in range(ticks):
        now_ns = round(tick * tick_s * NS)
        while coming is not None and coming[0].received_ns <= now_ns:
            follower.add(coming[1], coming[0])
            coming = next(waiting, None)
        motion = follower.advance(now_ns, tick_s)
        rotation = motion.pose_sd[:3, :3]
        poses[tick] = motion.pose_sd
        twists[tick, :3], twists[tick, 3:] = rotation @ motion.twist_d[:3], rotation @ motion.twist_d[3:]
    return Track(poses, twists, tick_s)


class Yardstick(NamedTuple):
    """What tracks of one stream are held against."""

    truth: Array
    """T_sd at every tick, (N, 4, 4)."""
    counted: Array
    """(N,): whether the error at that tick counts."""


def yardstick(stream: Stream, ticks: int, tick_s: float = TICK_S) -> Yardstick:
    """For :func:`figures`; worth keeping where several followers are measured on one stream."""
    truth = np.array([stream.truth.pose(tick * tick_s) for tick in range(ticks)])
    return Yardstick(truth, counted(stream, tick_s * np.arange(ticks, dtype=np.float64)))


class Smoothness(NamedTuple):
    """Of a velocity over time, in its unit per s and s2; sizes are Euclidean norms over its columns."""

    acceleration_peak: float
    """Per tick."""
    acceleration_rms: float
    acceleration_20ms_peak: float
    """Averaged over 20 ms."""
    acceleration_20ms_rms: float
    jerk_peak: float
    jerk_rms: float


def smoothness(velocity: Array, tick_s: float) -> Smoothness:
    """Of ``velocity`` (N, any), one row per tick; the begin is left out."""
    first = round(SKIPPED_S / tick_s)
    acceleration = np.diff(velocity, axis=0) / tick_s
    jerk = np.diff(acceleration, axis=0) / tick_s
    window = round(0.02 / tick_s)
    smooth = (velocity[window:] - velocity[:-window]) / (window * tick_s)
    sizes = [np.linalg.norm(values, axis=1) for values in (acceleration[first:], smooth[first:], jerk)]
    return Smoothness(*(float(of(size)) for size in sizes for of in (np.max, _rms)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


class Figures(NamedTuple):
    """Of position in mm, m/s2, m/s3, or of orientation in mrad, rad/s2, rad/s3."""

    rms: float
    """Error against the truth at the same time."""
    max: float
    lag_ms: float
    after_lag: float
    """RMS error against the truth ``lag_ms`` ago."""
    acceleration_peak: float
    """Per tick."""
    acceleration_rms: float
    acceleration_20ms_peak: float
    """Averaged over 20 ms."""
    jerk_rms: float


def figures(track: Track, stream: Stream, known: Yardstick | None = None) -> tuple[Figures, Figures]:
    """Position's and orientation's."""
    truth, counted = known or yardstick(stream, len(track.poses), track.tick_s)
    shifts = range(int(LONGEST_LAG_S / track.tick_s))
    linear = [_position_errors(track.poses, truth, counted, shift) for shift in shifts]
    angular = [_turn_errors(track.poses, truth, counted, shift) for shift in shifts]
    return (
        _figures(linear, track.twists_s[:, :3], track.tick_s),
        _figures(angular, track.twists_s[:, 3:], track.tick_s),
    )


def counted(stream: Stream, times: Array) -> Array:
    """Whether errors at ``times`` (N,) count, (N,): not at the begin, and not about a step of the target."""
    result = times >= SKIPPED_S
    settings = TargetSettings()
    period_s = float(np.median(np.diff(stream.times_s)))
    for before, after, a, b in zip(stream.times_s, stream.times_s[1:], stream.poses, stream.poses[1:], strict=False):
        dt = max(after - before, 0.5 * period_s, 0.01)
        way = float(np.linalg.norm(b[:3, 3] - a[:3, 3]))
        turn = float(np.linalg.norm(se3.log_rotation(a[:3, :3].T @ b[:3, :3])))
        if way > settings.max_linear_speed * dt or turn > settings.max_angular_speed * dt:
            result &= (times < before - 0.3) | (times > after + 2.0)
    return np.asarray(result, dtype=np.float64)


def _position_errors(poses: Array, truth: Array, counted: Array, shift: int) -> Array:
    errors = np.linalg.norm(poses[shift:, :3, 3] - truth[: len(truth) - shift, :3, 3], axis=1)
    return np.asarray(errors[counted[shift:] > 0.0])


def _turn_errors(poses: Array, truth: Array, counted: Array, shift: int) -> Array:
    difference = poses[shift:, :3, :3] - truth[: len(truth) - shift, :3, :3]
    # |A - B| in the Frobenius norm is sqrt(8) sin(angle / 2)
    chords = np.linalg.norm(difference, axis=(1, 2))[counted[shift:] > 0.0]
    return np.asarray(2.0 * np.arcsin(np.minimum(chords / np.sqrt(8.0), 1.0)))


def _figures(errors: Sequence[Array], velocity: Array, tick_s: float) -> Figures:
    rms = [_rms(error) for error in errors]
    best = int(np.argmin(rms))
    smooth = smoothness(velocity, tick_s)
    return Figures(
        1e3 * rms[0],
        1e3 * float(errors[0].max()),
        1e3 * best * tick_s,
        1e3 * rms[best],
        smooth.acceleration_peak,
        smooth.acceleration_rms,
        smooth.acceleration_20ms_peak,
        smooth.jerk_rms,
    )


def eight(rate_hz: float, noise_m: float = 0.0, noise_rad: float = 0.0, seed: int = 0) -> Stream:
    """A figure of eight of 0.3 m x 0.15 m in 10 s with turning tool, and noise on each sample."""
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
    """Gathers speed over the first second; known at every instant."""

    duration_s = 12.0

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        s = time_s - 0.5 if time_s > 1.0 else 2.5 * time_s**4 - 3.0 * time_s**5 + time_s**6
        phase = 0.2 * np.pi * s
        pose = np.eye(4)
        pose[:3, :3] = se3.exp_rotation(np.array((0.4 * np.sin(phase), 0.4 * np.sin(2.0 * phase), 0.0)))
        pose[:3, 3] = (0.4 + 0.15 * np.sin(phase), 0.075 * np.sin(2.0 * phase), 0.5)
        return pose


class Wander:
    """A hand that does not know where it goes: sines of many frequencies up to 3 Hz, in every direction."""

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


def wander(rate_hz: float) -> Stream:
    """Poses of :class:`Wander`."""
    times, truth = np.arange(0.0, 12.0, 1.0 / rate_hz), Wander()
    return Stream(f"wander {rate_hz:g} Hz", times, np.array([truth.pose(time) for time in times.tolist()]), truth)


def decimated(name: str, recording: SampledTrajectory, rate_hz: float) -> Stream:
    """Every n-th sample of a recording, so that about ``rate_hz`` is left; the recording is the truth."""
    samples = recording.samples()
    times = np.array([sample.time_s for sample in samples])
    step = max(1, round(1.0 / (rate_hz * float(np.median(np.diff(times))))))
    poses = np.array([sample.pose for sample in samples])
    return Stream(f"{name} {rate_hz:g} Hz", times[::step], poses[::step], recording)


def first_seconds(stream: Stream, seconds: float) -> Stream:
    """Its begin; all of it where ``seconds`` is 0."""
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
"""Dense recordings to decimate: name, place below the folder of data, how to read it."""
TASK_BOARD = "taskboard_20hz/data_trial1.csv"
"""Goals as they were sent to a robot."""


def task_board_format(data: Path) -> PoseFileFormat:
    """How to read :data:`TASK_BOARD` below ``data``."""
    stamps = (data / TASK_BOARD).with_name("seq_trial1.csv")
    return PoseFileFormat(prefix="goal", time="pose_header_seq", time_unit="ms", time_file=str(stamps))


def task_board(data: Path) -> Stream:
    """The goals of the task board in ``data``; their own interpolation is the densest truth there is."""
    goals = load(data / TASK_BOARD, task_board_format(data))
    times = np.array([sample.time_s for sample in goals.samples()])
    return Stream("task board", times, np.array([sample.pose for sample in goals.samples()]), goals)


def absent(data: Path) -> tuple[str, ...]:
    """Names of the real streams that ``data`` does not hold."""
    places = {"task board": TASK_BOARD} | {name: place for name, place, _ in RECORDINGS}
    return tuple(name for name, place in places.items() if not (data / place).exists())


def real(
    data: Path, rates_hz: Sequence[float], start_pose: Array | None = None
) -> Iterator[tuple[Stream, tuple[Dirt, ...]]]:
    """The recordings in ``data`` that are there: as sent, or decimated to the rates.

    ``start_pose`` (4, 4) gives what a recording does not hold: orientation, height, or where it begins.
    """
    missing = absent(data)
    if "task board" not in missing:
        yield task_board(data), (AS_RECORDED,)
    start = np.eye(4)
    start[:3, 3] = (0.4, 0.0, 0.4)
    for name, place, how in RECORDINGS:
        if name not in missing:
            recording = load(data / place, how, start if start_pose is None else start_pose)
            for rate_hz in rates_hz:
                yield decimated(name, recording, rate_hz), (CLEAN, STAMPED, UNSTAMPED)


def followers() -> dict[str, Callable[[], Follower]]:
    """What is compared, by name; ours and the P control that it must beat come first."""
    settings = TargetSettings()
    return {
        "ours": lambda: StreamedPoses(settings),
        f"P, {GAIN:g}/s": lambda: Proportional(GAIN),
        "last slope": lambda: LastSlope(settings),
        "whole error": lambda: Proportional(1.0 / TICK_S, settings.max_linear_speed, settings.max_angular_speed),
    }


class Verdict(NamedTuple):
    """Ours beside P control; each below 1 is what is asked of streams at 20 to 33 Hz."""

    position_lag: float
    """As part of 30 ms or one sample period, whichever is larger."""
    rotation_lag: float
    """As part of 1.5 sample periods."""
    position_after_lag: float
    """As part of P's."""
    rotation_after_lag: float
    position_peak: float
    """Five times the peak acceleration per tick, as part of P's."""
    rotation_peak: float


def verdict(ours: tuple[Figures, Figures], rival: tuple[Figures, Figures], period_s: float) -> Verdict:
    """Orientation counts as kept where it never changes."""
    turns = rival[1].acceleration_peak > 1e-6
    return Verdict(
        ours[0].lag_ms / max(30.0, 1e3 * period_s),
        ours[1].lag_ms / (1.5e3 * period_s) if turns else 0.0,
        ours[0].after_lag / rival[0].after_lag,
        ours[1].after_lag / rival[1].after_lag if turns else 0.0,
        5.0 * ours[0].acceleration_peak / rival[0].acceleration_peak,
        5.0 * ours[1].acceleration_peak / rival[1].acceleration_peak if turns else 0.0,
    )


def main(arguments: Sequence[str]) -> int:
    """Prints the table; with ``--json`` one object per stream, dirt and follower."""
    parser = argparse.ArgumentParser(prog="ik_benchmark streams", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of real recordings")
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 33.0], help="Hz, to decimate recordings to")
    parser.add_argument("--seeds", type=int, default=1, help="how many draws of the dirt")
    parser.add_argument("--only", default="", help="streams whose name holds this")
    parser.add_argument("--json", action="store_true", help="one JSON object per line instead of the table")
    options = parser.parse_args(arguments)
    made = ((make(rate), (CLEAN, STAMPED, UNSTAMPED)) for make in (eight, wander) for rate in (20.0, 50.0, 500.0))
    noisy = ((eight(rate, 2e-4, 1e-3), (CLEAN,)) for rate in (20.0, 50.0, 500.0))
    if not options.json:
        print(_HEAD)
    for stream, dirts in (*made, *noisy, *real(options.data, options.rates)):
        for dirt in dirts if options.only in stream.name else ():
            for seed in range(options.seeds if dirt.lost else 1):
                _compare(stream, dirt, seed, options.json)
    return 0


_HEAD = """lag ms, RMS error at the same time, RMS error after removing the lag, peak and RMS acceleration per tick,
peak acceleration over 20 ms, of position (mm, m/s2) and of orientation (mrad, rad/s2)
"""


def _compare(stream: Stream, dirt: Dirt, seed: int, as_json: bool) -> None:
    samples = sent(stream, dirt, seed)
    results = {name: figures(follow(make(), stream, samples), stream) for name, make in followers().items()}
    ours, rival = list(results.values())[:2]
    judged = verdict(ours, rival, float(np.median(np.diff(stream.times_s))))
    if as_json:
        for name, (linear, angular) in results.items():
            row = {"stream": stream.name, "dirt": dirt.name, "seed": seed, "follower": name}
            print(json.dumps({**row, "position": linear._asdict(), "orientation": angular._asdict()}), flush=True)
        return
    missed = [f"{name} {value:.2f}" for name, value in judged._asdict().items() if value > 1.0]
    print(f"{stream.name}, {dirt.name}, draw {seed}: {'above 1: ' + ', '.join(missed) if missed else 'all met'}")
    for name, both in results.items():
        cells = " | ".join(
            f"{f.lag_ms:4.0f}{f.rms:9.3f}{f.after_lag:9.3f}{f.acceleration_peak:10.2f}{f.acceleration_rms:8.2f}"
            f"{f.acceleration_20ms_peak:8.2f}"
            for f in both
        )
        print(f"  {name:<12}{cells}", flush=True)
