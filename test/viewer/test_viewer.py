"""The viewer shows the content of a run, and the page works in a browser without internet access.

viser does the drawing. These tests check the values it receives (against Pinocchio's mesh readers and kinematics), the
playback, and in headless Chromium that the scene is visible, that the slider moves the arm, and that nothing is
requested from another computer. The appearance was inspected in docs/view.webp.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import Browser, Picture
from recorded_loop import finish, recorded_loop
from support import PROJECT

from ik_node.cli import view as view_cli
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.errors import RobotError
from ik_node.interfaces.samples import ObstacleSample
from ik_node.interfaces.step import ARRAY_FIELDS, NUMBER_FIELDS, TEXT_FIELDS, Level, Mode, Status
from ik_node.math import se3
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.messages import cdr
from ik_node.messages.decode_obstacles import decode_obstacles
from ik_node.messages.step_codec import CallKind
from ik_node.recording.run import RecordedTargets, Run
from ik_node.recording.run_reader import load_run
from ik_node.report.recorded_scene import ClosestPointQuery, RecordedObstacles, SceneHistory, read_obstacles
from ik_node.report.reported_run import read_reported_runs
from ik_node.report.text import what_was_done
from ik_node.report.verdict import verdict
from ik_node.robot import catalogue
from ik_node.robot.catalogue import robots_folder
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ArmSettings, ObstacleSettings, Settings
from ik_node.settings.schema import Value
from ik_node.viewer import decimation, meshes, status_html
from ik_node.viewer.open_run import open_run
from ik_node.viewer.page import ViewerPage
from ik_node.viewer.playback import Playback
from ik_node.viewer.plots import FROM_ZERO, PlotSpec, plots_for, scales_of
from ik_node.viewer.server import serve, url_of
from ik_node.viewer.task_plots import task_plots
from ik_node.viewer.timeline import TimelineBuffer, timeline_of

DURATION_S = 4.0
RATE_HZ = 100.0


def made_run(name: str) -> Run:
    """A synthetic run: every joint oscillates, the desired pose is 5 mm beside the tool."""
    robot = catalogue.robot_from_settings(ArmSettings(robot=name))
    n, k = robot.n, round(DURATION_S * RATE_HZ) + 1
    times = np.arange(k) / RATE_HZ
    ros_ns = np.arange(k, dtype=np.int64) * round(1e9 / RATE_HZ)
    middle = np.clip(np.full(n, 0.4), robot.limits.lower, robot.limits.upper)
    q = middle + 0.35 * np.sin(times[:, None] * np.linspace(0.7, 1.4, n))
    poses = np.array([robot.pose(row) for row in q])
    desired = poses.copy()
    desired[:, 2, 3] += 0.005
    still = np.zeros((k, 6))
    tracking = Status(Level.OK, Mode.TRACKING, "following <script>alert(1)</script>")
    known: dict[str, Any] = {
        "robot": name,
        "urdf": robot.urdf,
        "joints": robot.joints,
        "velocity_limits": robot.limits.velocity,
        "base_frame": robot.base_frame,
        "tip_frame": robot.tip_frame,
        "settings": Settings().flat(),
        "setting_changes": (),
        "times_s": times,
        "ros_ns": ros_ns,
        "state_times_s": times,
        "state_ros_ns": ros_ns,
        "q": q,
        "joint_velocity": np.gradient(q, times, axis=0),
        "pose_sb": poses,
        "pose_sd": desired,
        "error_b": still + np.array((0.0, 0.0, 0.005, 0.0, 0.0, 0.0)),
        "scale": np.ones(k),
        "multiplier_task": still + 1.0,
        "multiplier_potential": still,
        "singular_values": np.full((k, min(6, n)), 0.1),
        "clearance": np.full(k, 0.02),
        "closest_points": np.stack((poses[:, :3, 3], poses[:, :3, 3] + (0.02, 0.0, 0.0)), axis=1),
        "off_direction_limits": ((),) * k,
        "closest_pair": (("one", "other"),) * k,
        "binding": ((),) * k,
        "status": (Status(Level.OK, Mode.HOLDING, "no target yet"),) * (k // 2) + (tracking,) * (k - k // 2),
        "targets": RecordedTargets(
            times[::10],
            ros_ns[::10],
            ros_ns[::10],
            desired[::10, :3, 3],
            np.tile((0.0, 0.0, 0.0, 1.0), (len(times[::10]), 1)),
            (robot.base_frame,) * len(times[::10]),
        ),
        "complete": True,
    }
    names = {"q": "joint_position"}
    fields = (*ARRAY_FIELDS, *NUMBER_FIELDS)
    columns = {field.name: np.stack([field.not_computed(n)] * k) for field in fields}
    columns |= {names.get(name, name): known[name] for name in known if names.get(name, name) in columns}
    texts = {field.name: known[field.name] for field in TEXT_FIELDS}
    # Other entries that the viewer does not show are left out.
    entries: list[Any] = [known.get(name) for name in Run._fields]
    return Run(*entries)._replace(columns=columns, texts=texts)


@pytest.fixture(scope="module")
def run() -> Run:
    return made_run("xarm7")


@pytest.fixture
def server() -> Iterator[Any]:
    made = serve(0)
    yield made
    made.stop()


# --- playback --------------------------------------------------------------------------------------------------------


def test_playback_stays_within_the_timeline_and_stops_at_its_end() -> None:
    """For every input; play at the end restarts."""
    playback = Playback(1.0, 3.0)
    playback.toggle()
    playback.speed = 2.0
    playback.advance(0.5)
    assert playback.time_s == 2.0
    playback.advance(10.0)
    assert (playback.time_s, playback.playing) == (3.0, False)
    playback.toggle()
    assert (playback.time_s, playback.playing) == (1.0, True)
    playback.seek(-5.0)
    assert playback.time_s == 1.0
    playback.toggle()
    playback.advance(1.0)
    assert playback.time_s == 1.0


def test_live_playback_follows_the_end_until_paused() -> None:
    """A paused position stays while it is still kept; play returns to the end."""
    playback = Playback(0.0, 1.0, live=True)
    playback.extend(0.0, 2.0)
    assert playback.following
    assert playback.time_s == 2.0
    playback.playing = False
    playback.seek(1.5)
    playback.extend(0.0, 9.0)
    playback.advance(1.0)
    assert playback.time_s == 1.5
    playback.extend(4.0, 10.0)
    assert playback.time_s == 4.0
    playback.toggle()
    playback.extend(4.0, 11.0)
    assert playback.time_s == 11.0


# --- lines -----------------------------------------------------------------------------------------------------------


def test_decimated_lines_keep_every_extreme() -> None:
    """Minimum and maximum of every column, at their time up to the length of a block."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(1e-3, 3e-3, 7013))
    values = rng.normal(size=(7013, 3)) ** 5
    values[2000:2600, 1] = np.nan
    values[:, 2] = 0.25
    thin_times, decimate = decimation.decimate(times, values, max_rows=300)
    assert len(thin_times) == 300
    assert (np.diff(thin_times) > 0.0).all()
    block_s = 2.0 * (times[-1] - times[0]) / 150
    for column in range(3):
        for best, place in ((np.nanmax, np.nanargmax), (np.nanmin, np.nanargmin)):
            assert best(decimate[:, column]) == best(values[:, column])
            assert abs(thin_times[place(decimate[:, column])] - times[place(values[:, column])]) < block_s
    inside = (thin_times > times[2050]) & (thin_times < times[2550])
    assert np.isnan(decimate[inside, 1]).all()
    assert np.isfinite(decimate[:, 0]).all()


