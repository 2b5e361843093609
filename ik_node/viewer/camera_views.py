"""Where the camera of the viewer is: a few views of the scene, on wide windows and on a phone."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array

FIELD_OF_VIEW = 0.7
"""Vertical, rad."""
VIEWS = {
    "home": np.array([1.02, 1.02, 0.6]),
    "front": np.array([1.8, 0.0, 0.1]),
    "side": np.array([0.0, -1.8, 0.1]),
    "top": np.array([0.0, -0.02, 1.9]),
}
"""View -> position of the camera relative to the centre of the scene, in units of its size."""
NARROW_PX = 576
"""Width of a window up to which viser shows its panels as a sheet over the lower part of the scene."""
FREE = 0.4
"""Part of the height of a narrow window above that sheet."""


class CameraPlacement(NamedTuple):
    """Position of a camera, and the point in the middle of its picture, each (3,), m."""

    position: Array
    look_at: Array


def camera_placement(view: str, centre: Array, size: float, width_px: int | None = None) -> CameraPlacement:
    """Returns where the camera has to be to show the scene.

    Args:
        view: A key of :data:`VIEWS`.
        centre: Of the scene, (3,), m.
        size: Of the scene, m.
        width_px: Width of the window; default: a wide one. In a narrow one the scene is shown above the sheet.
    """
    offset = size * VIEWS[view]
    if width_px is None or width_px > NARROW_PX:
        return CameraPlacement(centre + offset, centre)
    offset = offset / FREE
    forward = -offset / np.linalg.norm(offset)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    up = np.cross(right / np.linalg.norm(right), forward)
    look_at = centre - (1.0 - FREE) * math.tan(0.5 * FIELD_OF_VIEW) * float(np.linalg.norm(offset)) * up
    return CameraPlacement(look_at + offset, look_at)
