"""A recording that is exported for Foxglove: transforms, markers and layouts fit the run and each other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from loop import Loop
from recorded_loop import finish, recorded_loop
from rosbags.highlevel import AnyReader

from ik_node.cli import export
from ik_node.math import se3
from ik_node.messages.decode_obstacles import DELETE
from ik_node.messages.markers import SPHERE, TRIANGLE_LIST
from ik_node.trajectory.shapes import figure_of_eight
from ik_node.viewer import meshes

VALUES = {"rate_hz": 100.0, "obstacles.self_collision": False}
ROBOTS = ("panda", "ur5")


@pytest.fixture(scope="module", params=ROBOTS)
def exported(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Loop]:
    """A recorded figure of eight with a ball, exported."""
    folder = tmp_path_factory.mktemp("foxglove")
    scene = folder / "scene.yaml"
    scene.write_text("obstacles:\n- {name: ball, sphere: {radius: 0.1}, position: [0.0, 0.0, 1.5]}\n")
    loop = recorded_loop(folder / "bag", {**VALUES, "obstacles.scene": str(scene)}, request.param)
    loop.follow(figure_of_eight(loop.pose()).pose, 2.0, 50.0)
    finish(loop)
    assert export.main([str(folder / "bag"), "--foxglove", str(folder / "out")]) == 0
    return folder / "out", loop


def messages(folder: Path, topic: str) -> list[tuple[int, Any]]:
    """Time of recording and content."""
    with AnyReader([folder]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        return [(at_ns, reader.deserialize(data, entry.msgtype)) for entry, at_ns, data in reader.messages(wanted)]


def poses(message: Any) -> dict[str, np.ndarray]:
    """Child frame -> pose of a TFMessage."""
    found = {}
    for entry in message.transforms:
        at, turn = entry.transform.translation, entry.transform.rotation
        found[entry.child_frame_id] = se3.pose_from([at.x, at.y, at.z], [turn.x, turn.y, turn.z, turn.w])
    return found


def test_the_transforms_are_the_poses_of_the_links(exported: tuple[Path, Loop]) -> None:
    folder, loop = exported
    ((_, fixed),) = messages(folder, "/tf_static")
    moving = messages(folder, "/tf")
    states = dict(messages(folder, "/joint_states"))
    assert len(moving) >= 90
    for at_ns, message in moving:
        q = np.array(states[at_ns].position)
        links = {**poses(fixed), **poses(message)}
        assert {*links, loop.robot.base_frame} == set(loop.robot.frames)
        for link, pose in links.items():
            np.testing.assert_allclose(pose, loop.robot.frame_pose(q, link), atol=1e-12)
        assert {entry.header.frame_id for entry in message.transforms} == {loop.robot.base_frame}


def test_the_arm_is_drawn_where_pinocchio_places_its_meshes(exported: tuple[Path, Loop]) -> None:
    """Marker points, moved by /tf, are the vertices of the visual geometry, moved by the joints of the model."""
    folder, loop = exported
    robot = loop.robot
    ((_, arm),) = messages(folder, "/ik_node/arm")
    ((_, fixed),) = messages(folder, "/tf_static")
    at_ns, last = messages(folder, "/tf")[-1]
    q = np.array(dict(messages(folder, "/joint_states"))[at_ns].position)
    links = {**poses(fixed), **poses(last), robot.base_frame: np.eye(4)}
    robot.pose(q)
    parts = meshes.load(robot)
    assert len(arm.markers) == len(parts) > 5
    for entry, part in zip(arm.markers, parts, strict=True):
        assert entry.type == TRIANGLE_LIST
        assert entry.frame_locked
        assert len(entry.points) == 3 * len(part.faces)
        assert (entry.scale.x, entry.scale.y, entry.scale.z) == (1.0, 1.0, 1.0)
        assert entry.color.a == 1.0
        drawn = np.array([[point.x, point.y, point.z, 1.0] for point in entry.points]) @ links[entry.header.frame_id].T
        placed = robot.pose_base_root @ robot.data.oMi[part.parent].homogeneous
        expected = part.vertices[part.faces].reshape(-1, 3) @ placed[:3, :3].T + placed[:3, 3]
        np.testing.assert_allclose(drawn[:, :3], expected, atol=1e-9)


def test_obstacles_and_targets_are_markers(exported: tuple[Path, Loop]) -> None:
    folder, loop = exported
    found = messages(folder, "/ik_node/markers")
    assert len(found) >= 18
    shown = [entry for _, message in found for entry in message.markers if entry.action != DELETE]
    (ball,) = {(entry.pose.position.z, entry.scale.x) for entry in shown if entry.ns == "obstacles"}
    assert ball == (1.5, 0.2)
    assert {entry.type for entry in shown if entry.ns == "obstacles"} == {SPHERE}
    assert {"tool_path", "target"} <= {entry.ns for entry in shown}
    assert {entry.header.frame_id for entry in shown if entry.ns} == {loop.robot.base_frame}


def test_inputs_and_outputs_keep_their_bytes(exported: tuple[Path, Loop]) -> None:
    folder, _ = exported
    with AnyReader([folder]) as copy, AnyReader([folder.parent / "bag"]) as original:
        topics = {entry.topic for entry in copy.connections} & {entry.topic for entry in original.connections}
        assert {"/joint_states", "/ik_node/commands", "/ik_node/target_pose", "/robot_description"} <= topics

        def content(reader: AnyReader) -> list[tuple[str, int, bytes]]:
            wanted = [entry for entry in reader.connections if entry.topic in topics]
            return sorted((entry.topic, at_ns, bytes(data)) for entry, at_ns, data in reader.messages(wanted))

        assert content(copy) == content(original)


def test_the_layouts_name_topics_and_joints_of_the_run(exported: tuple[Path, Loop]) -> None:
    folder, loop = exported
    with AnyReader([folder]) as reader:
        topics = {entry.topic for entry in reader.connections}
    layout = json.loads((folder / "foxglove_layout.json").read_text())
    for title in ("Joint positions", "Joint velocity commands"):
        (panel,) = (entry for entry in layout["configById"].values() if entry.get("title") == title)
        assert [path["label"] for path in panel["paths"]] == list(loop.robot.joints)
    (view,) = (entry for name, entry in layout["configById"].items() if name.startswith("3D!"))
    assert view["followTf"] == loop.robot.base_frame
    shown = {topic for topic, entry in view["topics"].items() if entry.get("visible")}
    assert {"/ik_node/arm", "/ik_node/markers"} <= shown
    assert "/robot_description" not in shown, "its meshes are package:// and would be missing"
    curves = {entry.get("name", "") for entry in ElementTree.parse(folder / "plotjuggler_layout.xml").iter("curve")}
    assert {f"/joint_states/{joint}/position" for joint in loop.robot.joints} <= curves
    assert {f"/ik_node/joint_velocity/{joint}/velocity" for joint in loop.robot.joints} <= curves
    for curve in curves:
        assert any(curve.startswith(f"{topic}/") for topic in topics), curve
    others = {"panda_joint1"} - set(loop.robot.joints)
    assert not any(other in curve for other in others for curve in curves)


def test_an_export_that_cannot_be_made_is_one_line(exported: tuple[Path, Loop], capsys: Any) -> None:
    folder, _ = exported
    assert export.main([str(folder.parent / "bag"), "--foxglove", str(folder)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert export.main([str(folder.parent / "bag")]) == 2
    assert "--foxglove FOLDER" in capsys.readouterr().err
    assert export.main([str(folder), "--foxglove", str(folder.parent / "new")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