def test_short_lines_are_not_decimated() -> None:
    times, values = np.arange(5.0), np.ones((5, 2))
    assert decimation.decimate(times, values)[1] is values


def test_path_has_its_ends_and_even_steps() -> None:
    """For a circle traversed at very uneven speed, with a gap of NaN and a long stop."""
    angle = np.concatenate((np.linspace(0.0, 1.0, 4000) ** 3 * 6.0, np.full(2000, 6.0)))
    points = 0.2 * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(len(angle))))
    points[100:120] = np.nan
    found = decimation.path(points, step_m=0.004)
    assert np.array_equal(found[0], points[0])
    assert np.array_equal(found[-1], points[-1])
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    assert steps.max() < 0.009
    assert len(found) == pytest.approx(0.2 * 6.0 / 0.004, rel=0.05)
    assert len(decimation.path(points, max_points=50, step_m=1e-6)) <= 52


# --- timeline --------------------------------------------------------------------------------------------------------


def test_ring_buffer_keeps_the_newest_and_never_changes_earlier_timelines(run: Run) -> None:
    """A live timeline is extended while earlier ones are drawn; those must not change."""
    timeline, buffer = timeline_of(run), TimelineBuffer(len(run.joints), capacity=50)
    snapshots = []
    for row in range(len(timeline.times_s)):
        buffer.append(timeline.frame(row))
        buffer.append(timeline.frame(row))  # the same time again: ignored
        snapshots.append(buffer.timeline())
    for row, seen in enumerate(snapshots):
        count = len(seen.times_s)
        assert min(row + 1, 50) <= count <= 100
        assert np.array_equal(seen.times_s, timeline.times_s[row + 1 - count : row + 1])
        assert np.array_equal(seen.pose_sd, timeline.pose_sd[row + 1 - count : row + 1])
        assert seen.status == timeline.status[row + 1 - count : row + 1]


