"""The differential inverse kinematics of one control step: from a desired twist to the commanded joint velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.avoidance import AvoidanceTerms
from ik_node.collision.distances import ClosestPair
from ik_node.collision.monitor import CollisionMonitor
from ik_node.differential_ik import constrained
from ik_node.differential_ik.closed_form import IDENTITY, NO_GRADIENT
from ik_node.differential_ik.compiled_step import FREE, NO_ORDER, StepSolution, solve_step, stacked_limits
from ik_node.differential_ik.constrained import binding_names, relaxed_names
from ik_node.differential_ik.deadlock import TIMEOUT_S, executed_fraction, is_truncated, release_direction, stalled_time
from ik_node.differential_ik.locked_joints import FreeJoints, FreeRows
from ik_node.differential_ik.manipulability import manipulability_potential
from ik_node.differential_ik.off_direction import limits_off_direction
from ik_node.differential_ik.own_methods import GivenMethods
from ik_node.differential_ik.selected_method import SelectedMethod
from ik_node.differential_ik.singularity import START, RegulatedTask, regulate_singularities
from ik_node.differential_ik.solution import INITIAL, NO_TRUNCATION, ArmState, DifferentialIkSolution, SolverSnapshot
from ik_node.differential_ik.task_problem import MULTIPLIER_FADE_M, TaskProblem
from ik_node.differential_ik.task_rows import TaskRows
from ik_node.differential_ik.twist_change import solve_gradually
from ik_node.differential_ik.viable_scale import Prediction, viable_scale
from ik_node.math.pseudoinverse import Decomposition
from ik_node.math.types import Array
from ik_node.robot.joint_limits import (
    ROUNDING,
    JointBounds,
    MotionLimits,
    exceeds,
    joint_bounds,
    largest_change,
    motion_limits,
    within_velocity_limits,
)
from ik_node.robot.locked_chain import free_joints
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

NO_PAIR = ClosestPair(float("nan"), (), np.full((2, 3), np.nan))
"""The closest pair if no distances are computed."""

OTHER_SPEED_FRACTION = 0.3
"""Fraction of ``null_space_speed`` that methods which do not avoid obstacles may use."""

ESCAPE_N = 100.0
"""Force of the potential that leads an arm out of a singularity along its null space."""


class DifferentialIkSolver:
    """Computes joint velocities within all limits, for one robot and one method."""

    def __init__(self, robot: Robot, settings: Settings, methods: GivenMethods | None = None) -> None:
        """Builds the collision monitor, loads own methods and :meth:`configure` s the solver.

        Args:
            robot: The arm.
            settings: All settings.
            methods: Own methods by name; default: they are imported.

        Raises:
            SettingsError: The limits do not fit the robot, or an own method cannot be loaded.
            SceneError: The scene file cannot be used.
            UnknownNameError: A configured pair names a link that does not exist.
        """
        self._robot = robot
        self.collision_monitor = CollisionMonitor(robot, settings.obstacles)
        self.method = SelectedMethod(robot, settings, methods)
        self._snapshot = INITIAL
        self._locked: tuple[str, ...] = ()
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Replaces the settings.

        Raises:
            SettingsError: The limits, the method or the locked joints do not fit the robot; nothing has changed then.
        """
        free = free_joints(self._robot.joints, settings.control.locked_joints)
        limits = motion_limits(self._robot, settings.limits, settings.control.rate_hz)
        self.method.configure(settings)
        self._velocity_limit = limits.velocity
        self.unlimited = tuple(self._robot.joints[index] for index in np.flatnonzero(np.isinf(limits.velocity)))
        """Names of the joints without a velocity limit."""
        self.collision_monitor.configure(settings.obstacles)
        self._control, self._singularity = settings.control, settings.singularity
        self._exact = settings.task.tolerance.count(0.0)
        self._whole_pose = TaskRows(self._robot, np.repeat((1.0, settings.control.characteristic_length), 3))
        fraction = 1.0 if self.method.avoids_obstacles else OTHER_SPEED_FRACTION
        self._null_space_cap = np.full(len(free), fraction * settings.control.null_space_speed)
        self._regular_from = max(settings.singularity.threshold, MULTIPLIER_FADE_M)
        self._joints = tuple(self._robot.joints[index] for index in free)
        """Joints of the problem; those that are not locked."""
        self._free = FreeJoints(self._robot.joints, free) if len(free) < self._robot.n else None
        self._no_rows = np.zeros((0, len(free))), np.zeros(0)
        self._set_limits(limits)
        if set(self._locked) != set(settings.control.locked_joints):
            self._locked = settings.control.locked_joints
            self.reset()

    def _set_limits(self, limits: MotionLimits) -> None:
        self.limits = limits
        self._own_limits = limits if self._free is None else self._free.limits(limits)
        """Of the joints of the problem."""
        self._per_joint = stacked_limits(self._own_limits, self._null_space_cap)

    def exceeding(self, velocity: Array) -> tuple[str, ...]:
        """Names of the joints whose velocity (n,), rad/s (m/s), is over a velocity limit that was lowered."""
        if not exceeds(velocity, self._velocity_limit):
            return ()
        over = np.abs(velocity) > self._velocity_limit + ROUNDING
        return tuple(self._robot.joints[index] for index in np.flatnonzero(over))

    def lower_velocity_limits(self, previous: Array, elapsed_s: float) -> None:
        """Sets the velocity limits of the next command: those of the settings, unless the last command exceeds them.

        A limit that was lowered below the last command is approached at the acceleration limit; the other joints keep
        theirs.

        Args:
            previous: Last command, (n,), rad/s (m/s).
            elapsed_s: Time since the last command, s.
        """
        limit = self._velocity_limit
        if exceeds(previous, limit):
            speed, change = np.abs(previous), largest_change(self.limits.acceleration, elapsed_s, self.limits.dt_max_s)
            limit = np.where(speed > limit + ROUNDING, np.maximum(limit, speed - change), limit)
        elif self.limits.velocity is limit:
            return
        self._set_limits(self.limits._replace(velocity=limit))

    def capture(self) -> SolverSnapshot:
        """The state, for :meth:`restore`."""
        return self._snapshot._replace(method_fault=self.method.fault)

    def restore(self, snapshot: SolverSnapshot) -> None:
        """Sets the state; the following solutions are those of the captured solver, bit for bit."""
        self._snapshot = snapshot
        self.method.fault = snapshot.method_fault

    def reset(self) -> None:
        """Forgets the last control steps."""
        self._snapshot = INITIAL

    @property
    def without_effect(self) -> str:
        """Reason why the gradient of the method has no effect; empty if it has."""
        return self.method.without_effect(self.collision_monitor.unavailable, len(self._joints), self._exact)

    def solve_twist(
        self, state: ArmState, twist_b: Array, rows: TaskRows | None = None, *, foresight: bool = False
    ) -> DifferentialIkSolution:
        """Joint velocity for a twist of the tool.

        Args:
            state: State of the arm.
            twist_b: V, (6,), in {b}, linear part first, m/s and rad/s.
            rows: Which part of it is followed, and the bands; None for the whole pose.
            foresight: Of the whole pose, s and V_f are those that the joints can follow ahead and in time
                (:mod:`~ik_node.differential_ik.viable_scale`, :mod:`~ik_node.differential_ik.twist_change`).

        Raises:
            InputError: There is no finite solution.
        """
        terms = self._avoidance_terms(state, self.method.avoids_obstacles)
        rows = self._whole_pose if rows is None else rows
        jacobian, twist = rows.place(state.q_middle), rows.twist(twist_b)
        repulsion = None if terms is None else terms.potential.gradient
        weight, gradient = self.method.cost(state.q_middle, state.q, repulsion)
        free = self._free
        if free is None:
            order = self._robot.chain_order if foresight and rows is self._whole_pose else NO_ORDER
            return self._solve(state, rows, jacobian, twist, weight, gradient, terms, order)
        ramp = free.ramp(state, self.limits)
        ramp_twist = jacobian @ ramp
        found = self._solve(
            free.state(state),
            FreeRows(rows, free, state, ramp),
            free.columns(jacobian),
            twist - ramp_twist,
            None if weight is None else free.columns(weight[free.free]),
            None if gradient is None else gradient[free.free],
            free.terms(terms, ramp),
        )
        return free.solution(found, ramp, rows.body_twist(ramp_twist))

    def _solve(
        self,
        state: ArmState,
        rows: TaskRows,
        jacobian: Array,
        twist: Array,
        weight: Array | None,
        gradient: Array | None,
        terms: AvoidanceTerms | None,
        order: NDArray[np.int64] = NO_ORDER,
    ) -> DifferentialIkSolution:
        """The solution for the joints of the problem; all arguments are those of these joints."""
        row_scale, gain = rows.row_scale, 0.0 if gradient is None else self._control.gradient_gain
        dampers = None if terms is None else terms.dampers
        step = solve_step(
            jacobian,
            twist,
            row_scale,
            self._regular_from,
            IDENTITY if weight is None else weight,
            NO_GRADIENT if gradient is None else gradient,
            gain,
            self._per_joint,
            self._own_limits.dt_max_s,
            self._own_limits.recovery_speed,
            state.q,
            state.previous,
            state.elapsed_s,
            *(self._no_rows if dampers is None else dampers[:2]),
            *(self._no_rows if rows.bands is None else rows.bands[:2]),
            order,
            self._singularity.tolerance,
        )
        if step.is_solved:
            solution = self._solution(step, state, rows, twist, terms)
            if solution is not None:
                return solution
        bounds = joint_bounds(self._own_limits, state.q, state.previous, state.elapsed_s)
        task = self._regulated(rows, state, jacobian, twist, bounds, step.svd)
        if task.retention < 1.0 and task.state.branch is None and len(self._joints) > len(twist):
            # The null space leads the arm away from the singularity that it started in.
            force = (1.0 - task.retention) * ESCAPE_N
            away = manipulability_potential(rows.jacobian, state.q_middle, row_scale, force).gradient
            gradient = away if gradient is None else gradient + away
            gain = self._control.gradient_gain
        problem = TaskProblem(
            task.jacobian, weight, gradient, gain, row_scale, self._null_space_cap, task.svd, rows.bands
        )
        wish = task.singularity_scale
        if len(order) and not state.foreseen:
            ahead = Prediction(jacobian, order, row_scale, twist, self._singularity.tolerance, task.kept)
            wish = min(wish, viable_scale(ahead, state.q, state.previous, self.limits))
        moving = state if len(order) and self._snapshot.stalled_s <= TIMEOUT_S else None
        found = solve_gradually(problem, jacobian, task.twist, wish, moving, self._own_limits, bounds, dampers)
        limited, bounds, deferred, share, aside = found
        closed, scale = limited.unconstrained, limited.task_scale
        truncated = task.truncated + deferred
        progress = (1.0 - share) * scale
        if task.singular_values[-1] < MULTIPLIER_FADE_M:
            closed = problem.with_faded_multipliers(closed, jacobian, twist, step.svd)
        ratio = 1.0 if progress >= task.singularity_scale else progress / task.singularity_scale
        # A singularity that is passed slowly is passed: what it asks for is no stall.
        stalled_s = self._stalled_time(twist, executed_fraction(twist, ratio * task.twist, row_scale), state.elapsed_s)
        self._snapshot = SolverSnapshot(task.state, ratio, stalled_s)
        velocity = limited.joint_velocity
        if stalled_s > TIMEOUT_S:
            velocity = release_direction(velocity, jacobian, twist, row_scale, bounds, dampers, stalled_s)
        velocity = within_velocity_limits(velocity, bounds.velocity)
        if stalled_s > TIMEOUT_S and is_truncated(twist, task.twist, row_scale):  # V_f has no direction to keep
            scale, truncated = 1.0, twist - jacobian @ velocity
        off_direction = jacobian @ velocity - scale * (twist - truncated)
        active = () if rows.bands is None else rows.bands.active(velocity, scale)
        return DifferentialIkSolution(
            velocity,
            scale,
            wish,
            rows.body_twist(truncated),
            rows.body_twist(off_direction),
            limits_off_direction(off_direction, limited, jacobian, row_scale, bounds, self._joints, dampers),
            rows.wrench(closed.multiplier_task),
            rows.wrench(closed.multiplier_potential),
            rows.all_singular_values(task.singular_values),
            (*limited.binding(bounds, self._joints, dampers), *active),
            relaxed_names(limited, bounds, self._joints, dampers),
            NO_PAIR if terms is None else terms.closest,
            deferred if share > 0.0 else NO_TRUNCATION,
            aside,
        )

    def _regulated(
        self, rows: TaskRows, state: ArmState, jacobian: Array, twist: Array, bounds: JointBounds, svd: Decomposition
    ) -> RegulatedTask:
        """What singularities leave of the twist."""
        if rows.is_empty:
            return RegulatedTask(jacobian, twist, np.zeros(1), 1.0, 1.0, np.ones(1), np.zeros(1), None, START)
        return regulate_singularities(
            rows.jacobian,
            state.q_middle,
            jacobian,
            twist,
            state.previous,
            bounds,
            self._own_limits,
            rows.row_scale,
            svd,
            self._singularity,
            self._snapshot.singularity,
            state.elapsed_s,
            self._snapshot.task_scale,
            state.foreseen,
        )

    def twist_of(self, state: ArmState, velocity: Array, rows: TaskRows | None = None) -> Array:
        """The followed part of the body twist (6,) of a joint velocity (n,), rad/s (m/s)."""
        rows = self._whole_pose if rows is None else rows
        return rows.body_twist(rows.place(state.q_middle) @ self._with_ramp(state, velocity))

    def _with_ramp(self, state: ArmState, velocity: Array) -> Array:
        """``velocity`` (n,) with the velocities that locked joints have in this control step."""
        if self._free is None:
            return velocity
        return self._free.all_joints(velocity[self._free.free], self._free.ramp(state, self.limits))

    def solve_velocity(self, state: ArmState, velocity: Array, rows: TaskRows | None = None) -> DifferentialIkSolution:
        """The largest multiple of a joint velocity, up to 1, that limits and dampers permit.

        The multipliers of the solution are NaN: no method selects the joint velocity.

        Args:
            state: State of the arm.
            velocity: (n,), rad/s (m/s).
            rows: Which part of the pose is followed; None for the whole pose.

        Raises:
            InputError: There is no finite solution.
        """
        terms = self._avoidance_terms(state, False)
        rows = self._whole_pose if rows is None else rows
        jacobian, row_scale, free = rows.place(state.q_middle), rows.row_scale, self._free
        ramp_twist, ramp = np.zeros(len(jacobian)), np.zeros(self._robot.n)
        if free is not None:
            ramp = free.ramp(state, self.limits)
            ramp_twist, state, terms = jacobian @ ramp, free.state(state), free.terms(terms, ramp)
            jacobian, velocity = free.columns(jacobian), velocity[free.free]
        bounds = joint_bounds(self._own_limits, state.q, state.previous, state.elapsed_s)
        dampers = None if terms is None else terms.dampers
        limited = constrained.solve(np.eye(len(self._joints)), velocity, bounds.lo, bounds.hi, dampers=dampers)
        command, unknown = within_velocity_limits(limited.joint_velocity, bounds.velocity), np.full(6, np.nan)
        off_direction = jacobian @ (command - limited.task_scale * velocity)
        found = DifferentialIkSolution(
            command,
            limited.task_scale,
            1.0,
            NO_TRUNCATION,
            rows.body_twist(off_direction),
            limits_off_direction(off_direction, limited, jacobian, row_scale, bounds, self._joints, dampers),
            unknown,
            unknown,
            rows.all_singular_values(np.asarray(np.linalg.svd(row_scale[:, None] * jacobian, compute_uv=False))),
            limited.binding(bounds, self._joints, dampers),
            relaxed_names(limited, bounds, self._joints, dampers),
            NO_PAIR if terms is None else terms.closest,
        )
        return found if free is None else free.solution(found, ramp, rows.body_twist(ramp_twist))

    def _solution(
        self, step: StepSolution, state: ArmState, rows: TaskRows, twist: Array, terms: AvoidanceTerms | None
    ) -> DifferentialIkSolution | None:
        """The solution of a control step that is solved; None if a limit has blocked the arm for too long."""
        before, stalled_s = self._snapshot, 0.0
        if step.task_scale < 1.0 or before.stalled_s > 0.0:
            stalled_s = self._stalled_time(twist, step.task_scale, state.elapsed_s)
            if stalled_s > TIMEOUT_S:
                return None
        singularity = before.singularity
        if singularity is not START:
            delay_s = max(0.0, singularity.delay_s - state.elapsed_s)
            singularity = START._replace(delay_s=delay_s) if delay_s > 0.0 else START
        self._snapshot = SolverSnapshot(singularity, step.task_scale, stalled_s)
        return DifferentialIkSolution(
            step.joint_velocity,
            step.task_scale,
            step.viable_scale,
            NO_TRUNCATION,
            rows.body_twist(step.off_direction),
            (),
            rows.wrench(step.multiplier_task),
            rows.wrench(step.multiplier_potential),
            rows.all_singular_values(step.svd.sigma),
            () if step.status == FREE else self._binding(step, state, rows, terms),
            (),
            NO_PAIR if terms is None else terms.closest,
        )

    def _binding(
        self, step: StepSolution, state: ArmState, rows: TaskRows, terms: AvoidanceTerms | None
    ) -> tuple[str, ...]:
        bands = () if rows.bands is None else rows.bands.active(step.joint_velocity, step.task_scale)
        if not np.count_nonzero(step.sides):
            return bands
        bounds = joint_bounds(self._own_limits, state.q, state.previous, state.elapsed_s)
        dampers = () if terms is None else terms.dampers.names
        return (*binding_names(step.sides, bounds, self._joints, dampers), *bands)

    def _avoidance_terms(self, state: ArmState, repel: bool) -> AvoidanceTerms | None:
        hold_s = self.limits.dt_max_s
        change = largest_change(self.limits.acceleration, state.elapsed_s, hold_s)
        return self.collision_monitor.update(state.q, state.previous, change, hold_s, state.time_ns, repel)

    def _stalled_time(self, twist: Array, fraction: float, elapsed_s: float) -> float:
        return stalled_time(self._snapshot.stalled_s, fraction, float(np.abs(twist).max()), elapsed_s)
