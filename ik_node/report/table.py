"""The metrics of several recordings side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import NamedTuple

from ik_node.report import quantities
from ik_node.report.lateness import AgeMetrics
from ik_node.report.quantities import NOT_AVAILABLE, DisplayedQuantity
from ik_node.report.reported_run import ReportedRun, methods_of
from ik_node.report.tracking import TrackingMetrics

MAX_WIDTH = 22
"""Of a column of values, in characters."""


class MetricRow(NamedTuple):
    """One metric of every recording."""

    label: str
    """With its unit."""
    values: tuple[str, ...]
    """In the order of the recordings; NOT_AVAILABLE where a recording lacks it."""


_Cell = Callable[[ReportedRun], str]


def _number(quantity: DisplayedQuantity, value: Callable[[ReportedRun], float]) -> tuple[str, _Cell]:
    """Label and cell of a value in SI units."""
    return quantity.label, lambda reported: quantity.text(value(reported))


def _tracking(label: str, digits: int, value: Callable[[TrackingMetrics], float]) -> tuple[str, _Cell]:
    """Label and cell of a metric that needs a ground truth."""
    quantity = DisplayedQuantity(label, digits=digits)

    def cell(reported: ReportedRun) -> str:
        tracking = reported.metrics.tracking
        return NOT_AVAILABLE if tracking is None else quantity.text(value(tracking))

    return label, cell


def _tracking_errors() -> tuple[tuple[str, _Cell], ...]:
    """RMS and maximum of both errors, settled and over the whole run."""
    cells = []
    for field, quantity in (("position", quantities.POSITION_ERROR), ("orientation", quantities.ORIENTATION_ERROR)):
        for interval in ("settled", "overall"):
            for statistic in ("RMS", "max"):
                label = f"{quantity.name}, {'settled ' if interval == 'settled' else ''}{statistic} [{quantity.unit}]"
                value = attrgetter(f"{interval}.{field}_{statistic.lower()}_{quantity.unit}")
                cells.append(_tracking(label, quantity.digits, value))
    return tuple(cells)


def _first_target_s(reported: ReportedRun) -> float:
    times = reported.run.targets.times_s
    return float(times[0]) if len(times) else float("nan")


def _with(quantity: DisplayedQuantity, name: str) -> DisplayedQuantity:
    return quantity._replace(name=name.format(quantity.name))


def _ages(name: str, value: Callable[[ReportedRun], AgeMetrics]) -> tuple[tuple[str, _Cell], ...]:
    """Median, 95th percentile and maximum of an age at the control steps."""
    labels = ("median", "95th percentile", "max")
    quantities_ms = [DisplayedQuantity(f"{name}, {label}", "ms", digits=1) for label in labels]
    return (
        _number(quantities_ms[0], lambda reported: value(reported).median_ms),
        _number(quantities_ms[1], lambda reported: value(reported).p95_ms),
        _number(quantities_ms[2], lambda reported: value(reported).max_ms),
    )


_MS = DisplayedQuantity("control period", "ms")
_S = DisplayedQuantity("duration", "s", digits=2)
_CELLS: tuple[tuple[str, _Cell], ...] = (
    ("robot", lambda reported: reported.metrics.robot),
    ("method", lambda reported: ", ".join(methods_of(reported)) or NOT_AVAILABLE),
    ("control law", lambda reported: str(reported.run.settings.get("control_law", NOT_AVAILABLE))),
    _number(_S, lambda reported: reported.metrics.duration_s),
    _number(_S._replace(name="first target at", digits=3), _first_target_s),
    ("targets", lambda reported: str(reported.metrics.targets)),
    ("targets late", lambda reported: str(reported.metrics.late_targets.late)),
    ("targets lost", lambda reported: str(reported.metrics.late_targets.lost)),
    *_ages("age of the target", lambda reported: reported.metrics.late_targets.age),
    ("control steps", lambda reported: str(reported.metrics.ticks.number)),
    ("control steps not recorded", lambda reported: str(reported.metrics.ticks.missing)),
    _number(DisplayedQuantity("rate", "Hz", digits=1), lambda reported: reported.metrics.ticks.rate_hz),
    _number(_with(_MS, "{}, median"), lambda reported: reported.metrics.ticks.period_median_ms),
    _number(_with(_MS, "{}, 99th percentile"), lambda reported: reported.metrics.ticks.period_p99_ms),
    _number(_with(_MS, "{}, max"), lambda reported: reported.metrics.ticks.period_max_ms),
    ("late control steps", lambda reported: str(reported.metrics.late_steps.late)),
    ("of these by the machine of the node", lambda reported: str(reported.metrics.late_steps.by_machine)),
    ("commands held longer than hold_periods", lambda reported: str(reported.metrics.late_steps.held_too_long)),
    ("hold-ups of the node", lambda reported: str(reported.metrics.late_steps.hold_ups)),
    _number(_S._replace(name="hold-ups, time"), lambda reported: reported.metrics.late_steps.hold_ups_s),
    _number(_MS._replace(name="longest hold-up"), lambda reported: reported.metrics.late_steps.hold_up_max_ms),
    *_ages("age of the joint state", lambda reported: reported.metrics.late_steps.state_age),
    ("errors against", lambda reported: t.against if (t := reported.metrics.tracking) else NOT_AVAILABLE),
    ("settled", lambda reported: f"after {t.settle_s:g} s" if (t := reported.metrics.tracking) else NOT_AVAILABLE),
    *_tracking_errors(),
    _tracking("lag of the position [ms]", 1, lambda tracking: tracking.lag_position_ms),
    _tracking("lag of the orientation [ms]", 1, lambda tracking: tracking.lag_rotation_ms),
    _number(_with(quantities.JOINT_SPEED, "top speed"), lambda reported: reported.metrics.speed.part_of_limit),
    ("top speed, joint", lambda reported: reported.metrics.speed.joint or NOT_AVAILABLE),
    ("commands not finite", lambda reported: str(reported.metrics.speed.non_finite)),
    ("commands over a limit", lambda reported: str(reported.metrics.speed.over_limit)),
    _number(
        DisplayedQuantity("min distance to a joint limit", "rad (m)"), lambda reported: reported.metrics.margin.least
    ),
    ("joint at that distance", lambda reported: reported.metrics.margin.joint or NOT_AVAILABLE),
    _number(quantities.SMALLEST_SINGULAR_VALUE, lambda reported: reported.metrics.singularity.least),
    _number(
        _with(quantities.TRUNCATED_LINEAR, "{} max"),
        lambda reported: reported.metrics.singularity.truncated_linear_max,
    ),
    _number(
        _with(quantities.TRUNCATED_ANGULAR, "{} max"),
        lambda reported: reported.metrics.singularity.truncated_angular_max,
    ),
    _number(_S._replace(name="truncated twist, time"), lambda reported: reported.metrics.singularity.truncated_s),
    _number(
        _with(quantities.OFF_DIRECTION_LINEAR, "{} max"),
        lambda reported: reported.metrics.direction.off_linear_max,
    ),
    _number(
        _with(quantities.OFF_DIRECTION_ANGULAR, "{} max"),
        lambda reported: reported.metrics.direction.off_angular_max,
    ),
    _number(
        _S._replace(name="more than 1 % off the direction, time"), lambda reported: reported.metrics.direction.off_s
    ),
    (
        "limit that causes it longest",
        lambda reported: limits[0][0] if (limits := reported.metrics.direction.limits) else NOT_AVAILABLE,
    ),
    _number(
        _with(quantities.HELD_BACK_LINEAR, "{} max"),
        lambda reported: reported.metrics.direction.held_back_linear_max,
    ),
    _number(_with(quantities.SCALE, "min {}"), lambda reported: reported.metrics.scaling.least),
    _number(_S._replace(name="time with s < 1"), lambda reported: reported.metrics.scaling.slowed_s),
    ("limit active longest", lambda reported: b[0][0] if (b := reported.metrics.scaling.binding) else NOT_AVAILABLE),
    _number(_with(quantities.CLEARANCE, "min {}"), lambda reported: reported.metrics.nearness.least),
    ("closest pair", lambda reported: " and ".join(reported.metrics.nearness.pair) or NOT_AVAILABLE),
    _number(
        _with(quantities.MULTIPLIER_TASK_LINEAR, "{} max"),
        lambda reported: reported.metrics.multiplier.task_linear_max,
    ),
    _number(
        _with(quantities.MULTIPLIER_TASK_ANGULAR, "{} max"),
        lambda reported: reported.metrics.multiplier.task_angular_max,
    ),
    _number(
        _with(quantities.MULTIPLIER_POTENTIAL_LINEAR, "{} max"),
        lambda reported: reported.metrics.multiplier.potential_linear_max,
    ),
    _number(
        _with(quantities.MULTIPLIER_POTENTIAL_ANGULAR, "{} max"),
        lambda reported: reported.metrics.multiplier.potential_angular_max,
    ),
    ("messages dropped", lambda reported: str(reported.metrics.dropped)),
    ("recording", lambda reported: "complete" if reported.metrics.complete else "truncated"),
)
"""Label of each row, and the function that gives the text of its cell."""


def metric_rows(reported_runs: Sequence[ReportedRun]) -> tuple[MetricRow, ...]:
    """The rows of all metrics that at least one of the recordings has."""
    table = (MetricRow(label, tuple(cell(reported) for reported in reported_runs)) for label, cell in _CELLS)
    return tuple(row for row in table if any(value != NOT_AVAILABLE for value in row.values))


def as_table(reported_runs: Sequence[ReportedRun], max_width: int = MAX_WIDTH) -> str:
    """Table as text: one column of at most ``max_width`` characters per recording under its name."""
    names = tuple(_shortened(reported.name, max_width) for reported in reported_runs)
    lines = [MetricRow("", names), *metric_rows(reported_runs)]
    first = max(len(line.label) for line in lines)
    widths = [min(max(len(line.values[index]) for line in lines), max_width) for index in range(len(names))]
    return "\n".join(
        "  ".join(
            [
                line.label.ljust(first),
                *(_shortened(value, max_width).rjust(width) for value, width in zip(line.values, widths, strict=True)),
            ]
        ).rstrip()
        for line in lines
    )


def _shortened(text: str, max_width: int) -> str:
    """The end of a long text, which is more specific than its beginning."""
    return text if len(text) <= max_width else "..." + text[len(text) - max_width + 3 :]