def test_frame_is_the_last_one_before(run: Run) -> None:
    timeline = timeline_of(run)
    frame = timeline.frame(timeline.row(1.2345))
    assert frame.time_s == pytest.approx(1.23)
    assert np.array_equal(frame.joint_position, run.q[123])
    assert timeline.row(-9.0) == 0
    assert timeline.row(99.0) == len(run.q) - 1
    assert timeline.status_changes() == [0, len(run.q) // 2]


# --- meshes ----------------------------------------------------------------------------------------------------------


def pinocchio_corners(robot: Robot) -> dict[int, Array]:
    """Bounding box of the geometry at each joint, from Pinocchio's mesh reader (assimp)."""
    places = [str(robots_folder().parent.parent)]
    model = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.GeometryType.VISUAL, None, places)
    points: dict[int, list[Array]] = {}
    for entry in model.geometryObjects:
        placed = np.array(entry.geometry.vertices()) @ entry.placement.rotation.T + entry.placement.translation
        points.setdefault(entry.parentJoint, []).append(placed)
    return {joint: extremes(np.concatenate(many)) for joint, many in points.items()}


def extremes(points: Array) -> Array:
    return np.array([points.min(axis=0), points.max(axis=0)])


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_meshes_agree_with_pinocchio(name: str) -> None:
    """COLLADA files with their own units and axes (panda, ur5) and STL files (xarm7), in colour."""
    robot = catalogue.robot_from_settings(ArmSettings(robot=name))
    parts = meshes.load(robot)
    reference = pinocchio_corners(robot)
    assert {part.parent for part in parts} == set(reference)
    for joint, corners in reference.items():
        mine = extremes(np.concatenate([part.vertices for part in parts if part.parent == joint]))
        assert np.abs(mine - corners).max() < 2e-6, joint
    for part in parts:
        assert part.faces.max() < len(part.vertices)
        assert all(0.0 <= value <= 1.0 for value in part.colour)
    assert len({part.colour for part in parts}) > 1
    assert len({part.name for part in parts}) == len(parts)


def test_meshes_that_trimesh_cannot_read_keep_their_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """For example without pycollada: default colour, the same triangles."""
    import trimesh

    def fails(path: str) -> None:
        raise ImportError(f"cannot read {path}")

    monkeypatch.setattr(trimesh, "load_scene", fails)
    robot = catalogue.robot_from_settings(ArmSettings(robot="ur5"))
    parts = meshes.load(robot)
    for joint, corners in pinocchio_corners(robot).items():
        mine = extremes(np.concatenate([part.vertices for part in parts if part.parent == joint]))
        assert np.array_equal(mine, corners)


def test_primitive_shapes_of_a_urdf_are_drawn() -> None:
    """Box, sphere and cylinder, with the URDF's own colour."""
    visual = "<visual><origin xyz='0 0 1'/><geometry>{}</geometry>{}</visual>"
    red = "<material name='red'><color rgba='1 0 0 1'/></material>"
    solids = ("<box size='2 4 6'/>", "<sphere radius='0.5'/>", "<cylinder radius='0.3' length='2'/>")
    urdf = (
        "<robot name='r'><link name='a'/><link name='b'>"
        + "".join(visual.format(solid, red) for solid in solids)
        + "</link><joint name='j' type='continuous'><parent link='a'/><child link='b'/><axis xyz='0 0 1'/></joint>"
        "</robot>"
    )
    parts = meshes.load(Robot(urdf))
    halves = [(1.0, 2.0, 3.0), (0.5, 0.5, 0.5), (0.3, 0.3, 1.0)]
    for part, half in zip(parts, halves, strict=True):
        assert extremes(part.vertices) == pytest.approx(np.array([(0.0, 0.0, 1.0)]) + np.outer((-1, 1), half), abs=0.01)
        assert part.colour == (1.0, 0.0, 0.0)


def test_error_names_the_missing_mesh() -> None:
    run = made_run("xarm7")
    robot = Robot(run.urdf.replace("package://", "package://gone/"), run.base_frame, run.tip_frame)
    with pytest.raises(RobotError, match=r"link_base\.stl"):
        meshes.load(robot)


# --- the scene on the server -----------------------------------------------------------------------------------------


