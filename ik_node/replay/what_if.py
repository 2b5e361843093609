"""Comparison of simulated runs with other settings by their metrics."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from math import isfinite
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Level, Step
from ik_node.math.se3 import pose_from, quaternion_from_rotation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.replay.call_source import CallSource, RecordingSource, calls
from ik_node.replay.closed_loop import SimulatedRun, open_loop, simulate
from ik_node.replay.gc_pause import infrequent_gc
from ik_node.report.ground_truth import (
    GroundTruth,
    ground_truth_from_targets,
    rotation_angle,
)
from ik_node.report.reported_run import stored_truth
from ik_node.report.run_tasks import excess
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.settings.method_names import ALL_METHODS, METHOD_NAMES, is_import_path
from ik_node.settings.schema import Value

SETTLE_S = 1.0
"""Tracking errors are evaluated from this time after the first target, because the approach to it is no tracking."""


SourceFactory = Callable[[], CallSource]


class Variant(NamedTuple):
    """Settings to simulate."""

    name: str
    changes: Mapping[str, Value]
    """Parameter by full name -> value, on top of the recorded ones."""


RECORDED = Variant("recorded", {})
"""The recorded settings, simulated like the others."""


@dataclasses.dataclass(frozen=True)
class VariantMetrics:
    """Metrics of one closed-loop run. NaN: not available."""

    name: str
    method: str
    steps: int
    position_rms_mm: float
    position_max_mm: float
    orientation_rms_mrad: float
    orientation_max_mrad: float
    energy_mean_j: float
    """Kinetic energy 1/2 qd' M qd of the commands, mean over the control steps."""
    energy_max_j: float
    clearance_min_mm: float
    """To the nearest obstacle or between links; inf without distance monitoring."""
    scale_min: float
    """Smallest task scale s."""
    scaled_percent: float
    """Control steps with s < 1."""
    peak_speed_percent: float
    """Of the joint that comes closest to its velocity limit."""
    peak_speed: float
    """Fastest joint, rad/s (m/s)."""
    faults: int
    """Control steps with level ERROR."""
    refused: int
    """Targets that the controller refused."""


class OpenLoopMetrics(NamedTuple):
    """Difference of the commands on the recorded joint states from the recorded commands."""

    name: str
    steps: int
    """Control steps with both commands."""
    difference_rms: float
    """Of the joint velocities, rad/s (m/s)."""
    difference_max: float


def make_variants(recorded: Settings, methods: Sequence[str], changes: Mapping[str, Value]) -> tuple[Variant, ...]:
    """The variants to simulate: one per method, each with ``changes``, without those equal to the recorded settings.

    Args:
        recorded: Recorded settings.
        methods: Names of methods; ``all`` for every one.
        changes: Parameter -> value.

    Raises:
        InputError: A method is unknown; the message lists the valid ones.
    """
    names = METHOD_NAMES if ALL_METHODS in methods else tuple(dict.fromkeys(methods))
    own = recorded.control.extra_methods
    for name in names:
        if name not in (*METHOD_NAMES, *own) and not is_import_path(name):
            valid = ", ".join((ALL_METHODS, *METHOD_NAMES, *own, "package.module:name"))
            raise InputError(f"unknown method '{name}'; valid: {valid}")
    rest = ", ".join(f"{name}={_shown(value)}" for name, value in changes.items())
    variants = [Variant(f"{name}, {rest}" if rest else name, {"method": name, **changes}) for name in names]
    variants = variants or [Variant(rest, dict(changes))]
    return tuple(variant for variant in variants if recorded.with_values(variant.changes) != recorded)


def _shown(value: Value) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(entry) for entry in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def ground_truth_of(path: Path, node: str) -> GroundTruth | None:
    """The reference trajectory: the one stored beside the recording, otherwise the recorded targets."""
    if (stored := stored_truth(path)) is not None:
        return stored
    run = load_run(path, node)
    return ground_truth_from_targets(run.targets, run.base_frame)


def compare(
    opened: SourceFactory, variants: Sequence[Variant], truth: GroundTruth | None, jobs: int
) -> list[VariantMetrics]:
    """Simulates every variant.

    Args:
        opened: Opens the source; called once per variant, in another process when ``jobs`` > 1.
        variants: Settings to simulate.
        truth: Reference trajectory for tracking errors; None for none.
        jobs: Number of processes.

    Returns:
        Metrics in the order of the variants.
    """
    work = [(opened, variant, truth) for variant in variants]
    if jobs == 1:
        return [_run(*entry) for entry in work]
    with ProcessPoolExecutor(min(jobs, len(work)), get_context("fork")) as pool:
        return list(pool.map(_run, *zip(*work, strict=True)))


