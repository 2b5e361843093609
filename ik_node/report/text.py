"""The metrics of one run as one screen of text and as JSON."""

from __future__ import annotations

import json
import math
from typing import Any

from ik_node.report.lateness import LateStepMetrics
from ik_node.report.metrics import DirectionMetrics, RunMetrics, ScalingMetrics, SingularityMetrics
from ik_node.report.tracking import TrackingMetrics

WIDTH = 80
MAX_PERIODS = 5
MAX_BINDING = 2


def as_text(metrics: RunMetrics) -> str:
    """At most 25 lines of at most 80 characters, without a trailing newline."""
    ticks, speed = metrics.ticks, metrics.speed
    lines = [title(metrics)]
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
    clearance = metrics.nearness
    if math.isfinite(clearance.least):
        lines.append(
            f"clearance    min {1e3 * clearance.least:.1f} mm ({clearance.time_s:.2f} s), {' - '.join(clearance.pair)}"
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
    return "\n".join(line if len(line) <= WIDTH else line[: WIDTH - 3] + "..." for line in lines)


def title(metrics: RunMetrics) -> str:
    """Robot, trajectory and method in one line."""
    texts = [metrics.robot, metrics.trajectory, f"method {metrics.method}" if metrics.method else ""]
    return ", ".join(text for text in texts if text)


def as_json(metrics: RunMetrics) -> str:
    """All metrics by name, with units in the names; null for what is not available. The series are omitted."""
    return json.dumps(as_plain(metrics), indent=2, allow_nan=False)


def as_plain(metrics: RunMetrics | tuple[Any, ...]) -> dict[str, Any]:
    """The content of :func:`as_json`, or of a part of the metrics, as dictionaries, lists and plain values."""
    plain: dict[str, Any] = _plain(metrics)
    return plain


def _tracking(tracking: TrackingMetrics) -> list[str]:
    settled, overall = tracking.settled, tracking.overall
    after = f"after {tracking.settle_s:g} s"
    return [
        f"measured tool pose against the {tracking.against} at the same time",
        f"error        {after:>20}{'from the start':>22}",
        f"{'':13}{'RMS':>10}{'max':>10}{'RMS':>12}{'max':>10}",
        f"position {settled.position_rms_mm:14.3f}{settled.position_max_mm:10.3f}"
        f"{overall.position_rms_mm:12.3f}{overall.position_max_mm:10.3f}  mm",
        f"orientation {settled.orientation_rms_mrad:11.3f}{settled.orientation_max_mrad:10.3f}"
        f"{overall.orientation_rms_mrad:12.3f}{overall.orientation_max_mrad:10.3f}  mrad",
        f"lag          position {_ms(tracking.lag_position_ms)}, rotation {_ms(tracking.lag_rotation_ms)}; residual "
        f"{tracking.position_rms_without_lag_mm:.3f} mm, {tracking.orientation_rms_without_lag_mrad:.3f} mrad",
    ]


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
        return {name: _plain(entry) for name, entry in value._asdict().items() if name != "series"}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