def world_pose(server: Any, name: str) -> Array:
    """Pose of a node of viser whose parents are ``/base`` or fixed."""
    handle = server.scene.get_handle_by_name(name)
    w, x, y, z = handle.wxyz
    pose = se3.pose_from(handle.position, (x, y, z, w))
    return world_pose(server, "/base") @ pose if name.startswith("/base/") else pose


def ends(server: Any, name: str) -> Array:
    """End points of an object of unit length along x, in the base frame."""
    handle = server.scene.get_handle_by_name(name)
    w, x, y, z = handle.wxyz
    points = np.asarray(handle.points[0], dtype=np.float64) * handle.scale
    return np.asarray(points @ se3.rotation_from_quaternion((x, y, z, w)).T + handle.position)


@pytest.mark.parametrize("name", ["xarm7", "talos_arm"])
def test_arm_and_frames_agree_with_kinematics(name: str, server: Any) -> None:
    """Also if the base frame is not the root of the model (talos_arm)."""
    run = made_run(name)
    page = open_run(server, run)
    page.playback.seek(2.0)
    page.request_redraw()
    page.update(0.0)
    robot = page.content.robot
    q = run.q[200]
    base_root = robot.pose_base_root
    for joint in page.scene_view.joints:
        if joint:
            frame = next(f for f in robot.model.frames if f.parentJoint == joint and f.type == pin.FrameType.BODY)
            expected = robot.frame_pose(q, frame.name) @ se3.inverse(frame.placement.homogeneous)
            assert np.abs(base_root @ world_pose(server, f"/robot/{joint}") - expected).max() < 1e-6
    for node, pose in (("tool", run.pose_sb[200]), ("desired", run.pose_sd[200])):
        assert np.abs(base_root @ world_pose(server, f"/base/{node}") - pose).max() < 1e-6
        assert server.scene.get_handle_by_name(f"/base/{node}").visible
    begin, end = ends(server, "/base/lambda_task_linear")
    assert begin == pytest.approx(run.pose_sb[200, :3, 3], abs=1e-6)
    along = run.pose_sb[200, :3, :3] @ run.multiplier_task[200, :3]
    assert (end - begin) / np.linalg.norm(end - begin) == pytest.approx(along / np.linalg.norm(along), abs=1e-4)


def test_values_that_were_not_computed_are_hidden(run: Run, server: Any) -> None:
    """Frames and arrows are hidden; the arm keeps its last position."""
    half = len(run.times_s) // 2
    broken = {
        name: getattr(run, name).copy()
        for name in ("joint_position", "pose_sb", "pose_sd", "error_b", "multiplier_task")
    }
    for column in broken.values():
        column[half:] = np.nan
    page = open_run(server, run.with_columns(**broken))
    page.playback.seek(run.times_s[half - 1])
    page.request_redraw()
    page.update(0.0)
    seen = world_pose(server, "/robot/3")
    page.playback.seek(DURATION_S)
    page.request_redraw()
    page.update(0.0)
    assert np.array_equal(world_pose(server, "/robot/3"), seen)
    for name in ("tool", "desired", "lambda_task_linear"):
        assert not server.scene.get_handle_by_name(f"/base/{name}").visible
    assert "not computed" in page.status


def test_without_meshes_lines_and_a_note_are_shown(run: Run, server: Any) -> None:
    page = open_run(server, run._replace(urdf=run.urdf.replace("package://", "package://gone/")))
    points = server.scene.get_handle_by_name("/base/links").points
    assert points.shape == (len(run.joints) + 1, 2, 3)
    assert points[0, 0] == pytest.approx((0.0, 0.0, 0.0))
    assert points[-1, 1] == pytest.approx(run.pose_sb[0, :3, 3], abs=1e-6)
    assert "link_base.stl" in page.content.notes[0]


