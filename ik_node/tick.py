"""One tick's optimum: from the twist that is wanted to the joint velocity that is commanded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node import bounded, se3
from ik_node.errors import InputError
from ik_node.limits import JointBounds, conceded, joint_bounds, motion_limits
from ik_node.methods import METHODS
from ik_node.resolution import Resolution, resolve
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import Settings
from ik_node.surroundings import Closest, Lookout, Surroundings

NOTHING_SEEN = Closest(float("nan"), (), np.full((2, 3), np.nan))
"""Where nothing is watched."""


class Moment(NamedTuple):
    """Where the arm is and what stands at its motors."""

    q: Array
    """Measured joint positions, (n,), rad (m)."""
    q_middle: Array
    """Where they will be in the middle of the interval in which the next command stands, (n,)."""
    previous: Array
    """The command that stands now, (n,), rad/s (m/s)."""
    elapsed_s: float
    """For how long it has stood."""
    time_ns: int
    """Now, on the monotonic clock."""


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
    """Limits and dampers that bound."""
    conceded: tuple[str, ...]
    """Limits and dampers that gave way to stronger ones."""
    closest: Closest
    """The nearest pair of links, or link and obstacle."""


class TickSolver:
    """Solves the problem of :mod:`ik_node.bounded` at every tick, with the settings' method and limits."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        """Raises SettingsError when limits do not fit the robot, and as :class:`Lookout` does."""
        self._robot = robot
        self.lookout = Lookout(robot, settings.obstacles)
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Other settings from now on; raises SettingsError, changing nothing, when limits do not fit the robot."""
        self.limits = motion_limits(self._robot, settings.limits, settings.control.rate_hz)
        self.lookout.configure(settings.obstacles)
        self._control = settings.control
        self._method = METHODS[settings.control.method]
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self._null_space_cap = np.full(self._robot.n, settings.control.null_space_speed)

    @property
    def without_effect(self) -> str:
        """Why the method's gradient cannot do anything here; empty when it can."""
        if self._control.method == "obstacle_gradient":
            if self.lookout.unavailable:
                return f"obstacle_gradient sees no obstacles: {self.lookout.unavailable}"
            if self._robot.n <= 6:
                return "obstacle_gradient has no effect: an arm of six joints has no null space"
        return ""

    def follow_twist(self, moment: Moment, twist_b: Array) -> Outcome:
        """The optimum for a body twist V (6,). Raises InputError when no finite answer exists."""
        control = self._control
        bounds, seen = self._surroundings(moment, control.method == "obstacle_gradient")
        kinematics = self._robot.evaluate(moment.q_middle)
        jacobian, twist = kinematics.jacobian_b, twist_b
        to_frame = None if control.jacobian == "body" else se3.adjoint(kinematics.pose_sb)
        if to_frame is not None:
            jacobian, twist = to_frame @ jacobian, to_frame @ twist
        weight, gradient = self._cost(moment, seen)
        gain = 0.0 if gradient is None else control.gradient_gain
        wanted = resolve(
            jacobian,
            twist,
            weight,
            gradient,
            gain,
            threshold=control.singularity_threshold,
            row_scale=self._row_scale,
            null_space_cap=self._null_space_cap,
            checked=True,
        )
        answer = None
        if not _fits(wanted.joint_velocity, bounds, seen):
            answer = bounded.solve(
                jacobian,
                wanted.attained,
                bounds.lo,
                bounds.hi,
                weight,
                gradient,
                gain,
                row_scale=self._row_scale,
                null_space_cap=self._null_space_cap,
                dampers=None if seen is None else seen.dampers,
            )
        return self._outcome(wanted, answer, bounds, seen, twist - wanted.attained, to_frame)

    def follow_velocity(self, moment: Moment, wanted: Array) -> Outcome:
        """The longest part of a joint velocity ``wanted`` (n,) that limits and dampers let through.

        There is no method and no multiplier: the joints are given. Raises InputError when no finite answer exists.
        """
        bounds, seen = self._surroundings(moment, False)
        dampers = None if seen is None else seen.dampers
        answer = bounded.solve(np.eye(self._robot.n), wanted, bounds.lo, bounds.hi, dampers=dampers)
        jacobian = self._robot.evaluate(moment.q_middle).jacobian_b * self._row_scale[:, None]
        unknown = np.full(6, np.nan)
        return Outcome(
            _finite(answer.joint_velocity),
            answer.scale,
            np.zeros(6),
            unknown,
            unknown,
            np.linalg.svd(jacobian, compute_uv=False),
            answer.binding(bounds, self._robot.joints, dampers),
            self._conceded(bounds, answer, seen),
            NOTHING_SEEN if seen is None else seen.closest,
        )

    def _surroundings(self, moment: Moment, repel: bool) -> tuple[JointBounds, Surroundings | None]:
        limits = self.limits
        bounds = joint_bounds(limits, moment.q, moment.previous, moment.elapsed_s)
        change = limits.acceleration * min(max(moment.elapsed_s, 0.0), limits.dt_max_s)
        seen = self.lookout.look(moment.q, moment.previous, change, limits.dt_max_s, moment.time_ns, repel)
        return bounds, seen

    def _cost(self, moment: Moment, seen: Surroundings | None) -> tuple[Array | None, Array | None]:
        """Weight and gradient of the method, the secondary gradients added."""
        repulsion = None if seen is None else seen.potential.gradient
        weight, gradient = self._method(self._robot, moment.q_middle, repulsion)
        secondary = self.lookout.secondary_gradient(moment.q)
        if secondary is not None:
            gradient = secondary if gradient is None else gradient + secondary
        return weight, gradient

    def _outcome(
        self,
        wanted: Resolution,
        answer: bounded.Bounded | None,
        bounds: JointBounds,
        seen: Surroundings | None,
        lost: Array,
        to_frame: Array | None,
    ) -> Outcome:
        task, potential = wanted.multiplier_task, wanted.multiplier_potential
        if to_frame is not None:
            lost = np.asarray(np.linalg.solve(to_frame, lost))
            task, potential = to_frame.T @ task, to_frame.T @ potential
        dampers = None if seen is None else seen.dampers
        return Outcome(
            _finite(wanted.joint_velocity if answer is None else answer.joint_velocity),
            1.0 if answer is None else answer.scale,
            lost,
            task,
            potential,
            wanted.singular_values,
            () if answer is None else answer.binding(bounds, self._robot.joints, dampers),
            self._conceded(bounds, answer, seen),
            NOTHING_SEEN if seen is None else seen.closest,
        )

    def _conceded(
        self, bounds: JointBounds, answer: bounded.Bounded | None, seen: Surroundings | None
    ) -> tuple[str, ...]:
        names = conceded(bounds, self._robot.joints)
        if answer is None or seen is None:
            return names
        yielded = np.flatnonzero(answer.damper_slack > 1e-9).tolist()
        return (*names, *(f"damper {seen.dampers.names[index]}" for index in yielded))


def _fits(velocity: Array, bounds: JointBounds, seen: Surroundings | None) -> bool:
    if not ((velocity >= bounds.lo).all() and (velocity <= bounds.hi).all()):
        return False
    return seen is None or bool((seen.dampers.rows @ velocity >= seen.dampers.least).all())


def _finite(velocity: Array) -> Array:
    if not np.isfinite(velocity).all():
        raise InputError(f"the resolution gave a joint velocity that is not finite: {velocity}")
    return velocity
