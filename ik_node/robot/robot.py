"""Robot: a Pinocchio model reduced to the controlled joints, with its kinematics and dynamics.

Joint positions are one number per joint, in the order of ``Robot.joints``, also for continuous joints, which Pinocchio
represents by cosine and sine. Mimic joints move with their masters (:mod:`ik_node.robot.mimic`); they are not
coordinates.
"""

from __future__ import annotations

import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node import dependencies

dependencies.check(dependencies.ROBOTICS)

import pinocchio as pin

from ik_node.errors import RobotError
from ik_node.jit import compiled
from ik_node.math.angles import joint_differences
from ik_node.math.types import Array
from ik_node.robot.default_tip import DefaultTip, default_tip
from ik_node.robot.description import read_description, robot_name
from ik_node.robot.joint_limits import limit_faults, urdf_limits
from ik_node.robot.kinematics import Dynamics, JointLimits, Kinematics
from ik_node.robot.mimic import master_range, mimic_map
from ik_node.robot.reduced_model import frame_id, held_at, read, reduced, root_frame, select, strip

GRAVITY = 9.81
"""Gravitational acceleration along -z of the model's root, m/s2 (Pinocchio's default)."""


class Robot:
    """A reduced Pinocchio model with a base frame and a tool frame. Not thread-safe.

    See :func:`ik_node.robot.catalogue.load_robot` for robots by name or from a file.
    """

    def __init__(
        self, urdf: str, base_frame: str = "", tip_frame: str = "", joints: tuple[str, ...] = (), joint_prefix: str = ""
    ) -> None:
        """Builds the model from a URDF. Joints that are not controlled stay at their neutral position.

        Args:
            urdf: Text of the URDF; its meshes are not needed.
            base_frame: Frame {s}; default: the root of the model.
            tip_frame: Tool frame {b}; default: the end of the longest chain, without the joints of a gripper.
            joints: Controlled joints in order; default: every movable joint between base and tip in chain order, with
                the masters of mimic joints.
            joint_prefix: Prefix of the names in :attr:`joints`.

        Raises:
            UnknownNameError: A frame or joint does not exist; lists the valid names.
            RobotError: The URDF is invalid, there is no joint to control, or controlled joints move the base.
        """
        self.description = read_description(urdf)
        """Checked description; :attr:`urdf` is the text as it was given."""
        full = read(self.description)
        self.base_frame = base_frame or root_frame(full)
        frame_id(full, self.base_frame)
        mimics = self.description.mimics
        self.tip_frame, self.gripper = DefaultTip(tip_frame, ()) if tip_frame else default_tip(full, mimics)
        """Joints of the URDF that are left out as a gripper's, where no tool frame is given."""
        wanted = tuple(strip(name, joint_prefix) for name in joints)
        model_joints = select(full, self.base_frame, self.tip_frame, wanted, mimics)
        names = list(full.names)[1:]
        self._followers = {
            name: mimics[name] for name in names if name in mimics and mimics[name].master in model_joints
        }
        moving_joints = (*model_joints, *self._followers)
        held = [full.getJointId(name) for name in names if name not in moving_joints]
        self.model = reduced(full, held, held_at(full, mimics))
        self.data = self.model.createData()
        self._position_key, self._all_columns = b"", np.zeros(0)
        links = (frame.name for frame in self.model.frames if frame.type == pin.FrameType.BODY)
        self.frames: tuple[str, ...] = tuple(dict.fromkeys((*links, self.base_frame, self.tip_frame)))
        """Names of the links, in which targets and obstacles may be given; joints are none."""
        self.urdf = urdf
        self.joints = tuple(joint_prefix + name for name in model_joints)
        self._model_joints = model_joints
        self._moving_joints = moving_joints
        self._mimic_map = mimic_map(model_joints, list(self._followers.values())) if self._followers else None
        self._base_id = frame_id(self.model, self.base_frame)
        self._tip_id = frame_id(self.model, self.tip_frame)
        model_ids = [self.model.getJointId(name) for name in moving_joints]
        self._velocity_index = np.array([self.model.joints[index].idx_v for index in model_ids])
        self._in_model_order = bool((self._velocity_index == np.arange(len(model_ids))).all())
        self._coordinates = [(self.model.joints[index].idx_q, self.model.joints[index].nq) for index in model_ids]
        self._plain = all(nq == 1 for _, nq in self._coordinates)
        self.moving_revolute = np.array(
            [self.model.joints[index].shortname().startswith("JointModelR") for index in model_ids]
        )
        """(m,), bool: which moving joints (see :meth:`motion`) are revolute; the others are prismatic."""
        self.revolute = self.moving_revolute[: self.n]
        """(n,), bool: which controlled joints are revolute."""
        # A full turn of a master is not a full turn of its mimic joints.
        alone = ~np.isin(model_joints, [mimic.master for mimic in self._followers.values()])
        self.turning = self.revolute & alone
        """(n,), bool: which controlled joints are revolute and have no mimic joints, so a full turn changes nothing."""
        self.continuous = np.array([nq == 2 for _, nq in self._coordinates])[: self.n] & alone
        """(n,), bool: which of these have no position limits."""
        if self.model.frames[self._base_id].parentJoint != 0:
            raise RobotError(
                f"base frame '{self.base_frame}' is moved by the controlled joints {', '.join(self.joints)}"
            )
        pin.framesForwardKinematics(self.model, self.data, pin.neutral(self.model))
        self._pose_base_root = np.ascontiguousarray(self.data.oMf[self._base_id].inverse().homogeneous)
        self._base_is_root = bool((self._pose_base_root == np.eye(4)).all())
        self.limits = self._read_limits()
        self.limit_faults = limit_faults(
            {name: self.description.joints[model] for name, model in zip(self.joints, model_joints, strict=True)}
        )
        """Limits of the URDF that cannot be meant; infinite in :attr:`limits`."""

    def copy(self) -> Robot:
        """The same robot with Pinocchio data of its own, for code that may use it between two calls of this one."""
        other = copy.copy(self)
        other.data = self.model.createData()
        other._position_key = b""
        return other

    @property
    def name(self) -> str:
        """Name of the robot in the URDF; ``robot`` if there is none."""
        return robot_name(self.urdf)

    @property
    def default_tip_text(self) -> str:
        """Which tool frame is used because none is given, and which joints are left out as those of a gripper."""
        text = f"'{self.tip_frame}', the end of the longest chain, is used, and its last joint is '{self.joints[-1]}'"
        return f"{text}; left out as a gripper's: {', '.join(self.gripper)}" if self.gripper else text

    @property
    def n(self) -> int:
        """Number of controlled joints."""
        return len(self.joints)

    @cached_property
    def chain_order(self) -> NDArray[np.int64]:
        """(n,): indices of the controlled joints from the base to the tool; empty for an arm with mimic joints."""
        return np.argsort(self._velocity_index) if self._mimic_map is None else np.zeros(0, dtype=np.int64)

    def _read_limits(self) -> JointLimits:
        m = len(self._moving_joints)
        lower, upper = np.full(m, -np.inf), np.full(m, np.inf)
        for row, (index, nq) in enumerate(self._coordinates):
            if nq == 1:
                lower[row], upper[row] = self.model.lowerPositionLimit[index], self.model.upperPositionLimit[index]
        given = urdf_limits(lower, upper, np.array(self.model.velocityLimit[self._velocity_index], dtype=np.float64))
        lower, upper, velocity = given.lower, given.upper, given.velocity
        for row, mimic in enumerate(self._followers.values(), self.n):
            master = self._model_joints.index(mimic.master)
            own = (float(lower[row]), float(upper[row]))
            lower[master], upper[master] = master_range(mimic, (lower[master], upper[master]), own)
            if mimic.multiplier != 0.0:
                velocity[master] = min(velocity[master], velocity[row] / abs(mimic.multiplier))
        return JointLimits(lower[: self.n], upper[: self.n], velocity[: self.n])

    def _configuration(self, q: Array) -> Array:
        if self._mimic_map is not None:
            q = self._mimic_map.ratio @ q + self._mimic_map.offset
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
        """Columns of the moving joints."""
        return matrix if self._in_model_order else matrix[..., self._velocity_index]

    def motion(self, qd: Array) -> Array:
        """Velocities of all moving joints, (m,): the controlled joints, ``qd`` (n,), then their mimic joints."""
        return qd if self._mimic_map is None else np.asarray(self._mimic_map.ratio @ qd)

    def per_joint(self, rows: Array) -> Array:
        """Derivatives by the moving joints, (k, m) or (m,), as derivatives by the controlled joints, (k, n) or (n,)."""
        if self._mimic_map is None:
            return rows
        # The order of summation does not depend on k.
        return np.asarray(np.add.reduce(rows[..., None] * self._mimic_map.ratio, axis=-2))

    def bounds_per_joint(self, rows: Array) -> Array:
        """Bounds per moving joint, (k, m), as bounds per controlled joint, (k, n)."""
        return rows if self._mimic_map is None else np.asarray(rows @ np.abs(self._mimic_map.ratio))

    def pose(self, q: Array) -> Array:
        """Forward kinematics.

        Args:
            q: Joint positions, (n,), rad (m).

        Returns:
            T_sb(q), (4, 4).
        """
        self._set_position(q)
        return self._from_base(pin.updateFramePlacement(self.model, self.data, self._tip_id))

    def _set_position(self, q: Array) -> Any:
        """Updates the joint placements in :attr:`data` for q (n,); returns the joint Jacobian in Pinocchio's order.

        The result is cached, because a control step evaluates pose and distances at the same q.
        """
        if (at := q.tobytes()) != self._position_key:
            self._position_key = b""
            self._all_columns = pin.computeJointJacobians(self.model, self.data, self._configuration(q))
            self._position_key = at
        return self._all_columns

    def _from_base(self, placement: Any) -> Array:
        """A placement in the root frame as a pose in the base frame, (4, 4), C-contiguous."""
        matrix = placement.homogeneous
        return np.ascontiguousarray(matrix) if self._base_is_root else np.asarray(self._pose_base_root @ matrix)

    def evaluate(self, q: Array) -> Kinematics:
        """Pose and body Jacobian of the tool.

        Args:
            q: Joint positions, (n,), rad (m).

        Returns:
            T_sb, (4, 4), and J_b, (6, n), linear rows first.
        """
        self._set_position(q)
        placement = pin.updateFramePlacement(self.model, self.data, self._tip_id)
        # Pinocchio returns a vector for an arm with one joint.
        jacobian = pin.getFrameJacobian(self.model, self.data, self._tip_id, pin.LOCAL).reshape(6, -1)
        rows = np.ascontiguousarray(self.per_joint(self._columns(jacobian)))
        return Kinematics(self._from_base(placement), rows)

    def dynamics(self, q: Array) -> Dynamics:
        """Mass matrix and gradient of the potential energy.

        Args:
            q: Joint positions, (n,), rad (m).

        Returns:
            M(q), (n, n), and the gravity gradient, (n,).
        """
        self._position_key = b""
        configuration = self._configuration(q)
        mass = _symmetric(pin.crba(self.model, self.data, configuration))
        gravity = pin.computeGeneralizedGravity(self.model, self.data, configuration)
        if not self._in_model_order:
            mass = mass[np.ix_(self._velocity_index, self._velocity_index)]
        if self._mimic_map is not None:
            mass = self.per_joint(self.per_joint(mass).T)
            mass = 0.5 * (mass + mass.T)
        return Dynamics(mass, self.per_joint(self._columns(gravity)))

    def kinetic_energy(self, q: Array, qd: Array) -> float:
        """Kinetic energy 1/2 qd' M(q) qd, J, at q (n,), rad (m), and qd (n,), rad/s (m/s)."""
        self._position_key = b""
        motion = self.motion(qd)
        if not self._in_model_order:
            motion = motion[np.argsort(self._velocity_index)]
        return float(pin.computeKineticEnergy(self.model, self.data, self._configuration(q), motion))

    def gravitational_energy(self, q: Array) -> float:
        """Potential energy in the gravity of the model, J, at q (n,), rad (m); 0 at the height of its root."""
        self._position_key = b""
        return float(pin.computePotentialEnergy(self.model, self.data, self._configuration(q)))

    @property
    def pose_base_root(self) -> Array:
        """Pose of the model's root in the base frame, (4, 4); constant."""
        result: Array = self._pose_base_root
        return result

    def root_jacobian(self, q: Array) -> Array:
        """Spatial Jacobian of the moving joints in the root frame, (6, m), linear rows first.

        Column j is the twist of the bodies that moving joint j (see :meth:`motion`) moves. The joint placements at
        q (n,) remain in :attr:`data`, for Pinocchio's geometry functions.
        """
        # Pinocchio returns a vector for an arm with one joint.
        return self._columns(self._set_position(q).reshape(6, -1))

    def joint_moves(self, parent: int) -> NDArray[np.bool_]:
        """(m,), bool: which moving joints (see :meth:`motion`) move the bodies attached to joint ``parent``."""
        supports = {self.model.names[index] for index in self.model.supports[parent]}
        return np.array([name in supports for name in self._moving_joints])

    def moved_links(self, joint: int) -> tuple[str, ...]:
        """Names of the links that the controlled joint of index ``joint`` moves."""
        model, number = self.model, self.model.getJointId(self._model_joints[joint])
        bodies = (frame for frame in model.frames if frame.type == pin.FrameType.BODY)
        return tuple(frame.name for frame in bodies if number in list(model.supports[frame.parentJoint]))

    @property
    def strokes(self) -> Array:
        """(m,): largest distance of the moving joints from zero within their limits, rad (m)."""
        largest = np.maximum(np.abs(self.limits.lower), np.abs(self.limits.upper)).tolist()
        for mimic in self._followers.values():
            master = largest[self._model_joints.index(mimic.master)] if mimic.multiplier != 0.0 else 0.0
            largest.append(abs(mimic.multiplier) * master + abs(mimic.offset))
        return np.array(largest)

    def frame_pose(self, q: Array, frame: str) -> Array:
        """Pose T_sf(q), (4, 4), of a frame of the model; raises UnknownNameError listing the frames."""
        number = frame_id(self.model, frame)
        self._set_position(q)
        return self._from_base(pin.updateFramePlacement(self.model, self.data, number))

    def moves_with_tool(self, frame: str) -> bool:
        """True when ``frame`` is fixed in the tool frame; raises UnknownNameError listing the frames."""
        frames = self.model.frames
        return bool(frames[frame_id(self.model, frame)].parentJoint == frames[self._tip_id].parentJoint)

    def joint_origins(self, q: Array) -> Array:
        """Origins of the controlled joints at q (n,) in the base frame, (n, 3), m."""
        self._set_position(q)
        points = np.array([self.data.oMi[self.model.getJointId(name)].translation for name in self._model_joints])
        return np.asarray(points @ self._pose_base_root[:3, :3].T + self._pose_base_root[:3, 3])

    def difference(self, q_from: Array, q_to: Array) -> Array:
        """``q_to - q_from``, (n,); for continuous joints the smallest rotation."""
        return np.asarray(joint_differences(q_from, q_to, self.continuous))


@compiled
def _symmetric(upper: Array) -> Array:
    """Symmetric matrix from its upper triangle, the only part that Pinocchio computes."""
    n = len(upper)
    matrix = np.empty((n, n))
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = matrix[j, i] = upper[i, j]
    return matrix
