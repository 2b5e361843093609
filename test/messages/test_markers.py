"""Markers of a run: after all messages, a viewer displays exactly the present objects.

A minimal viewer applies the messages as RViz does (a marker is identified by namespace and number). Not tested here:
transport over DDS (test_node.py) and appearance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_steps import made_step, stopped_step
from test_messages import by_ros

from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import Step
from ik_node.math import se3
from ik_node.messages.cdr import deserialize
from ik_node.messages.decode_obstacles import MARKERS_TYPE, decode_obstacles
from ik_node.messages.markers import CYLINDER, MAX_POINTS, SPACING_M, SPHERE, SceneMarkers

ADD, DELETE, DELETE_ALL = 0, 2, 3
BOX, BALL, POST = shape("box", (0.1, 0.2, 0.3)), shape("sphere", (0.05,)), shape("cylinder", (0.05, 0.6))


def at(tick: int) -> Instant:
    return Instant(10 * NS + tick * 100_000_000, 1_700_000_000 * NS + tick * 100_000_000)


class Viewer:
    """Minimal viewer: the markers that are displayed."""

    def __init__(self) -> None:
        self.shown: dict[tuple[str, int], Any] = {}

    def take(self, data: bytes) -> list[Any]:
        markers: list[Any] = deserialize(data, MARKERS_TYPE).markers
        for marker in markers:
            if marker.action == DELETE_ALL:
                self.shown.clear()
            elif marker.action == DELETE:
                del self.shown[marker.ns, marker.id]
            else:
                self.shown[marker.ns, marker.id] = marker
        return markers

    def numbers(self, namespace: str) -> set[int]:
        return {number for ns, number in self.shown if ns == namespace}


def step_at(tick: int, position: Any, **changes: Any) -> Step:
    step = made_step(tick, 7)
    step.pose_sb[:3, 3] = position
    return step._replace(**changes)


def test_obstacles_are_shown_where_they_are_and_keep_their_numbers() -> None:
    """The decoder of ~/obstacles reads the markers back as the same solids at the same poses."""
    markers, viewer, pose = SceneMarkers("base"), Viewer(), se3.exp(np.array([0.3, -0.2, 0.5, 0.4, -0.7, 0.2]))
    scene = Scene().put(obstacle("wall", BOX, pose)).put(obstacle("ball", BALL, pose)).put(obstacle("post", POST, pose))
    data = markers.encode_markers(scene, at(0))
    viewer.take(data)
    read = [sample for sample in decode_obstacles(data) if sample.name.startswith("obstacles/")]
    assert [sample.kind for sample in read] == ["box", "sphere", "cylinder"]
    for sample, solid in zip(read, (BOX, BALL, POST), strict=True):
        assert sample.size == pytest.approx(solid.size)
        assert sample.frame_id == "base"
        assert sample.stamp_ns == at(0).ros_ns
        assert np.abs(se3.pose_from(sample.position, sample.quaternion, "it") - pose).max() < 1e-12
    first = {sample.name for sample in read}
    moved = scene.remove("ball").put(obstacle("post", POST, se3.exp(np.full(6, 0.1))))
    viewer.take(markers.encode_markers(moved, at(1)))
    second = {f"obstacles/{number}" for number in viewer.numbers("obstacles")}
    assert second == first - {read[1].name}, "the other obstacles kept their numbers, the ball is removed"
    viewer.take(markers.encode_markers(moved.put(obstacle("new", BALL, pose)), at(2)))
    assert len(viewer.numbers("obstacles")) == 3
    viewer.take(markers.encode_markers(Scene(), at(3)))
    assert not viewer.numbers("obstacles")


def test_obstacles_that_expire_or_move_by_themselves() -> None:
    """No control step runs in between, because the arm may be paused."""
    markers, viewer = SceneMarkers("base"), Viewer()
    brief = obstacle("brief", BALL, np.eye(4), at(0).monotonic_ns, expires_ns=at(5).monotonic_ns)
    steady = obstacle("steady", BALL, np.eye(4), at(0).monotonic_ns, velocity_s=np.array([0.0, 0.5, 0.0]))
    scene = Scene().put(brief).put(steady)
    viewer.take(markers.encode_markers(scene, at(4)))
    assert len(viewer.numbers("obstacles")) == 2
    viewer.take(markers.encode_markers(scene, at(10)))
    (left,) = (marker for (ns, _), marker in viewer.shown.items() if ns == "obstacles")
    assert left.pose.position.y == pytest.approx(0.5)


def test_a_capsule_is_a_cylinder_with_two_round_ends() -> None:
    markers, viewer = SceneMarkers("base"), Viewer()
    viewer.take(markers.encode_markers(Scene().put(obstacle("arm", shape("capsule", (0.05, 0.4)), np.eye(4))), at(0)))
    parts = sorted((int(marker.type), marker.pose.position.z, marker.scale.z) for marker in viewer.shown.values())
    assert parts == [(SPHERE, -0.2, 0.1), (SPHERE, 0.2, 0.1), (CYLINDER, 0.0, 0.4)]


def test_the_tool_path_is_where_the_tool_was_and_stays_bounded() -> None:
    markers, viewer = SceneMarkers("base"), Viewer()
    viewer.take(markers.encode_markers(Scene(), at(0)))
    assert not viewer.shown, "no data has been received yet"
    angles = np.linspace(0.0, 2.0 * np.pi, 500)
    circle = np.column_stack((0.1 * np.cos(angles), 0.1 * np.sin(angles), np.full(500, 0.4)))
    for tick, point in enumerate(circle):
        markers.add_step(step_at(tick, point))
        if tick % 50 == 49:
            viewer.take(markers.encode_markers(Scene(), at(tick // 50)))
    strip = np.array([[p.x, p.y, p.z] for p in viewer.shown["tool_path", 0].points])
    assert np.abs(np.hypot(strip[:, 0], strip[:, 1]) - 0.1).max() < 1e-12
    gaps = np.linalg.norm(np.diff(strip, axis=0), axis=1)
    assert gaps.min() >= SPACING_M
    assert gaps.max() < 2.0 * SPACING_M
    assert len(strip) > 100
    markers.add_step(stopped_step(500, 7))
    viewer.take(markers.encode_markers(Scene(), at(11)))
    assert ("tool_path", 0) in viewer.shown, "values that were not measured add no points"
    for tick in range(3000):
        markers.add_step(step_at(tick, (0.01 * tick, 0.0, 0.0)))
        if tick % 100 == 99:
            viewer.take(markers.encode_markers(Scene(), at(12 + tick)))
    strip = viewer.shown["tool_path", 0].points
    assert len(strip) == MAX_POINTS
    assert strip[-1].x == pytest.approx(29.99)


def test_target_and_clearance_are_shown_while_they_are_known() -> None:
    markers, viewer = SceneMarkers("base"), Viewer()
    points = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.323]])
    step = step_at(0, (0.0, 0.0, 0.0), clearance=0.023, closest_points=points, closest_pair=("panda_link5", "post"))
    scene = Scene().put(obstacle("post", POST, np.eye(4))).put(obstacle("far", POST, np.eye(4)))
    markers.add_step(step)
    viewer.take(markers.encode_markers(scene, at(0)))
    line, text = viewer.shown["clearance", 0], viewer.shown["clearance", 1]
    assert np.array([[p.x, p.y, p.z] for p in line.points]).tolist() == points.tolist()
    assert text.text == "23 mm  panda_link5 - post"
    assert text.pose.position.z == pytest.approx(0.3115)
    axes = viewer.shown["target", 0]
    tips = np.array([[p.x, p.y, p.z] for p in axes.points[1::2]]) - step.pose_sd[:3, 3]
    assert np.abs(tips - 0.1 * step.pose_sd[:3, :3].T).max() < 1e-12
    near, far = (viewer.shown["obstacles", number].color for number in sorted(viewer.numbers("obstacles")))
    assert near != far, "the nearest obstacle is highlighted"
    markers.add_step(stopped_step(1, 7))
    viewer.take(markers.encode_markers(scene, at(1)))
    assert {ns for ns, _ in viewer.shown} == {"obstacles"}
    markers.add_step(
        step_at(2, (0.0, 0.0, 0.0), clearance=float("inf"), closest_pair=(), closest_points=points * np.nan)
    )
    viewer.take(markers.encode_markers(scene, at(2)))
    assert {ns for ns, _ in viewer.shown} == {"obstacles", "target"}


def test_the_first_message_and_the_last_sweep_the_screen() -> None:
    markers, viewer = SceneMarkers("base"), Viewer()
    scene = Scene().put(obstacle("post", POST, np.eye(4)))
    assert viewer.take(markers.encode_markers(scene, at(0)))[0].action == DELETE_ALL
    assert all(marker.action == ADD for marker in viewer.take(markers.encode_markers(scene, at(1))))
    viewer.take(markers.delete_all(at(2)))
    assert not viewer.shown


def test_ros_reads_the_same() -> None:
    """rclpy reads the same content and serialises it to the same bytes."""
    first, second = SceneMarkers("base"), SceneMarkers("base")
    scene = Scene().put(obstacle("post", POST, se3.exp(np.full(6, 0.3))))
    for markers in (first, second):
        markers.add_step(made_step(1, 7))
        markers.add_step(made_step(2, 7))
    data = first.encode_markers(scene, at(3))
    assert data == second.encode_markers(scene, at(3))
    ours, theirs = deserialize(data, MARKERS_TYPE).markers, by_ros(data, MARKERS_TYPE).markers
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        assert (one.ns, one.id, one.type, one.action, one.text) == (
            other.ns,
            other.id,
            other.type,
            other.action,
            other.text,
        )
        assert [(p.x, p.y, p.z) for p in one.points] == [(p.x, p.y, p.z) for p in other.points]
