"""Body Jacobians computed by Pinocchio from the URDF, without the code under test."""

from __future__ import annotations

import numpy as np
import pinocchio

from ik_node.math.types import Array
from ik_node.robot.robot import Robot


class Kinematics:
    """The body Jacobian of a robot by Pinocchio alone."""

    def __init__(self, robot: Robot) -> None:
        full = pinocchio.buildModelFromXML(robot.urdf)
        controlled = [full.getJointId(joint) for joint in robot.joints]
        others = [index for index in range(1, full.njoints) if index not in controlled]
        self._model = pinocchio.buildReducedModel(full, others, pinocchio.neutral(full))
        self._data = self._model.createData()
        self._joints = [self._model.joints[self._model.getJointId(joint)] for joint in robot.joints]
        self._tip = self._model.getFrameId(robot.tip_frame)

    def jacobian(self, q: Array) -> Array:
        """J_b, (6, n)."""
        place = pinocchio.neutral(self._model)
        for value, joint in zip(q.tolist(), self._joints, strict=True):
            if joint.nq == joint.nv:
                place[joint.idx_q] = value
            else:  # a joint without limits: cosine and sine
                place[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        whole = pinocchio.computeFrameJacobian(self._model, self._data, place, self._tip, pinocchio.LOCAL)
        return np.asarray(whole[:, [joint.idx_v for joint in self._joints]])
