"""The tolerance of the task in the 3-D scene: free axes as lines, bands as boxes, cones and sectors.

All objects are at the desired pose, in the axes of the tolerance (:mod:`ik_node.math.task_error`): in the frame
``tool`` those of the target, turned about a free rotation to be nearest to those of the tool; in the frame ``base``
those of the base frame.

==================================  =====================================================================
free translation                    a long line along the axis
free rotation                       a dashed line along the axis of rotation
bands of translations               a box of their half-widths, flat in exact and long in free directions
bands of rotations about two axes   a cone: the third axis stays in it
band of one rotation                a sector in the plane that it turns, for each other axis that stays in one
==================================  =====================================================================
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node.math import se3
from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array

FREE_COLOUR, BAND_COLOUR = (240, 170, 0), (0, 158, 115)
FREE_M, TURN_M, CONE_M = 0.5, 0.2, 0.15
"""Lengths of a line to either side of the target, of a free translation and a free rotation, and of cone and sector."""
DASHES = 8
"""Of a free rotation, to either side."""
FLAT_M = 0.001
"""Thickness of a box in an exact direction."""
SIDE_POINTS = 12
"""Points on each of the four sides of a cone's rim."""
ARC_POINTS = 33
"""Points on the arc of a sector."""


class ToleranceView:
    """Draws a tolerance; the objects are made when it changes, and moved with the desired pose."""

    def __init__(self, scene: Any) -> None:
        """Adds nothing yet; ``scene`` is that of viser."""
        self._scene = scene
        self._tolerance = TaskTolerance()
        self._handles: list[Any] = []
        self._node = scene.add_frame("/base/tolerance", show_axes=False, visible=False)

    def update(self, tolerance: TaskTolerance, pose_sb: Array, pose_sd: Array, visible: bool) -> None:
        """Draws a tolerance at a desired pose.

        Args:
            tolerance: The task; nothing is drawn of one that is exact.
            pose_sb: T_sb, (4, 4): the tool; NaN if it is not known.
            pose_sd: T_sd, (4, 4): the desired pose; NaN hides everything.
            visible: Whether the layer is shown.
        """
        if tolerance != self._tolerance:
            for handle in self._handles:
                handle.remove()
            self._tolerance, self._handles = tolerance, self._add(tolerance)
        known = bool(np.isfinite(pose_sd).all())
        if known:
            tool = pose_sb if np.isfinite(pose_sb).all() else pose_sd
            pose = np.ascontiguousarray(tool), np.ascontiguousarray(pose_sd)
            # The rows of the linear part are those of its axes: A' R_sb.
            axes = tool[:3, :3] @ task_deviation(tolerance.form, *pose).rows_b[:3, :3].T
            x, y, z, w = se3.quaternion_from_rotation(axes)
            self._node.wxyz, self._node.position = np.array([w, x, y, z]), pose_sd[:3, 3].copy()
        self._node.visible = known and visible and bool(self._handles)

    def _add(self, tolerance: TaskTolerance) -> list[Any]:
        widths, free, node = np.array(tolerance.half_widths), tolerance.free, "/base/tolerance"
        bands = ~free & ~tolerance.exact
        handles = []
        for index in np.flatnonzero(free).tolist():
            name, axis = "xyz"[index % 3], np.eye(3)[index % 3]
            length, parts = (FREE_M, 1) if index < 3 else (TURN_M, 4 * DASHES)
            ends = np.linspace(-length, length, parts + 1)[:, None] * axis
            segments = np.stack((ends[:-1], ends[1:]), axis=1)[::2]
            kind = "free_" if index < 3 else "free_r"
            handles.append(
                self._scene.add_line_segments(
                    f"{node}/{kind}{name}", segments, FREE_COLOUR, thickness=3.0, thickness_units="screen"
                )
            )
        if bands[:3].any():
            size = 2.0 * np.where(free[:3], FREE_M, np.maximum(widths[:3], 0.5 * FLAT_M))
            handles.append(
                self._scene.add_box(
                    f"{node}/box", color=BAND_COLOUR, dimensions=tuple(size.tolist()), opacity=0.25, side="double"
                )
            )
        for index in range(3):
            across = [3 + (index + 1) % 3, 3 + (index + 2) % 3]
            if bands[across].all():
                handles.append(self._add_band(f"cone_{'xyz'[index]}", *cone(index, widths[3:])))
        if np.count_nonzero(bands[3:]) == 1:
            about = int(np.flatnonzero(bands[3:])[0])
            others = [(about + 1) % 3, (about + 2) % 3]
            # Beside one free rotation only its axis is held; the other one turns about it.
            for axis in [k for k in others if free[3 + k]] if np.count_nonzero(free[3:]) == 1 else others:
                name = f"sector_r{'xyz'[about]}_{'xyz'[axis]}"
                handles.append(self._add_band(name, *sector(about, axis, widths[3 + about])))
        return handles

    def _add_band(self, name: str, vertices: Array, faces: NDArray[np.int64]) -> Any:
        return self._scene.add_mesh_simple(
            f"/base/tolerance/{name}", vertices, faces, color=BAND_COLOUR, opacity=0.3, side="double"
        )


def cone(axis: int, half_widths: Array) -> tuple[Array, NDArray[np.int64]]:
    """Surface that an axis reaches at the border of two bands of rotation.

    Args:
        axis: 0, 1 or 2.
        half_widths: About x, y, z, (3,), rad; that about ``axis`` does not count.

    Returns:
        Vertices (k, 3), m, of which the first is the tip, and triangles (k - 1, 3).
    """
    first, second = (axis + 1) % 3, (axis + 2) % 3
    along = np.linspace(-1.0, 1.0, SIDE_POINTS, endpoint=False)
    side = np.ones(SIDE_POINTS)
    rim = np.zeros((4 * SIDE_POINTS, 3))
    rim[:, first] = half_widths[first] * np.concatenate((along, side, -along, -side))
    rim[:, second] = half_widths[second] * np.concatenate((-side, along, side, -along))
    points = [CONE_M * se3.exp_rotation(turn)[:, axis] for turn in rim]
    count = len(points)
    faces = np.array([(0, 1 + i, 1 + (i + 1) % count) for i in range(count)], dtype=np.int64)
    return np.vstack((np.zeros(3), *points)), faces


def sector(about: int, axis: int, half_width: float) -> tuple[Array, NDArray[np.int64]]:
    """Surface that an axis sweeps between the borders of a band of rotation.

    Args:
        about: Axis of rotation: 0, 1 or 2.
        axis: The other axis: 0, 1 or 2.
        half_width: Of the band, rad.

    Returns:
        Vertices (k, 3), m, of which the first is the tip and the others the arc, and triangles (k - 2, 3).
    """
    turns = np.linspace(-half_width, half_width, ARC_POINTS)[:, None] * np.eye(3)[about]
    arc = [CONE_M * se3.exp_rotation(turn)[:, axis] for turn in turns]
    faces = np.array([(0, i, i + 1) for i in range(1, ARC_POINTS)], dtype=np.int64)
    return np.vstack((np.zeros(3), *arc)), faces
