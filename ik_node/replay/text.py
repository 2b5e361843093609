"""What came of a replay, for people and for machines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ik_node.recording.call_log import RecordedCalls
from ik_node.replay.bitwise import SINGULAR_TOLERANCE, TOLERANCE, Comparison, Parting
from ik_node.replay.what_if import Figures, OpenLoop

_LONGEST = 300


def as_plain(found: Comparison) -> dict[str, Any]:
    """Figures as JSON has them."""
    return {
        "identical": found.identical,
        "holds": found.holds,
        "tolerance": TOLERANCE,
        "singular_tolerance": SINGULAR_TOLERANCE,
        "calls": found.calls,
        "ticks": found.ticks,
        "duration_s": found.duration_s,
        "checkpoints": found.checkpoints,
        "lost": {"calls": found.lost_calls, "skipped_calls": found.skipped_calls, "steps": found.lost_steps},
        "elsewhere": list(found.elsewhere),
        "largest": {name: None if math.isinf(size) else size for name, size in found.largest.items()},
        "sayings": found.sayings,
        "first": _plain_parting(found.first),
        "beyond": _plain_parting(found.beyond),
    }


def _plain_parting(parting: Parting | None) -> dict[str, Any] | None:
    if parting is None:
        return None
    size = None if math.isinf(parting.size) else parting.size
    where = {"tick": parting.tick, "time_s": parting.time_s, "source": parting.source, "field": parting.field}
    return {**where, "size": size, "recorded": parting.recorded, "replayed": parting.replayed}


def as_text(recorded: RecordedCalls, found: Comparison, took_s: float) -> str:
    """A few lines."""
    head = recorded.head
    robot = head.setup["robot"] or "a robot given as URDF"
    lines = [
        f"recording {recorded.path}: {head.node}, {robot}, method {head.settings.control.method}",
        f"replayed  {found.calls} calls, {found.ticks} ticks, {found.duration_s:.1f} s in {took_s:.2f} s"
        f" ({found.duration_s / took_s:.1f} times real time)",
    ]
    if not recorded.recording.complete:
        lines.append("cut off   its writer did not end it; ik_repair makes it whole")
    if found.lost_calls or found.lost_steps:
        lines.append(
            f"lost      {found.lost_calls} calls and {found.lost_steps} steps are not in the recording;"
            f" {found.skipped_calls} calls until the next recorded state were not tried"
        )
    return "\n".join((*lines, *_verdict(found)))


def _verdict(found: Comparison) -> list[str]:
    if found.first is None:
        states = f", and so are {found.checkpoints} recorded states" if found.checkpoints else ""
        return [f"same      every step is bit for bit the recorded one{states}"]
    there = [f"          {line}" for line in found.elsewhere]
    if there:
        there = ["made      elsewhere, or by other code:", *there]
    largest = [f"          {name} parts by up to {size:.3g}" for name, size in found.largest.items()]
    if found.sayings:
        largest.append(f"          {found.sayings} steps say something else of status, limits or the closest pair")
    if found.holds:
        bound = f"{TOLERANCE:g}, near singularities {SINGULAR_TOLERANCE:g}"
        return [*there, f"same      but for rounding: no number parts by more than {bound}", *largest]
    parting = found.beyond if there and found.beyond is not None else found.first
    return [*there, *_parting(parting), "apart     at most, in SI units:", *largest]


def _parting(first: Parting) -> list[str]:
    return [
        f"parts     at tick {first.tick}, {first.time_s:.6f} s, {first.source}: {first.field} by {first.size:.3g}",
        f"          recorded {first.recorded[:_LONGEST]}",
        f"          replayed {first.replayed[:_LONGEST]}",
    ]


_ROWS = (
    ("position error rms [mm]", "position_rms_mm", ".3f"),
    ("position error max [mm]", "position_max_mm", ".3f"),
    ("orientation error rms [mrad]", "orientation_rms_mrad", ".3f"),
    ("orientation error max [mrad]", "orientation_max_mrad", ".3f"),
    ("kinetic energy mean [J]", "energy_mean_j", ".4g"),
    ("kinetic energy max [J]", "energy_max_j", ".4g"),
    ("clearance min [mm]", "clearance_min_mm", ".1f"),
    ("s min", "scale_min", ".3f"),
    ("ticks with s < 1 [%]", "scaled_percent", ".2f"),
    ("peak joint speed [% of limit]", "peak_speed_percent", ".1f"),
    ("peak joint speed [rad/s, m/s]", "peak_speed", ".3f"),
    ("ticks with an error", "faults", "d"),
    ("targets refused", "refused", "d"),
)
_LABEL = max(len(label) for label, _, _ in _ROWS)


def closed_loop_table(found: Sequence[Figures], against: str) -> str:
    """Runs beside each other; ``against``: what errors are measured by."""
    width = max(16, *(len(run.name) for run in found))
    lines = [
        "what if   closed loop in the simulator, from the first recorded state, recorded targets and obstacles",
        f"          errors against {against}",
        "",
        " " * _LABEL + "".join(f"  {run.name:>{width}}" for run in found),
        f"{'method':<{_LABEL}}" + "".join(f"  {run.method:>{width}}" for run in found),
    ]
    for label, name, form in _ROWS:
        lines.append(f"{label:<{_LABEL}}" + "".join(f"  {getattr(run, name):>{width}{form}}" for run in found))
    return "\n".join(lines)


def open_loop_table(found: Sequence[OpenLoop]) -> str:
    """Differences from the recorded commands."""
    lines = ["open loop: commands on the recorded joint states less the recorded commands; nothing moves"]
    for run in found:
        size = f"{run.difference_rms:.3g} rms, {run.difference_max:.3g} at most [rad/s, m/s]"
        lines.append(f"  {run.name}: {size}, {run.ticks} ticks")
    return "\n".join(lines)


def used_topics(used: Mapping[str, tuple[str, int]]) -> str:
    """What of a foreign bag is taken for what."""
    return "\n".join(f"taken     {count} messages of {topic} for {name}" for topic, (name, count) in used.items())
