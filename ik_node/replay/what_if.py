"""Runs with other settings beside each other, in figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from math import isfinite
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Level, Step
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array
from ik_node.recording.call_log import RecordedCalls
from ik_node.recording.run_reader import load_run
from ik_node.replay.call_source import Source, calls
from ik_node.replay.closed_loop import Simulated, open_loop, simulate
from ik_node.replay.gc_pause import seldom_collecting
from ik_node.report.ground_truth import FILE_NAME, Truth, read_truth, rotation_angle, truth_from_targets
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import METHODS, Settings, Value

SETTLE_S = 1.0
"""Errors count from so long after the first target on: the way to it is not tracking."""


Opened = Callable[[], Source]


class Variant(NamedTuple):
    """Settings to try."""

    name: str
    changes: Mapping[str, Value]
    """Parameter by full name -> value, on top of the recorded ones."""


RECORDED = Variant("recorded", {})
"""The settings of the recording, run the same way as the others."""


@dataclasses.dataclass(frozen=True)
class Figures:
    """What came of one closed-loop run. NaN: nothing to measure it by."""

    name: str
    method: str
    ticks: int
    position_rms_mm: float
    position_max_mm: float
    orientation_rms_mrad: float
    orientation_max_mrad: float
    energy_mean_j: float
    """Kinetic energy 1/2 qd' M qd of the commands, mean over the ticks."""
    energy_max_j: float
    clearance_min_mm: float
    """To the nearest obstacle or between own links; inf where nothing is watched."""
    scale_min: float
    """Smallest s: part of the twist that the limits let through."""
    scaled_percent: float
    """Ticks with s < 1."""
    peak_speed_percent: float
    """Of the joint that comes nearest to its velocity limit."""
    peak_speed: float
    """Fastest joint, rad/s (m/s)."""
    faults: int
    """Ticks whose status was an error."""
    refused: int
    """Targets that were not taken."""


class OpenLoop(NamedTuple):
    """Commands on the recorded joint states beside the recorded commands; nothing moves."""

    name: str
    ticks: int
    """At which both command."""
    difference_rms: float
    """Of the joint velocities, rad/s (m/s)."""
    difference_max: float


def variants(recorded: Settings, methods: Sequence[str], changes: Mapping[str, Value]) -> tuple[Variant, ...]:
    """One per method (``all``: every method), each with ``changes``; without those that are as recorded.

    InputError with the valid methods when one is unknown.
    """
    wanted = METHODS if "all" in methods else tuple(dict.fromkeys(methods))
    for name in wanted:
        if name not in METHODS:
            raise InputError(f"unknown method '{name}'; valid: all, {', '.join(METHODS)}")
    rest = ", ".join(f"{name}={_shown(value)}" for name, value in changes.items())
    found = [Variant(f"{name}, {rest}" if rest else name, {"method": name, **changes}) for name in wanted]
    tried = found or [Variant(rest, dict(changes))]
    return tuple(variant for variant in tried if recorded.with_values(variant.changes) != recorded)


def parsed(assignment: str) -> tuple[str, Value]:
    """``name=value``, the value as YAML has it, as a parameter and its value.

    Raises InputError when it is no assignment, SettingsError when there is no such parameter or value.
    """
    name, equals, text = assignment.partition("=")
    try:
        value = yaml.safe_load(text) if equals else None
    except yaml.YAMLError:
        value = None
    if value is None:
        raise InputError(f"'{assignment}' is no assignment; expected NAME=VALUE")
    return name, Settings().with_values({name: value}).flat()[name]


