"""Moments of a running node, out of what it publishes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.step import Level, Mode, Status
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages import cdr, encode
from ik_node.messages.decode import decode_joint_state, decode_pose
from ik_node.messages.decode_obstacles import decode_obstacles
from ik_node.robot.robot import Robot
from ik_node.ros.live_view.listener import ViewNode
from ik_node.settings.groups import Settings
from ik_node.viewer.open_run import first_scene
from ik_node.viewer.recorded_scene import Nearby, Scenes
from ik_node.viewer.timeline import Moment, Reel

MOST_TARGETS = 2000
STALE_S = 1.0
"""Without a joint state for this long the page says so."""


class LiveFilm:
    """Moments of a running node, made when :meth:`shoot` is called."""

    def __init__(self, node: ViewNode, robot: Robot, settings: Settings, capacity: int) -> None:
        """Keeps at least ``capacity`` moments."""
        self._node = node
        self.robot = robot
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self.reel = Reel(robot.n, capacity)
        self.scenes = Scenes(robot, first_scene(robot, settings.obstacles.scene)[0])
        self._nearby = Nearby(robot, settings.obstacles)
        self.targets: deque[Array] = deque(maxlen=MOST_TARGETS)
        self._q = np.full(robot.n, np.nan)
        self._q_time_s = -math.inf

    @property
    def placed(self) -> bool:
        """Where the arm is, is known."""
        return bool(np.isfinite(self._q).all())

    def shoot(self, time_s: float) -> None:
        """Adds the moment of now."""
        node, n = self._node, self.robot.n
        # Taken together, so that they are of the same tick or of neighbours.
        newest = dict(node.newest)
        self._take_state(node.newest.pop("joint_states", None), time_s)
        self._take_arrived(time_s)
        q = self._q
        kinematics = self.robot.evaluate(q) if self.placed else None
        # The node's own clearance comes once a second only, and without the points.
        closest = self._nearby.closest(q, self.scenes(time_s))
        sigma_min = math.nan
        if kinematics is not None:
            sigma_min = float(np.linalg.svd(kinematics.jacobian_b * self._row_scale[:, None], compute_uv=False)[-1])
        self.reel.append(
            Moment(
                time_s=time_s,
                q=q,
                joint_velocity=_understood(newest.get(encode.JOINT_VELOCITY), _velocity, (n,)),
                pose_sb=np.full((4, 4), np.nan) if kinematics is None else kinematics.pose_sb,
                pose_sd=_understood(newest.get(encode.DESIRED_POSE), _pose, (4, 4)),
                error_b=_understood(newest.get(encode.TWIST_ERROR), _twist, (6,)),
                multiplier_task=_understood(newest.get(encode.MULTIPLIER_TASK), _wrench, (6,)),
                multiplier_potential=_understood(newest.get(encode.MULTIPLIER_POTENTIAL), _wrench, (6,)),
                sigma_min=sigma_min,
                scale=_number(node.values.get("scale")),
                clearance=math.nan if closest is None else closest.distance,
                closest_points=np.full((2, 3), np.nan) if closest is None else closest.points_s,
                closest_pair=() if closest is None else closest.names,
                binding=tuple(part for part in node.values.get("binding", "").split(", ") if part),
                status=self._status(time_s),
            )
        )

    def _take_state(self, data: bytes | None, time_s: float) -> None:
        if data is None:
            return
        try:
            sample = decode_joint_state(data)
        except InputError:  # the node under watch refuses it too, and says so
            return
        where = {name: index for index, name in enumerate(sample.names)}
        if all(name in where and where[name] < len(sample.position) for name in self.robot.joints):
            self._q = np.array([sample.position[where[name]] for name in self.robot.joints])
            self._q_time_s = time_s

    def _take_arrived(self, time_s: float) -> None:
        arrived = self._node.arrived
        while arrived:
            topic, data = arrived.popleft()
            try:
                if topic == "obstacles":
                    q = np.where(np.isfinite(self._q), self._q, 0.0)
                    self.scenes.add((time_s, decode_obstacles(data)), q)
                else:
                    sample = decode_pose(data)
                    if sample.frame_id in ("", self.robot.base_frame):
                        self.targets.append(sample.position)
            except InputError:  # the node under watch refuses it too, and says so
                continue

    def _status(self, time_s: float) -> Status:
        said = self._node.status
        if said is None:
            return Status(Level.STALE, Mode.WAITING, f"nothing heard from {self._node.watched} yet")
        if time_s - self._q_time_s > STALE_S:
            return Status(Level.STALE, Mode.WAITING, f"no joint states; the node last said: {said.message}")
        mode = next((entry.value for entry in said.values if entry.key == "mode"), Mode.WAITING.value)
        return Status(Level(int.from_bytes(said.level, "little")), Mode(mode), said.message)


def _understood(data: bytes | None, how: Callable[[bytes], Array], shape: tuple[int, ...]) -> Array:
    """What is in ``data``, or NaN where there is nothing of use."""
    if data is not None:
        try:
            found = how(data)
        except InputError:
            found = np.zeros(0)
        if found.shape == shape:
            return found
    return np.full(shape, np.nan)


def _velocity(data: bytes) -> Array:
    return np.array(cdr.deserialize(data, encode.TYPES[encode.JOINT_VELOCITY]).velocity, dtype=np.float64)


def _pose(data: bytes) -> Array:
    sample = decode_pose(data)
    return se3.pose_from(sample.position, sample.quaternion)


def _twist(data: bytes) -> Array:
    twist = cdr.deserialize(data, encode.TYPES[encode.TWIST_ERROR]).twist
    return np.array([twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y, twist.angular.z])


def _wrench(data: bytes) -> Array:
    wrench = cdr.deserialize(data, encode.TYPES[encode.MULTIPLIER_TASK]).wrench
    force, torque = wrench.force, wrench.torque
    return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])


def _number(text: str | None) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        return math.nan
