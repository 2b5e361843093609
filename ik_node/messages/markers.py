"""Tool path, target, obstacles and clearance as visualization_msgs/MarkerArray, for RViz and Foxglove.

============== ======================= ===============================================================================
namespace      types                   content
============== ======================= ===============================================================================
``tool_path``  LINE_STRIP              path of the tool point: the last ``MAX_POINTS`` points, ``SPACING_M`` apart
``target``     LINE_LIST               axes of the desired pose: x red, y green, z blue
``obstacles``  SPHERE, CUBE, CYLINDER  the controller's obstacles; a capsule is a cylinder and two spheres
``clearance``  LINE_LIST, TEXT         line between the nearest points of the closest pair, distance, names
============== ======================= ===============================================================================

An object keeps its marker number while it exists; afterwards its markers are deleted.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from ik_node.collision.scene import Obstacle, Scene
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Step
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages.cdr import header, make, serialize
from ik_node.messages.decode_obstacles import ADD, DELETE, DELETE_ALL, MARKERS_TYPE

CUBE, SPHERE, CYLINDER, LINE_STRIP, LINE_LIST, TEXT, TRIANGLE_LIST = 1, 2, 3, 4, 5, 9, 11
"""Marker types."""
MAX_POINTS = 500
"""Length of the tool path in points: a message of 12 kB that is encoded in 0.4 ms."""
SPACING_M = 0.004
"""Minimum distance of consecutive points of the tool path."""
WAITING_POINTS = 1000
"""Capacity for points since the last message; more than arrive in its period."""
PARTS = 3
"""Marker numbers per obstacle."""
AXIS_M = 0.1
LINE_M = 0.003
TEXT_M = 0.03
CLOSE_M = 0.05
"""Clearance below this value is drawn in red."""
RED, GREEN, BLUE = (0.9, 0.1, 0.1, 1.0), (0.1, 0.7, 0.1, 1.0), (0.1, 0.2, 0.9, 1.0)
TRAIL, SOLID, NEAREST = (1.0, 0.6, 0.0, 1.0), (0.5, 0.5, 0.6, 0.7), (0.9, 0.3, 0.2, 0.7)

_NO_ROTATION = np.array([0.0, 0.0, 0.0, 1.0])
_ORIGIN = np.zeros(3)


class SceneMarkers:
    """Encodes the markers of one node."""

    def __init__(self, base_frame: str) -> None:
        """Encodes a message once, because the first one takes ten times as long."""
        self.base_frame = base_frame
        self._new_points: deque[Array] = deque(maxlen=WAITING_POINTS)
        self._path: deque[Array] = deque(maxlen=MAX_POINTS)
        self._last: Step | None = None
        self._numbers: dict[str, int] = {}
        self._shown: set[tuple[str, int]] = set()
        self._started = False
        serialize(make(MARKERS_TYPE, markers=[self._marker("", 0, TEXT, 0, points=np.zeros((2, 3)), colours=(RED,))]))

    def add_step(self, step: Step) -> None:
        """Stores a Step for the next message."""
        self._last = step
        self._new_points.append(step.pose_sb)

    def encode_markers(self, scene: Scene, now: Instant) -> bytes:
        """Encodes the present markers and the deletion of those that disappeared.

        The first message deletes all markers first, because an earlier process may have left some.

        Args:
            scene: Obstacles of the controller.
            now: Time of the message.

        Returns:
            CDR bytes of a visualization_msgs/MarkerArray.
        """
        self._extend()
        stamp_ns = now.ros_ns
        markers = self._tool_path(stamp_ns) + self._obstacles(scene.at(now.monotonic_ns), now)
        if self._last is not None:
            markers += _finite(self._target(self._last.pose_sd, stamp_ns), self._last.pose_sd)
            markers += _finite(self._clearance(self._last, stamp_ns), self._last.closest_points)
        shown = {(marker.ns, marker.id) for marker in markers}
        deletions = [self._marker(ns, number, 0, stamp_ns, DELETE) for ns, number in sorted(self._shown - shown)]
        if not self._started:
            deletions = [self._marker("", 0, 0, stamp_ns, DELETE_ALL)]
        self._shown, self._started = shown, True
        return serialize(make(MARKERS_TYPE, markers=deletions + markers))

    def delete_all(self, now: Instant) -> bytes:
        """Encodes the deletion of all markers."""
        self._shown, self._started = set(), False
        return serialize(make(MARKERS_TYPE, markers=[self._marker("", 0, 0, now.ros_ns, DELETE_ALL)]))

    def _extend(self) -> None:
        """Adds the new points to the tool path."""
        for pose in self._new_points:
            point = pose[:3, 3]
            far = not self._path or float(np.linalg.norm(point - self._path[-1])) >= SPACING_M
            if far and np.isfinite(point).all():
                self._path.append(point)
        self._new_points.clear()

    def _tool_path(self, stamp_ns: int) -> list[Any]:
        if len(self._path) < 2:  # RViz reports a line strip of one point as an error
            return []
        points = np.array(self._path)
        return [
            self._marker("tool_path", 0, LINE_STRIP, stamp_ns, size=(LINE_M, 0.0, 0.0), colour=TRAIL, points=points)
        ]

    def _target(self, pose: Array, stamp_ns: int) -> list[Any]:
        origin, axes = pose[:3, 3], AXIS_M * pose[:3, :3]
        points = np.array([origin + offset for axis in axes.T for offset in (_ORIGIN, axis)])
        colours = (RED, RED, GREEN, GREEN, BLUE, BLUE)
        return [
            self._marker(
                "target", 0, LINE_LIST, stamp_ns, size=(2.0 * LINE_M, 0.0, 0.0), points=points, colours=colours
            )
        ]

    def _clearance(self, step: Step, stamp_ns: int) -> list[Any]:
        colour = RED if step.clearance < CLOSE_M else GREEN
        middle = step.closest_points.mean(axis=0)
        text = f"{1e3 * step.clearance:.0f} mm  {' - '.join(step.closest_pair)}"
        size = (LINE_M, 0.0, 0.0)
        return [
            self._marker("clearance", 0, LINE_LIST, stamp_ns, size=size, colour=colour, points=step.closest_points),
            self._marker("clearance", 1, TEXT, stamp_ns, at=middle, size=(0.0, 0.0, TEXT_M), colour=colour, text=text),
        ]

    def _obstacles(self, scene: Scene, now: Instant) -> list[Any]:
        self._number(scene)
        nearest = () if self._last is None else self._last.closest_pair[1:]
        result = []
        for name, entry in scene.obstacles.items():
            colour = NEAREST if name in nearest else SOLID
            for part, (kind, at, size) in enumerate(_solids(entry.at(now.monotonic_ns))):
                number = PARTS * self._numbers[name] + part
                turn = se3.quaternion_from_rotation(entry.pose_s[:3, :3])
                result.append(
                    self._marker("obstacles", number, kind, now.ros_ns, at=at, turn=turn, size=size, colour=colour)
                )
        return result

    def _number(self, scene: Scene) -> None:
        """Assigns the lowest free numbers to new obstacles."""
        self._numbers = {name: number for name, number in self._numbers.items() if name in scene.obstacles}
        taken = set(self._numbers.values())
        free = (number for number in range(len(taken) + len(scene.obstacles)) if number not in taken)
        for name in scene.obstacles:
            if name not in self._numbers:
                self._numbers[name] = next(free)

    def _marker(self, namespace: str, number: int, kind: int, stamp_ns: int, action: int = ADD, **content: Any) -> Any:
        return marker(self.base_frame, namespace, number, kind, stamp_ns, action, **content)


def marker(
    frame_id: str,
    namespace: str,
    number: int,
    kind: int,
    stamp_ns: int,
    action: int = ADD,
    at: Array = _ORIGIN,
    turn: Array = _NO_ROTATION,
    size: tuple[float, float, float] = (1.0, 1.0, 1.0),
    colour: tuple[float, ...] = RED,
    points: Array | None = None,
    colours: tuple[tuple[float, ...], ...] = (),
    text: str = "",
    frame_locked: bool = False,
) -> Any:
    """A visualization_msgs/Marker.

    Args:
        frame_id: Frame of ``at`` and ``turn``.
        namespace: Namespace of the number.
        number: Identifies the marker within its namespace.
        kind: One of the marker types above.
        stamp_ns: ROS time.
        action: ADD, DELETE or DELETE_ALL.
        at: Position, (3,), m.
        turn: Orientation, quaternion x, y, z, w.
        size: Scale; its meaning depends on the type.
        colour: Red, green, blue, opacity, 0 to 1.
        points: (k, 3), m, in the frame of the marker.
        colours: One per point; default: ``colour`` for all.
        text: Text of a TEXT marker.
        frame_locked: True when the marker moves with its frame after ``stamp_ns``.
    """
    x, y, z, w = turn.tolist()
    corners = [] if points is None else points.tolist()
    nothing = np.empty(0, dtype=np.uint8)
    return make(
        "visualization_msgs/msg/Marker",
        header=header(frame_id, stamp_ns),
        ns=namespace,
        id=number,
        type=kind,
        action=action,
        pose=make(
            "geometry_msgs/msg/Pose",
            position=_triple("Point", *at.tolist()),
            orientation=make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
        scale=_triple("Vector3", *size),
        color=_colour(*colour),
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=frame_locked,
        points=[_triple("Point", *corner) for corner in corners],
        colors=[_colour(*entry) for entry in colours],
        texture_resource="",
        texture=make("sensor_msgs/msg/CompressedImage", header=header(""), format="", data=nothing),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )


def _solids(entry: Obstacle) -> list[tuple[int, Array, tuple[float, float, float]]]:
    """Marker type, centre and extent of the parts of an obstacle; all have its orientation."""
    kind, size = entry.shape
    centre = entry.pose_s[:3, 3]
    width = 2.0 * size[0]
    if kind == "box":
        return [(CUBE, centre, (size[0], size[1], size[2]))]
    if kind == "sphere":
        return [(SPHERE, centre, (width, width, width))]
    trunk = (CYLINDER, centre, (width, width, size[1]))
    if kind == "cylinder":
        return [trunk]
    half = 0.5 * size[1] * entry.pose_s[:3, 2]
    return [trunk, *((SPHERE, centre + offset, (width, width, width)) for offset in (half, -half))]


def _finite(markers: list[Any], values: Array) -> list[Any]:
    """``markers``, or none if ``values`` contain NaN."""
    return markers if np.isfinite(values).all() else []


def _triple(kind: str, x: float, y: float, z: float) -> Any:
    return make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _colour(r: float, g: float, b: float, a: float) -> Any:
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a)
