"""A recorded run as arrays over ticks: what the report, the viewer and the tests read.

Rows of every array belong together: row i is tick i of the recording. Where a tick computed nothing (a stopped one)
its floats are NaN. Twists: linear part first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.step import Status
from ik_node.math.types import Array
from ik_node.settings.groups import Value


class StatusChange(NamedTuple):
    """From this moment on the controller was in ``status``."""

    time_s: float
    """On the axis of ``Run.times_s``."""
    status: Status


class Targets(NamedTuple):
    """Every target pose that arrived, refused ones too, as received."""

    times_s: Array
    """Arrival, (m,), on the axis of ``Run.times_s``."""
    received_ros_ns: NDArray[np.int64]
    """Arrival in ROS time, (m,)."""
    stamp_ns: NDArray[np.int64]
    """Header stamps, (m,); 0 meant "now"."""
    position: Array
    """(m, 3), m."""
    quaternion_xyzw: Array
    """(m, 4), unchecked."""
    frame_ids: tuple[str, ...]


class Run(NamedTuple):
    """One recording; k ticks, n joints."""

    robot: str
    """Name of the robot, or empty when it came as a URDF."""
    urdf: str
    joints: tuple[str, ...]
    lower: Array
    """Position limits in force at the start, (n,), rad (m); infinite where there is none."""
    upper: Array
    velocity_limits: Array
    """In force at the start, (n,), rad/s (m/s); infinite where there is none."""
    base_frame: str
    tip_frame: str
    settings: Mapping[str, Value]
    """Every parameter by full name at the start of the recording."""
    setting_changes: tuple[tuple[float, Mapping[str, Value]], ...]
    """(time_s, parameters by full name) of each later change."""
    versions: Mapping[str, str]
    """Distribution name -> version of what made the run."""

    tick: NDArray[np.int64]
    """Running number since configuration, (k,); a gap means that the recording lost ticks."""
    times_s: Array
    """When each tick was made, (k,), s from the first one, on the steady clock."""
    ros_ns: NDArray[np.int64]
    """The same moments in ROS time, (k,)."""
    state_times_s: Array
    """When ``q`` held, (k,), on the axis of ``times_s``."""
    state_ros_ns: NDArray[np.int64]
    """When ``q`` held, in ROS time, (k,)."""
    q: Array
    """Measured joint positions, (k, n), rad (m)."""
    joint_velocity: Array
    """The command, (k, n), rad/s (m/s)."""
    pose_sb: Array
    """Tool poses, (k, 4, 4)."""
    pose_sd: Array
    """Desired poses at ``state_times_s``, (k, 4, 4)."""
    error_b: Array
    """log(T_bd), (k, 6), m and rad."""
    feedforward_b: Array
    """Ad(T_bd) V_d, (k, 6), m/s and rad/s."""
    twist_b: Array
    """V, (k, 6)."""
    lost_b: Array
    """V - V_f, (k, 6)."""
    scale: Array
    """s, (k,)."""
    multiplier_task: Array
    """(k, 6)."""
    multiplier_potential: Array
    """(k, 6)."""
    singular_values: Array
    """Descending, (k, min(6, n)), m."""
    progress: Array
    """Part of the path that has been gone through, (k,)."""
    path_distance: Array
    """Distance of the tool point from the path, (k,), m."""
    clearance: Array
    """Distance of the closest pair, (k,), m."""
    closest_points: Array
    """Where that is, in the base frame, (k, 2, 3), m."""
    closest_pair: tuple[tuple[str, ...], ...]
    """Its names, per tick."""
    binding: tuple[tuple[str, ...], ...]
    """Names of the limits that bound, per tick."""
    status: tuple[Status, ...]
    """Per tick."""
    statuses: tuple[StatusChange, ...]
    """The changes of ``status`` only."""
    targets: Targets

    dropped: int
    """Messages that the writer had to leave out, as far as the recording says."""
    complete: bool
    """Closed by its writer; False when it was cut off."""
