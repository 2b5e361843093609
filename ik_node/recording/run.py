"""A recorded run as arrays over control steps, for the report, the viewer and analyses.

Row i of every array and tuple belongs to control step i of the recording. What a stopped controller did not compute is
NaN. Twists: linear components first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.step import Status
from ik_node.math.types import Array
from ik_node.settings.schema import Value


class StatusChange(NamedTuple):
    """Time from which the controller had a status."""

    time_s: float
    """On the axis of ``Run.times_s``."""
    status: Status


class RecordedTargets(NamedTuple):
    """All m received target poses, also the refused ones."""

    times_s: Array
    """Arrival, (m,), on the axis of ``Run.times_s``."""
    received_ros_ns: NDArray[np.int64]
    """Arrival in ROS time, (m,)."""
    stamp_ns: NDArray[np.int64]
    """Header stamps, (m,); 0 means "at arrival"."""
    position: Array
    """(m, 3), m."""
    quaternion_xyzw: Array
    """(m, 4), unchecked."""
    frame_ids: tuple[str, ...]


class CallTimes(NamedTuple):
    """The c calls that a running node makes all the time, joint states and clock calls, and those that end a pause."""

    times_s: Array
    """(c,), on the axis of ``Run.times_s``, in the order in which they were made."""
    resumed: NDArray[np.bool_]
    """Whether the call ends a pause, (c,)."""


class Run(NamedTuple):
    """A recorded run of k control steps and n joints.

    The arrays and numbers of a Step are attributes as well, under their names in Step: ``run.twist_b`` is (k, 6),
    ``run.scale`` is (k,).
    """

    robot: str
    """Name in example-robot-data; empty when the robot was given as URDF."""
    urdf: str
    joints: tuple[str, ...]
    lower: Array
    """Lower position limits at the start, (n,), rad (m); -inf for none."""
    upper: Array
    """Upper position limits, (n,), rad (m); inf for none."""
    velocity_limits: Array
    """(n,), rad/s (m/s); inf for none."""
    base_frame: str
    """Frame {s}."""
    tip_frame: str
    """Frame {b}."""
    settings: Mapping[str, Value]
    """Parameters at the start, by full name."""
    setting_changes: tuple[tuple[float, Mapping[str, Value]], ...]
    """Time on the axis of ``times_s``, and the parameters that were changed."""
    versions: Mapping[str, str]
    """Of this package, its libraries and the platform."""
    tick: NDArray[np.int64]
    """Number of the control step since configuration, (k,); a gap means that steps are missing."""
    times_s: Array
    """Time of the control steps, (k,), on the steady clock; the first is 0."""
    ros_ns: NDArray[np.int64]
    """The same in ROS time, (k,)."""
    state_times_s: Array
    """Time at which the joint positions were measured, (k,), on the axis of ``times_s``."""
    state_ros_ns: NDArray[np.int64]
    """The same in ROS time, (k,)."""
    computing_s: Array
    """Time from the call of the controller until the command was published, (k,), s; NaN where it was not measured."""
    simulated: bool
    """Whether the first joint state names a simulated arm as its source; False also when its source is unknown."""
    columns: Mapping[str, Array]
    """Array or number of a Step -> values, (k, *shape)."""
    texts: Mapping[str, tuple[Any, ...]]
    """Text field of a Step -> value per control step."""
    status_changes: tuple[StatusChange, ...]
    targets: RecordedTargets
    calls: CallTimes
    dropped: int
    """Messages that the writer left out, according to the recording."""
    complete: bool
    """True when the writer closed the recording."""

    def __getattr__(self, name: str) -> Array:
        """An array or number of a Step over the run."""
        if name in self.columns:
            return self.columns[name]
        raise AttributeError(f"Run has no attribute '{name}'")

    def with_columns(self, **columns: Array) -> Run:
        """A copy with other values of some columns, (k, *shape)."""
        return self._replace(columns={**self.columns, **columns})

    @property
    def q(self) -> Array:
        """Measured joint positions, (k, n), rad (m)."""
        return self.columns["joint_position"]

    @property
    def status(self) -> tuple[Status, ...]:
        """Status per control step."""
        return self.texts["status"]

    @property
    def binding(self) -> tuple[tuple[str, ...], ...]:
        """Names of the active limits per control step."""
        return self.texts["binding"]

    @property
    def off_direction_limits(self) -> tuple[tuple[str, ...], ...]:
        """Names of the limits that force the tool off its direction, per control step."""
        return self.texts["off_direction_limits"]

    @property
    def closest_pair(self) -> tuple[tuple[str, ...], ...]:
        """Names of the closest pair per control step."""
        return self.texts["closest_pair"]
