"""The viewer draws the tolerance of the task at the desired pose, in the axes of its frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from ik_node.math import se3
from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.viewer.server import serve
from ik_node.viewer.tolerance_view import ToleranceView, cone

INF = float("inf")
TARGET = se3.pose_from((0.4, 0.1, 0.5), (0.0, 0.6, 0.0, 0.8))


@pytest.fixture
def server() -> Iterator[Any]:
    made = serve(0)
    yield made
    made.stop()


def drawn(server: Any, widths: tuple[float, ...], frame: str = "tool", tool: Array = TARGET) -> ToleranceView:
    view = ToleranceView(server.scene)
    view.update(TaskTolerance(widths, frame), tool, TARGET, True)
    return view


def in_base(server: Any, name: str) -> Array:
    """Points of a line or mesh in the base frame, (k, 3)."""
    node, handle = (server.scene.get_handle_by_name(f"/base/tolerance{part}") for part in ("", f"/{name}"))
    points = handle.points if hasattr(handle, "points") else handle.vertices
    w, x, y, z = node.wxyz
    rotation = se3.rotation_from_quaternion(np.array([x, y, z, w]))
    return np.asarray(np.asarray(points).reshape(-1, 3) @ rotation.T + node.position)


def names(server: Any, *asked: str) -> list[str]:
    return [name for name in asked if server.scene.get_handle_by_name(f"/base/tolerance/{name}") is not None]


@pytest.mark.parametrize("frame", ["tool", "base"])
@pytest.mark.parametrize(("name", "index"), [("free_x", 0), ("free_z", 2), ("free_ry", 4), ("free_rz", 5)])
def test_a_free_axis_is_a_line_through_the_target(server: Any, frame: str, name: str, index: int) -> None:
    widths = [0.0] * 6
    widths[index] = INF
    drawn(server, tuple(widths), frame)
    axis = (TARGET[:3, :3] if frame == "tool" else np.eye(3))[:, index % 3]
    points = in_base(server, name) - TARGET[:3, 3]
    assert np.abs(np.cross(points, axis)).max() < 1e-6
    assert points[0] == pytest.approx(-points[-1], abs=0.1 * np.abs(points).max())
    assert server.scene.get_handle_by_name("/base/tolerance").visible


def test_a_cone_has_the_poses_at_the_border_of_both_bands(server: Any) -> None:
    """The tool that is turned so that its axis is on the rim has its rotation at the border of the tolerance."""
    for frame, third in (("tool", 0.0), ("tool", INF), ("base", INF)):
        tolerance = TaskTolerance((0.0, 0.0, 0.0, 0.1, 0.3, third), frame)
        vertices, faces = cone(2, np.array(tolerance.half_widths[3:]))
        assert vertices[0] == pytest.approx(np.zeros(3))
        assert sorted(set(faces.ravel().tolist())) == list(range(len(vertices)))
        axes = TARGET[:3, :3] if frame == "tool" else np.eye(3)
        for tip in vertices[1:]:
            direction = tip / np.linalg.norm(tip)
            normal = np.cross((0.0, 0.0, 1.0), direction)
            angle = np.arctan2(np.linalg.norm(normal), direction[2])
            turn = axes @ se3.exp_rotation(angle * normal / np.linalg.norm(normal)) @ axes.T
            tool = TARGET.copy()
            tool[:3, :3] = turn @ TARGET[:3, :3]
            parts = np.abs(task_deviation(tolerance.form, tool, TARGET).components[3:5]) / (0.1, 0.3)
            assert parts.max() == pytest.approx(1.0, abs=1e-6)


def test_a_cone_stands_at_the_target_about_the_axis_that_leans(server: Any) -> None:
    drawn(server, (0.0, 0.0, 0.0, 0.2, 0.2, INF), "base")
    points = in_base(server, "cone_z") - TARGET[:3, 3]
    assert np.abs(points[0]).max() < 1e-6
    assert points.mean(axis=0)[:2] == pytest.approx(np.zeros(2), abs=1e-6)
    angles = np.arccos(points[1:, 2] / np.linalg.norm(points[1:], axis=1))
    assert angles.min() == pytest.approx(0.2, abs=1e-6)
    assert names(server, "cone_x", "cone_y", "cone_z", "box", "free_rz") == ["cone_z", "free_rz"]


@pytest.mark.parametrize("frame", ["tool", "base"])
@pytest.mark.parametrize(
    ("rotations", "shown"),
    [
        ((0.3, 0.0, 0.0), ["sector_rx_y", "sector_rx_z"]),
        ((0.0, 0.0, 2.5), ["sector_rz_x", "sector_rz_y"]),
        ((0.3, 0.0, INF), ["sector_rx_z"]),
        ((INF, 0.3, 0.0), ["sector_ry_x"]),
        ((INF, 0.3, INF), ["sector_ry_x", "sector_ry_z"]),
        ((0.3, 0.3, 0.0), []),
        ((0.3, 0.3, 0.3), []),
    ],
)
def test_a_band_about_one_axis_is_a_sector_for_each_axis_that_it_turns(
    server: Any, frame: str, rotations: tuple[float, ...], shown: list[str]
) -> None:
    """The tool that is turned so that its axis is on an edge has its rotation at the border of the tolerance."""
    tolerance = TaskTolerance((0.0, 0.0, 0.0, *rotations), frame)
    drawn(server, (0.0, 0.0, 0.0, *rotations), frame)
    assert names(server, *(f"sector_r{i}_{k}" for i in "xyz" for k in "xyz")) == shown
    axes = TARGET[:3, :3] if frame == "tool" else np.eye(3)
    for name in shown:
        about, axis = "xyz".index(name[8]), "xyz".index(name[-1])
        points = in_base(server, name) - TARGET[:3, 3]
        assert np.abs(points[0]).max() < 1e-6
        assert np.abs(points @ axes[:, about]).max() < 1e-6, "normal to the axis of rotation"
        for edge in (points[1], points[-1]):
            angle = np.arctan2(edge @ np.cross(axes[:, about], axes[:, axis]), edge @ axes[:, axis])
            tool = TARGET.copy()
            tool[:3, :3] = axes @ se3.exp_rotation(angle * np.eye(3)[about]) @ axes.T @ TARGET[:3, :3]
            deviation = task_deviation(tolerance.form, tool, TARGET).components[3 + about]
            assert abs(deviation) == pytest.approx(rotations[about], abs=1e-6)


def test_bands_of_positions_are_a_box_in_the_axes_of_the_nearest_member(server: Any) -> None:
    tool = TARGET.copy()
    tool[:3, :3] = TARGET[:3, :3] @ se3.exp_rotation(np.array([0.0, 0.0, 0.7]))
    drawn(server, (0.02, 0.0, INF, 0.0, 0.0, INF), "tool", tool)
    box, node = (server.scene.get_handle_by_name(f"/base/tolerance{part}") for part in ("/box", ""))
    assert box.dimensions[0] == pytest.approx(0.04)
    assert box.dimensions[1] < 0.002
    assert box.dimensions[2] == pytest.approx(1.0)
    w, x, y, z = node.wxyz
    assert se3.rotation_from_quaternion(np.array([x, y, z, w])) == pytest.approx(tool[:3, :3], abs=1e-9)
    assert node.position == pytest.approx(TARGET[:3, 3])


def test_the_objects_follow_a_change_and_vanish_without_a_tolerance(server: Any) -> None:
    view = drawn(server, (0.0, 0.0, 0.0, 0.0, 0.0, INF))
    node = server.scene.get_handle_by_name("/base/tolerance")
    assert names(server, "free_rz", "box") == ["free_rz"]
    view.update(TaskTolerance((0.01, 0.01, 0.0, 0.0, 0.0, 0.0)), TARGET, TARGET, True)
    assert names(server, "free_rz", "box") == ["box"]
    view.update(TaskTolerance((0.01, 0.01, 0.0, 0.0, 0.0, 0.0)), TARGET, TARGET, False)
    assert not node.visible
    view.update(TaskTolerance((0.01, 0.01, 0.0, 0.0, 0.0, 0.0)), TARGET, np.full((4, 4), np.nan), True)
    assert not node.visible
    view.update(TaskTolerance(), TARGET, TARGET, True)
    assert names(server, "free_rz", "box") == []
    assert not node.visible
