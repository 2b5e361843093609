"""Obstacles: visualization_msgs/MarkerArray -> plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import ObstacleSample
from ik_node.messages.cdr import deserialize, stamp_of

MARKERS_TYPE = "visualization_msgs/msg/MarkerArray"
ADD, DELETE, DELETE_ALL = 0, 2, 3
KINDS = {1: "box", 2: "sphere", 3: "cylinder"}
"""Supported marker types: CUBE, SPHERE, CYLINDER."""


def decode_obstacles(data: bytes) -> tuple[ObstacleSample, ...]:
    """Decodes obstacles without validating them.

    A name consists of namespace and number of the marker: ``shelf/3``. Spheres and cylinders with unequal scales get
    the largest diameter. The kind of other marker types (arrows, text, meshes) is ``marker type N``.

    Args:
        data: CDR bytes of a visualization_msgs/MarkerArray.

    Raises:
        InputError: The bytes are no such message.
    """
    return tuple(_sample(marker) for marker in deserialize(data, MARKERS_TYPE).markers)


def _sample(marker: Any) -> ObstacleSample:
    p, q, scale = marker.pose.position, marker.pose.orientation, marker.scale
    kind = KINDS.get(int(marker.type), "")
    size = {
        "box": (scale.x, scale.y, scale.z),
        "sphere": (0.5 * max(scale.x, scale.y, scale.z),),
        "cylinder": (0.5 * max(scale.x, scale.y), scale.z),
    }.get(kind, ())
    lifetime = marker.lifetime
    return ObstacleSample(
        stamp_ns=stamp_of(marker),
        frame_id=str(marker.header.frame_id),
        name=f"{marker.ns}/{marker.id}",
        action={ADD: "add", DELETE: "delete", DELETE_ALL: "delete_all"}.get(int(marker.action), str(marker.action)),
        kind=kind or f"marker type {marker.type}",
        size=tuple(float(value) for value in size),
        position=np.array([p.x, p.y, p.z]),
        quaternion=np.array([q.x, q.y, q.z, q.w]),
        lifetime_ns=int(lifetime.sec) * NS + int(lifetime.nanosec),
    )