def test_obstacles_are_added_moved_and_deleted(run: Run, server: Any) -> None:
    """By messages; the distance to a far sphere agrees with geometry."""
    robot = Robot(run.urdf, run.base_frame, run.tip_frame)

    def message(name: str, action: str, x: float, kind: str = "sphere", lifetime_ns: int = 0) -> ObstacleSample:
        size = (0.1,) if kind == "sphere" else (0.1, 0.2, 0.3)
        at = np.array([x, 0.0, 0.5])
        return ObstacleSample(0, robot.base_frame, name, action, kind, size, at, np.array([0, 0, 0, 1.0]), lifetime_ns)

    arrivals = (
        (0.5, (message("a/1", "add", 2.0), message("b", "add", 3.0, lifetime_ns=500_000_000))),
        (0.7, (message("invalid", "add", 1.0, kind="torus"),)),
        (2.0, (message("a/1", "add", 1.5), message("c", "add", 3.0, kind="box"))),
        (3.0, (message("a/1", "delete", 0.0),)),
        (3.5, (message("", "delete_all", 0.0),)),
    )
    page = open_run(server, run, obstacles=RecordedObstacles(None, arrivals))

    def names(time_s: float) -> list[str]:
        page.playback.seek(time_s)
        page.request_redraw()
        page.update(0.0)
        return list(page.scene_view.obstacles)

    assert names(0.0) == []
    assert names(0.9) == ["a/1", "b"]
    assert names(1.2) == ["a/1"]
    assert server.scene.get_handle_by_name("/base/obstacles/a_1").position == pytest.approx((2.0, 0.0, 0.5))
    assert names(2.5) == ["a/1", "c"]
    assert server.scene.get_handle_by_name("/base/obstacles/a_1").position == pytest.approx((1.5, 0.0, 0.5))
    assert names(3.2) == ["c"]
    assert names(3.8) == []
    nearby = ClosestPointQuery(robot, ObstacleSettings(self_collision=False))
    ball = Scene().put(obstacle("ball", shape("sphere", (0.1,)), se3.pose_from((9.0, 0.0, 0.5), (0, 0, 0, 1.0))))
    found = nearby.closest(run.q[0], ball)
    assert found is not None
    assert np.linalg.norm(found.points_s[1] - (9.0, 0.0, 0.5)) == pytest.approx(0.1, abs=1e-6)
    assert np.linalg.norm(found.points_s[1] - found.points_s[0]) == pytest.approx(found.distance, abs=1e-6)


def test_moving_obstacles_are_extrapolated_between_messages() -> None:
    """As in the controller; an obstacle given in a frame of the arm is placed where that frame was."""
    robot = catalogue.robot_from_settings(ArmSettings(robot="xarm7"))
    scenes, q = SceneHistory(robot), np.full(7, 0.3)
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    for time_s in (0.0, 0.1, 0.2):
        at = np.array([0.5 * time_s, 0.0, 0.0])
        sample = ObstacleSample(0, robot.base_frame, "m", "add", "sphere", (0.1,), at, unit, 0)
        scenes.add((time_s, (sample,)), q)
    assert scenes(0.25).obstacles["m"].pose_s[0, 3] == pytest.approx(0.125)
    tip = ObstacleSample(0, robot.tip_frame, "t", "add", "sphere", (0.1,), np.array([0.0, 0.0, 0.1]), unit, 0)
    scenes.add((0.3, (tip,)), q)
    expected = robot.pose(q) @ np.array([0.0, 0.0, 0.1, 1.0])
    assert scenes(0.3).obstacles["t"].pose_s[:3, 3] == pytest.approx(expected[:3])


def test_the_tolerance_of_the_run_is_drawn_from_its_time_on(run: Run, server: Any) -> None:
    """At the desired pose; its checkbox hides it."""
    changes = ((2.0, {"task.tolerance": (0.0, 0.0, 0.0, 0.0, 0.0, float("inf"))}),)
    page = open_run(server, run._replace(setting_changes=changes))
    node = server.scene.get_handle_by_name("/base/tolerance")

    def show(time_s: float) -> bool:
        page.playback.seek(time_s)
        page.request_redraw()
        page.update(0.0)
        return bool(node.visible)

    assert not show(1.0)
    assert show(3.0)
    row = timeline_of(run).row(3.0)
    assert node.position == pytest.approx(run.pose_sd[row, :3, 3])
    points = server.scene.get_handle_by_name("/base/tolerance/free_rz").points
    assert np.abs(points[..., :2]).max() == 0.0
    w, x, y, z = node.wxyz
    axis = se3.rotation_from_quaternion(np.array([x, y, z, w]))[:, 2]
    assert axis == pytest.approx(run.pose_sd[row, :3, 2], abs=1e-9)
    page.scene_view.set_visible("tolerance", False)
    assert not show(3.0)
    assert not show(1.0)


