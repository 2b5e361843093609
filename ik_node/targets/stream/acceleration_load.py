"""Whether the target of a stream accelerates faster than the reference may.

The acceleration of a target is not known from noisy samples. That of the reference is: at each sample it is at its
bound or not. Steps and noise reach the bound for a few samples; a target that accelerates too fast keeps it there.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import FASTER

MEMORY_S = 0.5
"""Time constant of the fraction of the samples at the bound."""
AT_BOUND = 0.95
"""Ratio of an acceleration to its bound that counts."""
REPORTED, RELEASED = 0.4, 0.1
"""Fraction of the samples above which it is reported, and below which no more. Recordings at 33 Hz have at most 0.2, in
the orientation of a hand-held camera; sines of 3 to 6 Hz and 1.5 times the bound have 0.55 and more at 50 Hz."""


class AccelerationLoad(NamedTuple):
    """How much of the time the reference is at its bounds of acceleration."""

    time_ns: int = 0
    """Of the newest sample."""
    fractions: tuple[float, float] = (0.0, 0.0)
    """Fading fraction of the samples [linear, angular]."""
    reported: tuple[bool, bool] = (False, False)


def updated_load(
    load: AccelerationLoad, time_ns: int, accelerations: tuple[float, float], bounds: tuple[float, float]
) -> AccelerationLoad:
    """The state after a sample.

    Args:
        load: The state before.
        time_ns: Monotonic time of arrival of the sample.
        accelerations: Accelerations [linear, angular] of the reference then, m/s2 and rad/s2; 0 at a jump.
        bounds: Their bounds.
    """
    part = min(1.0, max(0.0, (time_ns - load.time_ns) / NS / MEMORY_S))
    fractions, reported = [], []
    for half in (0, 1):
        at_bound = accelerations[half] >= AT_BOUND * bounds[half]
        fraction = load.fractions[half] + part * (at_bound - load.fractions[half])
        fractions.append(fraction)
        reported.append(fraction > (RELEASED if load.reported[half] else REPORTED))
    return AccelerationLoad(time_ns, (fractions[0], fractions[1]), (reported[0], reported[1]))


def accelerates_text(load: AccelerationLoad, time_ns: int, bounds: tuple[float, float]) -> str:
    """Warning at a monotonic time; empty for none.

    Args:
        load: The state.
        time_ns: Present time.
        bounds: Bounds [linear, angular] of the reference, m/s2 and rad/s2.
    """
    if time_ns - load.time_ns > MEMORY_S * NS:
        return ""
    linear = f"accelerates {FASTER}acceleration ({bounds[0]:g} m/s2)" if load.reported[0] else ""
    angular = f"accelerates in rotation {FASTER}acceleration ({bounds[1]:g} rad/s2)" if load.reported[1] else ""
    found = " and ".join(filter(None, (linear, angular)))
    return f"the target {found}" if found else ""
