"""Recorded poses of a file as a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError, TrajectoryFileError, one_line
from ik_node.interfaces.clock import NS
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.trajectory.pose_file_format import DEFAULT_DURATION_S, PoseFileFormat
from ik_node.trajectory.pose_reader import PoseSamples, read_poses
from ik_node.trajectory.sampled import SampledTrajectory


class PoseFileTrajectory(SampledTrajectory):
    """The trajectory of a file, interpolated by :class:`SampledTrajectory`."""

    def __init__(self, times_s: Array, poses: Array, description: str) -> None:
        super().__init__(times_s, poses)
        self._description = description

    def describe(self) -> str:
        """One printable line with the columns, units and times that were read."""
        return one_line(self._description)


class PoseFile(NamedTuple):
    """A file that has been read and checked; the trajectory needs the start pose of the arm only."""

    samples: PoseSamples
    file_format: PoseFileFormat
    times_s: Array
    """Times of all samples (N,), from 0."""
    used: slice
    """The samples between the times ``start_s`` and ``end_s`` of the format."""
    timing: str
    """Origin of the times, if the file has none."""

    def missing(self) -> tuple[str, ...]:
        """Parts of a pose that the file does not have, "z" and "orientation"."""
        parts = (("z", self.samples.position.shape[1] == 3), ("orientation", self.samples.rotation is not None))
        return tuple(name for name, is_there in parts if not is_there)

    def trajectory(self, start_pose: Array | None = None) -> PoseFileTrajectory:
        """The trajectory.

        Args:
            start_pose: Start pose T_sb of the arm (4, 4), for ``relative`` and for parts that the file does not have.

        Raises:
            TrajectoryFileError: A start pose is needed, and none is given.
        """
        start = None if start_pose is None else se3.checked_pose(start_pose, "start_pose")
        name = self.samples.name
        if self.missing() and start is None:
            raise TrajectoryFileError(f"{name} holds no {' and no '.join(self.missing())}, and no start pose was given")
        poses = np.tile(np.eye(4) if start is None else start, (len(self.times_s), 1, 1))
        poses[:, : self.samples.position.shape[1], 3] = self.samples.position
        if self.samples.rotation is not None:
            poses[:, :3, :3] = self.samples.rotation
        times, poses = self.times_s[self.used] - self.times_s[self.used][0], poses[self.used]
        _place(poses, self.file_format, start, name)
        try:
            return PoseFileTrajectory(times, poses, self._description(times))
        except InputError as error:
            raise TrajectoryFileError(f"{name}: {error}") from error

    def _description(self, times_s: Array) -> str:
        parts = [f"{len(times_s)} samples over {times_s[-1]:.4g} s", self.timing, *self.samples.description]
        parts += ["z held"] if "z" in self.missing() else []
        parts += ["relative to the start pose"] if self.file_format.relative else []
        return f"{self.samples.name}: " + "; ".join(filter(None, parts))


def read(path: str | Path, file_format: PoseFileFormat | None = None) -> PoseFile:
    """Reads and checks a file.

    Args:
        path: The file, or the folder of a bag.
        file_format: Format of the file; default: detected.

    Raises:
        TrajectoryFileError: As :func:`~ik_node.trajectory.pose_reader.read_poses`; or no motion is within the times
            ``start_s`` and ``end_s``.
        RecordingError: The file is a bag that cannot be read.
    """
    file_format = file_format or PoseFileFormat()
    samples = read_poses(path, file_format)
    times_s, timing = _times(samples, file_format)
    return PoseFile(samples, file_format, times_s, _window(times_s, file_format, samples.name), timing)


def load(
    path: str | Path, file_format: PoseFileFormat | None = None, start_pose: Array | None = None
) -> PoseFileTrajectory:
    """The trajectory of a file: :func:`read`, then :meth:`PoseFile.trajectory`, with their arguments and errors."""
    return read(path, file_format).trajectory(start_pose)


def _times(samples: PoseSamples, file_format: PoseFileFormat) -> tuple[Array, str]:
    """Times from the first sample (N,) [s], and how they were obtained."""
    given_s = file_format.duration_s
    if samples.stamps_ns is None:
        duration_s = DEFAULT_DURATION_S if given_s is None else given_s
        origin = "no time in the file" if given_s is None else "as asked"
        count = len(samples.position)
        return np.linspace(0.0, duration_s, count), f"evenly spaced over {duration_s:g} s ({origin})"
    times: Array = (samples.stamps_ns - samples.stamps_ns[0]) / NS
    return (times, "") if given_s is None else (times * (given_s / times[-1]), f"played in {given_s:g} s")


def _window(times: Array, file_format: PoseFileFormat, name: str) -> slice:
    length_s = float(times[-1])
    if file_format.end_s is not None and file_format.end_s > length_s:
        raise TrajectoryFileError(
            f"{name}: --end {file_format.end_s:g} has no effect: the motion ends at {length_s:.6g} s"
        )
    end_s = length_s if file_format.end_s is None else file_format.end_s
    first, last = int(np.searchsorted(times, file_format.start_s)), int(np.searchsorted(times, end_s, side="right"))
    if last - first < 2 or times[first] == times[last - 1]:
        raise TrajectoryFileError(
            f"{name}: no motion between --start {file_format.start_s:g} and --end {end_s:g}; it lasts {times[-1]:.4g} s"
        )
    return slice(first, last)


def _place(poses: Array, file_format: PoseFileFormat, start: Array | None, name: str) -> None:
    """Scales the poses, moves them onto the start pose and by the offset, in place."""
    first = poses[0].copy()
    poses[:, :3, 3] = first[:3, 3] + file_format.scale * (poses[:, :3, 3] - first[:3, 3])
    if file_format.relative:
        if start is None:
            raise TrajectoryFileError(f"{name}: relative needs the arm's start pose")
        poses[:, :3, 3] += start[:3, 3] - first[:3, 3]
        poses[:, :3, :3] = poses[:, :3, :3] @ (first[:3, :3].T @ start[:3, :3])
    poses[:, :3, 3] += file_format.offset