def test_what_is_not_exact_is_listed_and_drawn_from_its_time_on(run: Run, server: Any) -> None:
    """The desired pose is 5 mm above the tool: in the axes of the base a band, and no error."""
    changes: tuple[tuple[float, dict[str, Value]], ...] = (
        (1.5, {"task.tolerance": (0.0, 0.0, 0.01, 0.0, 0.0, float("inf")), "task.frame": "base"}),
        (3.0, {"task.tolerance": (0.0,) * 6}),
    )
    page = open_run(server, run._replace(setting_changes=changes))
    texts = []
    for time_s in (1.0, 2.0, 3.5):
        page.playback.seek(time_s)
        page.request_redraw()
        page.update(0.0)
        texts.append(page.status)
    assert "band of" not in texts[0]
    assert "free" not in texts[0]
    assert "z, band of \u00b110 mm" in texts[1]
    assert ">5.0 mm<" in texts[1]
    assert "rz, free" in texts[1]
    assert "band of" not in texts[2]
    positions, rotations = task_plots(page.content.tolerance_at)
    timeline = timeline_of(run)
    within = (timeline.times_s > 1.5) & (timeline.times_s <= 3.0)
    for plot, index, value in ((positions, 2, 5.0), (rotations, 2, 0.0)):
        columns = plot.columns(timeline)
        assert columns[within, index] == pytest.approx(value, abs=1e-6)
        assert np.isnan(columns[~within]).all()
        assert np.isnan(np.delete(columns, index, axis=1)).all()
    assert np.isnan(task_plots(lambda _: TaskTolerance())[0].columns(timeline)).all()


@pytest.mark.parametrize("span", [None, FROM_ZERO, (0.0, 1.1)])
def test_values_that_are_not_known_at_first_do_not_empty_a_plot(span: tuple[float | None, float | None] | None) -> None:
    """uPlot finds no range of lines of which one begins with NaN."""
    plot = PlotSpec("title", ("one", "two"), lambda timeline: timeline.pose_sb[:, :2, 3], span)
    known = np.array([[3.0, 210.0], [4.0, 190.0], [5.0, np.nan]])
    assert scales_of(plot, known).get("y") == (None if span is None else {"range": span})
    for column in (0, 1):
        values = known.copy()
        values[0, column] = np.nan
        low, high = scales_of(plot, values)["y"]["range"]
        if span == (0.0, 1.1):
            assert (low, high) == span
        else:
            assert 0.0 <= low <= 3.0
            assert np.nanmax(values) <= high <= 300.0
            assert scales_of(plot, 0.0 * values + 7.0)["y"]["range"][1] >= 7.0, "constant"
    for nothing in (0.0, np.nan):
        low, high = scales_of(plot, np.full((3, 2), nothing)).get("y", {"range": (0.0, 1.0)})["range"]
        assert (low, high) == (span if span == (0.0, 1.1) else (0.0, 1.0))


def test_recorded_texts_are_escaped(run: Run) -> None:
    """A recorded reason can contain any text."""
    frame = timeline_of(run).frame(len(run.times_s) - 1)
    text = status_html.frame_html(frame, run.joints, run.velocity_limits, mass_weighted=True, gradient_gain=0.5)
    assert "<script" not in text
    assert "following &lt;script&gt;" in text
    assert "5.000 mm" in text
    assert "<b>" not in status_html.note_html("<b>")


# --- a recording -----------------------------------------------------------------------------------------------------

SCENE = "obstacles: [{name: post, cylinder: {radius: 0.04, length: 0.7}, position: [0.4, 0.35, 0.35]}]"


