"""The arm: a URDF reduced to the controlled joints, and what the controller wants to know of it at q.

Angles go in and out as one number per joint, in the order of ``Robot.joints``, also where Pinocchio keeps a continuous
joint as cosine and sine.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_node.errors import RobotError, UnknownNameError
from ik_node.se3 import Array

GRAVITY = 9.81
"""Gravitational acceleration along -z of the model's root, m/s2 (Pinocchio's default)."""


class Kinematics(NamedTuple):
    """What holds at one q."""

    pose_sb: Array
    """T_sb, (4, 4): tool seen from the base frame."""
    jacobian_b: Array
    """Body Jacobian J_b, (6, n), linear rows first: body twist of the tool = J_b qd."""


class Dynamics(NamedTuple):
    """What depends on masses at one q."""

    mass_matrix: Array
    """M(q), (n, n), symmetric positive definite."""
    gravity: Array
    """Gradient of the gravitational potential energy, (n,): N m (N for prismatic joints)."""


@dataclass(frozen=True)
class JointLimits:
    """Limits per controlled joint, as the URDF states them; infinite where it states none."""

    lower: Array
    upper: Array
    velocity: Array


class Robot:
    """A reduced Pinocchio model with a base frame and a tool frame.

    One instance keeps scratch data and belongs to one thread.
    """

    def __init__(
        self, urdf: str, base_frame: str = "", tip_frame: str = "", joints: tuple[str, ...] = (), joint_prefix: str = ""
    ) -> None:
        """Reads ``urdf`` (text, meshes not needed); joints that are not in ``joints`` stay at their neutral position.

        ``joints`` defaults to every movable joint between base and tip, in chain order; ``tip_frame`` to the end of the
        longest chain. ``joint_prefix`` stands before each model joint's name in :attr:`joints`. Raises
        UnknownNameError, and RobotError when this is no URDF, there is nothing to control, or controlled joints move
        the base.
        """
        full = _read(urdf)
        self.base_frame = base_frame or _root_frame(full)
        _frame_id(full, self.base_frame)
        self.tip_frame = tip_frame or _longest_chain_tip(full)
        wanted = tuple(_strip(name, joint_prefix) for name in joints)
        model_joints = _select(full, self.base_frame, self.tip_frame, wanted)
        held = [index for index in range(1, full.njoints) if full.names[index] not in model_joints]
        self.model = _reduced(full, held)
        self.data = self.model.createData()
        self.urdf = urdf
        self.joints = tuple(joint_prefix + name for name in model_joints)
        self._model_joints = model_joints
        self._base_id = _frame_id(self.model, self.base_frame)
        self._tip_id = _frame_id(self.model, self.tip_frame)
        model_ids = [self.model.getJointId(name) for name in model_joints]
        self._velocity_index = np.array([self.model.joints[index].idx_v for index in model_ids])
        self._in_model_order = bool((self._velocity_index == np.arange(self.n)).all())
        self._coordinates = [(self.model.joints[index].idx_q, self.model.joints[index].nq) for index in model_ids]
        self._plain = all(nq == 1 for _, nq in self._coordinates)
        self._configuration_index = np.array([index for index, _ in self._coordinates])
        self.continuous = np.array([nq == 2 for _, nq in self._coordinates])
        self.turning = np.array([self.model.joints[index].shortname().startswith("JointModelR") for index in model_ids])
        if self.model.frames[self._base_id].parentJoint != 0:
            raise RobotError(
                f"base frame '{self.base_frame}' is moved by the controlled joints {', '.join(self.joints)}"
            )
        pin.framesForwardKinematics(self.model, self.data, pin.neutral(self.model))
        self._pose_base_root = self.data.oMf[self._base_id].inverse().homogeneous
        self.limits = self._read_limits()

    @property
    def n(self) -> int:
        """Number of controlled joints."""
        return len(self.joints)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of every frame of the model."""
        return tuple(dict.fromkeys(frame.name for frame in self.model.frames if frame.type != pin.FrameType.JOINT))

    def _read_limits(self) -> JointLimits:
        lower, upper = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        for row, (index, nq) in enumerate(self._coordinates):
            low, high = self.model.lowerPositionLimit[index], self.model.upperPositionLimit[index]
            if nq == 1 and low < high:
                lower[row], upper[row] = low, high
        velocity = np.array(self.model.velocityLimit[self._velocity_index], dtype=np.float64)
        velocity[velocity <= 0.0] = np.inf
        return JointLimits(lower, upper, velocity)

    def _configuration(self, q: Array) -> Array:
        if self._plain and self._in_model_order:
            return q
        configuration = np.empty(self.model.nq)
        for value, (index, nq) in zip(q.tolist(), self._coordinates, strict=True):
            if nq == 1:
                configuration[index] = value
            else:
                configuration[index], configuration[index + 1] = np.cos(value), np.sin(value)
        return configuration

    def _columns(self, matrix: Array) -> Array:
        return matrix if self._in_model_order else matrix[..., self._velocity_index]

    def pose(self, q: Array) -> Array:
        """T_sb(q), (4, 4)."""
        pin.forwardKinematics(self.model, self.data, self._configuration(q))
        placement = pin.updateFramePlacement(self.model, self.data, self._tip_id)
        result: Array = self._pose_base_root @ placement.homogeneous
        return result

    def evaluate(self, q: Array) -> Kinematics:
        """Pose and body Jacobian at q (n,) [rad, m]."""
        pin.computeJointJacobians(self.model, self.data, self._configuration(q))
        placement = pin.updateFramePlacement(self.model, self.data, self._tip_id)
        # Pinocchio drops the second dimension for an arm of one joint.
        jacobian = pin.getFrameJacobian(self.model, self.data, self._tip_id, pin.LOCAL).reshape(6, -1)
        return Kinematics(self._pose_base_root @ placement.homogeneous, self._columns(jacobian))

    def dynamics(self, q: Array) -> Dynamics:
        """Mass matrix and gravity gradient at q (n,)."""
        configuration = self._configuration(q)
        mass = pin.crba(self.model, self.data, configuration)
        mass = np.triu(mass) + np.triu(mass, 1).T
        gravity = pin.computeGeneralizedGravity(self.model, self.data, configuration)
        if not self._in_model_order:
            mass = mass[np.ix_(self._velocity_index, self._velocity_index)]
        return Dynamics(mass, self._columns(gravity))

    @property
    def pose_base_root(self) -> Array:
        """The root of the model seen from the base frame, (4, 4); constant."""
        result: Array = self._pose_base_root
        return result

    def root_jacobian(self, q: Array) -> Array:
        """(6, n): column j is the twist, in axes and at the origin of the model's root, that joint j gives to all that
        it moves. Leaves the placements of all joints at q in :attr:`data`, for Pinocchio's geometry functions."""
        jacobian: Array = pin.computeJointJacobians(self.model, self.data, self._configuration(q))
        return self._columns(jacobian)

    def joint_moves(self, parent: int) -> NDArray[np.bool_]:
        """(n,), bool: which controlled joints move what hangs on joint ``parent`` of the model."""
        supports = {self.model.names[index] for index in self.model.supports[parent]}
        return np.array([name in supports for name in self._model_joints])

    def frame_pose(self, q: Array, frame: str) -> Array:
        """T_sf(q), (4, 4) of any frame of the model; UnknownNameError with the list of frames."""
        frame_id = _frame_id(self.model, frame)
        pin.forwardKinematics(self.model, self.data, self._configuration(q))
        placement = pin.updateFramePlacement(self.model, self.data, frame_id)
        result: Array = self._pose_base_root @ placement.homogeneous
        return result

    def moves_with_tool(self, frame: str) -> bool:
        """Whether ``frame`` stands still in the tool frame; UnknownNameError with the list of frames."""
        frames = self.model.frames
        return bool(frames[_frame_id(self.model, frame)].parentJoint == frames[self._tip_id].parentJoint)

    def joint_origins(self, q: Array) -> Array:
        """Where the controlled joints are at q (n,), seen from the base frame, (n, 3), m."""
        pin.forwardKinematics(self.model, self.data, self._configuration(q))
        points = np.array([self.data.oMi[self.model.getJointId(name)].translation for name in self._model_joints])
        return np.asarray(points @ self._pose_base_root[:3, :3].T + self._pose_base_root[:3, 3])

    def difference(self, q_from: Array, q_to: Array) -> Array:
        """``q_to - q_from``, the short way round where a joint has no limits."""
        delta = q_to - q_from
        turns = np.round(delta / (2.0 * np.pi))
        return np.where(self.continuous, delta - 2.0 * np.pi * turns, delta)


