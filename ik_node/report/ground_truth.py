"""Ground truth of a run: the desired tool trajectory, densely sampled in ROS time, stored beside the recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import InputError, RecordingError, TrajectoryFileError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Trajectory
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.run import RecordedTargets
from ik_node.trajectory.pose_file_format import PoseFileFormat
from ik_node.trajectory.pose_reader import read_poses

GROUND_TRUTH_FILE = "trajectory.csv"
"""File name of the ground truth in the folder of a run."""
HEADER = "ros_ns,x,y,z,qx,qy,qz,qw"
RATE_HZ = 500.0
"""Sampling rate of a stored ground truth: at 0.3 m/s2 linear interpolation is within 0.15 um of the curve."""


class Poses(NamedTuple):
    """Poses as arrays."""

    position: Array
    """(m, 3), m."""
    quaternion: Array
    """(m, 4) x, y, z, w, of unit norm."""


@dataclass(frozen=True)
class GroundTruth:
    """Densely sampled poses; interpolated linearly (Slerp for the orientation), constant before and after."""

    ros_ns: NDArray[np.int64]
    """ROS time, (m,), not decreasing."""
    position: Array
    """(m, 3), m."""
    quaternion: Array
    """(m, 4) x, y, z, w, of unit norm; neighbours with a positive scalar product."""
    source: str = "trajectory"
    """Name of the reference in the report."""

    def __post_init__(self) -> None:
        count = len(self.ros_ns)
        if self.position.shape != (count, 3) or self.quaternion.shape != (count, 4) or count < 2:
            raise InputError(
                f"{count} stamps do not match position {self.position.shape} and quaternion {self.quaternion.shape}"
            )
        if (np.diff(self.ros_ns) < 0).any() or self.ros_ns[0] == self.ros_ns[-1]:
            raise InputError("the stamps of a ground truth must not decrease and must span some time")
        if not (np.isfinite(self.position).all() and np.isfinite(self.quaternion).all()):
            raise InputError("the samples of a ground truth must be finite")

    def at(self, ros_ns: NDArray[np.int64], lag_s: float = 0.0) -> Poses:
        """Interpolated poses.

        Args:
            ros_ns: ROS times, (m,).
            lag_s: Subtracted from each time.
        """
        # Differences of integers first: a double cannot represent nanoseconds since 1970.
        query = (ros_ns - self.ros_ns[0]) / NS - lag_s
        times = (self.ros_ns - self.ros_ns[0]) / NS
        index = np.clip(np.searchsorted(times, query, side="right") - 1, 0, len(times) - 2)
        step = times[index + 1] - times[index]
        u = np.clip((query - times[index]) / np.where(step > 0.0, step, 1.0), 0.0, 1.0)[:, None]
        position = (1.0 - u) * self.position[index] + u * self.position[index + 1]
        return Poses(position, _slerp(self.quaternion[index], self.quaternion[index + 1], u))


def ground_truth_from_trajectory(trajectory: Trajectory, start_ros_ns: int, rate_hz: float = RATE_HZ) -> GroundTruth:
    """Samples a trajectory.

    Args:
        trajectory: Desired tool motion.
        start_ros_ns: ROS time at which the trajectory's time is 0.
        rate_hz: Samples per second.
    """
    count = max(round(trajectory.duration_s * rate_hz), 1) + 1
    times = np.linspace(0.0, trajectory.duration_s, count)
    poses = [trajectory.pose(time) for time in times.tolist()]
    quaternions = np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses])
    ros_ns = start_ros_ns + np.round(times * NS).astype(np.int64)
    return GroundTruth(ros_ns, np.array([pose[:3, 3] for pose in poses]), _continuous(quaternions))


def ground_truth_from_targets(targets: RecordedTargets, base_frame: str) -> GroundTruth | None:
    """The recorded targets as ground truth, for a run without a stored trajectory.

    Args:
        targets: All received target poses. Invalid poses and those in other frames are skipped; the arrival time
            replaces a stamp of 0.
        base_frame: Name of the base frame.

    Returns:
        None if fewer than two usable targets, or targets of one instant only, were recorded.
    """
    norm = np.linalg.norm(targets.quaternion_xyzw, axis=1)
    usable = np.isfinite(targets.position).all(axis=1) & (np.abs(norm - 1.0) < se3.ROTATION_TOLERANCE)
    usable &= np.array([frame in ("", base_frame) for frame in targets.frame_ids], dtype=bool)
    stamps = np.where(targets.stamp_ns == 0, targets.received_ros_ns, targets.stamp_ns)[usable]
    if len(stamps) < 2 or stamps.min() == stamps.max():
        return None
    order = np.argsort(stamps, kind="stable")
    quaternions = (targets.quaternion_xyzw / norm[:, None])[usable][order]
    return GroundTruth(stamps[order], targets.position[usable][order], _continuous(quaternions), "recorded targets")


def write_ground_truth(path: str | Path, trajectory: Trajectory | GroundTruth, start_ros_ns: int = 0) -> GroundTruth:
    """Stores a ground truth, or a trajectory that began at ``start_ros_ns``, as CSV, and returns the ground truth.

    Raises:
        RecordingError: The file exists or cannot be written.
    """
    truth = (
        trajectory if isinstance(trajectory, GroundTruth) else ground_truth_from_trajectory(trajectory, start_ros_ns)
    )
    try:
        with Path(path).open("x", encoding="utf-8") as file:
            file.write(HEADER + "\n")
            for stamp, position, quaternion in zip(truth.ros_ns, truth.position, truth.quaternion, strict=True):
                file.write(",".join([str(stamp), *(f"{value:.12g}" for value in (*position, *quaternion))]) + "\n")
    except OSError as error:
        raise RecordingError(f"the trajectory cannot be written: {error}") from error
    return truth


def read_ground_truth(path: str | Path, file_format: PoseFileFormat | None = None) -> GroundTruth:
    """Reads a ground truth.

    Args:
        path: A file of :func:`write_ground_truth`, or any file of poses with times in ROS time.
        file_format: Format of the file; default: detected.

    Raises:
        TrajectoryFileError: The file cannot be read as poses, or has no times, no orientation or no z.
        RecordingError: The file is a bag that cannot be read.
    """
    own = Path(path).name == GROUND_TRUTH_FILE and not (file_format and file_format.given())
    samples = read_poses(path, PoseFileFormat(units="m") if own else file_format)
    if samples.stamps_ns is None or samples.rotation is None or samples.position.shape[1] != 3:
        parts = (
            ("time", samples.stamps_ns is None),
            ("orientation", samples.rotation is None),
            ("z", samples.position.shape[1] != 3),
        )
        missing = " and no ".join(name for name, is_missing in parts if is_missing)
        raise TrajectoryFileError(f"{path} is no ground truth: it holds no {missing}")
    quaternions = np.array([se3.quaternion_from_rotation(rotation) for rotation in samples.rotation])
    return GroundTruth(samples.stamps_ns, samples.position, _continuous(quaternions), Path(path).stem)


def rotation_angle(first: Array, second: Array) -> Array:
    """Angles between orientations, accurate near 0 and near pi.

    Args:
        first: Unit quaternions, (m, 4).
        second: Unit quaternions, (m, 4), in the same order of components.

    Returns:
        (m,), rad: 4 atan2(|p - q|, |p + q|) with the sign of q for which the scalar product is not negative.
    """
    sign = np.where((first * second).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    difference = np.linalg.norm(first - sign * second, axis=1)
    total = np.linalg.norm(first + sign * second, axis=1)
    result: Array = 4.0 * np.arctan2(difference, total)
    return result


def _continuous(quaternions: Array) -> Array:
    """Flips signs so that the scalar product of neighbours is not negative."""
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