def _shown(value: Value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def truth_of(path: Path, node: str) -> Truth | None:
    """What the tool should have done: the trajectory that lies beside the recording, else the recorded targets."""
    folder = path.resolve() if path.is_dir() else path.resolve().parent
    beside = folder.parent / FILE_NAME
    if beside.is_file():
        return read_truth(beside)
    run = load_run(path, node)
    return truth_from_targets(run.targets, run.base_frame)


def compare(opened: Opened, wanted: Sequence[Variant], truth: Truth | None, jobs: int) -> list[Figures]:
    """Figures of every variant, on ``jobs`` processes at once.

    ``opened`` gives the source anew at every call, in another process too.
    """
    work = [(opened, variant, truth) for variant in wanted]
    if jobs == 1:
        return [_run(*entry) for entry in work]
    with ProcessPoolExecutor(min(jobs, len(work)), get_context("fork")) as pool:
        return list(pool.map(_run, *zip(*work, strict=True)))


def _run(opened: Opened, variant: Variant, truth: Truth | None) -> Figures:
    source = opened()
    with seldom_collecting():
        return figures(source, variant, simulate(source, variant.changes), truth)


def figures(source: Source, variant: Variant, run: Simulated, truth: Truth | None) -> Figures:
    """What there is to say of a closed-loop run; InputError when it has no tick."""
    steps = run.steps
    if not steps:
        raise InputError(f"the run '{variant.name}' has no tick")
    settings = source.begins_with.with_values(variant.changes)
    robot = source.robot()
    velocity = np.array([step.joint_velocity for step in steps])
    energy = _energies(robot, steps)
    scale = _finite([step.scale for step in steps])
    clearance = _finite([step.clearance for step in steps])
    position, orientation = _errors(steps, truth)
    speed = np.abs(velocity).max(axis=0)
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz).velocity
    return Figures(
        name=variant.name,
        method=str(settings.control.method),
        ticks=len(steps),
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


def compare_open_loop(opened: Callable[[], RecordedCalls], wanted: Sequence[Variant]) -> list[OpenLoop]:
    """Commands of every variant on the recorded joint states, beside the recorded ones."""
    source = opened()
    steps = [source.steps.step(event.step) for event in calls(source) if event.step is not None]
    recorded = {step.now: step.joint_velocity for step in steps}
    found = []
    for variant in wanted:
        both = [step for step in open_loop(opened(), variant.changes) if step.now in recorded]
        apart = np.array([step.joint_velocity - recorded[step.now] for step in both]).ravel()
        found.append(OpenLoop(variant.name, len(both), _rms(apart), _max(np.abs(apart))))
    return found


def _energies(robot: Robot, steps: Sequence[Step]) -> Array:
    """Of the ticks that have a measured position."""
    moments = ((step.joint_position, step.joint_velocity) for step in steps)
    return np.array([robot.kinetic_energy(q, qd) for q, qd in moments if isfinite(q[0])])


def _errors(steps: Sequence[Step], truth: Truth | None) -> tuple[Array, Array]:
    """Distances, m, and angles, rad, of the measured tool from the truth at the same time, once settled."""
    if truth is None:
        return np.zeros(0), np.zeros(0)
    kept = [step for step in steps if np.isfinite(step.pose_sb[0, 0])]
    ros_ns = np.array([step.now.ros_ns - (step.now.monotonic_ns - step.state_time_ns) for step in kept], dtype=np.int64)
    inside = (ros_ns >= truth.ros_ns[0] + round(SETTLE_S * NS)) & (ros_ns <= truth.ros_ns[-1])
    kept = [step for step, counts in zip(kept, inside.tolist(), strict=True) if counts]
    if not kept:
        return np.zeros(0), np.zeros(0)
    wanted = truth.at(ros_ns[inside])
    position = np.array([step.pose_sb[:3, 3] for step in kept])
    quaternion = np.array([quaternion_from_rotation(step.pose_sb[:3, :3]) for step in kept])
    return np.linalg.norm(position - wanted.position, axis=1), rotation_angle(quaternion, wanted.quaternion)


def _finite(values: Sequence[float]) -> Array:
    array = np.array(values, dtype=np.float64)
    return np.asarray(array[np.isfinite(array)])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _max(values: Array) -> float:
    return float(values.max()) if len(values) else float("nan")