def _read(urdf: str) -> Any:
    try:
        return pin.buildModelFromXML(urdf)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"robot_description is not a URDF that can be read: {error}") from error


def _reduced(full: Any, held: list[int]) -> Any:
    """``full`` with the joints ``held`` fixed at neutral.

    Pinocchio finds frames by name alone here and gives up where a joint and a link share one (so100, anymal): their
    joints bear another name meanwhile.
    """
    count = Counter(frame.name for frame in full.frames)
    _rename_joints(full, {name: f"{name} (joint)" for name in count if count[name] > 1})
    reduced = pin.buildReducedModel(full, held, pin.neutral(full))
    _rename_joints(reduced, {f"{name} (joint)": name for name in count if count[name] > 1})
    return reduced


def _rename_joints(model: Any, names: dict[str, str]) -> None:
    for index in range(1, model.njoints):
        model.names[index] = names.get(model.names[index], model.names[index])
    for frame in model.frames:
        if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT):
            frame.name = names.get(frame.name, frame.name)


def _root_frame(model: Any) -> str:
    return str(next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY))


def _frame_id(model: Any, name: str) -> int:
    kinds = (pin.FrameType.BODY, pin.FrameType.FIXED_JOINT, pin.FrameType.OP_FRAME)
    for kind in kinds:
        if model.existFrame(name, kind):
            return int(model.getFrameId(name, kind))
    raise UnknownNameError("frame", name, {frame.name for frame in model.frames if frame.type in kinds})


