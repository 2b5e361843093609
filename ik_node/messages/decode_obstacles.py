"""Obstacles: visualization_msgs/MarkerArray -> plain data."""

from __future__ import annotations

from ik_node.interfaces.samples import ObstacleSample
from ik_node.messages.cdr import Cursor, reading

MARKERS_TYPE = "visualization_msgs/msg/MarkerArray"
ADD, DELETE, DELETE_ALL = 0, 2, 3
KINDS = {1: "box", 2: "sphere", 3: "cylinder"}
"""Supported marker types: CUBE, SPHERE, CYLINDER."""
UNSUPPORTED = {
    0: "ARROW",
    4: "LINE_STRIP",
    5: "LINE_LIST",
    6: "CUBE_LIST",
    7: "SPHERE_LIST",
    8: "POINTS",
    9: "TEXT_VIEW_FACING",
    10: "MESH_RESOURCE",
    11: "TRIANGLE_LIST",
    12: "ARROW_STRIP",
}
"""Marker types that are no obstacles, as visualization_msgs/Marker names them."""
MAX_MARKERS = 1000
"""Markers of one message, deletions included: decoding and using them takes about 8 ms."""
MAX_MARKER_BYTES = 1_000_000
"""Size of one message. Points, textures and meshes in it are skipped, but it is received and recorded as a whole."""


def decode_obstacles(data: bytes) -> tuple[ObstacleSample, ...]:
    """Decodes obstacles without validating them.

    A name consists of namespace and number of the marker: ``shelf/3``. Spheres and cylinders with unequal scales get
    the largest diameter. The kind of other marker types (arrows, text, meshes) is their name, for example
    ``LINE_LIST``.

    Args:
        data: CDR bytes of a visualization_msgs/MarkerArray.

    Raises:
        InputError: The bytes are no such message, or it has more than :data:`MAX_MARKERS` markers; their number is
            read before the markers are.
    """
    with reading(data, MARKERS_TYPE) as cursor:
        count = cursor.bounded_count(MAX_MARKERS, "markers")
        cursor.check_size(MAX_MARKER_BYTES)
        drawings: dict[int, bytes] = {}
        return tuple(_sample(cursor, drawings) for _ in range(count))


def _sample(cursor: Cursor, drawings: dict[int, bytes]) -> ObstacleSample:
    """Reads a marker. ``drawings``: what was passed behind the lifetime, by its alignment: markers of one sender mostly
    have the same bytes there, which then have the same length."""
    stamp_ns = cursor.stamp()
    frame_id, namespace = cursor.string(), cursor.string()
    number = (cursor.count() ^ 0x80000000) - 0x80000000  # signed
    marker_type = (cursor.count() ^ 0x80000000) - 0x80000000
    action = (cursor.count() ^ 0x80000000) - 0x80000000
    numbers = cursor.floats(10)
    cursor.skip(4, 4, 4)  # colour
    lifetime_ns = cursor.stamp()
    start = cursor.offset
    drawing = drawings.get(start % 8)
    if drawing is not None and cursor.data.startswith(drawing, start):
        cursor.offset += len(drawing)
    else:
        _skip_drawing(cursor)
        drawings[start % 8] = cursor.data[start : cursor.offset]
    x, y, z = numbers[7:].tolist()
    kind = KINDS.get(marker_type, "")
    size = {
        "box": (x, y, z),
        "sphere": (0.5 * max(x, y, z),),
        "cylinder": (0.5 * max(x, y), z),
    }.get(kind, ())
    return ObstacleSample(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        name=f"{namespace}/{number}",
        action={ADD: "add", DELETE: "delete", DELETE_ALL: "delete_all"}.get(action, str(action)),
        kind=kind or UNSUPPORTED.get(marker_type, f"marker type {marker_type}"),
        size=size,
        position=numbers[:3],
        quaternion=numbers[3:7],
        lifetime_ns=lifetime_ns,
    )


def _skip_drawing(cursor: Cursor) -> None:
    """Passes the fields of a Marker behind its lifetime."""
    cursor.skip(1, 1)  # frame_locked
    cursor.skip(24, 8, cursor.count())  # points
    cursor.skip(16, 4, cursor.count())  # colors
    cursor.skip(1, 1, cursor.count())  # texture_resource
    cursor.stamp()  # texture
    for _ in range(3):  # its frame, format and data
        cursor.skip(1, 1, cursor.count())
    cursor.skip(8, 4, cursor.count())  # uv_coordinates
    for _ in range(4):  # text, mesh_resource, and name and data of mesh_file
        cursor.skip(1, 1, cursor.count())
    cursor.skip(1, 1)  # mesh_use_embedded_materials
