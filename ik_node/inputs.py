"""What messages say, as plain data: the inputs of the controller, unchecked and in the frames they came in."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.se3 import Array


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
