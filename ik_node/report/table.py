"""The metrics of several recordings side by side."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from operator import attrgetter
from typing import NamedTuple

from ik_node.report import quantities
from ik_node.report.lateness import AgeMetrics
from ik_node.report.quantities import NOT_AVAILABLE, DisplayedQuantity
from ik_node.report.reported_run import ReportedRun, methods_of
from ik_node.report.tracking import TrackingMetrics

MAX_WIDTH = 30
"""Of a column of values, in characters."""


class MetricRow(NamedTuple):
    """One metric of every recording."""

    label: str
    """With its unit."""
    values: tuple[str, ...]
    """In the order of the recordings; NOT_AVAILABLE where a recording lacks it."""
    explanation: str = ""
    """What the number means, in one sentence."""


class _Metric(NamedTuple):
    """A row of the table."""

    label: str
    cell: Callable[[ReportedRun], str]
    explanation: str


def _text(label: str, attribute: str, explanation: str) -> _Metric:
    """A text or a count: an attribute of the metrics, by its dotted name."""
    value = attrgetter(attribute)
    return _Metric(label, lambda reported: str(value(reported.metrics)) or NOT_AVAILABLE, explanation)


def _number(quantity: DisplayedQuantity, attribute: str, explanation: str, label: str = "{}") -> _Metric:
    """A value in SI units; ``label``: of the row, with the name of the quantity in the braces."""
    named, value = quantity._replace(name=label.format(quantity.name)), attrgetter(attribute)
    return _Metric(named.label, lambda reported: quantity.text(value(reported.metrics)), explanation)


def _first(label: str, attribute: str, explanation: str) -> _Metric:
    """The first name of a list of (name, time)."""
    value = attrgetter(attribute)

    def cell(reported: ReportedRun) -> str:
        names = value(reported.metrics)
        return str(names[0][0]) if names else NOT_AVAILABLE

    return _Metric(label, cell, explanation)


def _tracking(label: str, digits: int, value: Callable[[TrackingMetrics], float], explanation: str) -> _Metric:
    """A metric that needs a ground truth."""
    quantity = DisplayedQuantity(label, digits=digits)

    def cell(reported: ReportedRun) -> str:
        tracking = reported.metrics.tracking
        return NOT_AVAILABLE if tracking is None else quantity.text(value(tracking))

    return _Metric(label, cell, explanation)


_ERRORS = (
    ("settled", quantities.POSITION_ERROR, quantities.ORIENTATION_ERROR, "Measured tool against the trajectory."),
    (
        "reference_to_trajectory",
        quantities.REFERENCE_POSITION_ERROR,
        quantities.REFERENCE_ORIENTATION_ERROR,
        "Part of it: what targets and smoothing did.",
    ),
    (
        "tool_to_reference",
        quantities.TOOL_POSITION_ERROR,
        quantities.TOOL_ORIENTATION_ERROR,
        "Part of it: what control law, limits and timing did.",
    ),
    (
        "overall",
        quantities.POSITION_ERROR,
        quantities.ORIENTATION_ERROR,
        "Measured tool against the trajectory, with the first second.",
    ),
)


def _tracking_errors() -> tuple[_Metric, ...]:
    """RMS and maximum of all errors."""
    cells = []
    for interval, *both, explanation in _ERRORS:
        for field, quantity in zip(("position", "orientation"), both, strict=True):
            for statistic in ("RMS", "max"):
                when = "from the start, " if interval == "overall" else ""
                label = f"{quantity.name}, {when}{statistic} [{quantity.unit}]"
                value = attrgetter(f"{interval}.{field}_{statistic.lower()}_{quantity.unit}")
                cells.append(_tracking(label, quantity.digits, value, explanation))
    return tuple(cells)


def _first_target(reported: ReportedRun) -> str:
    times = reported.run.targets.times_s
    return _S.text(float(times[0])) if len(times) else NOT_AVAILABLE


def _ages(name: str, attribute: str, explanation: str) -> tuple[_Metric, ...]:
    """Median, 95th percentile and maximum of an age at the control steps."""
    ms, value = DisplayedQuantity(name, "ms", digits=1), attrgetter(attribute)

    def metric(label: str, field: str) -> _Metric:
        def cell(reported: ReportedRun) -> str:
            age: AgeMetrics = value(reported.metrics)
            return ms.text(getattr(age, field))

        return _Metric(f"{name}, {label} [ms]", cell, explanation)

    return metric("median", "median_ms"), metric("95th percentile", "p95_ms"), metric("max", "max_ms")


_MS = DisplayedQuantity("control period", "ms")
_S = DisplayedQuantity("duration", "s", digits=2)
_TIMES = "Time between two control steps."
_COMPUTING = DisplayedQuantity("computing time", "ms")
_COMPUTED = "From the call of the controller until its command was published."
_TASK = "Term of the multiplier that makes the tool follow the twist: a momentum; without unit for `plain`."
_GRADIENT = "Term of the multiplier that keeps the potential from moving the tool, divided by the gain k: a wrench."
_LEFT = "Twist that is not done because a singular direction is given up."
_METRICS: tuple[_Metric, ...] = (
    _text("robot", "robot", "Name in example-robot-data, or of the URDF."),
    _Metric(
        "method",
        lambda reported: ", ".join(methods_of(reported)) or NOT_AVAILABLE,
        "Selects the joint velocity among those with the same tool motion.",
    ),
    _Metric(
        "control law",
        lambda reported: str(reported.run.settings.get("control_law", NOT_AVAILABLE)),
        "How the pose error becomes a twist.",
    ),
    _text("recorded", "recorded_utc", "First control step."),
    _Metric(
        "arm",
        lambda reported: "simulated" if reported.metrics.simulated else NOT_AVAILABLE,
        "Named where the joint states are those of a simulated arm.",
    ),
    _number(_S, "duration_s", "From the first control step to the last."),
    *_tracking_errors(),
    _Metric(
        "trajectory",
        lambda reported: t.against if (t := reported.metrics.tracking) else NOT_AVAILABLE,
        "What the errors are measured against.",
    ),
    _Metric(
        "errors count",
        lambda reported: f"after {t.settle_s:g} s" if (t := reported.metrics.tracking) else NOT_AVAILABLE,
        "The errors above leave out the approach to the trajectory.",
    ),
    _Metric(
        "task",
        lambda reported: t.task if (t := reported.metrics.tracking) and t.task else NOT_AVAILABLE,
        "Errors count beyond this tolerance.",
    ),
    _tracking(
        "lag of the position [ms]",
        1,
        lambda tracking: tracking.lag_position_ms,
        "Delay that explains most of the error.",
    ),
    _tracking(
        "lag of the orientation [ms]", 1, lambda tracking: tracking.lag_rotation_ms, "The same for the orientation."
    ),
    _Metric("first target at [s]", _first_target, "Arrival of the first target pose."),
    _text("targets", "targets", "Target poses that arrived."),
    _text("targets late", "late_targets.late", "They came later than a sample period after they were due."),
    _text("targets lost", "late_targets.lost", "Gaps in the stream, in sample periods."),
    *_ages("age of the target", "late_targets.age", "Of the newest target at each control step, since its stamp."),
    _text("control steps", "ticks.number", "Commands that were computed or braked."),
    _text("control steps not recorded", "ticks.missing", "The recorder was too slow for them."),
    _number(DisplayedQuantity("rate", "Hz", digits=1), "ticks.rate_hz", "Control steps per second, mean."),
    _number(_MS, "ticks.period_median_ms", _TIMES, "{}, median"),
    _number(_MS, "ticks.period_p99_ms", _TIMES, "{}, 99th percentile"),
    _number(_MS, "ticks.period_max_ms", _TIMES, "{}, max"),
    _number(_COMPUTING, "computing.median_ms", _COMPUTED, "{}, median"),
    _number(_COMPUTING, "computing.p99_ms", _COMPUTED, "{}, 99th percentile"),
    _number(_COMPUTING, "computing.max_ms", _COMPUTED, "{}, max"),
    _text("late control steps", "late_steps.late", "More than two control periods after the one before."),
    _text("of these by the machine of the node", "late_steps.by_machine", "The others waited for a late joint state."),
    _text(
        "commands held longer than hold_periods", "late_steps.held_too_long", "The arm moved on with an old command."
    ),
    _text("hold-ups of the node", "late_steps.hold_ups", "Times over 12 ms in which the computer did not run it."),
    _number(_S, "late_steps.hold_ups_s", "All of them together.", "hold-ups, time"),
    _number(_MS, "late_steps.hold_up_max_ms", "The longest one.", "longest hold-up"),
    *_ages("age of the joint state", "late_steps.state_age", "At the control step, since its stamp."),
    _number(quantities.JOINT_SPEED, "speed.part_of_limit", "Joint nearest to its velocity limit.", "top speed"),
    _text("top speed, joint", "speed.joint", "That joint."),
    _text("commands not finite", "speed.non_finite", "Always 0: the last check before the motors."),
    _text("commands over a limit", "speed.over_limit", "Beyond a velocity limit."),
    _number(
        DisplayedQuantity("min distance to a joint limit", "rad (m)"),
        "margin.least",
        "Smallest distance of a measured position to a position limit.",
    ),
    _text("joint at that distance", "margin.joint", "That joint."),
    _number(
        quantities.SMALLEST_SINGULAR_VALUE,
        "singularity.least",
        "Near 0 the tool cannot move in one direction.",
        "{}, min",
    ),
    _number(quantities.TRUNCATED_LINEAR, "singularity.truncated_linear_max", _LEFT, "{} max"),
    _number(quantities.TRUNCATED_ANGULAR, "singularity.truncated_angular_max", _LEFT, "{} max"),
    _number(_S, "singularity.truncated_s", "Time in which a direction is given up.", "truncated twist, time"),
    _number(
        quantities.OFF_DIRECTION_LINEAR, "direction.off_linear_max", "Motion that limits force off the path.", "{} max"
    ),
    _number(quantities.OFF_DIRECTION_ANGULAR, "direction.off_angular_max", "The same for the rotation.", "{} max"),
    _number(_S, "direction.off_s", "Time in which that is noticeable.", "more than 1 % off the direction, time"),
    _first("limit that causes it longest", "direction.limits", "That limit."),
    _number(quantities.HELD_BACK_LINEAR, "direction.held_back_linear_max", "Speed that waits because s < 1.", "{} max"),
    _number(quantities.SCALE, "scaling.least", "Smallest fraction of the desired twist that is done.", "min {}"),
    _number(_S, "scaling.slowed_s", "Time in which the arm is slowed.", "time with s < 1"),
    _first("limit active longest", "scaling.binding", "Also while it does not slow the arm."),
    _number(quantities.OBSTACLE_CLEARANCE, "obstacle_clearance.least", "Arm to the nearest obstacle.", "{}, min"),
    _Metric(
        "nearest obstacle",
        lambda reported: " and ".join(reported.metrics.obstacle_clearance.pair) or NOT_AVAILABLE,
        "That pair.",
    ),
    _number(quantities.SELF_CLEARANCE, "self_clearance.least", "Links of the arm to each other.", "{}, min"),
    _Metric(
        "nearest links",
        lambda reported: " and ".join(reported.metrics.self_clearance.pair) or NOT_AVAILABLE,
        "That pair.",
    ),
    _number(quantities.KINETIC_ENERGY, "energy.kinetic_mean_j", "1/2 qd' M qd of the commands.", "{}, mean"),
    _number(quantities.KINETIC_ENERGY, "energy.kinetic_max_j", "The same.", "{}, max"),
    _number(quantities.NULL_SPACE_SPEED, "null_space.rms", "Joint velocity that does not move the tool.", "{}, RMS"),
    _number(quantities.NULL_SPACE_SPEED, "null_space.max", "The same.", "{}, max"),
    _number(
        quantities.GRAVITATIONAL_ENERGY, "energy.gravitational_mean_j", "Lowered by `gravity_gradient`.", "{}, mean"
    ),
    _number(quantities.REPULSION, "energy.repulsion_mean_j", "Lowered by `obstacle_gradient`.", "{}, mean"),
    _text("potential h", "energy.potential", "What the method lowers in the null space."),
    _number(quantities.POTENTIAL, "energy.potential_first_j", "At the first position.", "{}, at the start"),
    _number(quantities.POTENTIAL, "energy.potential_last_j", "At the last position.", "{}, at the end"),
    _number(quantities.MULTIPLIER_TASK_LINEAR, "multiplier.task_linear_max", _TASK, "{}, max"),
    _number(quantities.MULTIPLIER_TASK_ANGULAR, "multiplier.task_angular_max", _TASK, "{}, max"),
    _number(quantities.MULTIPLIER_POTENTIAL_LINEAR, "multiplier.potential_linear_max", _GRADIENT, "{}, max"),
    _number(quantities.MULTIPLIER_POTENTIAL_ANGULAR, "multiplier.potential_angular_max", _GRADIENT, "{}, max"),
    _text("messages dropped", "dropped", "Left out by the recorder."),
    _Metric(
        "recording",
        lambda reported: "complete" if reported.metrics.complete else "truncated",
        "Truncated: its writer was ended; ik_repair completes it.",
    ),
)


def metric_rows(reported_runs: Sequence[ReportedRun]) -> tuple[MetricRow, ...]:
    """The rows of all metrics that at least one of the recordings has."""
    table = (
        MetricRow(metric.label, tuple(metric.cell(reported) for reported in reported_runs), metric.explanation)
        for metric in _METRICS
    )
    return tuple(row for row in table if any(value != NOT_AVAILABLE for value in row.values))


MAIN_LABELS = (
    "robot",
    "method",
    "position error, tool to trajectory, RMS [mm]",
    "position error, tool to trajectory, max [mm]",
    "orientation error, tool to trajectory, RMS [mrad]",
    "position error, reference to trajectory, RMS [mm]",
    "position error, tool to reference, RMS [mm]",
    "targets lost",
    "rate [Hz]",
    "hold-ups, time [s]",
    "top speed [% of limit]",
    "time with s < 1 [s]",
    "truncated twist, time [s]",
    "clearance to obstacles, min [mm]",
    "clearance between links, min [mm]",
    "kinetic energy of the command, mean [J]",
)
"""Rows of the comparison of several recordings in a picture."""


METHOD_LABELS = (
    "method",
    "kinetic energy of the command, mean [J]",
    "kinetic energy of the command, max [J]",
    "gravitational energy, mean [J]",
    "repulsion of near pairs, mean [J]",
    "null-space speed |N qd|, RMS [rad/s]",
    "null-space speed |N qd|, max [rad/s]",
    "λ task, linear, max [N s]",
    "λ task, angular, max [N m s]",
    "λ potential / k, force, max [N]",
    "λ potential / k, torque, max [N m]",
)
"""Rows that differ between methods on the same motion."""


def as_table(reported_runs: Sequence[ReportedRun], max_width: int = MAX_WIDTH, labels: Collection[str] = ()) -> str:
    """Table as text: one column of at most ``max_width`` characters per recording under its name.

    Args:
        reported_runs: The recordings.
        max_width: Of a column.
        labels: Labels of the rows; default: all.
    """
    names = tuple(_shortened(reported.name, max_width) for reported in reported_runs)
    rows = [row for row in metric_rows(reported_runs) if not labels or row.label in labels]
    lines = [MetricRow("", names), *rows]
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
