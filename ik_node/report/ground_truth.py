"""What the tool should have done: a trajectory sampled densely on the clock of ROS, kept beside a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Trajectory
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.run import Targets

FILE_NAME = "trajectory.csv"
"""The truth's usual name in a recording's folder."""
HEADER = "ros_ns,x,y,z,qx,qy,qz,qw"
RATE_HZ = 500.0
"""Samples per second of a stored truth: at 0.3 m/s2 straight lines between them are within 0.15 um of the curve."""


class Poses(NamedTuple):
    """Many poses at once."""

    position: Array
    """(m, 3), m."""
    quaternion: Array
    """(m, 4) x, y, z, w, of unit norm."""


@dataclass(frozen=True)
class Truth:
    """Dense samples of a motion; straight lines and shortest turns between them, held at both ends."""

    ros_ns: NDArray[np.int64]
    """(m,), not decreasing."""
    position: Array
    """(m, 3), m."""
    quaternion: Array
    """(m, 4) x, y, z, w, of unit norm; neighbours on the same side."""
    source: str = "trajectory"
    """What errors against it are called after."""

    def __post_init__(self) -> None:
        count = len(self.ros_ns)
        if self.position.shape != (count, 3) or self.quaternion.shape != (count, 4) or count < 2:
            raise InputError(f"a truth of {count} samples has positions {self.position.shape}, {self.quaternion.shape}")
        if (np.diff(self.ros_ns) < 0).any() or self.ros_ns[0] == self.ros_ns[-1]:
            raise InputError("the samples of a truth go forward in time")
        if not (np.isfinite(self.position).all() and np.isfinite(self.quaternion).all()):
            raise InputError("the samples of a truth are finite")

    def at(self, ros_ns: NDArray[np.int64], lag_s: float = 0.0) -> Poses:
        """Poses at these moments (m,), each ``lag_s`` earlier."""
        # Differences of integers first: nanoseconds since 1970 do not fit into a double.
        wanted = (ros_ns - self.ros_ns[0]) / NS - lag_s
        times = (self.ros_ns - self.ros_ns[0]) / NS
        index = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, len(times) - 2)
        step = times[index + 1] - times[index]
        u = np.clip((wanted - times[index]) / np.where(step > 0.0, step, 1.0), 0.0, 1.0)[:, None]
        position = (1.0 - u) * self.position[index] + u * self.position[index + 1]
        return Poses(position, _slerp(self.quaternion[index], self.quaternion[index + 1], u))


def truth_from(trajectory: Trajectory, start_ros_ns: int, rate_hz: float = RATE_HZ) -> Truth:
    """Samples ``trajectory``, whose time 0 is ``start_ros_ns``."""
    count = max(round(trajectory.duration_s * rate_hz), 1) + 1
    times = np.linspace(0.0, trajectory.duration_s, count)
    poses = [trajectory.pose(time) for time in times.tolist()]
    quaternions = np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses])
    ros_ns = start_ros_ns + np.round(times * NS).astype(np.int64)
    return Truth(ros_ns, np.array([pose[:3, 3] for pose in poses]), _one_sided(quaternions))


def truth_from_targets(targets: Targets, base_frame: str) -> Truth | None:
    """The poses that were streamed, as a stand-in where nobody kept the trajectory; None when there are not two.

    Refused ones and those of other frames are left out. A stamp of 0 counts as the arrival.
    """
    norm = np.linalg.norm(targets.quaternion_xyzw, axis=1)
    usable = np.isfinite(targets.position).all(axis=1) & (np.abs(norm - 1.0) < se3.ROTATION_TOLERANCE)
    usable &= np.array([frame in ("", base_frame) for frame in targets.frame_ids], dtype=bool)
    stamps = np.where(targets.stamp_ns == 0, targets.received_ros_ns, targets.stamp_ns)[usable]
    if len(stamps) < 2 or stamps.min() == stamps.max():
        return None
    order = np.argsort(stamps, kind="stable")
    quaternions = (targets.quaternion_xyzw / norm[:, None])[usable][order]
    return Truth(stamps[order], targets.position[usable][order], _one_sided(quaternions), "recorded targets")


def write_truth(path: str | Path, trajectory: Trajectory | Truth, start_ros_ns: int = 0) -> Truth:
    """Stores a truth, or a trajectory that began at ``start_ros_ns``, as CSV, and returns it.

    Refuses to overwrite: RecordingError, as when the file cannot be written.
    """
    truth = trajectory if isinstance(trajectory, Truth) else truth_from(trajectory, start_ros_ns)
    try:
        with Path(path).open("x", encoding="utf-8") as file:
            file.write(HEADER + "\n")
            for stamp, position, quaternion in zip(truth.ros_ns, truth.position, truth.quaternion, strict=True):
                file.write(",".join([str(stamp), *(f"{value:.12g}" for value in (*position, *quaternion))]) + "\n")
    except OSError as error:
        raise RecordingError(f"the trajectory cannot be written: {error}") from error
    return truth


def read_truth(path: str | Path) -> Truth:
    """Reads what :func:`write_truth` wrote; RecordingError when it is something else."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"the trajectory cannot be read: {error}") from error
    if not lines or lines[0].strip() != HEADER:
        raise RecordingError(f"{path} is no trajectory of a run; its first line is not {HEADER}")
    try:
        rows = [line.split(",") for line in lines[1:] if line.strip()]
        stamps = np.array([int(row[0]) for row in rows], dtype=np.int64)
        numbers = np.array([[float(text) for text in row[1:]] for row in rows], dtype=np.float64).reshape(-1, 7)
        quaternions = numbers[:, 3:] / np.linalg.norm(numbers[:, 3:], axis=1, keepdims=True)
        return Truth(stamps, numbers[:, :3], _one_sided(quaternions))
    except (ValueError, IndexError) as error:
        raise RecordingError(f"{path} is no trajectory of a run: {error}") from error


def rotation_angle(first: Array, second: Array) -> Array:
    """Angle (m,) in rad between the orientations of unit quaternions (m, 4); accurate near 0 and near pi."""
    sign = np.where((first * second).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    apart, together = np.linalg.norm(first - sign * second, axis=1), np.linalg.norm(first + sign * second, axis=1)
    result: Array = 4.0 * np.arctan2(apart, together)
    return result


def _one_sided(quaternions: Array) -> Array:
    """The same orientations with neighbours on the same side of the sphere."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    result: Array = quaternions * np.concatenate(([1.0], np.cumprod(flips)))[:, None]
    return result


def _slerp(first: Array, second: Array, u: Array) -> Array:
    cosine = np.clip((first * second).sum(axis=1, keepdims=True), -1.0, 1.0)
    angle = np.arccos(cosine)
    small = angle < 1e-3
    sine = np.where(small, 1.0, np.sin(angle))
    before = np.where(small, 1.0 - u, np.sin((1.0 - u) * angle) / sine)
    after = np.where(small, u, np.sin(u * angle) / sine)
    mixed = before * first + after * second
    result: Array = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
    return result
