"""Obstacles as visualization_msgs/MarkerArray -> plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import ObstacleSample
from ik_node.messages.cdr import deserialize, stamp_of

MARKERS_TYPE = "visualization_msgs/msg/MarkerArray"
ADD, DELETE, DELETE_ALL = 0, 2, 3
KINDS = {1: "box", 2: "sphere", 3: "cylinder"}
"""Marker types that are solids: CUBE, SPHERE, CYLINDER."""


def decode_obstacles(data: bytes) -> tuple[ObstacleSample, ...]:
    """The markers in ``data``, in their order, unchecked; InputError when it is no MarkerArray.

    A marker's name is its namespace and number, ``shelf/3``. Spheres and cylinders that are stretched across become as
    wide as they are at their widest. Other types (arrows, text, meshes) come with an empty kind.
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
