"""pink and mink with the same task, limits and obstacles as the controller, for ``ik_benchmark tick``.

Both get the convex hulls of the links. pink: a frame task, its configuration and velocity limits, and a barrier for the
pairs of links and obstacles. mink: the same with its collision avoidance limit. Both solve with DAQP.
"""

from __future__ import annotations

import importlib
import logging
from typing import Any

import numpy as np
import pinocchio as pin

from ik_node.collision import geometry as collision_geometry
from ik_node.collision.convex_distances import make_solid
from ik_node.collision.pair_selection import add
from ik_node.collision.scene import Scene
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

GAIN = 10.0
"""1/s, of the pose error."""
RANGE_M = 0.2
"""Distance from which obstacles act."""


def optional_module(name: str) -> Any:
    """A module that is optional; None when it is not installed."""
    logging.getLogger(name).setLevel(logging.ERROR)
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def make_pink(robot: Robot, scene: Scene, rate_hz: float) -> Any:
    """The candidate pink; None when it is not installed."""
    return Pink(robot, scene, rate_hz) if optional_module("pink") else None


def make_mink(robot: Robot, scene: Scene, rate_hz: float) -> Any:
    """The candidate mink; None when it or MuJoCo is not installed, or the arm has other than revolute joints."""
    return Mink(robot, scene, rate_hz) if optional_module("mink") and optional_module("mujoco") else None


class Pink:
    """pink.solve_ik with DAQP."""

    name = "pink"

    def __init__(self, robot: Robot, scene: Scene, rate_hz: float) -> None:
        pink, barriers = optional_module("pink"), optional_module("pink.barriers")
        self._pink, self._robot, self._dt = pink, robot, 1.0 / rate_hz
        self._barriers: list[Any] = []
        model = data = None
        if scene.obstacles:
            geometry = collision_geometry.load(robot, self_collision=False)
            model = pin.GeometryModel()
            for link in geometry.links:
                add(model, link.name, link.parent, link.solid, link.placement)
            moving = np.flatnonzero(geometry.moves.any(axis=1)).tolist()
            for entry in scene.obstacles.values():
                number = add(model, f"obstacle {entry.name}", 0, make_solid(entry.shape), pin.SE3(entry.pose_s))
                for link in moving:
                    model.addCollisionPair(pin.CollisionPair(link, number))
            data = pin.GeometryData(model)
            pairs = min(len(model.collisionPairs), 20)
            self._barriers = [barriers.SelfCollisionBarrier(pairs, gain=20.0, d_min=0.01)]
        self._task = optional_module("pink.tasks").FrameTask(robot.tip_frame, 1.0, 1.0, gain=GAIN * self._dt)
        q = pin.neutral(robot.model)
        self._configuration = pink.Configuration(
            robot.model, robot.model.createData(), q, collision_model=model, collision_data=data
        )
        self._solve, self._qd = pink.solve_ik, np.zeros(robot.n)

    def target(self, pose: Array, time_ns: int) -> None:
        """As in :class:`benchmarks.tick.Candidate`."""
        del time_ns
        self._task.set_target(pin.SE3(self._robot.pose_base_root @ pose))

    def step(self, q: Array, time_ns: int) -> Array:
        """As in :class:`benchmarks.tick.Candidate`."""
        del time_ns
        self._configuration.update(q)
        self._qd = self._solve(
            self._configuration, [self._task], self._dt, solver="daqp", barriers=self._barriers, damping=1e-9
        )
        return self._qd

    def residual(self) -> float:
        """As in :class:`benchmarks.tick.Candidate`."""
        q = np.asarray(self._configuration.q)
        error = pin.log6(pin.SE3(self._robot.pose(q)).actInv(self._task.transform_target_to_world)).vector
        return float(np.abs(self._robot.evaluate(q).jacobian_b @ self._qd - GAIN * error).max())


