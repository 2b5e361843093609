"""Feedback law of a task with a tolerance: the same law on the exact components, and the borders of the bands.

With c, rows_b and rows_d of :mod:`ik_node.math.task_error`, and A the rows of rows_b that are followed exactly::

    V_t = rows_d V_d + K_p c          of the exact components; the speed of the feedback is bounded as for whole poses
    V_b = A^+ V_t                     the same as a body twist, zero along what is free

A component within its half-width is not corrected; :mod:`ik_node.differential_ik.task_rows` bounds its rate at the
borders of its band.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.control.feedback import DesiredTwist, twist_feedback
from ik_node.differential_ik.task_rows import BandBorders, ToleranceRows, least_twist_map
from ik_node.interfaces.motion import Motion
from ik_node.jit import compiled
from ik_node.math.quaternion import Vector, length
from ik_node.math.task_error import (
    NO_DIRECTION,
    TaskForm,
    task_deviation,
)
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.locked_chain import free_joints
from ik_node.robot.robot import Robot
from ik_node.robot.task_rank import task_rank
from ik_node.settings.groups import ControlSettings, Settings
from ik_node.settings.task import TaskSettings


class TaskFeedbackSnapshot(NamedTuple):
    """Attribute of a :class:`TaskFeedback`."""

    swing_direction: Vector = NO_DIRECTION


class TaskFeedback:
    """The feedback law of the configured tolerance: that of :mod:`ik_node.control.feedback` for the whole pose."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        self._robot = robot
        self.tolerance = TaskTolerance()
        """The tolerance that the settings state."""
        self.swing_direction: Vector = NO_DIRECTION
        self.configure(settings)

    def configure(self, settings: Settings) -> bool:
        """Applies changed settings; True if the tolerance is another one."""
        before = self.tolerance
        self.tolerance = tolerance = tolerance_of(settings.task)
        self._form: TaskForm | None = None if tolerance.is_exact else tolerance.form
        self._exact = np.flatnonzero(tolerance.exact)
        self._rows: ToleranceRows | None = None
        if self._form is not None:
            row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
            self._rows = ToleranceRows(self._robot, row_scale, self._form, self._borders(settings))
        if tolerance == before:
            return False
        self.swing_direction = NO_DIRECTION
        return True

    def _borders(self, settings: Settings) -> BandBorders:
        control, bands = settings.control, np.flatnonzero(~self.tolerance.exact & ~self.tolerance.free)
        limits = motion_limits(self._robot, settings.limits, control.rate_hz)
        acceleration = np.where(np.isin(self._robot.joints, control.locked_joints), 0.0, limits.acceleration)
        return BandBorders(
            bands, np.repeat(control.gain, 3)[bands], np.repeat(control.max_feedback_twist, 3)[bands], acceleration
        )

    def twist(self, pose_sb: Array, motion: Motion, control: ControlSettings) -> DesiredTwist:
        """The feedback law.

        Args:
            pose_sb: Pose of the tool, (4, 4).
            motion: Desired motion.
            control: Gains and bounds.

        Returns:
            What exceeds the tolerance, as a body error, and the twists.
        """
        if self._form is None:
            return twist_feedback(pose_sb, motion, control)
        desired, self.swing_direction = _feedback(
            self._form,
            self._exact,
            np.ascontiguousarray(pose_sb),
            np.ascontiguousarray(motion.pose_sd),
            motion.twist_d,
            *control.gain,
            *control.max_feedback_twist,
            self.swing_direction,
        )
        return desired

    def rows(self, motion: Motion, to_middle_s: float) -> ToleranceRows | None:
        """Rows of the last :meth:`twist` for the differential inverse kinematics; None for the whole pose.

        Args:
            motion: Desired motion of that twist.
            to_middle_s: Time from ``motion.pose_sd`` to the middle of the control interval, s.
        """
        if self._rows is not None:
            self._rows.aim(motion, to_middle_s, self.swing_direction)
        return self._rows


def task_note(robot: Robot, tolerance: TaskTolerance, locked: tuple[str, ...], proposes: bool) -> str:
    """What of a task the arm cannot follow in general; empty for nothing.

    Args:
        robot: The arm.
        tolerance: The task.
        locked: Names of the locked joints.
        proposes: See :func:`task_rank`.
    """
    free = free_joints(robot.joints, locked) if locked else None
    text = task_rank(robot, tolerance, proposes, free).text(tolerance)
    without = f"{', '.join(locked)} locked: " if locked else ""
    return f"{without}{text}; the deviation is the least one" if text else ""


def tolerance_of(task: TaskSettings) -> TaskTolerance:
    """The tolerance that the settings state."""
    return TaskTolerance(task.tolerance, task.frame)


@compiled
def _feedback(
    form: TaskForm,
    exact: NDArray[np.intp],
    pose_sb: Array,
    pose_sd: Array,
    twist_d: Array,
    gain_linear: float,
    gain_angular: float,
    max_linear: float,
    max_angular: float,
    swing_direction: Vector,
) -> tuple[DesiredTwist, Vector]:
    deviation = task_deviation(form, pose_sb, pose_sd, swing_direction)
    c, widths = deviation.components, form.half_widths
    feedforward, outside, feedback = deviation.rows_d @ twist_d, np.zeros(6), np.zeros(6)
    for first, gain, limit in ((0, gain_linear, max_linear), (3, gain_angular, max_angular)):
        for i in range(first, first + 3):
            if widths[i] == 0.0:
                outside[i], feedback[i] = c[i], gain * c[i]
            elif abs(c[i]) > widths[i]:
                outside[i] = c[i] - widths[i] if c[i] > 0.0 else c[i] + widths[i]
        speed = length((feedback[first], feedback[first + 1], feedback[first + 2]))
        if speed > limit:
            for i in range(first, first + 3):
                feedback[i] *= limit / speed
    rows = np.empty((len(exact), 6))
    wanted, lead = np.empty(len(exact)), np.empty(len(exact))
    for k in range(len(exact)):
        rows[k] = deviation.rows_b[exact[k]]
        lead[k] = feedforward[exact[k]]
        wanted[k] = lead[k] + feedback[exact[k]]
    lift = least_twist_map(rows)
    desired = DesiredTwist(_in_body(form, deviation.rows_b, outside, pose_sb), lift @ lead, lift @ wanted)
    return desired, deviation.swing_direction


@compiled
def _in_body(form: TaskForm, rows_b: Array, components: Array, pose_sb: Array) -> Array:
    """Components of a deviation as vectors in {b}, with the same lengths."""
    error = np.empty(6)
    for i in range(3):
        # the linear rows are the axes of the tolerance in {b}
        error[i] = rows_b[0, i] * components[0] + rows_b[1, i] * components[1] + rows_b[2, i] * components[2]
        error[3 + i] = components[3 + i]
        if form.in_base:
            x, y, z = pose_sb[0, i], pose_sb[1, i], pose_sb[2, i]
            error[3 + i] = x * components[3] + y * components[4] + z * components[5]
    return error
