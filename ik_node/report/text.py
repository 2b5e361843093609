"""The metrics of one run as one screen of text and as JSON."""

from __future__ import annotations

import json
import math
import textwrap
from typing import Any

from ik_node.report.lateness import LateStepMetrics
from ik_node.report.metrics import ComputingMetrics, DirectionMetrics, RunMetrics, ScalingMetrics, SingularityMetrics
from ik_node.report.quantities import REFERENCE_TO_TRAJECTORY, TOOL_TO_REFERENCE, TOOL_TO_TRAJECTORY
from ik_node.report.tracking import TrackingErrors, TrackingMetrics
from ik_node.report.verdict import verdict

WIDTH = 80
INDENT = 13
"""Of values, and of the second and further lines of an entry."""
MAX_PERIODS = 4
MAX_BINDING = 2


def as_text(metrics: RunMetrics) -> str:
    """The verdict, what was done, and the metrics, in lines of at most 80 characters, without a trailing newline."""
    head = [*textwrap.wrap(verdict(metrics).text, WIDTH), *textwrap.wrap(what_was_done(metrics), WIDTH), ""]
    return "\n".join([*head, *metric_lines(metrics)])


def metric_lines(metrics: RunMetrics) -> list[str]:
    """The metrics without verdict and title, in lines of at most 80 characters."""
    ticks, speed = metrics.ticks, metrics.speed
    lines = []
    if metrics.tracking is None:
        lines.append("tracking     not evaluated: no ground truth file and no recorded targets")
    else:
        lines += _tracking(metrics.tracking)
    missing = f"; {ticks.missing} not recorded" if ticks.missing else ""
    lines.append(f"steps        {ticks.number} in {metrics.duration_s:.2f} s, {ticks.rate_hz:.1f} Hz{missing}")
    lines.append(
        f"period       median {ticks.period_median_ms:.3f} ms, std {ticks.period_std_ms:.3f}, "
        f"p99 {ticks.period_p99_ms:.3f}, max {ticks.period_max_ms:.3f}"
    )
    lines.append(_computing(metrics.computing))
    lines += _late(metrics.late_steps)
    rate = "" if math.isnan(metrics.target_rate_hz) else f" at {metrics.target_rate_hz:.1f} Hz"
    late = metrics.late_targets
    lines.append(f"targets      {metrics.targets} poses{rate}; {late.late} late, {late.lost} lost")
    if math.isfinite(late.age.max_ms):
        lines.append(
            f"target age   median {late.age.median_ms:.1f} ms, p95 {late.age.p95_ms:.1f}, max {late.age.max_ms:.1f}"
        )
    if too_fast := metrics.target_too_fast.text:
        lines.append(
            f"too fast     {metrics.target_too_fast.duration_s:7.2f} s  {too_fast.removeprefix('the target ')}"
        )
    lines.append(
        f"top speed    {speed.joint or 'no joint'} at {100.0 * speed.part_of_limit:.1f} % of its limit "
        f"({speed.time_s:.2f} s)"
    )
    lines.append(f"commands     {speed.non_finite} not finite, {speed.over_limit} over a velocity limit")
    lines += _singularity(metrics.singularity)
    if metrics.direction.off_s > 0.0:
        lines.append(_direction(metrics.direction))
    lines.append(_scaling(metrics.scaling))
    lines += _clearances(metrics)
    energy = metrics.energy
    if math.isfinite(energy.kinetic_max_j):
        lines.append(f"energy       kinetic mean {energy.kinetic_mean_j:.3g} J, max {energy.kinetic_max_j:.3g} J")
    if energy.potential:
        lines.append(
            f"h(q)         {energy.potential}: {energy.potential_first_j:.3g} J at the start, "
            f"{energy.potential_last_j:.3g} J at the end, max {energy.potential_max_j:.3g} J"
        )
    lines += [
        f"{period.mode:<12} {period.duration_s:7.2f} s  {period.reason}" for period in metrics.periods[:MAX_PERIODS]
    ]
    remaining = metrics.periods[MAX_PERIODS:]
    if remaining:
        lines.append(
            f"other        {sum(period.duration_s for period in remaining):7.2f} s  {len(remaining)} more states"
        )
    if metrics.dropped or not metrics.complete:
        state = "complete" if metrics.complete else "truncated"
        lines.append(f"recording    {state}, {metrics.dropped} messages dropped")
    indent = " " * INDENT
    return [part for line in lines for part in textwrap.wrap(line, WIDTH, subsequent_indent=indent) or [""]]


def title(metrics: RunMetrics) -> str:
    """Robot, trajectory and method in one line."""
    texts = [metrics.robot, metrics.trajectory, f"method {metrics.method}" if metrics.method else ""]
    return ", ".join(text for text in texts if text)


def what_was_done(metrics: RunMetrics) -> str:
    """Robot, trajectory, method, date, and whether the arm was simulated, where that was recorded."""
    arm = "simulated arm" if metrics.simulated else ""
    task = metrics.tracking.task if metrics.tracking is not None else ""
    return ", ".join(text for text in (title(metrics), task, metrics.recorded_utc, arm) if text)


def as_json(metrics: RunMetrics) -> str:
    """Verdict and all metrics by name, with units in the names; null for what is not available, no series."""
    return json.dumps(report_plain(metrics), indent=2, allow_nan=False)


