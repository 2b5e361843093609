"""Computed motions whose samples are stamped or delivered irregularly: no lag, and an error far below the jitter.

Jitter of a stamp of 0.1 ms looks to a polynomial of high degree like the noise of a sensor. A measured motion is
followed with a delay of 25 ms and more; a computed one must not be taken for one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from ik_node.interfaces.clock import NS, Stamped
from ik_node.math.se3 import exp_rotation
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.stream.stream import StreamedPoses

TICK_S = 0.002
DURATION_S = 6.0
SKIPPED_S = 2.0
TRANSPORT_S = 3e-4
SPEED = 0.15
"""Of the circle, m/s: an error of 0.15 mm is 1 ms."""


def circle(time_s: float) -> Array:
    """A circle of 0.1 m at 1.5 rad/s with a tool that turns to and fro; the speed increases in the first second."""
    phase = 1.5 * (time_s - 0.5 if time_s > 1.0 else 0.5 * time_s * time_s)
    pose = np.eye(4)
    pose[:3, :3] = exp_rotation(np.array((0.0, 0.0, 0.3 * np.sin(phase))))
    pose[:3, 3] = (0.4 + 0.1 * np.cos(phase), 0.1 * np.sin(phase), 0.4)
    return pose


class Sample(NamedTuple):
    """A pose on its way to the node."""

    arrival_s: float
    stamp_s: float
    pose: Array


class Figures(NamedTuple):
    """Error of the position, and its part along the velocity divided by the speed."""

    rms_mm: float
    lag_ms: float


def followed(samples: list[Sample], stamped: bool = True) -> Figures:
    """Follow the circle."""
    stream, start_ns = StreamedPoses(TargetSettings()), 10 * NS
    stream.start(circle(0.0), start_ns)
    waiting = sorted(samples, key=lambda sample: sample.arrival_s)
    errors, velocities = [], []
    for tick in range(1, round(DURATION_S / TICK_S)):
        time_s = tick * TICK_S
        while waiting and waiting[0].arrival_s <= time_s:
            sample = waiting.pop(0)
            arrival_ns = start_ns + round(sample.arrival_s * NS)
            stamp_ns = start_ns + round(sample.stamp_s * NS) if stamped else arrival_ns
            stream.add(sample.pose, Stamped(stamp_ns, arrival_ns, 0))
        position = stream.advance(start_ns + round(time_s * NS), TICK_S).pose_sd[:3, 3]
        if time_s > SKIPPED_S:
            errors.append(position - circle(time_s)[:3, 3])
            velocities.append((circle(time_s + 1e-4)[:3, 3] - circle(time_s)[:3, 3]) / 1e-4)
    error, velocity = np.array(errors), np.array(velocities)
    return Figures(
        1e3 * float(np.sqrt((error**2).sum(axis=1).mean())),
        -1e3 * float((error * velocity).sum() / (velocity * velocity).sum()),
    )


def times(rate_hz: float) -> Array:
    return np.arange(0.0, DURATION_S, 1.0 / rate_hz)


def check(figures: Figures, limit_mm: float) -> None:
    assert abs(figures.lag_ms) < 2.0
    assert figures.rms_mm < limit_mm


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0])
@pytest.mark.parametrize("jitter_ms", [0.0, 0.02, 0.1, 0.3, 1.0])
def test_jitter_of_the_stamps_causes_no_lag(rate_hz: float, jitter_ms: float) -> None:
    """The pose belongs to the regular time, the stamp is late; also without a stamp."""
    rng = np.random.default_rng(0)
    late_s = 1e-3 * jitter_ms * np.abs(rng.normal(size=len(times(rate_hz))))
    samples = [
        Sample(time + late + TRANSPORT_S, time + late, circle(time))
        for time, late in zip(times(rate_hz).tolist(), late_s.tolist(), strict=True)
    ]
    check(followed(samples), 0.15)
    check(followed(samples, stamped=False), 0.15)


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0])
@pytest.mark.parametrize("jitter_ms", [0.1, 1.0, 3.0])
def test_irregular_samples_with_correct_stamps_cause_no_error(rate_hz: float, jitter_ms: float) -> None:
    """A sender whose timer is late computes the pose for the time of its stamp."""
    rng = np.random.default_rng(0)
    instants = times(rate_hz) + 1e-3 * jitter_ms * np.abs(rng.normal(size=len(times(rate_hz))))
    check(followed([Sample(time + TRANSPORT_S, time, circle(time)) for time in instants.tolist()]), 0.15)


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0])
def test_single_late_samples_cause_no_lag(rate_hz: float) -> None:
    """Every second one sample is stamped and delivered 3 ms late."""
    samples = []
    for index, time in enumerate(times(rate_hz).tolist()):
        late = 3e-3 if index % round(rate_hz) == round(0.7 * rate_hz) else 0.0
        samples.append(Sample(time + late + TRANSPORT_S, time + late, circle(time)))
    check(followed(samples), 0.2)
    check(followed(samples, stamped=False), 0.3)


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0])
def test_lost_samples_cause_no_lag(rate_hz: float) -> None:
    """2 % are lost, with and without stamps."""
    rng = np.random.default_rng(0)
    kept = times(rate_hz)[rng.uniform(size=len(times(rate_hz))) > 0.02].tolist()
    samples = [Sample(time + TRANSPORT_S, time, circle(time)) for time in kept]
    check(followed(samples), 0.2)
    check(followed(samples, stamped=False), 0.2)
