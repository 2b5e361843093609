"""Scalar metrics of a run."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np

from ik_node.interfaces.step import FASTER, smallest_singular_value
from ik_node.interfaces.twist_account import twist_account
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.clearances import (
    NO_CLEARANCE,
    ClearanceMetrics,
    ClearanceSeries,
    clearances,
    recorded_clearance,
)
from ik_node.report.deviation import Deviation, StatePeriod, largest_deviation, longest_first, longest_states
from ik_node.report.energies import EnergyMetrics, EnergySeries, energies
from ik_node.report.extremes import JointLimitMargin, MultiplierMaxima, joint_limit_margin, multiplier_maxima
from ik_node.report.ground_truth import GroundTruth, ground_truth_from_targets
from ik_node.report.lateness import LateStepMetrics, LateTargetMetrics, late_steps, late_targets
from ik_node.report.null_space import NullSpaceMetrics, NullSpaceSeries, null_space_motion
from ik_node.report.recorded_scene import RecordedObstacles
from ik_node.report.run_description import recording_date
from ik_node.report.tracking import TrackingErrors, TrackingMetrics, TrackingSeries, compare, tool_to_reference
from ik_node.robot.description import robot_name
from ik_node.robot.robot import Robot

SETTLE_S = 1.0
"""Duration of the initial transient, which the settled errors exclude."""
TRUNCATION_TOLERANCE = 1e-9
"""A part of a twist (m/s, rad/s) below this is rounding error."""
MIN_OFF_RATIO = 0.01
"""Fraction of the twist beyond which motion off its direction counts."""


class TimingMetrics(NamedTuple):
    """Intervals between control steps."""

    number: int
    """Recorded control steps."""
    rate_hz: float
    """Mean over the run."""
    period_median_ms: float
    period_std_ms: float
    period_p99_ms: float
    period_max_ms: float
    missing: int
    """Control steps that are not in the recording."""


class ComputingMetrics(NamedTuple):
    """Time from the call of the controller until the command was published; NaN where it was not measured."""

    median_ms: float
    p99_ms: float
    max_ms: float


class SpeedMetrics(NamedTuple):
    """Largest velocity command relative to its limit."""

    part_of_limit: float
    """Ratio to the limit of that joint."""
    joint: str
    time_s: float
    non_finite: int
    """Number of commands that are not finite."""
    over_limit: int
    """Number of commands above a velocity limit."""


class SingularityMetrics(NamedTuple):
    """Smallest singular value, and the truncated twist V - V_f near singularities."""

    least: float
    """Smallest singular value of J_b with weighted angular rows, m."""
    time_s: float
    truncated_linear_rms: float
    """m/s."""
    truncated_linear_max: float
    truncated_angular_rms: float
    """rad/s."""
    truncated_angular_max: float
    truncated_s: float
    """Time with a truncated twist, s."""


class DirectionMetrics(NamedTuple):
    """Motion off the direction of the twist, J qd - s V_f, and the twist held back, (1 - s) V_f."""

    off_linear_rms: float
    """m/s."""
    off_linear_max: float
    off_angular_rms: float
    """rad/s."""
    off_angular_max: float
    off_s: float
    """Time in which it is more than 1 % of the twist, s."""
    held_back_linear_max: float
    """m/s."""
    limits: tuple[tuple[str, float], ...]
    """(limit that causes it, time in s in which it is the most effective one), longest first."""


class ScalingMetrics(NamedTuple):
    """Task scale s and the active limits."""

    least: float
    """Smallest s."""
    slowed_s: float
    """Time with s < 1, s."""
    binding: tuple[tuple[str, float], ...]
    """(active limit, time it was active in s), longest first."""
    slowed_by: tuple[tuple[str, float], ...]
    """(limit, time in s in which it was active while s < 1), longest first."""


class TooFastTarget(NamedTuple):
    """Streams faster than the reference may be, as the status said."""

    duration_s: float
    text: str
    """The text with the highest speed; empty for none."""


class RunMetrics(NamedTuple):
    """All metrics of one run; the field names are the keys of the JSON report."""

    robot: str
    trajectory: str
    method: str
    recorded_utc: str
    """Date and time of the first control step; empty for simulated time."""
    simulated: bool
    """Whether the recording names a simulated arm."""
    joints: tuple[str, ...]
    duration_s: float
    """From the first control step to the last."""
    tracking: TrackingMetrics | None
    """None without a ground truth."""
    tool_to_reference: TrackingErrors
    """The measured tool pose against the desired pose T_sd, over all control steps in closed loop."""
    deviation: Deviation | None
    """Interval of the largest error; None when the tool is nowhere off the trajectory."""
    ticks: TimingMetrics
    speed: SpeedMetrics
    singularity: SingularityMetrics
    direction: DirectionMetrics
    scaling: ScalingMetrics
    nearness: ClearanceMetrics
    """Smallest recorded distance, to an obstacle or between links."""
    obstacle_clearance: ClearanceMetrics
    """Smallest distance to an obstacle, from the recorded positions."""
    self_clearance: ClearanceMetrics
    """Smallest distance between links, from the recorded positions."""
    energy: EnergyMetrics
    null_space: NullSpaceMetrics
    margin: JointLimitMargin
    multiplier: MultiplierMaxima
    periods: tuple[StatePeriod, ...]
    """Longest first."""
    targets: int
    """Number of received target poses."""
    target_rate_hz: float
    target_too_fast: TooFastTarget
    late_targets: LateTargetMetrics
    late_steps: LateStepMetrics
    computing: ComputingMetrics
    dropped: int
    """Messages that the recorder dropped."""
    complete: bool
    """Whether the recorder closed the recording."""
    series: TrackingSeries | None
    """For plots; like the following ones not part of the JSON."""
    clearance_series: ClearanceSeries | None
    energy_series: EnergySeries
    null_space_series: NullSpaceSeries


def compute_metrics(
    run: Run,
    truth: GroundTruth | None = None,
    trajectory: str = "",
    settle_s: float = SETTLE_S,
    obstacles: RecordedObstacles | None = None,
) -> RunMetrics:
    """Computes all metrics of a run.

    The tracking error compares the measured tool pose, the forward kinematics of the measured joint positions, with the
    ground truth at the stamp of the joint state. The node's desired pose is not used.

    Args:
        run: The recorded run.
        truth: Ground truth; the recorded targets if None.
        trajectory: Name of the trajectory in the report.
        settle_s: Duration of the initial transient, which the settled errors exclude.
        obstacles: Obstacles of the run; default: those of its scene file.
    """
    reference = truth or ground_truth_from_targets(run.targets, run.base_frame)
    tracking, series = (None, None) if reference is None else compare(run, reference, settle_s)
    durations_s = _durations(run)
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, str(run.settings.get("joint_prefix", "")))
    method = str(run.settings.get("method", ""))
    clearance_series = clearances(run, robot, obstacles)
    energy, energy_series = energies(run, robot, method, clearance_series)
    null_space, null_space_series = null_space_motion(run, robot)
    return RunMetrics(
        robot=run.robot or robot_name(run.urdf),
        trajectory=trajectory,
        method=method,
        recorded_utc=recording_date(int(run.ros_ns[0])) if len(run.ros_ns) else "",
        simulated=run.simulated,
        joints=run.joints,
        duration_s=float(run.times_s[-1] - run.times_s[0]) if len(run.times_s) else 0.0,
        tracking=tracking,
        tool_to_reference=tool_to_reference(run),
        deviation=None if series is None else largest_deviation(run, series, durations_s),
        ticks=_ticks(run),
        speed=_speed(run),
        singularity=_singularity(run, durations_s),
        direction=_direction(run, durations_s),
        scaling=_scaling(run, durations_s),
        nearness=recorded_clearance(run),
        obstacle_clearance=NO_CLEARANCE if clearance_series is None else clearance_series.least_obstacle,
        self_clearance=NO_CLEARANCE if clearance_series is None else clearance_series.least_own,
        energy=energy,
        null_space=null_space,
        margin=joint_limit_margin(run),
        multiplier=multiplier_maxima(run),
        periods=_periods(run, durations_s),
        targets=len(run.targets.times_s),
        target_rate_hz=_rate(run.targets.times_s),
        target_too_fast=_too_fast(run, durations_s),
        late_targets=late_targets(run),
        late_steps=late_steps(run),
        computing=_computing(run),
        dropped=run.dropped,
        complete=run.complete,
        series=series,
        clearance_series=clearance_series,
        energy_series=energy_series,
        null_space_series=null_space_series,
    )


def _computing(run: Run) -> ComputingMetrics:
    known = 1e3 * run.computing_s[np.isfinite(run.computing_s)]
    if not len(known):
        return ComputingMetrics(math.nan, math.nan, math.nan)
    return ComputingMetrics(float(np.median(known)), float(np.percentile(known, 99.0)), float(known.max()))


def velocity_ratio(run: Run) -> Array:
    """Velocity commands divided by the velocity limits, (k, n), signed."""
    result: Array = run.joint_velocity / run.velocity_limits
    return result


def _durations(run: Run) -> Array:
    """Duration of each command, (k,), s; the last one is given the median duration."""
    periods = np.diff(run.times_s)
    median = float(np.median(periods)) if len(periods) else 0.0
    return np.append(periods, median) if len(run.times_s) else periods


def _rate(times: Array) -> float:
    """Events per second from the median interval, so that pauses have no effect."""
    if len(times) < 2:
        return math.nan
    period = float(np.median(np.diff(times)))
    return 1.0 / period if period > 0.0 else math.nan


def _ticks(run: Run) -> TimingMetrics:
    periods = 1e3 * np.diff(run.times_s)
    if not len(periods):
        return TimingMetrics(len(run.tick), math.nan, math.nan, math.nan, math.nan, math.nan, 0)
    return TimingMetrics(
        number=len(run.tick),
        rate_hz=float(1e3 / periods.mean()),
        period_median_ms=float(np.median(periods)),
        period_std_ms=float(periods.std()),
        period_p99_ms=float(np.percentile(periods, 99.0)),
        period_max_ms=float(periods.max()),
        missing=int((np.diff(run.tick) - 1).sum()),
    )


def _speed(run: Run) -> SpeedMetrics:
    finite = np.isfinite(run.joint_velocity)
    ratios = np.where(finite, np.abs(velocity_ratio(run)), -1.0)
    if not finite.any():
        return SpeedMetrics(math.nan, "", math.nan, len(ratios), 0)
    row, joint = np.unravel_index(int(ratios.argmax()), ratios.shape)
    return SpeedMetrics(
        part_of_limit=float(ratios[row, joint]),
        joint=run.joints[int(joint)],
        time_s=float(run.times_s[row]),
        non_finite=int((~finite).any(axis=1).sum()),
        over_limit=int((ratios > 1.0).any(axis=1).sum()),
    )


def _singularity(run: Run, durations_s: Array) -> SingularityMetrics:
    last = smallest_singular_value(run.singular_values)
    finite = np.isfinite(last)
    row = int(np.where(finite, last, np.inf).argmin()) if finite.any() else -1
    truncated = run.truncated_b[np.isfinite(run.truncated_b).all(axis=1)]
    linear, angular = np.linalg.norm(truncated[:, :3], axis=1), np.linalg.norm(truncated[:, 3:], axis=1)
    with np.errstate(invalid="ignore"):
        is_truncated = np.abs(run.truncated_b).max(axis=1, initial=0.0) > TRUNCATION_TOLERANCE
    return SingularityMetrics(
        least=float(last[row]) if row >= 0 else math.nan,
        time_s=float(run.times_s[row]) if row >= 0 else math.nan,
        truncated_linear_rms=_rms(linear),
        truncated_linear_max=float(linear.max(initial=0.0)),
        truncated_angular_rms=_rms(angular),
        truncated_angular_max=float(angular.max(initial=0.0)),
        truncated_s=float(durations_s[is_truncated].sum()),
    )


def _direction(run: Run, durations_s: Array) -> DirectionMetrics:
    known = np.asarray(np.isfinite(run.off_direction_b).all(axis=1))
    account = twist_account(run.twist_b, run.truncated_b, run.off_direction_b, run.scale)
    row_scale = np.repeat((1.0, _characteristic_length(run)), 3)
    off = account.off_direction[known]
    linear, angular = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
    speed, wanted = (np.linalg.norm(row_scale * part[known], axis=1) for part in (account.off_direction, run.twist_b))
    is_off = speed > np.maximum(TRUNCATION_TOLERANCE, MIN_OFF_RATIO * wanted)
    times: dict[str, float] = {}
    limits = [names for names, is_known in zip(run.off_direction_limits, known.tolist(), strict=True) if is_known]
    for names, duration, counts in zip(limits, durations_s[known].tolist(), is_off, strict=True):
        if counts and names:
            times[names[0]] = times.get(names[0], 0.0) + duration
    held_back = np.linalg.norm(account.held_back[known][:, :3], axis=1)
    return DirectionMetrics(
        off_linear_rms=_rms(linear),
        off_linear_max=float(linear.max(initial=0.0)),
        off_angular_rms=_rms(angular),
        off_angular_max=float(angular.max(initial=0.0)),
        off_s=float(durations_s[known][is_off].sum()),
        held_back_linear_max=float(held_back.max(initial=0.0)),
        limits=longest_first(times),
    )


def _characteristic_length(run: Run) -> float:
    length = run.settings.get("characteristic_length")
    return float(length) if isinstance(length, (int, float)) else 1.0


def _scaling(run: Run, durations_s: Array) -> ScalingMetrics:
    finite = np.isfinite(run.scale)
    with np.errstate(invalid="ignore"):
        slowed = run.scale < 1.0
    times: dict[str, float] = {}
    slowing: dict[str, float] = {}
    for names, duration, is_slowed in zip(run.binding, durations_s.tolist(), slowed.tolist(), strict=True):
        for name in names:
            times[name] = times.get(name, 0.0) + duration
            if is_slowed:
                slowing[name] = slowing.get(name, 0.0) + duration
    return ScalingMetrics(
        least=float(run.scale[finite].min()) if finite.any() else math.nan,
        slowed_s=float(durations_s[slowed].sum()),
        binding=longest_first(times),
        slowed_by=longest_first(slowing),
    )


def _periods(run: Run, durations_s: Array) -> tuple[StatePeriod, ...]:
    times: dict[tuple[str, str], float] = {}
    for status, duration in zip(run.status, durations_s.tolist(), strict=True):
        key = (status.mode.value, status.reason)
        times[key] = times.get(key, 0.0) + duration
    return longest_states(times)


def _too_fast(run: Run, durations_s: Array) -> TooFastTarget:
    total_s, texts = 0.0, set()
    for status, duration in zip(run.status, durations_s.tolist(), strict=True):
        found = [text for text in status.reason.split("; ") if FASTER in text]
        total_s += duration if found else 0.0
        texts.update(found)
    return TooFastTarget(
        total_s, max(texts, key=lambda text: [float(n) for n in re.findall(r"at ([\d.]+)", text)], default="")
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
