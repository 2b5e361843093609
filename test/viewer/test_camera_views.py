"""Views of the viewer's camera: the scene is in the free part of the window."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ik_node.math.types import Array
from ik_node.viewer.camera_views import FIELD_OF_VIEW, FREE, NARROW_PX, VIEWS, CameraPlacement, camera_placement

CENTRE, SIZE = np.array([0.3, -0.1, 0.4]), 1.2


def image(placement: CameraPlacement, point: Array) -> float:
    """Height of a point in the picture: -1 at its lower edge, 1 at its upper one."""
    forward = placement.look_at - placement.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    up = np.cross(right, forward) / np.linalg.norm(right)
    seen = point - placement.position
    return float(seen @ up / (seen @ forward) / math.tan(0.5 * FIELD_OF_VIEW))


@pytest.mark.parametrize("view", VIEWS)
def test_a_phone_shows_the_scene_above_the_sheet(view: str) -> None:
    wide = camera_placement(view, CENTRE, SIZE, 1280)
    assert image(wide, CENTRE) == pytest.approx(0.0, abs=1e-12)
    narrow = camera_placement(view, CENTRE, SIZE, 390)
    assert image(narrow, CENTRE) == pytest.approx(1.0 - FREE)
    up = np.array([0.0, 0.0, 0.25 * SIZE]) if view != "top" else np.array([0.0, 0.25 * SIZE, 0.0])
    for placement, free in ((wide, 1.0), (narrow, FREE)):
        low, high = image(placement, CENTRE - up), image(placement, CENTRE + up)
        assert 1.0 - 2.0 * free < low < high < 1.0
    assert camera_placement(view, CENTRE, SIZE, NARROW_PX + 1).position.tobytes() == wide.position.tobytes()
