"""Results of a replay as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ik_node.recording.call_log import RecordedCalls
from ik_node.replay.bitwise import SINGULAR_TOLERANCE, TOLERANCE, Comparison, Mismatch
from ik_node.replay.what_if import OpenLoopMetrics, VariantMetrics

_MAX_LENGTH = 300


def as_plain(result: Comparison) -> dict[str, Any]:
    """A bitwise replay as JSON data."""
    return {
        "verdict": replay_verdict(result),
        "identical": result.identical,
        "passed": result.passed,
        "tolerance": TOLERANCE,
        "singular_tolerance": SINGULAR_TOLERANCE,
        "calls": result.calls,
        "steps": result.steps,
        "duration_s": result.duration_s,
        "snapshots": result.snapshots,
        "missing": {
            "calls": result.missing_calls,
            "skipped_calls": result.skipped_calls,
            "steps": result.missing_steps,
        },
        "environment_differences": list(result.environment_differences),
        "max_difference": {name: None if math.isinf(size) else size for name, size in result.max_difference.items()},
        "text_mismatches": result.text_mismatches,
        "first": _plain_mismatch(result.first),
        "first_beyond_tolerance": _plain_mismatch(result.first_beyond_tolerance),
    }


def _plain_mismatch(mismatch: Mismatch | None) -> dict[str, Any] | None:
    if mismatch is None:
        return None
    size = None if math.isinf(mismatch.size) else mismatch.size
    where = {"tick": mismatch.tick, "time_s": mismatch.time_s, "source": mismatch.source, "field": mismatch.field}
    return {**where, "size": size, "recorded": mismatch.recorded, "replayed": mismatch.replayed}


def as_text(recorded: RecordedCalls, result: Comparison, took_s: float) -> str:
    """A bitwise replay in a few lines."""
    head = recorded.head
    robot = head.setup["robot"] or "a robot given as URDF"
    lines = [
        replay_verdict(result),
        f"recording {recorded.path}: {head.node}, {robot}, method {head.settings.control.method}",
        f"replayed  {result.calls} calls, {result.steps} control steps, {result.duration_s:.1f} s in {took_s:.2f} s"
        f" ({result.duration_s / took_s:.1f} times real time)",
    ]
    if not recorded.recording.complete:
        lines.append("cut off   its writer did not close it; ik_repair completes it")
    if result.missing_calls or result.missing_steps:
        lines.append(
            f"missing   {result.missing_calls} calls and {result.missing_steps} Steps;"
            f" {result.skipped_calls} calls before the next recorded snapshot were skipped"
        )
    return "\n".join((*lines, *_conclusion(result)))


def replay_verdict(result: Comparison) -> str:
    """The result of a replay in one sentence."""
    if result.identical:
        return f"Replayed bit for bit: {result.steps} control steps."
    if result.passed:
        return f"Replayed within rounding on another platform: {result.steps} control steps."
    first = result.first_beyond_tolerance or result.first
    where = "" if first is None else f" from {first.time_s:.3f} s: {first.field} by {first.size:.3g}"
    return f"Not the recorded run{where}."


def _conclusion(result: Comparison) -> list[str]:
    if result.first is None:
        snapshots = f", and {result.snapshots} recorded snapshots" if result.snapshots else ""
        other = (f"note      {line}" for line in result.method_differences)
        return [f"identical every Step is bit for bit the recorded one{snapshots}", *other]
    environment = [f"          {line}" for line in result.environment_differences]
    if environment:
        environment = ["recorded  in another environment:", *environment]
    largest = [f"          {name} differs by up to {size:.3g}" for name, size in result.max_difference.items()]
    if result.text_mismatches:
        largest.append(f"          {result.text_mismatches} Steps with another status, other limits or another pair")
    if result.passed:
        bound = f"{TOLERANCE:g}, near singularities {SINGULAR_TOLERANCE:g}"
        return [*environment, f"equal     within rounding: no number differs by more than {bound}", *largest]
    mismatch = result.first_beyond_tolerance if environment else None
    return [*environment, *_mismatch_lines(mismatch or result.first), "largest   differences, in SI units:", *largest]


def _mismatch_lines(first: Mismatch) -> list[str]:
    where = f"at control step {first.tick}, {first.time_s:.6f} s, {first.source}"
    return [
        f"differs   {where}: {first.field} by {first.size:.3g}",
        f"          recorded {first.recorded[:_MAX_LENGTH]}",
        f"          replayed {first.replayed[:_MAX_LENGTH]}",
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
    ("control steps with s < 1 [%]", "scaled_percent", ".2f"),
    ("peak joint speed [% of limit]", "peak_speed_percent", ".1f"),
    ("peak joint speed [rad/s, m/s]", "peak_speed", ".3f"),
    ("control steps with an error", "faults", "d"),
    ("targets refused", "refused", "d"),
)
_LABEL = max(len(label) for label, _, _ in _ROWS)


def closed_loop_table(runs: Sequence[VariantMetrics], against: str) -> str:
    """Simulated runs side by side; ``against``: the reference of the tracking errors."""
    width = max(16, *(len(run.name) for run in runs))
    lines = [
        "what if   closed loop in the simulator, from the first recorded state, recorded targets and obstacles",
        f"          errors against {against}",
        "",
        " " * _LABEL + "".join(f"  {run.name:>{width}}" for run in runs),
        f"{'method':<{_LABEL}}" + "".join(f"  {run.method:>{width}}" for run in runs),
    ]
    for label, name, form in _ROWS:
        lines.append(f"{label:<{_LABEL}}" + "".join(f"  {getattr(run, name):>{width}{form}}" for run in runs))
    return "\n".join(lines)


def open_loop_table(runs: Sequence[OpenLoopMetrics]) -> str:
    """Differences from the recorded commands."""
    lines = ["open loop: commands on the recorded joint states minus the recorded commands"]
    for run in runs:
        size = f"{run.difference_rms:.3g} rms, {run.difference_max:.3g} at most [rad/s, m/s]"
        lines.append(f"  {run.name}: {size}, {run.steps} control steps")
    return "\n".join(lines)


def used_topics(used: Mapping[str, tuple[str, int]]) -> str:
    """Which topics of an external bag are used for which inputs."""
    return "\n".join(f"used      {count} messages of {topic} as {name}" for topic, (name, count) in used.items())