def _run(opened: SourceFactory, variant: Variant, truth: GroundTruth | None) -> VariantMetrics:
    source = opened()
    with infrequent_gc():
        return metrics_of(source, variant, simulate(source, variant.changes), truth)


def metrics_of(source: CallSource, variant: Variant, run: SimulatedRun, truth: GroundTruth | None) -> VariantMetrics:
    """Metrics of a closed-loop run; raises InputError when it has no Step."""
    steps = run.steps
    if not steps:
        raise InputError(f"the run '{variant.name}' has no control step")
    settings = source.initial_settings.with_values(variant.changes)
    robot = source.robot()
    velocity = np.array([step.joint_velocity for step in steps])
    energy = _energies(robot, steps)
    scale = _finite([step.scale for step in steps])
    clearance = _finite([step.clearance for step in steps])
    position, orientation = _errors(run, truth)
    speed = np.abs(velocity).max(axis=0)
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz).velocity
    return VariantMetrics(
        name=variant.name,
        method=str(settings.control.method),
        steps=len(steps),
        position_rms_mm=1e3 * _rms(position),
        position_max_mm=1e3 * _max(position),
        orientation_rms_mrad=1e3 * _rms(orientation),
        orientation_max_mrad=1e3 * _max(orientation),
        energy_mean_j=float(energy.mean()) if len(energy) else float("nan"),
        energy_max_j=_max(energy),
        clearance_min_mm=1e3 * float(clearance.min()) if len(clearance) else float("inf"),
        scale_min=float(scale.min()) if len(scale) else float("nan"),
        scaled_percent=100.0 * float((scale < 1.0).mean()) if len(scale) else float("nan"),
        peak_speed_percent=100.0 * float((speed / limits).max()),
        peak_speed=float(speed.max()),
        faults=sum(step.status.level is Level.ERROR for step in steps),
        refused=run.refused,
    )


def compare_open_loop(opened: Callable[[], RecordingSource], variants: Sequence[Variant]) -> list[OpenLoopMetrics]:
    """Compares the commands of every variant on the recorded joint states with the recorded commands."""
    source = opened()
    steps = [source.steps.step(entry.step) for entry in calls(source) if entry.step is not None]
    recorded = {step.now: step.joint_velocity for step in steps}
    result = []
    for variant in variants:
        both = [step for step in open_loop(opened(), variant.changes) if step.now in recorded]
        apart = np.array([step.joint_velocity - recorded[step.now] for step in both]).ravel()
        result.append(OpenLoopMetrics(variant.name, len(both), _rms(apart), _max(np.abs(apart))))
    return result


def _energies(robot: Robot, steps: Sequence[Step]) -> Array:
    """Kinetic energies, J, of the Steps that have a measured position."""
    states = ((step.joint_position, step.joint_velocity) for step in steps)
    return np.array([robot.kinetic_energy(q, qd) for q, qd in states if isfinite(q[0])])


def _errors(run: SimulatedRun, truth: GroundTruth | None) -> tuple[Array, Array]:
    """Distances, m, and angles, rad, between measured and reference pose at the same time, after :data:`SETTLE_S`.

    With a tolerance what exceeds it, as in reports.
    """
    if truth is None:
        return np.zeros(0), np.zeros(0)
    both = zip(run.steps, run.tasks, strict=True)
    kept = [(step, task) for step, task in both if np.isfinite(step.pose_sb[0, 0])]
    ros_ns = np.array(
        [step.now.ros_ns - (step.now.monotonic_ns - step.state_time_ns) for step, _ in kept], dtype=np.int64
    )
    inside = (ros_ns >= truth.ros_ns[0] + round(SETTLE_S * NS)) & (ros_ns <= truth.ros_ns[-1])
    kept = [entry for entry, counts in zip(kept, inside.tolist(), strict=True) if counts]
    if not kept:
        return np.zeros(0), np.zeros(0)
    reference = truth.at(ros_ns[inside])
    measured = np.array([step.pose_sb for step, _ in kept])
    quaternion = np.array([quaternion_from_rotation(pose[:3, :3]) for pose in measured])
    position = np.linalg.norm(measured[:, :3, 3] - reference.position, axis=1)
    orientation = rotation_angle(quaternion, reference.quaternion)
    for row, (_, task) in enumerate(kept):
        tolerance = TaskTolerance(task.tolerance, task.frame)
        if not tolerance.is_exact:
            target = pose_from(reference.position[row], reference.quaternion[row])
            position[row], orientation[row] = excess(tolerance, measured[row], target)
    return position, orientation


def _finite(values: Sequence[float]) -> Array:
    array = np.array(values, dtype=np.float64)
    return np.asarray(array[np.isfinite(array)])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _max(values: Array) -> float:
    return float(values.max()) if len(values) else float("nan")
