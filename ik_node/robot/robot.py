"""The arm: a URDF reduced to the controlled joints, and what the controller wants to know of it at q.

Angles go in and out as one number per joint, in the order of ``Robot.joints``, also where Pinocchio keeps a continuous
joint as cosine and sine. Mimic joints move with their masters (:mod:`ik_node.robot.mimic`) and are no coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_node.errors import RobotError
from ik_node.jit import compiled
from ik_node.math.angles import short_ways
from ik_node.math.types import Array
from ik_node.robot.mimic import following, masters_range, read_mimics
from ik_node.robot.reduced_model import frame_id, held_at, longest_chain_tip, read, reduced, root_frame, select, strip

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
    """Limits per controlled joint, as the URDF states them for it and for those that mimic it; infinite where it
    states none."""

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
        """Reads ``urdf`` (text, meshes not needed); joints that are not in ``joints`` stay at their neutral position,
        those that mimic where that puts them.

        ``joints`` defaults to every movable joint between base and tip, in chain order, of mimic joints the master;
        ``tip_frame`` to the end of the longest chain. ``joint_prefix`` stands before each model joint's name in
        :attr:`joints`. Raises UnknownNameError, and RobotError when this is no URDF, there is nothing to control, or
        controlled joints move the base.
        """
        full = read(urdf)
        self.base_frame = base_frame or root_frame(full)
        frame_id(full, self.base_frame)
        self.tip_frame = tip_frame or longest_chain_tip(full)
        wanted = tuple(strip(name, joint_prefix) for name in joints)
        mimics = read_mimics(urdf)
        model_joints = select(full, self.base_frame, self.tip_frame, wanted, mimics)
        names = list(full.names)[1:]
        self._followers = {
            name: mimics[name] for name in names if name in mimics and mimics[name].master in model_joints
        }
        moving_joints = (*model_joints, *self._followers)
        held = [full.getJointId(name) for name in names if name not in moving_joints]
        self.model = reduced(full, held, held_at(full, mimics))
        self.data = self.model.createData()
        self._put_at, self._all_columns = b"", np.zeros(0)
        named = (frame.name for frame in self.model.frames if frame.type != pin.FrameType.JOINT)
        self.frames: tuple[str, ...] = tuple(dict.fromkeys(named))
        """Names of every frame of the model."""
        self.urdf = urdf
        self.joints = tuple(joint_prefix + name for name in model_joints)
        self._model_joints = model_joints
        self._moving_joints = moving_joints
        self._following = following(model_joints, list(self._followers.values())) if self._followers else None
        self._base_id = frame_id(self.model, self.base_frame)
        self._tip_id = frame_id(self.model, self.tip_frame)
        model_ids = [self.model.getJointId(name) for name in moving_joints]
        self._velocity_index = np.array([self.model.joints[index].idx_v for index in model_ids])
        self._in_model_order = bool((self._velocity_index == np.arange(len(model_ids))).all())
        self._coordinates = [(self.model.joints[index].idx_q, self.model.joints[index].nq) for index in model_ids]
        self._plain = all(nq == 1 for _, nq in self._coordinates)
        self._configuration_index = np.array([index for index, _ in self._coordinates])
        self.moving_revolute = np.array(
            [self.model.joints[index].shortname().startswith("JointModelR") for index in model_ids]
        )
        """(m,), bool: which moving joints (see :meth:`motion`) are revolute; the others slide."""
        self.revolute = self.moving_revolute[: self.n]
        """(n,), bool: the same of the controlled ones."""
        # A whole turn of a master is none of those that mimic it.
        alone = ~np.isin(model_joints, [mimic.master for mimic in self._followers.values()])
        self.turning = self.revolute & alone
        """(n,), bool: where a joint is revolute, so that a full turn changes nothing."""
        self.continuous = np.array([nq == 2 for _, nq in self._coordinates])[: self.n] & alone
        """(n,), bool: which of these have no limits."""
        if self.model.frames[self._base_id].parentJoint != 0:
            raise RobotError(
                f"base frame '{self.base_frame}' is moved by the controlled joints {', '.join(self.joints)}"
            )
        pin.framesForwardKinematics(self.model, self.data, pin.neutral(self.model))
        self._pose_base_root = np.ascontiguousarray(self.data.oMf[self._base_id].inverse().homogeneous)
        self._base_is_root = bool((self._pose_base_root == np.eye(4)).all())
        self.limits = self._read_limits()

    @property
    def n(self) -> int:
        """Number of controlled joints."""
        return len(self.joints)

    def _read_limits(self) -> JointLimits:
        m = len(self._moving_joints)
        lower, upper = np.full(m, -np.inf), np.full(m, np.inf)
        for row, (index, nq) in enumerate(self._coordinates):
            low, high = self.model.lowerPositionLimit[index], self.model.upperPositionLimit[index]
            if nq == 1 and low < high:
                lower[row], upper[row] = low, high
        velocity = np.array(self.model.velocityLimit[self._velocity_index], dtype=np.float64)
        velocity[velocity <= 0.0] = np.inf
        for row, mimic in enumerate(self._followers.values(), self.n):
            master = self._model_joints.index(mimic.master)
            own = (float(lower[row]), float(upper[row]))
            lower[master], upper[master] = masters_range(mimic, (lower[master], upper[master]), own)
            if mimic.multiplier != 0.0:
                velocity[master] = min(velocity[master], velocity[row] / abs(mimic.multiplier))
        return JointLimits(lower[: self.n], upper[: self.n], velocity[: self.n])

    def _configuration(self, q: Array) -> Array:
        if self._following is not None:
            q = self._following.ratio @ q + self._following.offset
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
        """Of the moving joints."""
        return matrix if self._in_model_order else matrix[..., self._velocity_index]

    def motion(self, qd: Array) -> Array:
        """Velocities of all moving joints, (m,): of the controlled ones, ``qd`` (n,), then of those that mimic them."""
        return qd if self._following is None else np.asarray(self._following.ratio @ qd)

    def per_joint(self, rows: Array) -> Array:
        """(k, n): what ``rows`` (k, m) say per moving joint, per controlled joint; (m,) becomes (n,)."""
        if self._following is None:
            return rows
        # Summed in an order that does not hang on k.
        return np.asarray(np.add.reduce(rows[..., None] * self._following.ratio, axis=-2))

    def most_per_joint(self, rows: Array) -> Array:
        """(k, n): bounds per moving joint, (k, m), as bounds per controlled joint."""
        return rows if self._following is None else np.asarray(rows @ np.abs(self._following.ratio))

    def pose(self, q: Array) -> Array:
        """T_sb(q), (4, 4)."""
        self._put(q)
        return self._from_base(pin.updateFramePlacement(self.model, self.data, self._tip_id))

    def _put(self, q: Array) -> Any:
        """Puts the joints to q (n,): their placements into :attr:`data`; their Jacobian, as Pinocchio orders it.

        A tick asks for the tool's pose and for distances at the same q.
        """
        if (at := q.tobytes()) != self._put_at:
            self._put_at = b""
            self._all_columns = pin.computeJointJacobians(self.model, self.data, self._configuration(q))
            self._put_at = at
        return self._all_columns

    def _from_base(self, placement: Any) -> Array:
        """(4, 4), C-contiguous, of a placement seen from the root."""
        matrix = placement.homogeneous
        return np.ascontiguousarray(matrix) if self._base_is_root else np.asarray(self._pose_base_root @ matrix)

    def evaluate(self, q: Array) -> Kinematics:
        """Pose and body Jacobian at q (n,) [rad, m]."""
        self._put(q)
        placement = pin.updateFramePlacement(self.model, self.data, self._tip_id)
        # Pinocchio drops the second dimension for an arm of one joint.
        jacobian = pin.getFrameJacobian(self.model, self.data, self._tip_id, pin.LOCAL).reshape(6, -1)
        rows = np.ascontiguousarray(self.per_joint(self._columns(jacobian)))
        return Kinematics(self._from_base(placement), rows)

    def dynamics(self, q: Array) -> Dynamics:
        """Mass matrix and gravity gradient at q (n,)."""
        self._put_at = b""
        configuration = self._configuration(q)
        mass = _symmetric(pin.crba(self.model, self.data, configuration))
        gravity = pin.computeGeneralizedGravity(self.model, self.data, configuration)
        if not self._in_model_order:
            mass = mass[np.ix_(self._velocity_index, self._velocity_index)]
        if self._following is not None:
            mass = self.per_joint(self.per_joint(mass).T)
            mass = 0.5 * (mass + mass.T)
        return Dynamics(mass, self.per_joint(self._columns(gravity)))

    def kinetic_energy(self, q: Array, qd: Array) -> float:
        """1/2 qd' M(q) qd at q (n,) and qd (n,), J."""
        self._put_at = b""
        motion = self.motion(qd)
        if not self._in_model_order:
            motion = motion[np.argsort(self._velocity_index)]
        return float(pin.computeKineticEnergy(self.model, self.data, self._configuration(q), motion))

    @property
    def pose_base_root(self) -> Array:
        """The root of the model seen from the base frame, (4, 4); constant."""
        result: Array = self._pose_base_root
        return result

    def root_jacobian(self, q: Array) -> Array:
        """(6, m): column j is the twist, in axes and at the origin of the model's root, that moving joint j (see
        :meth:`motion`) gives to all that it moves.

        Leaves the placements of all joints at q in :attr:`data`, for Pinocchio's geometry functions.
        """
        # Pinocchio drops the second dimension for an arm of one joint.
        return self._columns(self._put(q).reshape(6, -1))

    def joint_moves(self, parent: int) -> NDArray[np.bool_]:
        """(m,), bool: which moving joints (see :meth:`motion`) move what hangs on joint ``parent`` of the model."""
        supports = {self.model.names[index] for index in self.model.supports[parent]}
        return np.array([name in supports for name in self._moving_joints])

    @property
    def strokes(self) -> Array:
        """(m,): how far from zero the limits let the moving joints go, rad (m)."""
        widest = np.maximum(np.abs(self.limits.lower), np.abs(self.limits.upper)).tolist()
        for mimic in self._followers.values():
            master = widest[self._model_joints.index(mimic.master)] if mimic.multiplier != 0.0 else 0.0
            widest.append(abs(mimic.multiplier) * master + abs(mimic.offset))
        return np.array(widest)

    def frame_pose(self, q: Array, frame: str) -> Array:
        """T_sf(q), (4, 4) of any frame of the model; UnknownNameError with the list of frames."""
        number = frame_id(self.model, frame)
        self._put(q)
        return self._from_base(pin.updateFramePlacement(self.model, self.data, number))

    def moves_with_tool(self, frame: str) -> bool:
        """Whether ``frame`` stands still in the tool frame; UnknownNameError with the list of frames."""
        frames = self.model.frames
        return bool(frames[frame_id(self.model, frame)].parentJoint == frames[self._tip_id].parentJoint)

    def joint_origins(self, q: Array) -> Array:
        """Where the controlled joints are at q (n,), seen from the base frame, (n, 3), m."""
        self._put(q)
        points = np.array([self.data.oMi[self.model.getJointId(name)].translation for name in self._model_joints])
        return np.asarray(points @ self._pose_base_root[:3, :3].T + self._pose_base_root[:3, 3])

    def difference(self, q_from: Array, q_to: Array) -> Array:
        """``q_to - q_from``, the short way round where a joint has no limits."""
        return np.asarray(short_ways(q_from, q_to, self.continuous))


@compiled
def _symmetric(upper: Array) -> Array:
    """A matrix of which Pinocchio computes the upper triangle only."""
    n = len(upper)
    matrix = np.empty((n, n))
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = matrix[j, i] = upper[i, j]
    return matrix
