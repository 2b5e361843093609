"""The figures of several recordings side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from ik_node.report.metrics import Report
from ik_node.report.reported_run import Subject, methods_of

NONE = "-"
MOST_WIDTH = 22
"""Of a column of text, letters."""


class Row(NamedTuple):
    """One figure of every recording."""

    label: str
    """With its unit."""
    values: tuple[str, ...]
    """In the order of the recordings; NONE where there is none."""


def rows(subjects: Sequence[Subject]) -> tuple[Row, ...]:
    """Every figure that one of the recordings has at least."""
    columns = [_column(subject) for subject in subjects]
    table = (Row(label, tuple(column[label] for column in columns)) for label in columns[0])
    return tuple(row for row in table if any(value != NONE for value in row.values))


def as_table(subjects: Sequence[Subject], widest: int = MOST_WIDTH) -> str:
    """Lines of text, a column of at most ``widest`` letters per recording under its name."""
    names = tuple(_short(subject.name, widest) for subject in subjects)
    lines = [Row("", names), *rows(subjects)]
    first = max(len(line.label) for line in lines)
    widths = [min(max(len(line.values[index]) for line in lines), widest) for index in range(len(names))]
    return "\n".join(
        "  ".join(
            [
                line.label.ljust(first),
                *(_short(value, widest).rjust(width) for value, width in zip(line.values, widths, strict=True)),
            ]
        ).rstrip()
        for line in lines
    )


def _short(text: str, widest: int) -> str:
    """The end of a text tells more than its beginning."""
    return text if len(text) <= widest else "..." + text[len(text) - widest + 3 :]


def _column(subject: Subject) -> dict[str, str]:
    """Label -> value."""
    report, run = subject.report, subject.run
    speed, near, margin = report.speed, report.nearness, report.margin
    targets = run.targets.times_s
    return {
        "robot": report.robot,
        "method": ", ".join(methods_of(subject)) or NONE,
        "control law": str(run.settings.get("control_law", NONE)),
        "duration [s]": _number(report.duration_s, 2),
        "first target at [s]": _number(float(targets[0]), 3) if len(targets) else NONE,
        "targets": str(report.targets),
        "ticks": str(report.ticks.number),
        "ticks not recorded": str(report.ticks.missing),
        "rate [Hz]": _number(report.ticks.rate_hz, 1),
        "between ticks, median [ms]": _number(report.ticks.period_median_ms, 3),
        "between ticks, 99 % [ms]": _number(report.ticks.period_p99_ms, 3),
        "between ticks, max [ms]": _number(report.ticks.period_max_ms, 3),
        **_tracking(report),
        "top speed [% of limit]": _number(100.0 * speed.part_of_limit, 1),
        "top speed, joint": speed.joint or NONE,
        "commands not finite": str(speed.non_finite),
        "commands over a limit": str(speed.over_limit),
        "nearest a position limit [rad (m)]": _number(margin.least, 3),
        "that joint": margin.joint or NONE,
        "least singular value [m]": _number(report.singularity.least, 4),
        "given up, linear max [mm/s]": _number(1e3 * report.singularity.lost_linear_max, 2),
        "given up, angular max [mrad/s]": _number(1e3 * report.singularity.lost_angular_max, 2),
        "given up, time [s]": _number(report.singularity.lossy_s, 2),
        "least s": _number(report.scaling.least, 3),
        "time with s < 1 [s]": _number(report.scaling.slowed_s, 2),
        "limit that bound longest": report.scaling.binding[0][0] if report.scaling.binding else NONE,
        "least clearance [mm]": _number(1e3 * near.least, 1),
        "between": " and ".join(near.pair) or NONE,
        "λ task, linear max": _number(report.multiplier.task_linear_max, 3),
        "λ task, angular max": _number(report.multiplier.task_angular_max, 3),
        "λ potential, linear max": _number(report.multiplier.potential_linear_max, 3),
        "λ potential, angular max": _number(report.multiplier.potential_angular_max, 3),
        "messages left out": str(report.dropped),
        "recording": "whole" if report.complete else "cut off",
    }


def _tracking(report: Report) -> dict[str, str]:
    """The same labels whether there is something to compare with or not."""
    tracking = report.tracking
    known = tracking is not None
    settled = tracking.settled if tracking is not None else (math.nan,) * 4
    overall = tracking.overall if tracking is not None else (math.nan,) * 4
    lags = (tracking.lag_position_ms, tracking.lag_rotation_ms) if tracking is not None else (math.nan,) * 2
    after = f"after {tracking.settle_s:g} s" if tracking is not None else NONE
    return {
        "errors against": tracking.against if tracking is not None else NONE,
        "settled": after if known else NONE,
        "position error, settled RMS [mm]": _number(settled[0], 3),
        "position error, settled max [mm]": _number(settled[1], 3),
        "position error, RMS [mm]": _number(overall[0], 3),
        "position error, max [mm]": _number(overall[1], 3),
        "orientation error, settled RMS [mrad]": _number(settled[2], 3),
        "orientation error, settled max [mrad]": _number(settled[3], 3),
        "orientation error, RMS [mrad]": _number(overall[2], 3),
        "orientation error, max [mrad]": _number(overall[3], 3),
        "lag of the position [ms]": _number(lags[0], 1),
        "lag of the orientation [ms]": _number(lags[1], 1),
    }


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else NONE
