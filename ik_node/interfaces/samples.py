"""What messages say, as plain data: the inputs of the controller, unchecked and in the frames they came in."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.math.types import Array


class JointSample(NamedTuple):
    """A joint state."""

    stamp_ns: int
    """Header stamp, ROS time; 0 means "now"."""
    names: tuple[str, ...]
    position: Array
    """rad (m), one per name."""


class PoseSample(NamedTuple):
    """A target pose."""

    stamp_ns: int
    """Header stamp, ROS time at which the pose should hold; 0 means "now"."""
    frame_id: str
    position: Array
    """(3,), m, in ``frame_id``."""
    quaternion: Array
    """(4,), x y z w."""


class ObstacleSample(NamedTuple):
    """What is said of one obstacle."""

    stamp_ns: int
    """Header stamp, ROS time at which the pose held; 0 means "now"."""
    frame_id: str
    name: str
    action: str
    """``add`` (which also changes), ``delete`` or ``delete_all``."""
    kind: str
    """A key of :data:`ik_node.collision.scene.SIZES`."""
    size: tuple[float, ...]
    """Its measures, m."""
    position: Array
    """(3,), m, of the centre in ``frame_id``."""
    quaternion: Array
    """(4,), x y z w."""
    lifetime_ns: int
    """It vanishes this long after its arrival; 0 stays for ever."""


class PathSample(NamedTuple):
    """A path of N poses."""

    frame_ids: tuple[str, ...]
    """One per pose; a pose that names none is in the path's own frame."""
    stamps_ns: tuple[int, ...]
    """ROS time at which each pose should hold; all alike where the path has no times."""
    positions: Array
    """(N, 3), m."""
    quaternions: Array
    """(N, 4), x y z w."""


class TrajectorySample(NamedTuple):
    """N poses with times, and with twists if there are any."""

    stamp_ns: int
    """Header stamp, ROS time of the start; 0 means "now"."""
    frame_id: str
    times_ns: tuple[int, ...]
    """From the start."""
    positions: Array
    """(N, 3), m."""
    quaternions: Array
    """(N, 4), x y z w."""
    twists: Array
    """(N, 6) or (0, 6): velocity of the tool point and angular velocity, in the axes of ``frame_id``."""
    accelerations: Array
    """(N, 6) or (0, 6): their derivatives."""


class TwistSample(NamedTuple):
    """A target twist: velocity of the tool point and angular velocity."""

    stamp_ns: int
    """Header stamp, ROS time; 0 means "now"."""
    frame_id: str
    twist: Array
    """(6,), m/s and rad/s, in the axes of ``frame_id``."""


def frames_of(sample: object) -> tuple[str, ...]:
    """The frames in which a target or an obstacle (a tuple of them) is written; none for joint states."""
    if isinstance(sample, PathSample):
        return tuple(dict.fromkeys(sample.frame_ids))
    if isinstance(sample, (PoseSample, ObstacleSample, TrajectorySample, TwistSample)):
        return (sample.frame_id,)
    if isinstance(sample, tuple) and not isinstance(sample, JointSample):
        return tuple(dict.fromkeys(frame for one in sample for frame in frames_of(one)))
    return ()
