"""Run a follower on a stream and measure error, lag, acceleration and jerk.

The tool is ideal. The error is that with respect to the densest truth at the same time. Acceleration is the difference
of the commanded velocity over one control step, written in {s}; jerk is the difference of the acceleration. The lag is
the delay of the truth with the smallest RMS error; between control steps, the squared error is a parabola. After a step
of the target that is faster than the reference may move, two seconds (and 0.3 s before it) count for accelerations, but
not for errors and lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.stream_baselines import Follower
from benchmarks.stream_data import Stream
from ik_node.interfaces.clock import NS, Stamped
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings

TICK_S = 0.002
LONGEST_LAG_S = 0.2
SKIPPED_S = 0.5
"""Start of each stream that does not count, because the followers do not have its velocity yet."""


class Track(NamedTuple):
    """Motion of a follower, one row per control step."""

    poses: Array
    """(N, 4, 4)"""
    twists_s: Array
    """(N, 6): commanded velocity of the tool point and angular velocity, written in {s}."""
    tick_s: float = TICK_S


def follow(
    follower: Follower, stream: Stream, samples: Sequence[tuple[Stamped, Array]], tick_s: float = TICK_S
) -> Track:
    """Run a follower from rest at the first pose over the whole stream."""
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


class ReferenceTrack(NamedTuple):
    """The truth that tracks of one stream are compared with."""

    truth: Array
    """T_sd at every control step, (N, 4, 4)."""
    counted: Array
    """Whether the error counts, (N,)."""


def reference_track(stream: Stream, ticks: int, tick_s: float = TICK_S) -> ReferenceTrack:
    """Return the reference for :func:`stream_metrics`; reuse it for several followers of one stream."""
    truth = np.array([stream.truth.pose(tick * tick_s) for tick in range(ticks)])
    return ReferenceTrack(truth, counted(stream, tick_s * np.arange(ticks, dtype=np.float64)))


class Smoothness(NamedTuple):
    """Acceleration and jerk of a velocity, as Euclidean norms over its columns, in its unit per s and s2."""

    acceleration_peak: float
    """Per control step."""
    acceleration_rms: float
    acceleration_20ms_peak: float
    """Averaged over 20 ms."""
    acceleration_20ms_rms: float
    jerk_peak: float
    jerk_rms: float


def smoothness(velocity: Array, tick_s: float) -> Smoothness:
    """Measure ``velocity`` (N, any), one row per control step; the start does not count."""
    first = round(SKIPPED_S / tick_s)
    acceleration = np.diff(velocity, axis=0) / tick_s
    jerk = np.diff(acceleration, axis=0) / tick_s
    window = round(0.02 / tick_s)
    smooth = (velocity[window:] - velocity[:-window]) / (window * tick_s)
    sizes = [np.linalg.norm(values, axis=1) for values in (acceleration[first:], smooth[first:], jerk)]
    return Smoothness(*(float(of(size)) for size in sizes for of in (np.max, _rms)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


class StreamMetrics(NamedTuple):
    """Figures of position (mm, m/s2, m/s3) or of orientation (mrad, rad/s2, rad/s3)."""

    rms: float
    """RMS error with respect to the truth at the same time."""
    max: float
    lag_ms: float
    after_lag: float
    """RMS error with respect to the truth ``lag_ms`` earlier."""
    acceleration_peak: float
    """Per control step."""
    acceleration_rms: float
    acceleration_20ms_peak: float
    """Averaged over 20 ms."""
    acceleration_20ms_rms: float
    jerk_rms: float


def stream_metrics(
    track: Track, stream: Stream, known: ReferenceTrack | None = None
) -> tuple[StreamMetrics, StreamMetrics]:
    """Return the figures of position and of orientation."""
    truth, counted = known or reference_track(stream, len(track.poses), track.tick_s)
    shifts = range(int(LONGEST_LAG_S / track.tick_s))
    linear = [_position_errors(track.poses, truth, counted, shift) for shift in shifts]
    angular = [_turn_errors(track.poses, truth, counted, shift) for shift in shifts]
    return (
        _figures(linear, track.twists_s[:, :3], track.tick_s),
        _figures(angular, track.twists_s[:, 3:], track.tick_s),
    )


def counted(stream: Stream, times: Array) -> Array:
    """Return whether errors at ``times`` (N,) count, (N,): not at the start, nor at a step of the target."""
    result = times >= SKIPPED_S
    settings = TargetSettings()
    period_s = float(np.median(np.diff(stream.times_s)))
    for before, after, a, b in zip(stream.times_s, stream.times_s[1:], stream.poses, stream.poses[1:], strict=False):
        dt = max(after - before, 0.5 * period_s, 0.01)
        way = float(np.linalg.norm(b[:3, 3] - a[:3, 3]))
        turn = float(np.linalg.norm(se3.log_rotation(a[:3, :3].T @ b[:3, :3])))
        if way > settings.max_speed[0] * dt or turn > settings.max_speed[1] * dt:
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


def _refined(rms: Sequence[float]) -> tuple[float, float]:
    """Place [steps] and value of the minimum of the parabola through three squared errors one control step apart."""
    before, least, after = (value * value for value in rms)
    slope, bend = 0.5 * (after - before), before - 2.0 * least + after
    if bend <= 0.0:
        return 0.0, rms[1]
    return -slope / bend, float(np.sqrt(max(0.0, least - 0.5 * slope * slope / bend)))


def _figures(errors: Sequence[Array], velocity: Array, tick_s: float) -> StreamMetrics:
    rms = [_rms(error) for error in errors]
    best = int(np.argmin(rms))
    offset, after_lag = _refined(rms[best - 1 : best + 2]) if 0 < best < len(rms) - 1 else (0.0, rms[best])
    smooth = smoothness(velocity, tick_s)
    return StreamMetrics(
        1e3 * rms[0],
        1e3 * float(errors[0].max()),
        1e3 * (best + offset) * tick_s,
        1e3 * after_lag,
        smooth.acceleration_peak,
        smooth.acceleration_rms,
        smooth.acceleration_20ms_peak,
        smooth.acceleration_20ms_rms,
        smooth.jerk_rms,
    )