def report_plain(metrics: RunMetrics) -> dict[str, Any]:
    """The content of :func:`as_json` as dictionaries, lists and plain values."""
    found = verdict(metrics)
    return {"verdict": found.text, "cause": found.cause.value, **as_plain(metrics)}


def as_plain(metrics: RunMetrics | tuple[Any, ...]) -> dict[str, Any]:
    """Metrics, or a part of them, as dictionaries, lists and plain values."""
    plain: dict[str, Any] = _plain(metrics)
    return plain


def _tracking(tracking: TrackingMetrics) -> list[str]:
    after = f"error after {tracking.settle_s:g} s"
    rows = (
        (TOOL_TO_TRAJECTORY, tracking.settled),
        (REFERENCE_TO_TRAJECTORY, tracking.reference_to_trajectory),
        (TOOL_TO_REFERENCE, tracking.tool_to_reference),
        (f"{TOOL_TO_TRAJECTORY}, from the start", tracking.overall),
    )
    return [
        f"{after:<34}{'position [mm]':>20}{'orientation [mrad]':>24}",
        f"{f'against the {tracking.against}':<34}{'RMS':>10}{'max':>10}{'RMS':>14}{'max':>10}",
        *(_errors(label, errors) for label, errors in rows),
        f"lag          position {_ms(tracking.lag_position_ms)}, rotation {_ms(tracking.lag_rotation_ms)}; residual "
        f"{tracking.position_rms_without_lag_mm:.3f} mm, {tracking.orientation_rms_without_lag_mrad:.3f} mrad",
    ]


def _errors(label: str, errors: TrackingErrors) -> str:
    return (
        f"{label:<34}{errors.position_rms_mm:10.3f}{errors.position_max_mm:10.3f}"
        f"{errors.orientation_rms_mrad:14.3f}{errors.orientation_max_mrad:10.3f}"
    )


def _computing(computing: ComputingMetrics) -> str:
    if math.isnan(computing.max_ms):
        return "computing    not recorded"
    return f"computing    median {computing.median_ms:.3f} ms, p99 {computing.p99_ms:.3f}, max {computing.max_ms:.3f}"


def _late(steps: LateStepMetrics) -> list[str]:
    parts = [(steps.by_machine, "by this machine"), (steps.late - steps.by_machine, "by late joint states")]
    causes = ", ".join(f"{number} {cause}" for number, cause in parts if number)
    lines = [f"late steps   {steps.late}" + (f": {causes}" if causes else "")]
    if steps.hold_ups or steps.held_too_long:
        lines.append(
            f"hold-ups     {steps.hold_ups}, {steps.hold_ups_s:.2f} s, max {steps.hold_up_max_ms:.1f} ms; "
            f"{steps.held_too_long} commands held too long"
        )
    return lines


def _ms(lag_ms: float) -> str:
    return "unknown" if math.isnan(lag_ms) else f"{lag_ms:.1f} ms"


def _singularity(singularity: SingularityMetrics) -> list[str]:
    lines = [f"singularity  smallest singular value {singularity.least:.4f} m ({singularity.time_s:.2f} s)"]
    if singularity.truncated_s == 0.0:
        return [lines[0] + "; no truncation"]
    rms = f"RMS {1e3 * singularity.truncated_linear_rms:.3f} mm/s, {1e3 * singularity.truncated_angular_rms:.3f} mrad/s"
    maxima = f"max {1e3 * singularity.truncated_linear_max:.1f}, {1e3 * singularity.truncated_angular_max:.1f}"
    return [*lines, f"truncated    {rms}; {maxima}; {singularity.truncated_s:.2f} s"]


def _clearances(metrics: RunMetrics) -> list[str]:
    """Distances to obstacles and between links; the recorded one, of either kind, where they are not known."""
    split = (("to obstacles", metrics.obstacle_clearance), ("between links", metrics.self_clearance))
    known = [(kind, entry) for kind, entry in split if math.isfinite(entry.least)]
    if not known and math.isfinite(metrics.nearness.least):
        known = [("", metrics.nearness)]
    return [
        f"clearance    {f'{kind} ' if kind else ''}min {1e3 * entry.least:.1f} mm ({entry.time_s:.2f} s), "
        f"{' - '.join(entry.pair)}"
        for kind, entry in known
    ]


def _direction(direction: DirectionMetrics) -> str:
    maxima = f"max {1e3 * direction.off_linear_max:.1f} mm/s, {1e3 * direction.off_angular_max:.1f} mrad/s"
    named = "".join(f"; {name}" for name, _ in direction.limits[:1])
    return f"direction    off {direction.off_s:.2f} s, {maxima}{named}"


def _scaling(scaling: ScalingMetrics) -> str:
    if scaling.slowed_s == 0.0:
        return "limits       s = 1 at all times"
    named = ", ".join(f"{name} {duration:.2f} s" for name, duration in scaling.binding[:MAX_BINDING])
    return f"limits       s < 1 for {scaling.slowed_s:.2f} s, min {scaling.least:.3f}" + (f"; {named}" if named else "")


def _plain(value: Any) -> Any:
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: _plain(entry) for name, entry in value._asdict().items() if not name.endswith("series")}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