def sphere(frame_id: str) -> Any:
    """A sphere of 0.1 m radius as a marker."""
    known = {
        "header": cdr.header(frame_id),
        "ns": "ball",
        "type": 2,
        "pose": cdr.make(
            "geometry_msgs/msg/Pose",
            position=cdr.make("geometry_msgs/msg/Point", x=0.5, y=-0.4, z=0.6),
            orientation=cdr.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        ),
        "scale": cdr.make("geometry_msgs/msg/Vector3", x=0.2, y=0.2, z=0.2),
        "color": cdr.make("std_msgs/msg/ColorRGBA", r=1.0, g=0.0, b=0.0, a=1.0),
        "lifetime": cdr.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        "texture": cdr.make(
            "sensor_msgs/msg/CompressedImage", header=cdr.header(""), format="", data=np.zeros(0, dtype=np.uint8)
        ),
        "mesh_file": cdr.make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, dtype=np.uint8)),
    }
    empty: dict[str, Any] = dict.fromkeys(("id", "action", "frame_locked", "mesh_use_embedded_materials"), 0)
    empty |= dict.fromkeys(("text", "mesh_resource", "texture_resource"), "")
    empty |= {name: [] for name in ("points", "colors", "uv_coordinates")}
    return cdr.make("visualization_msgs/msg/Marker", **empty, **known)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of a moving panda; a post from the start, a ball from 0.25 s on."""
    folder = tmp_path_factory.mktemp("view")
    (folder / "scene.yaml").write_text(SCENE)
    loop = recorded_loop(folder / "bag", {"rate_hz": 200.0, "obstacles.scene": str(folder / "scene.yaml")})
    loop.run(0.05)
    start = loop.pose()

    def pose(time_s: float) -> Array:
        wanted: Array = start.copy()
        wanted[1, 3] += 0.1 * time_s
        return wanted

    loop.follow(pose, 0.2, 50.0)
    data = cdr.serialize(cdr.make("visualization_msgs/msg/MarkerArray", markers=[sphere(loop.robot.base_frame)]))
    caller: Any = loop.controller
    caller.call(CallKind.ON_OBSTACLES, loop.now, decode_obstacles(data), data)
    loop.run(0.25)
    finish(loop)
    return folder / "bag"


def test_recorded_obstacles_and_clearance_are_those_of_the_run(bag: Path, server: Any) -> None:
    """The line between the closest points ends at the surface of the post and has the recorded clearance as length; the
    ball appears at its time of arrival."""
    run = load_run(bag)
    found = read_obstacles(bag)
    assert [time_s for time_s, _ in found.arrivals] == [pytest.approx(0.245)]
    page = open_run(server, run, str(bag), found)

    def show(time_s: float) -> None:
        page.playback.seek(time_s)
        page.request_redraw()
        page.update(0.0)

    show(0.2)
    assert list(page.scene_view.obstacles) == ["post"]
    show(0.4)
    assert list(page.scene_view.obstacles) == ["ball/0", "post"]
    assert server.scene.get_handle_by_name("/base/obstacles/ball_0").position == pytest.approx((0.5, -0.4, 0.6))
    line = ends(server, "/base/clearance")
    row = timeline_of(run).row(0.4)
    assert np.linalg.norm(line[1] - line[0]) == pytest.approx(run.clearance[row], abs=1e-5)
    assert run.closest_pair[row][-1] in page.status
    near_post = ClosestPointQuery(
        Robot(run.urdf, run.base_frame, run.tip_frame), ObstacleSettings(self_collision=False)
    )
    post = page.content.scene_at(0.0)
    closest = near_post.closest(run.q[row], post)
    assert closest is not None
    assert np.linalg.norm(closest.points_s[1, :2] - (0.4, 0.35)) == pytest.approx(0.04, abs=1e-6)


def test_page_of_a_recording_opens_with_its_verdict(server: Any) -> None:
    """And plots the error to the trajectory beside that to the reference, under the names of the report."""
    (reported,) = read_reported_runs([PROJECT / "bags" / "limit"])
    page = open_run(server, reported.run, "limit", metrics=reported.metrics)
    text = page.content.verdict_html
    assert verdict(reported.metrics).text in text
    assert what_was_done(reported.metrics) in text
    plot = plots_for(reported.run.joints, reported.run.velocity_limits, False, page.content.to_trajectory)[0]
    assert plot.labels == ("tool to trajectory", "tool to reference")
    found = plot.columns(timeline_of(reported.run)).max(axis=0)
    assert reported.metrics.tracking is not None
    assert found[0] == pytest.approx(reported.metrics.tracking.overall.position_max_mm, rel=1e-3)
    assert "slowed" in status_html.mode_bar_html(timeline_of(reported.run), 0, 0)


def test_potential_term_is_shown_as_a_wrench() -> None:
    """Divided by the gain k, as in the report."""
    run = load_run(PROJECT / "bags" / "gravity_gradient")
    frame = timeline_of(run).frame(100)
    text = status_html.frame_html(frame, run.joints, run.velocity_limits, mass_weighted=True, gradient_gain=0.5)
    force = np.linalg.norm(frame.multiplier_potential[:3]) / 0.5
    assert force > 1.0
    assert f"{force:.3f} N<" in text


def test_command_line_serves_a_recording(bag: Path) -> None:
    """Until a signal ends it with exit code 0."""
    command = [sys.executable, "-m", "ik_node.cli.view", str(bag), "--port", "0"]
    viewer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert viewer.stdout is not None
    try:
        address = re.search(r"http://localhost:(\d+)", viewer.stdout.readline())
        assert address is not None
        with urllib.request.urlopen(f"http://127.0.0.1:{address[1]}/") as answer:
            assert b"<html" in answer.read(2000)
        viewer.send_signal(signal.SIGINT)
        assert viewer.wait(120.0) == 0
    finally:
        viewer.kill()
        viewer.communicate()


# --- the command line ------------------------------------------------------------------------------------------------


def test_command_line_reports_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert view_cli.main([]) == 2
    assert view_cli.main([str(tmp_path), "--live"]) == 2
    assert view_cli.main([str(tmp_path / "nothing")]) == 2
    assert "nothing" in capsys.readouterr().err


# --- in a browser ----------------------------------------------------------------------------------------------------

WIDTH, HEIGHT = 1060, 440
LEFT, RIGHT = 300, 300


def scene_of(picture: Picture) -> Picture:
    """The scene between the panels of a screenshot."""
    return picture[10:, LEFT + 20 : WIDTH - RIGHT - 20]


def changed(first: Picture, second: Picture) -> float:
    """Fraction of the scene's pixels that differ clearly."""
    return float((np.abs(scene_of(first) - scene_of(second)).max(axis=2) > 24).mean())


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    made = Browser(tmp_path, WIDTH, HEIGHT)
    yield made
    made.close()