class Mink:
    """mink.solve_ik with DAQP, on a MuJoCo model made from the same kinematics and hulls."""

    name = "mink"

    def __init__(self, robot: Robot, scene: Scene, rate_hz: float) -> None:
        mink, mujoco = optional_module("mink"), optional_module("mujoco")
        geometry = collision_geometry.load(robot, self_collision=False)
        self._mink, self._robot, self._dt = mink, robot, 1.0 / rate_hz
        model = mujoco.MjModel.from_xml_string(_mjcf(robot, geometry, scene))
        self._configuration = mink.Configuration(model)
        self._task = mink.FrameTask("tool", "site", 1.0, 1.0, gain=GAIN * self._dt)
        self._tasks = [self._task]
        names = [f"joint{index}" for index in range(robot.n)]
        limits = robot.limits.velocity
        self._limits = [mink.ConfigurationLimit(model)]
        self._limits.append(mink.VelocityLimit(model, dict(zip(names, limits.tolist(), strict=True))))
        if scene.obstacles:
            links = [f"geom{link}" for link in np.flatnonzero(geometry.moves.any(axis=1)).tolist()]
            others = [f"obstacle{index}" for index in range(len(scene.obstacles))]
            self._limits.append(
                mink.CollisionAvoidanceLimit(
                    model,
                    [(links, others)],
                    minimum_distance_from_collisions=0.01,
                    collision_detection_distance=RANGE_M,
                )
            )
        self._solve, self._qd, self._target = mink.solve_ik, np.zeros(robot.n), np.eye(4)

    def target(self, pose: Array, time_ns: int) -> None:
        """As in :class:`benchmarks.tick.Candidate`."""
        del time_ns
        self._target = self._robot.pose_base_root @ pose
        self._task.set_target(self._mink.SE3.from_matrix(self._target))

    def step(self, q: Array, time_ns: int) -> Array:
        """As in :class:`benchmarks.tick.Candidate`."""
        del time_ns
        self._configuration.update(q)
        self._qd = self._solve(
            self._configuration, self._tasks, self._dt, solver="daqp", damping=1e-9, limits=self._limits
        )
        return np.asarray(self._qd)

    def residual(self) -> float:
        """As in :class:`benchmarks.tick.Candidate`."""
        q = np.asarray(self._configuration.q)
        error = se3.log(se3.inverse(self._robot.pose(q)) @ self._target)
        return float(np.abs(self._robot.evaluate(q).jacobian_b @ self._qd - GAIN * error).max())


def _mjcf(robot: Robot, geometry: collision_geometry.CollisionGeometry, scene: Scene) -> str:
    """MuJoCo model of the controlled joints, the hulls of the links and the obstacles."""
    meshes = "".join(
        f'<mesh name="hull{index}" vertex="{_text(link.points.ravel())}"/>' for index, link in enumerate(geometry.links)
    )
    geoms: dict[int, list[str]] = {}
    for index, link in enumerate(geometry.links):
        geoms.setdefault(link.parent, []).append(f'<geom name="geom{index}" type="mesh" mesh="hull{index}"/>')
    model = robot.model
    frame = model.frames[model.getFrameId(robot.tip_frame)]
    axes = {"JointModelRX": "1 0 0", "JointModelRY": "0 1 0", "JointModelRZ": "0 0 1"}
    body = ""
    for joint in range(model.njoints - 1, 0, -1):
        inner = "".join(geoms.get(joint, [])) + body
        if frame.parentJoint == joint:
            inner += f'<site name="tool" {_place(frame.placement)}/>'
        lower, upper = model.lowerPositionLimit[joint - 1], model.upperPositionLimit[joint - 1]
        axis = axes.get(model.joints[joint].shortname(), "0 0 1")
        body = (
            f'<body name="body{joint}" {_place(model.jointPlacements[joint])}><inertial mass="1" pos="0 0 0" '
            f'diaginertia="1 1 1"/><joint name="joint{joint - 1}" axis="{axis}" range="{lower:.17g} {upper:.17g}" '
            f'limited="true"/>{inner}</body>'
        )
    obstacles = "".join(
        f'<geom name="obstacle{index}" type="sphere" size="{entry.shape.size[0]}" pos="{_text(entry.pose_s[:3, 3])}"/>'
        for index, entry in enumerate(scene.obstacles.values())
    )
    inner = "".join(geoms.get(0, [])) + body + obstacles
    return (
        '<mujoco><compiler angle="radian" autolimits="true"/><asset>'
        f"{meshes}</asset><worldbody>{inner}</worldbody></mujoco>"
    )


def _place(placement: Any) -> str:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs().tolist()
    return f'pos="{_text(placement.translation)}" quat="{_text(np.array((w, x, y, z)))}"'


def _text(numbers: Array) -> str:
    return " ".join(f"{number:.17g}" for number in numbers.tolist())
