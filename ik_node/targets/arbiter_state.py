"""The active input among the targets, and the snapshot of the arbiter that selects it."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from ik_node.math.types import Array
from ik_node.targets.jog import JogSnapshot
from ik_node.targets.path.follower import PathSnapshot
from ik_node.targets.stream.stream import StreamSnapshot


class TargetSource(Enum):
    """The active input; the values are the names of the topics."""

    NONE = "none"
    POSE = "target_pose"
    PATH = "target_path"
    TRAJECTORY = "target_trajectory"
    TWIST = "target_twist"


class ArbiterSnapshot(NamedTuple):
    """State of :class:`ik_node.targets.arbiter.TargetArbiter`; plain data."""

    source: TargetSource
    previous_source: TargetSource
    """The input that was active before."""
    changes_ns: tuple[int, ...]
    """Times of the last changes between those two."""
    time_ns: int
    warning: str
    """Warning about the last path or twist; empty for none."""
    stream: StreamSnapshot
    path: PathSnapshot
    jog: JogSnapshot
    out_of_reach: str = ""
    """What of the active target is out of reach; empty for nothing."""
    tool_sb: Array | None = None
    """Last T_sb (4, 4), for a change of the tolerance; None while the whole pose is followed."""
    newest_sd: Array | None = None
    """Last pose of the stream as received, (4, 4); None while the whole pose is followed."""