@pytest.fixture
def page(run: Run, server: Any) -> Iterator[ViewerPage]:
    free_spin = {"task.tolerance": (0.0, 0.0, 0.0, 0.0, 0.0, float("inf"))}
    made = open_run(server, run._replace(setting_changes=((1.5, free_spin),)), "made/run")
    server.scene.configure_default_lights(cast_shadow=False)  # slow without a GPU
    done = threading.Event()

    def update() -> None:
        last_s = time.monotonic()
        while not done.wait(0.03):
            now_s = time.monotonic()
            made.update(now_s - last_s)
            last_s = now_s

    thread = threading.Thread(target=update)
    thread.start()
    yield made
    done.set()
    thread.join()


def test_page_in_a_browser_without_internet(page: ViewerPage, browser: Browser) -> None:
    """The arm is visible; the slider moves it, the buttons work, and all requests go to this computer."""
    url = url_of(page.server).replace("localhost", "127.0.0.1")
    browser.open(url)
    browser.until("the page to connect", lambda: bool(page.server.get_clients()))
    browser.until("the controls", lambda: browser.evaluate("!!document.querySelector('.mantine-Slider-track')"))
    # Chromium is slow without a GPU, and viser shows a notification about it in front of the scene.
    close = "document.querySelectorAll('.mantine-Notification-closeButton').forEach(e => e.click())"
    box = "[...document.querySelectorAll('label')].find(e => e.textContent == 'robot').htmlFor"

    def steady_picture(shown: str) -> Picture:
        pictures = [browser.picture()]

        def is_steady() -> bool:
            browser.evaluate(close)
            # Repeated: the server's echo of an earlier click may arrive after a later one.
            browser.evaluate(f"(e => {{ if (e.checked != {shown}) e.click() }})(document.getElementById({box}))")
            pictures.append(browser.picture())
            return len(pictures) > 2 and not any(changed(one, pictures[-1]) for one in pictures[-3:-1])

        browser.until("a steady picture", is_steady)
        return pictures[-1]

    def is_switched() -> bool:
        """Repeated until all meshes are loaded and drawn, which takes a while on a slow machine."""
        visible, hidden, again = (steady_picture(shown) for shown in ("true", "false", "true"))
        return min(changed(visible, hidden), changed(hidden, again)) > 0.02 and changed(visible, again) < 0.001

    browser.until("the arm to be hidden and shown", is_switched)
    visible = steady_picture("true")

    pose = world_pose(page.server, "/robot/5")
    x, y, width, height = browser.place(".mantine-Slider-track")
    browser.click(x + 0.6 * width, y + 0.5 * height)
    browser.until("the slider event", lambda: page.playback.time_s > 0.0)
    assert page.playback.time_s == pytest.approx(0.6 * DURATION_S, abs=0.05 * DURATION_S)
    browser.until("the arm to move", lambda: changed(visible, browser.picture()) > 0.02)
    assert np.abs(world_pose(page.server, "/robot/5") - pose).max() > 0.1
    browser.until("the status", lambda: browser.evaluate("document.body.innerText.includes('following <script>')"))

    x, y, width, height = browser.place("button", "Play")
    here_s, page.playback.speed = page.playback.time_s, 0.001  # a slow browser shows it before it ends
    browser.click(x + 0.5 * width, y + 0.5 * height)
    browser.until("playing", lambda: page.playback.time_s > here_s)
    browser.until("the pause button", lambda: browser.evaluate("document.body.innerText.includes('Pause')"))
    browser.click(x + 0.5 * width, y + 0.5 * height)
    browser.until("the pause", lambda: not page.playback.playing)

    browser.until("plots", lambda: browser.evaluate("document.querySelectorAll('.uplot canvas').length") == 7)
    charts = "Object.values(window.__viserTestpoints.uplots).map(entry => entry.chart)"
    undrawn = "charts.filter(chart => chart.scales.y.min == null).map(chart => chart.series[1].label)"
    # rx, ry and rz are NaN at first
    browser.until("their lines", lambda: browser.evaluate(f"(charts => {undrawn})({charts})") == [])
    asked = browser.requested()
    assert asked
    assert [address for address in asked if not re.match(rf"(data|blob):|{re.escape(url)}/", address)] == []
    assert browser.errors() == []
