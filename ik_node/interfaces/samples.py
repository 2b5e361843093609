"""Inputs of the controller: decoded messages as plain data, unchecked and in their original frames."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.math.types import Array

MAX_POSES = 2000
"""Poses of a path or points of a trajectory; longer ones are refused. Decoding and preparing them takes about 30 ms."""
FARTHEST_M = 100.0
"""Positions and sizes above this are refused: no arm reaches so far, and numbers of 1e160 overflow when squared."""


class JointSample(NamedTuple):
    """Measured joint positions."""

    stamp_ns: int
    """Header stamp, ROS time; 0 means "now"."""
    names: tuple[str, ...]
    position: Array
    """rad (m), one per name."""


class PoseSample(NamedTuple):
    """A target pose."""

    stamp_ns: int
    """Header stamp, ROS time for which the pose is the target; 0 means "now"."""
    frame_id: str
    position: Array
    """(3,), m, in ``frame_id``."""
    quaternion: Array
    """(4,), x y z w."""


class ObstacleSample(NamedTuple):
    """Addition, change or deletion of one obstacle."""

    stamp_ns: int
    """Header stamp, ROS time at which the pose was valid; 0 means "now"."""
    frame_id: str
    name: str
    action: str
    """``add`` (which also changes), ``delete`` or ``delete_all``."""
    kind: str
    """A key of :data:`ik_node.collision.scene.SIZES`."""
    size: tuple[float, ...]
    """Dimensions, m."""
    position: Array
    """(3,), m, of the centre in ``frame_id``."""
    quaternion: Array
    """(4,), x y z w."""
    lifetime_ns: int
    """The obstacle is removed this long after arrival; 0: never."""


class PathSample(NamedTuple):
    """A path of N poses."""

    frame_ids: tuple[str, ...]
    """Frame of each pose; empty: the frame of the path."""
    stamps_ns: tuple[int, ...]
    """ROS time for which each pose is the target; all equal when the path has no times."""
    positions: Array
    """(N, 3), m."""
    quaternions: Array
    """(N, 4), x y z w."""
    stamp_ns: int = 0
    """Header stamp of the path, ROS time at which its frames are placed; 0 means "now"."""


class TrajectorySample(NamedTuple):
    """N poses with times, and optionally with twists and accelerations."""

    stamp_ns: int
    """Header stamp, ROS time of the start; 0 means "now"."""
    frame_id: str
    times_ns: tuple[int, ...]
    """Times from the start, (N,)."""
    positions: Array
    """(N, 3), m."""
    quaternions: Array
    """(N, 4), x y z w."""
    twists: Array
    """(N, 6) or (0, 6): velocity of the tool point and angular velocity, m/s and rad/s, in the axes of ``frame_id``."""
    accelerations: Array
    """(N, 6) or (0, 6): derivatives of the twists."""


class TwistSample(NamedTuple):
    """A target twist: velocity of the tool point and angular velocity."""

    stamp_ns: int
    """Header stamp, ROS time; 0 means "now"."""
    frame_id: str
    twist: Array
    """(6,), m/s and rad/s, in the axes of ``frame_id``."""


def frames_of(sample: object) -> tuple[str, ...]:
    """Frames in which a target, or a tuple of obstacles, is expressed; none for joint states."""
    if isinstance(sample, PathSample):
        return tuple(dict.fromkeys(sample.frame_ids))
    if isinstance(sample, (PoseSample, ObstacleSample, TrajectorySample, TwistSample)):
        return (sample.frame_id,)
    if isinstance(sample, tuple) and not isinstance(sample, JointSample):
        return tuple(dict.fromkeys(frame for one in sample for frame in frames_of(one)))
    return ()


def stamp_of(sample: object) -> int:
    """ROS time, in ns, at which the frames of a target or of obstacles are placed: the header stamp; 0: the newest."""
    first = sample[0] if isinstance(sample, tuple) and sample and isinstance(sample[0], ObstacleSample) else sample
    stamped = (PoseSample, ObstacleSample, PathSample, TrajectorySample, TwistSample)
    return first.stamp_ns if isinstance(first, stamped) else 0
