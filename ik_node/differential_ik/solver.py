"""One tick's optimum: from the twist that is wanted to the joint velocity that is commanded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.collision.monitor import Closest, Lookout, Surroundings
from ik_node.differential_ik import constrained, manipulability
from ik_node.differential_ik.closed_form import IDENTITY, NO_GRADIENT, Resolution, resolve
from ik_node.differential_ik.deadlock import PATIENCE_S, blocked, let_go
from ik_node.differential_ik.fast_path import LOWER, UPPER, Usual, per_joint_of, usual_tick
from ik_node.differential_ik.methods import METHODS
from ik_node.differential_ik.posture import secondary_gradient
from ik_node.differential_ik.singularity import START, Passage, PassageState, pass_singularities
from ik_node.differential_ik.solution import NOTHING_LOST, Moment, Outcome
from ik_node.errors import InputError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.joint_limits import ROUNDING, JointBounds, conceded, joint_bounds, largest_change, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

NOTHING_SEEN = Closest(float("nan"), (), np.full((2, 3), np.nan))
"""Where nothing is watched."""
NOTHING = np.zeros(0)

ESCAPE_N = 100.0
"""Push along the null space out of a singularity in which a part of the twist is given up."""


class SolverSnapshot(NamedTuple):
    """What one tick hands to the next."""

    passage: PassageState
    scale: float
    """s, by the limits."""
    blocked_s: float
    """For how long the arm has been standing before a limit, s."""


class TickSolver:
    """Solves the problem of :mod:`ik_node.differential_ik.constrained` at every tick, with the settings' method and limits."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        """Raises SettingsError when limits do not fit the robot, and as :class:`Lookout` does."""
        self._robot = robot
        self.lookout = Lookout(robot, settings.obstacles)
        self._snapshot = SolverSnapshot(START, 1.0, 0.0)
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Other settings from now on; raises SettingsError, changing nothing, when limits do not fit the robot."""
        self.limits = motion_limits(self._robot, settings.limits, settings.control.rate_hz)
        self.lookout.configure(settings.obstacles)
        self._control = settings.control
        self._obstacles = settings.obstacles
        self._singularity = settings.singularity
        self._method = METHODS[settings.control.method]
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        dodges = settings.control.method == "obstacle_gradient"
        speed = settings.obstacles.evasion_speed if dodges else settings.control.null_space_speed
        self._null_space_cap = np.full(self._robot.n, speed)
        self._clear = max(settings.singularity.threshold, settings.control.singularity_threshold)
        self._per_joint = per_joint_of(self.limits, self._null_space_cap)
        self._no_rows = np.zeros((0, self._robot.n))

    def capture(self) -> SolverSnapshot:
        """For :meth:`restore`."""
        return self._snapshot

    def restore(self, snapshot: SolverSnapshot) -> None:
        """Goes on, bit for bit, from ``snapshot``."""
        self._snapshot = snapshot

    def begin(self) -> None:
        """The arm begins anew: nothing has been lost yet."""
        self._snapshot = SolverSnapshot(START, 1.0, 0.0)

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
        seen = self._look(moment, control.method == "obstacle_gradient")
        kinematics = self._robot.evaluate(moment.q_middle)
        to_frame = None if control.jacobian == "body" else se3.adjoint(kinematics.pose_sb)
        jacobian, twist = kinematics.jacobian_b, twist_b
        if to_frame is not None:
            jacobian, twist = to_frame @ jacobian, to_frame @ twist
        weight, gradient = self._cost(moment, seen)
        gain = 0.0 if gradient is None else control.gradient_gain
        outcome = self._usual(moment, jacobian, twist, weight, gradient, gain, seen, to_frame)
        if outcome is not None:
            return outcome
        bounds = joint_bounds(self.limits, moment.q, moment.previous, moment.elapsed_s)
        passage = pass_singularities(
            self._robot_jacobian,
            moment.q_middle,
            jacobian,
            twist,
            moment.previous,
            bounds,
            self.limits,
            self._row_scale,
            self._singularity,
            self._snapshot.passage,
            moment.elapsed_s,
            self._snapshot.scale,
        )
        if passage.keep < 1.0 and passage.state.branch is None and self._robot.n > 6:
            # The null space is of use to get away from the singularity that the arm started in.
            push = (1.0 - passage.keep) * ESCAPE_N
            away = manipulability.dexterity(self._robot_jacobian, moment.q_middle, self._row_scale, push).gradient
            gradient = away if gradient is None else gradient + away
            gain = control.gradient_gain
        wanted = resolve(
            passage.jacobian,
            passage.twist,
            weight,
            gradient,
            gain,
            row_scale=self._row_scale,
            null_space_cap=self._null_space_cap,
            checked=True,
            parts=passage.parts,
        )
        answer = None
        if not _fits(wanted.joint_velocity, bounds, seen):
            answer = constrained.solve(
                passage.jacobian,
                passage.twist,
                bounds.lo,
                bounds.hi,
                weight,
                gradient,
                gain,
                row_scale=self._row_scale,
                null_space_cap=self._null_space_cap,
                dampers=None if seen is None else seen.dampers,
                free=wanted,
                parts=passage.parts,
            )
        if passage.singular_values[-1] < control.singularity_threshold:
            # Exactly, the multiplier grows without bound; what is published fades out with the lost direction.
            faded = resolve(
                jacobian,
                twist,
                weight,
                gradient,
                gain,
                threshold=control.singularity_threshold,
                row_scale=self._row_scale,
                checked=True,
            )
            wanted = wanted._replace(
                multiplier_task=faded.multiplier_task, multiplier_potential=faded.multiplier_potential
            )
        scale = 1.0 if answer is None else answer.scale
        fastest = float(np.abs(twist).max())
        blocked_s = blocked(self._snapshot.blocked_s, passage.pace * scale, fastest, moment.elapsed_s)
        self._snapshot = SolverSnapshot(passage.state, scale, blocked_s)
        if answer is not None and blocked_s > PATIENCE_S:
            dampers = None if seen is None else seen.dampers
            velocity = let_go(answer.joint_velocity, jacobian, twist, self._row_scale, bounds, dampers, blocked_s)
            answer, lost = answer._replace(joint_velocity=velocity), twist - jacobian @ velocity
            passage = passage._replace(lost=lost)
        return self._outcome(wanted, answer, bounds, seen, passage, to_frame)

    def _usual(
        self,
        moment: Moment,
        jacobian: Array,
        twist: Array,
        weight: Array | None,
        gradient: Array | None,
        gain: float,
        seen: Surroundings | None,
        to_frame: Array | None,
    ) -> Outcome | None:
        """The outcome of a usual tick; None where it is none, or where the arm stands before a limit for too long."""
        rows, least = (self._no_rows, NOTHING) if seen is None else seen.dampers[:2]
        answer = usual_tick(
            jacobian,
            twist,
            self._row_scale,
            self._clear,
            IDENTITY if weight is None else weight,
            NO_GRADIENT if gradient is None else gradient,
            gain,
            self._per_joint,
            self.limits.dt_max_s,
            self.limits.recovery_speed,
            moment.q,
            moment.previous,
            moment.elapsed_s,
            rows,
            least,
        )
        if not answer.usual:
            return None
        before, blocked_s = self._snapshot, 0.0
        if answer.scale < 1.0 or before.blocked_s > 0.0:
            fastest = float(np.abs(twist).max())
            blocked_s = blocked(before.blocked_s, answer.scale, fastest, moment.elapsed_s)
            if blocked_s > PATIENCE_S:
                return None
        passage = before.passage
        if passage is not START:
            lost_s = max(0.0, passage.lost_s - moment.elapsed_s)
            passage = START._replace(lost_s=lost_s) if lost_s > 0.0 else START
        self._snapshot = SolverSnapshot(passage, answer.scale, blocked_s)
        task, potential = answer.multiplier_task, answer.multiplier_potential
        if to_frame is not None:
            task, potential = to_frame.T @ task, to_frame.T @ potential
        return Outcome(
            answer.joint_velocity,
            answer.scale,
            1.0,
            NOTHING_LOST,
            task,
            potential,
            answer.singular_values,
            self._names_of_sides(answer, moment, seen) if len(answer.sides) else (),
            (),
            NOTHING_SEEN if seen is None else seen.closest,
        )

    def _names_of_sides(self, answer: Usual, moment: Moment, seen: Surroundings | None) -> tuple[str, ...]:
        bounds = joint_bounds(self.limits, moment.q, moment.previous, moment.elapsed_s)
        n, sides = self._robot.n, answer.sides
        dampers = () if seen is None else seen.dampers.names
        lower, upper = (sides[:n] & LOWER) > 0, (sides[:n] & UPPER) > 0
        return constrained.names_of_binding(lower, upper, sides[n:] > 0, bounds, self._robot.joints, dampers)

    def _robot_jacobian(self, q: Array) -> Array:
        kinematics = self._robot.evaluate(q)
        if self._control.jacobian == "body":
            return kinematics.jacobian_b
        return np.asarray(se3.adjoint(kinematics.pose_sb) @ kinematics.jacobian_b)

    def follow_velocity(self, moment: Moment, wanted: Array) -> Outcome:
        """The longest part of a joint velocity ``wanted`` (n,) that limits and dampers let through.

        There is no method and no multiplier: the joints are given. Raises InputError when no finite answer exists.
        """
        seen = self._look(moment, False)
        bounds = joint_bounds(self.limits, moment.q, moment.previous, moment.elapsed_s)
        dampers = None if seen is None else seen.dampers
        answer = constrained.solve(np.eye(self._robot.n), wanted, bounds.lo, bounds.hi, dampers=dampers)
        jacobian = self._robot.evaluate(moment.q_middle).jacobian_b * self._row_scale[:, None]
        unknown = np.full(6, np.nan)
        return Outcome(
            _released(answer.joint_velocity, bounds),
            answer.scale,
            1.0,
            np.zeros(6),
            unknown,
            unknown,
            np.linalg.svd(jacobian, compute_uv=False),
            answer.binding(bounds, self._robot.joints, dampers),
            self._conceded(bounds, answer, seen),
            NOTHING_SEEN if seen is None else seen.closest,
        )

    def _look(self, moment: Moment, repel: bool) -> Surroundings | None:
        limits = self.limits
        change = largest_change(limits.acceleration, moment.elapsed_s, limits.dt_max_s)
        return self.lookout.look(moment.q, moment.previous, change, limits.dt_max_s, moment.time_ns, repel)

    def _cost(self, moment: Moment, seen: Surroundings | None) -> tuple[Array | None, Array | None]:
        """Weight and gradient of the method, the secondary gradients added."""
        repulsion = None if seen is None else seen.potential.gradient
        weight, gradient = self._method(self._robot, moment.q_middle, repulsion)
        secondary = secondary_gradient(self._robot, moment.q, self._obstacles)
        if secondary is not None:
            gradient = secondary if gradient is None else gradient + secondary
        return weight, gradient

    def _outcome(
        self,
        wanted: Resolution,
        answer: constrained.Bounded | None,
        bounds: JointBounds,
        seen: Surroundings | None,
        passage: Passage,
        to_frame: Array | None,
    ) -> Outcome:
        lost, task, potential = passage.lost, wanted.multiplier_task, wanted.multiplier_potential
        if to_frame is not None:
            lost = np.asarray(np.linalg.solve(to_frame, lost))
            task, potential = to_frame.T @ task, to_frame.T @ potential
        dampers = None if seen is None else seen.dampers
        return Outcome(
            _released(wanted.joint_velocity if answer is None else answer.joint_velocity, bounds),
            passage.pace * (1.0 if answer is None else answer.scale),
            passage.pace,
            lost,
            task,
            potential,
            passage.singular_values,
            () if answer is None else answer.binding(bounds, self._robot.joints, dampers),
            self._conceded(bounds, answer, seen),
            NOTHING_SEEN if seen is None else seen.closest,
        )

    def _conceded(
        self, bounds: JointBounds, answer: constrained.Bounded | None, seen: Surroundings | None
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


def _released(velocity: Array, bounds: JointBounds) -> Array:
    """The last gate: finite, and within the velocity limits to the last bit.

    InputError when it is off by more than rounding: then something inside is wrong, and the arm has to stop.
    """
    if not np.isfinite(velocity).all():
        raise InputError(f"the resolution gave a joint velocity that is not finite: {velocity}")
    held = np.minimum(np.maximum(velocity, -bounds.velocity), bounds.velocity)
    if np.abs(held - velocity).max() > ROUNDING:
        raise InputError(f"the resolution gave a joint velocity over its limits: {velocity}")
    return held