def _longest_chain_tip(model: Any) -> str:
    """The last body of the first longest chain of movable joints."""
    depth = max(len(model.supports[frame.parentJoint]) for frame in model.frames)
    deepest = [frame for frame in model.frames if len(model.supports[frame.parentJoint]) == depth]
    bodies: list[Any] = [f for f in deepest if f.type == pin.FrameType.BODY and f.parentJoint == deepest[0].parentJoint]
    return str(bodies[-1].name)


def _select(model: Any, base: str, tip: str, wanted: tuple[str, ...]) -> tuple[str, ...]:
    """The controlled joints by model name, checked."""
    base_joint = model.frames[_frame_id(model, base)].parentJoint
    tip_joint = model.frames[_frame_id(model, tip)].parentJoint
    base_chain, tip_chain = list(model.supports[base_joint]), list(model.supports[tip_joint])
    chain = [index for index in tip_chain if index not in base_chain]
    below_base = [model.names[index] for index in base_chain if index not in tip_chain]
    if below_base:
        moving = ", ".join(below_base)
        raise RobotError(f"base frame '{base}' is not between the root and tip frame '{tip}': joints {moving} move it")
    movable = {model.names[index]: index for index in range(1, model.njoints)}
    for name in wanted:
        if name not in movable:
            raise UnknownNameError("joint", name, movable)
    if len(set(wanted)) != len(wanted):
        raise RobotError(f"joints holds a name twice: {', '.join(wanted)}")
    selected = wanted or tuple(model.names[index] for index in chain)
    if not selected:
        raise RobotError(f"no movable joint between base frame '{base}' and tip frame '{tip}'")
    for name in selected:
        joint = model.joints[movable[name]]
        if joint.nv != 1:
            raise RobotError(
                f"joint '{name}' has {joint.nv} degrees of freedom; only joints with one can be controlled"
            )
        if movable[name] not in chain:
            moving = ", ".join(model.names[index] for index in chain)
            raise RobotError(f"joint '{name}' does not move tip frame '{tip}'; those that do: {moving}")
    return selected


def _strip(name: str, prefix: str) -> str:
    return name[len(prefix) :] if prefix and name.startswith(prefix) else name
