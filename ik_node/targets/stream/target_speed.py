"""Whether the target of a stream moves faster than the reference may follow.

The speed is that along the polygon of samples at least :data:`SHORTEST_STEP_S` apart, over blocks of :data:`BLOCK_S`
and at least :data:`STEPS` steps. The largest step of each block is left out, and most steps must be fast: jumps are
single steps, and do not count as speed. What was too fast is reported for :data:`RELEASE_S` longer.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import FASTER
from ik_node.math.quaternion import (
    IDENTITY,
    ZERO,
    Quaternion,
    Vector,
    conjugate,
    difference,
    length,
    multiply,
    to_rotation_vector,
)

BLOCK_S = 0.1
SHORTEST_STEP_S = 0.015
"""Samples in between are skipped: the noise of fast streams would count as speed."""
STEPS = 4
"""Least number of steps in a block."""
FAST_FRACTION = 0.6
"""Least fraction of fast steps: more than two of four."""
FAST_STEP = 0.5
"""Ratio to the bound above which a single step is fast; smaller than 1 since stamps are irregular."""
LONGEST_STEP_S = 1.0
"""After a longer gap a new block begins."""
RELEASE_S = 0.5
MARGIN = 1.02
"""Smallest ratio of a speed to its bound that is reported."""


class TargetSpeed(NamedTuple):
    """The present block, and the highest speeds that were too fast."""

    steps: int = 0
    """Steps of the block; 0 without a first sample."""
    first_ns: int = 0
    last_ns: int = 0
    last_position: Vector = ZERO
    last_orientation: Quaternion = IDENTITY
    moved: float = 0.0
    """Sum of the steps, m."""
    turned: float = 0.0
    """The same of the turns, rad."""
    largest_m: float = 0.0
    """Longest step of the block ..."""
    largest_m_s: float = 0.0
    """... and its duration, s."""
    largest_rad: float = 0.0
    largest_rad_s: float = 0.0
    fast_steps: tuple[int, int] = (0, 0)
    """Number of fast steps [linear, angular]."""
    begun: bool = False
    linear: float = 0.0
    """Highest linear speed above the bound since the report began, m/s; 0 for none."""
    angular: float = 0.0
    """The same for the angular speed, rad/s."""
    until_ns: int = 0
    """Monotonic time until which it is reported."""


def updated_speed(
    speed: TargetSpeed,
    time_ns: int,
    position: Vector,
    orientation: Quaternion,
    bounds: tuple[float, float],
) -> TargetSpeed:
    """The state after a sample.

    Args:
        speed: The state before.
        time_ns: Time of the sample; not before that of the last one.
        position: Its position, m.
        orientation: Its orientation.
        bounds: Bounds [linear, angular] of the reference, m/s and rad/s.
    """
    step_s = (time_ns - speed.last_ns) / NS
    if not speed.begun or step_s > LONGEST_STEP_S:
        return _block(speed, time_ns, position, orientation)
    if step_s < SHORTEST_STEP_S:
        return speed
    way = length(difference(position, speed.last_position))
    turn = _angle(speed.last_orientation, orientation)
    new = speed._replace(
        steps=speed.steps + 1,
        last_ns=time_ns,
        last_position=position,
        last_orientation=orientation,
        moved=speed.moved + way,
        turned=speed.turned + turn,
        fast_steps=(
            speed.fast_steps[0] + (way > FAST_STEP * bounds[0] * step_s),
            speed.fast_steps[1] + (turn > FAST_STEP * bounds[1] * step_s),
        ),
    )
    if way >= speed.largest_m:
        new = new._replace(largest_m=way, largest_m_s=step_s)
    if turn >= speed.largest_rad:
        new = new._replace(largest_rad=turn, largest_rad_s=step_s)
    block_s = (time_ns - speed.first_ns) / NS
    if new.steps < STEPS or block_s < BLOCK_S:
        return new
    linear = (new.moved - new.largest_m) / (block_s - new.largest_m_s)
    angular = (new.turned - new.largest_rad) / (block_s - new.largest_rad_s)
    counted = [
        value if fast >= FAST_FRACTION * new.steps else 0.0
        for value, fast in zip((linear, angular), new.fast_steps, strict=True)
    ]
    return _block(_reported(new, (counted[0], counted[1]), time_ns, bounds), time_ns, position, orientation)


def too_fast_text(speed: TargetSpeed, time_ns: int, bounds: tuple[float, float]) -> str:
    """Warning at a monotonic time, with the highest speed to two digits; empty for none.

    Args:
        speed: The state.
        time_ns: Present time.
        bounds: Bounds [linear, angular] of the reference, m/s and rad/s.
    """
    if time_ns >= speed.until_ns:
        return ""
    linear = f"moves at {speed.linear:.2g} m/s, {FASTER}speed ({bounds[0]:g} m/s)" if speed.linear else ""
    angular = f"turns at {speed.angular:.2g} rad/s, {FASTER}speed ({bounds[1]:g} rad/s)" if speed.angular else ""
    return f"the target {' and '.join(filter(None, (linear, angular)))}"


def _reported(
    speed: TargetSpeed, speeds: tuple[float, float], time_ns: int, bounds: tuple[float, float]
) -> TargetSpeed:
    ended = time_ns >= speed.until_ns
    before = (0.0, 0.0) if ended else (speed.linear, speed.angular)
    fast = [value if value > MARGIN * bound else 0.0 for value, bound in zip(speeds, bounds, strict=True)]
    if any(fast):
        highest = [max(value, earlier) for value, earlier in zip(fast, before, strict=True)]
        return speed._replace(linear=highest[0], angular=highest[1], until_ns=time_ns + round(RELEASE_S * NS))
    return speed._replace(linear=before[0], angular=before[1])


def _block(speed: TargetSpeed, time_ns: int, position: Vector, orientation: Quaternion) -> TargetSpeed:
    """A new block that begins with a sample."""
    return TargetSpeed(
        first_ns=time_ns,
        last_ns=time_ns,
        last_position=position,
        last_orientation=orientation,
        begun=True,
        linear=speed.linear,
        angular=speed.angular,
        until_ns=speed.until_ns,
    )


def _angle(first: Quaternion, second: Quaternion) -> float:
    return length(to_rotation_vector(multiply(second, conjugate(first))))
