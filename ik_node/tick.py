"""One tick's optimum: from the twist that is wanted to the joint velocity that is commanded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node import bounded, se3
from ik_node.errors import InputError
from ik_node.limits import conceded, joint_bounds, motion_limits
from ik_node.methods import METHODS, Potential
from ik_node.resolution import resolve
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import Settings


class Outcome(NamedTuple):
    """What was chosen, and what it cost. Twists and wrenches (6,) in {b}, linear part first."""

    joint_velocity: Array
    """(n,), rad/s (m/s), finite and within the velocity limits."""
    scale: float
    """s: the part of V_f that the limits let through."""
    lost_b: Array
    """V - V_f."""
    multiplier_task: Array
    multiplier_potential: Array
    singular_values: Array
    """Of J_b with angular rows times the characteristic length, m."""
    binding: tuple[str, ...]
    """Limits that bound."""
    conceded: tuple[str, ...]
    """Limits that gave way to stronger ones."""


class TickSolver:
    """Solves the problem of :mod:`ik_node.bounded` at every tick, with the settings' method and limits."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        """Raises SettingsError when limits do not fit the robot."""
        self._robot = robot
        self.potential: Potential | None = None
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Other settings from now on; raises SettingsError, changing nothing, when limits do not fit the robot."""
        limits = motion_limits(self._robot, settings.limits, settings.control.rate_hz)
        self.limits = limits
        self._control = settings.control
        self._method = METHODS[settings.control.method]
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self._null_space_cap = np.full(self._robot.n, settings.control.null_space_speed)

    def follow_velocity(self, q: Array, q_middle: Array, wanted: Array, previous: Array, elapsed_s: float) -> Outcome:
        """The longest part of a joint velocity ``wanted`` (n,) that the limits let through; else as follow_twist.

        There is no method and no multiplier: the joints are given.
        """
        bounds = joint_bounds(self.limits, q, previous, elapsed_s)
        answer = bounded.solve(np.eye(self._robot.n), wanted, bounds.lo, bounds.hi)
        jacobian = self._robot.evaluate(q_middle).jacobian_b * self._row_scale[:, None]
        return Outcome(
            _finite(answer.joint_velocity),
            answer.scale,
            np.zeros(6),
            np.full(6, np.nan),
            np.full(6, np.nan),
            np.linalg.svd(jacobian, compute_uv=False),
            answer.binding(bounds, self._robot.joints),
            conceded(bounds, self._robot.joints),
        )

    def follow_twist(self, q: Array, q_middle: Array, twist_b: Array, previous: Array, elapsed_s: float) -> Outcome:
        """The optimum for a body twist V (6,).

        ``q`` (n,) measured, ``q_middle`` where the arm will be in the middle of the interval that the answer stands,
        ``previous`` (n,) the command that stands now and has stood for ``elapsed_s``. Raises InputError when no finite
        answer exists.
        """
        control = self._control
        kinematics = self._robot.evaluate(q_middle)
        jacobian, twist = kinematics.jacobian_b, twist_b
        to_frame = None if control.jacobian == "body" else se3.adjoint(kinematics.pose_sb)
        if to_frame is not None:
            jacobian, twist = to_frame @ jacobian, to_frame @ twist
        cost = self._method(self._robot, q_middle, self.potential)
        gain = 0.0 if cost.gradient is None else control.gradient_gain
        wanted = resolve(
            jacobian,
            twist,
            cost.weight,
            cost.gradient,
            gain,
            threshold=control.singularity_threshold,
            row_scale=self._row_scale,
            null_space_cap=self._null_space_cap,
            checked=True,
        )
        bounds = joint_bounds(self.limits, q, previous, elapsed_s)
        velocity, scale = wanted.joint_velocity, 1.0
        binding: tuple[str, ...] = ()
        if not ((velocity >= bounds.lo).all() and (velocity <= bounds.hi).all()):
            answer = bounded.solve(
                jacobian,
                wanted.attained,
                bounds.lo,
                bounds.hi,
                cost.weight,
                cost.gradient,
                gain,
                row_scale=self._row_scale,
                null_space_cap=self._null_space_cap,
            )
            velocity, scale = answer.joint_velocity, answer.scale
            binding = answer.binding(bounds, self._robot.joints)
        lost, task, potential = twist - wanted.attained, wanted.multiplier_task, wanted.multiplier_potential
        if to_frame is not None:
            lost = np.asarray(np.linalg.solve(to_frame, lost))
            task, potential = to_frame.T @ task, to_frame.T @ potential
        return Outcome(
            _finite(velocity),
            scale,
            lost,
            task,
            potential,
            wanted.singular_values,
            binding,
            conceded(bounds, self._robot.joints),
        )


def _finite(velocity: Array) -> Array:
    if not np.isfinite(velocity).all():
        raise InputError(f"the resolution gave a joint velocity that is not finite: {velocity}")
    return velocity
