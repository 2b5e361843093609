"""A report as one screen of text and as JSON."""

from __future__ import annotations

import json
import math
from typing import Any

from ik_node.report.metrics import Report, Scaling, Singularity
from ik_node.report.tracking import Tracking

WIDTH = 80
MOST_PERIODS = 5
MOST_BINDING = 2


def as_text(report: Report) -> str:
    """At most 24 lines of at most 80 characters, without a newline at the end."""
    ticks, speed = report.ticks, report.speed
    lines = [title(report)]
    if report.tracking is None:
        lines.append("tracking     nothing to compare with: no trajectory beside the run, no targets in it")
    else:
        lines += _tracking(report.tracking)
    missing = f"; {ticks.missing} not recorded" if ticks.missing else ""
    lines.append(f"ticks        {ticks.number} in {report.duration_s:.2f} s, {ticks.rate_hz:.1f} Hz{missing}")
    lines.append(
        f"period       median {ticks.period_median_ms:.3f} ms, std {ticks.period_std_ms:.3f}, "
        f"p99 {ticks.period_p99_ms:.3f}, max {ticks.period_max_ms:.3f}"
    )
    rate = "" if math.isnan(report.target_rate_hz) else f" at {report.target_rate_hz:.1f} Hz"
    lines.append(f"targets      {report.targets} poses{rate}")
    lines.append(
        f"top speed    {speed.joint or 'no joint'} at {100.0 * speed.part_of_limit:.1f} % of its limit "
        f"({speed.time_s:.2f} s)"
    )
    lines.append(f"commands     {speed.non_finite} not finite, {speed.over_limit} over a velocity limit")
    lines += _singularity(report.singularity)
    lines.append(_scaling(report.scaling))
    near = report.nearness
    if math.isfinite(near.least):
        lines.append(f"clearance    least {1e3 * near.least:.1f} mm ({near.time_s:.2f} s), {' - '.join(near.pair)}")
    lines += [
        f"{period.mode:<12} {period.duration_s:7.2f} s  {period.reason}" for period in report.periods[:MOST_PERIODS]
    ]
    left = report.periods[MOST_PERIODS:]
    if left:
        lines.append(f"other        {sum(period.duration_s for period in left):7.2f} s  {len(left)} more states")
    if report.dropped or not report.complete:
        state = "whole" if report.complete else "cut off"
        lines.append(f"recording    {state}, {report.dropped} messages left out")
    return "\n".join(line if len(line) <= WIDTH else line[: WIDTH - 3] + "..." for line in lines)


def title(report: Report) -> str:
    """Robot, trajectory and method on one line."""
    parts = [report.robot, report.trajectory, f"method {report.method}" if report.method else ""]
    return ", ".join(part for part in parts if part)


def as_json(report: Report) -> str:
    """Every figure by name, units in the names; null where there is none. The series stay out."""
    return json.dumps(as_plain(report), indent=2, allow_nan=False)


def as_plain(report: Report) -> dict[str, Any]:
    """What :func:`as_json` writes."""
    plain: dict[str, Any] = _plain(report._replace(series=None))
    return plain


def _tracking(tracking: Tracking) -> list[str]:
    settled, overall = tracking.settled, tracking.overall
    after = f"after {tracking.settle_s:g} s"
    return [
        f"measured tool against the {tracking.against} at the same time",
        f"error        {after:>20}{'from the start':>22}",
        f"{'':13}{'RMS':>10}{'max':>10}{'RMS':>12}{'max':>10}",
        f"position {settled.position_rms_mm:14.3f}{settled.position_max_mm:10.3f}"
        f"{overall.position_rms_mm:12.3f}{overall.position_max_mm:10.3f}  mm",
        f"orientation {settled.orientation_rms_mrad:11.3f}{settled.orientation_max_mrad:10.3f}"
        f"{overall.orientation_rms_mrad:12.3f}{overall.orientation_max_mrad:10.3f}  mrad",
        f"lag          position {_ms(tracking.lag_position_ms)}, rotation {_ms(tracking.lag_rotation_ms)}; without it "
        f"{tracking.position_rms_without_lag_mm:.3f} mm, {tracking.orientation_rms_without_lag_mrad:.3f} mrad",
    ]


def _ms(lag_ms: float) -> str:
    return "unknown" if math.isnan(lag_ms) else f"{lag_ms:.1f} ms"


def _singularity(singularity: Singularity) -> list[str]:
    lines = [f"singularity  least singular value {singularity.least:.4f} m ({singularity.time_s:.2f} s)"]
    if singularity.lossy_s == 0.0:
        return [lines[0] + "; nothing lost"]
    rms = f"RMS {1e3 * singularity.lost_linear_rms:.3f} mm/s, {1e3 * singularity.lost_angular_rms:.3f} mrad/s"
    most = f"max {1e3 * singularity.lost_linear_max:.1f}, {1e3 * singularity.lost_angular_max:.1f}"
    return [*lines, f"lost there   {rms}; {most}; {singularity.lossy_s:.2f} s"]


def _scaling(scaling: Scaling) -> str:
    if scaling.slowed_s == 0.0:
        return "limits       s = 1 throughout"
    named = ", ".join(f"{name} {duration:.2f} s" for name, duration in scaling.binding[:MOST_BINDING])
    return f"limits       s < 1 for {scaling.slowed_s:.2f} s, least {scaling.least:.3f}" + (
        f"; {named}" if named else ""
    )


def _plain(value: Any) -> Any:
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: _plain(entry) for name, entry in value._asdict().items() if name != "series"}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
