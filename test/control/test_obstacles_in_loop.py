"""Obstacles that are added and removed while the arm moves: avoided, and ignored after removal. In one process.

Distances are tested in test_collision.py, the optimum with velocity dampers in test_constrained.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.errors import SceneError
from ik_node.interfaces.samples import ObstacleSample
from ik_node.messages.cdr import make, serialize, time_message
from ik_node.messages.decode_obstacles import decode_obstacles
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def ball(position: object, radius: float = 0.05, lifetime_ns: int = 0, frame: str = "panda_link0") -> ObstacleSample:
    return ObstacleSample(0, frame, "test/1", "add", "sphere", (radius,), np.array(position), UPRIGHT, lifetime_ns)


def reach_down(robot: Robot, obstacle: ObstacleSample | None, **values: object) -> Loop:
    """The target is 0.25 m below the tool."""
    loop = Loop(robot, READY["panda"], Settings().with_values(values))
    loop.run(0.05)
    if obstacle is not None:
        loop.controller.on_obstacles((obstacle,), loop.now)
    goal = loop.pose()
    for step in range(150):
        lowered = goal.copy()
        lowered[2, 3] -= 0.25 * min(step / 100.0, 1.0)
        loop.target(lowered)
        loop.run(0.02)
    return loop


def test_an_obstacle_on_the_path_stops_the_arm_before_contact_until_it_is_removed(panda: Robot) -> None:
    free = reach_down(panda, None)
    start, end = free.steps[0].pose_sb, free.steps[-1].pose_sb
    assert start[2, 3] - end[2, 3] > 0.24
    in_the_way = ball(end[:3, 3] + (0.0, 0.0, -0.02))
    loop = reach_down(panda, in_the_way)
    assert min(step.clearance for step in loop.steps) > 0.005
    assert loop.pose()[2, 3] > end[2, 3] + 0.02
    assert "test/1" in loop.steps[-1].closest_pair
    assert any(name.startswith("damper") for step in loop.steps for name in step.binding)
    loop.controller.on_obstacles((in_the_way._replace(action="delete"),), loop.now)
    for _ in range(100):
        loop.target(end)
        loop.run(0.02)
    assert np.abs(loop.pose()[:3, 3] - end[:3, 3]).max() < 1e-3


def test_an_obstacle_with_a_lifetime_is_removed(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"])
    loop.run(0.05)
    near = loop.pose()[:3, 3] + (0.0, 0.0, -0.09)
    loop.controller.on_obstacles((ball(near, lifetime_ns=100_000_000),), loop.now)
    loop.run(0.05)
    assert "test/1" in loop.steps[-1].closest_pair
    loop.run(0.2)
    assert "test/1" not in loop.steps[-1].closest_pair


def test_without_geometry_the_rest_works_and_the_status_reports_it(panda: Robot) -> None:
    values = {"obstacles.geometry": "none", "method": "obstacle_gradient"}
    loop = reach_down(panda, ball((0.3, 0.0, 0.3)), **values)
    assert "no distances are computed" in loop.controller.status.reason
    assert np.isnan(loop.steps[-1].clearance)
    assert loop.steps[0].pose_sb[2, 3] - loop.pose()[2, 3] > 0.24


def test_the_status_of_a_six_joint_arm_reports_that_the_gradient_has_no_effect() -> None:
    loop = Loop(make_robot("ur5"), READY["ur5"], Settings().with_values({"method": "obstacle_gradient"}))
    loop.run(0.05)
    assert "no null space" in loop.controller.status.reason


def test_invalid_obstacles_are_refused_by_name_and_the_others_used(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"])
    loop.run(0.05)
    good = ball(loop.pose()[:3, 3] + (0.0, 0.0, -0.09))
    bad = (
        good._replace(name="a/1", size=(-1.0,)),
        good._replace(name="a/2", frame_id="kitchen"),
        good._replace(name="a/3", kind="marker type 9"),
        good._replace(name="a/4", position=np.array([np.nan, 0.0, 0.0])),
    )
    with pytest.raises(SceneError, match=r"a/1: .*a/2: unknown frame 'kitchen'.*a/3: .*a/4: "):
        loop.controller.on_obstacles((*bad[:2], good, *bad[2:]), loop.now)
    loop.run(0.02)
    assert "test/1" in loop.steps[-1].closest_pair
    assert "obstacle refused" in loop.controller.status.reason


def test_markers_are_decoded() -> None:
    """CUBE, SPHERE, CYLINDER, DELETE and DELETEALL as in rviz."""

    def marker(kind: int, action: int, size: tuple[float, float, float]) -> object:
        point = make("geometry_msgs/msg/Point", x=0.1, y=0.2, z=0.3)
        turn = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        stamp = time_message(5)
        return make(
            "visualization_msgs/msg/Marker",
            header=make("std_msgs/msg/Header", stamp=stamp, frame_id="base"),
            ns="shelf",
            id=3,
            type=kind,
            action=action,
            pose=make("geometry_msgs/msg/Pose", position=point, orientation=turn),
            scale=make("geometry_msgs/msg/Vector3", x=size[0], y=size[1], z=size[2]),
            color=make("std_msgs/msg/ColorRGBA", r=1.0, g=0.0, b=0.0, a=1.0),
            lifetime=make("builtin_interfaces/msg/Duration", sec=1, nanosec=5),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=make(
                "sensor_msgs/msg/CompressedImage",
                header=make("std_msgs/msg/Header", stamp=stamp, frame_id=""),
                format="",
                data=np.empty(0, np.uint8),
            ),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=np.empty(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )

    kinds = [(1, 0), (2, 0), (3, 0), (2, 2), (2, 3)]
    data = serialize(
        make("visualization_msgs/msg/MarkerArray", markers=[marker(kind, act, (0.2, 0.4, 0.6)) for kind, act in kinds])
    )
    box, sphere, cylinder, gone, all_gone = decode_obstacles(data)
    assert (box.kind, box.size) == ("box", (0.2, 0.4, 0.6))
    assert (sphere.kind, sphere.size) == ("sphere", (0.3,))
    assert (cylinder.kind, cylinder.size) == ("cylinder", (0.2, 0.6))
    assert (gone.action, all_gone.action) == ("delete", "delete_all")
    assert (box.name, box.frame_id, box.stamp_ns, box.lifetime_ns) == ("shelf/3", "base", 5, 1_000_000_005)
    assert box.position.tolist() == [0.1, 0.2, 0.3]
