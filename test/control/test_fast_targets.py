"""A stream that moves or accelerates faster than ``target.max_*`` is in the status while it does; jumps are not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Level
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.settings.groups import Settings

RADIUS_M = 0.15
LIMIT = (1.0, 2.5)
assert Settings().target.max_speed == LIMIT


def circle(speed_m_s: float) -> Callable[[float], Array]:
    """Displacement on a circle at a constant speed, with a start within half a second."""

    def twist(time_s: float) -> Array:
        way = speed_m_s * (time_s if time_s > 0.5 else time_s**2)
        way -= 0.25 * speed_m_s if time_s > 0.5 else 0.0
        angle = way / RADIUS_M
        return np.array([0.0, RADIUS_M * math.sin(angle), RADIUS_M * (1.0 - math.cos(angle)), 0.0, 0.0, 0.0])

    return twist


def turning(rate: float) -> Callable[[float], Array]:
    """To and fro about the tool's z at a constant speed, one second each."""
    return lambda time_s: np.array([0.0, 0.0, 0.0, 0.0, 0.0, rate * (0.5 - abs(time_s % 2.0 - 1.0))])


def shaking(acceleration: float, axis: int) -> Callable[[float], Array]:
    """To and fro at 4 Hz, with an acceleration of this size."""
    rate = 2.0 * math.pi * 4.0

    def twist(time_s: float) -> Array:
        displacement = np.zeros(6)
        displacement[axis] = acceleration / rate**2 * (1.0 - math.cos(rate * time_s))
        return displacement

    return twist


def jumps(distance_m: float, every: int) -> Callable[[float], Array]:
    """A jump and back in the next sample, at every n-th sample of 50 Hz."""
    return lambda time_s: np.array([0.0, distance_m * (round(50.0 * time_s) % every == 1), 0.0, 0.0, 0.0, 0.0])


def run(
    loop: Loop, motion: Callable[[float], Array], rate_hz: float, duration_s: float, noise_m: float = 0.0
) -> set[str]:
    """Stream the motion, and return the texts of the status about the speed."""
    start, begin, sent = loop.pose(), loop.time_ns, 0
    found: set[str] = set()
    random = np.random.default_rng(0)

    def send() -> None:
        nonlocal sent
        while sent / rate_hz <= (loop.time_ns - begin) / NS:
            pose, twist = start.copy(), motion(sent / rate_hz)
            pose[:3, 3] += twist[:3] + noise_m * random.normal(size=3)
            pose[:3, :3] = pose[:3, :3] @ se3.exp_rotation(twist[3:])
            loop.target(pose)
            sent += 1
        found.update(part for part in loop.controller.status.reason.split("; ") if "faster than" in part)

    loop.run(duration_s, send)
    return found


@pytest.fixture
def loop() -> Loop:
    loop = Loop(make_robot("panda"), READY["panda"], Settings().with_values({"rate_hz": 250.0}))
    loop.run(0.1)
    return loop


@pytest.mark.parametrize("rate_hz", [15.0, 50.0, 250.0])
def test_a_fast_stream_is_named_with_the_parameter(loop: Loop, rate_hz: float) -> None:
    said = run(loop, circle(1.3), rate_hz, 2.0)
    assert "the target moves at 1.3 m/s, faster than target.max_speed (1 m/s)" in said
    assert all("rad/s" not in text for text in said)
    assert loop.controller.status.level is Level.WARN
    assert len(said) <= 3, "the text changes with the highest speed only"
    loop.run(1.5)
    assert "faster than" not in loop.controller.status.reason


def test_a_fast_turn_is_named(loop: Loop) -> None:
    said = run(loop, turning(3.2), 50.0, 0.9)
    assert said == {"the target turns at 3.2 rad/s, faster than target.max_speed (2.5 rad/s)"}


@pytest.mark.parametrize(
    ("axis", "text"),
    [
        (1, "the target accelerates faster than target.max_acceleration (10 m/s2)"),
        (5, "the target accelerates in rotation faster than target.max_acceleration (25 rad/s2)"),
    ],
)
def test_a_stream_that_accelerates_too_fast_is_named(loop: Loop, axis: int, text: str) -> None:
    bound = Settings().target.max_acceleration[axis > 2]
    assert not run(loop, shaking(0.5 * bound, axis), 50.0, 1.0)
    assert run(loop, shaking(1.5 * bound, axis), 50.0, 1.5) == {text}
    loop.run(1.5)
    assert "faster than" not in loop.controller.status.reason


def test_the_present_parameter_decides(loop: Loop) -> None:
    assert not run(loop, circle(0.3), 50.0, 1.0)
    loop.controller.apply(loop.settings.with_values({"target.max_speed": [0.2, 2.5]}))
    said = run(loop, circle(0.3), 50.0, 1.0)
    assert any(text.endswith("faster than target.max_speed (0.2 m/s)") for text in said)


@pytest.mark.parametrize(
    ("motion", "rate_hz", "noise_m"),
    [(circle(0.95), 50.0, 0.0), (circle(0.95), 15.0, 0.0), (circle(0.8), 250.0, 3e-4), (turning(2.2), 50.0, 0.0)],
)
def test_a_stream_within_the_bounds_is_not(
    loop: Loop, motion: Callable[[float], Array], rate_hz: float, noise_m: float
) -> None:
    assert not run(loop, motion, rate_hz, 2.0, noise_m)


@pytest.mark.parametrize("every", [10**6, 25])
def test_jumps_are_not(loop: Loop, every: int) -> None:
    """A jump of 0.3 m, once and back, and again every half second."""
    assert not run(loop, jumps(0.3, every), 50.0, 2.0)


def test_a_step_that_stays_is_not(loop: Loop) -> None:
    assert not run(loop, lambda time_s: np.array([0.0, 0.3 * (time_s > 0.5), 0.0, 0.0, 0.0, 0.0]), 50.0, 1.5)
