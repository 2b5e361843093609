"""One control tick's outcome: what the command topic, the diagnostics, the recording, the report and the tests all
read."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from ik_node.interfaces.clock import Instant
from ik_node.math.types import Array


class Level(Enum):
    """Severity, numbered as diagnostic_msgs/DiagnosticStatus does."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Mode(Enum):
    """What the controller is doing."""

    WAITING = "waiting"
    """No joint states yet: nothing is commanded."""
    HOLDING = "holding"
    """Closed loop at the last pose."""
    TRACKING = "tracking"
    """Following a target."""
    RAMPING = "ramping"
    """On the way to standstill within the acceleration limits."""
    PAUSED = "paused"
    """At standstill because it was asked to."""
    STOPPED = "stopped"
    """Zeros were sent at once; goes on by itself when the cause is gone."""
    FAULT = "fault"
    """Zeros were sent at once; stays until reset."""


class Status(NamedTuple):
    """What the controller is doing, and why."""

    level: Level
    mode: Mode
    reason: str


class Step(NamedTuple):
    """Everything one tick computed. Twists: linear part first. Arrays of a stopped tick may hold NaN where
    nothing was computed."""

    tick: int
    """Counts from 0 at configuration."""
    now: Instant
    """When the tick was made."""
    state_time_ns: int
    """Monotonic time at which ``joint_position`` held."""
    joint_position: Array
    """Measured q, (n,), rad (m)."""
    joint_velocity: Array
    """The command, (n,), rad/s (m/s): always finite and within the velocity limits."""
    pose_sb: Array
    """Tool pose at q, (4, 4)."""
    pose_sd: Array
    """Desired pose at ``state_time_ns``, (4, 4)."""
    error_b: Array
    """log(T_bd), (6,), m and rad, in {b}."""
    feedforward_b: Array
    """Ad(T_bd) V_d, (6,), in {b}."""
    twist_b: Array
    """V = feed-forward plus feedback, (6,), in {b}."""
    lost_b: Array
    """V - V_f: what a singularity took out of V, (6,), in {b}."""
    scale: float
    """s in [0, 1]: the part of V_f that the limits let through; NaN where no law was at work."""
    multiplier_task: Array
    """First term of lambda, (6,): task-space momentum, N s for a mass-weighted method; not a force."""
    multiplier_potential: Array
    """Second term of lambda, (6,): 1/k times it is a wrench (N, N m) on the tool."""
    singular_values: Array
    """Of J_b with angular rows times the characteristic length, descending, (min(6, n),), m."""
    binding: tuple[str, ...]
    """Names of the limits that bound, e.g. ``velocity panda_joint4``."""
    progress: float
    """Part of a path that has been gone through, 0 to 1; NaN where none is followed."""
    path_distance: float
    """Distance of the tool point from the path, m; NaN where none is followed."""
    clearance: float
    """Distance of the nearest pair of links, or of link and obstacle, m; NaN when not computed."""
    closest_points: Array
    """Where that distance is, in the base frame, (2, 3), m; NaN when not computed."""
    closest_pair: tuple[str, ...]
    """Names of the two; none when not computed."""
    status: Status


def bare_step(
    tick: int, now: Instant, state_time_ns: int, position: Array, pose_sb: Array, velocity: Array, status: Status
) -> Step:
    """A Step that no control law made: what was not computed is NaN."""
    unknown, nothing = np.full(6, np.nan), float("nan")
    return Step(
        tick=tick,
        now=now,
        state_time_ns=state_time_ns,
        joint_position=position,
        joint_velocity=velocity,
        pose_sb=pose_sb,
        pose_sd=np.full((4, 4), np.nan),
        error_b=unknown,
        feedforward_b=unknown,
        twist_b=unknown,
        lost_b=unknown,
        scale=nothing,
        multiplier_task=unknown,
        multiplier_potential=unknown,
        singular_values=np.full(min(6, len(velocity)), np.nan),
        binding=(),
        progress=nothing,
        path_distance=nothing,
        clearance=nothing,
        closest_points=np.full((2, 3), np.nan),
        closest_pair=(),
        status=status,
    )
