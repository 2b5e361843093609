"""Velocity controller: the joint velocity command from a measured state and a desired motion.

It composes the feedback law (task space or joint space), integral action, the Smith predictor and the differential
inverse kinematics within the limits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.control.feedback import DesiredTwist, IkDifference, IkDifferenceSnapshot
from ik_node.control.integral_action import IntegralAction, IntegralSnapshot
from ik_node.control.joint_states import JointState
from ik_node.control.off_direction_warning import MIN_RATIO, MIN_SPEED, NO_WARNING, OffDirectionWarning, updated_warning
from ik_node.control.rest_off_target import RestOffTarget, RestSnapshot
from ik_node.control.smith_predictor import SmithPredictor, SmithPredictorSnapshot
from ik_node.control.task_feedback import TaskFeedback, TaskFeedbackSnapshot, task_note
from ik_node.differential_ik.own_methods import GivenMethods
from ik_node.differential_ik.solution import NO_TRUNCATION, ArmState, DifferentialIkSolution, SolverSnapshot
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.snapshot import capture, restore
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

MAX_GAIN_WITH_LAG = 100.0
"""Largest ik_difference_gain [1/s] that was stable in simulation with 20 ms of lag and one sample of delay."""


class ControlOutput(NamedTuple):
    """Result of one control step."""

    desired: DesiredTwist
    """Error at the measured position, and the twists of the feedback law."""
    solution: DifferentialIkSolution
    """Solution of the differential inverse kinematics; contains the command."""
    held_since_ns: int
    """Monotonic time of the previous command if it was held for longer than the limits hold; 0 otherwise."""


DEFERRED = "a change of the twist is deferred"


class CommandSnapshot(NamedTuple):
    """Attributes of a :class:`VelocityController`, without those of its components."""

    velocity: Array
    """Last command, (n,), rad/s (m/s)."""
    commanded_ns: int
    """Monotonic time of the last command."""
    task_scale: float
    """s of the last control step."""
    truncated: bool
    """True when a part of the last twist was truncated near a singularity or deferred."""
    off_direction: OffDirectionWarning


class VelocityControllerSnapshot(NamedTuple):
    """Complete internal state of a :class:`VelocityController`."""

    command: CommandSnapshot
    ik_difference: IkDifferenceSnapshot
    integral: IntegralSnapshot
    smith_predictor: SmithPredictorSnapshot
    solver: SolverSnapshot
    task: TaskFeedbackSnapshot = TaskFeedbackSnapshot()
    rest: RestSnapshot = RestSnapshot()


class VelocityController:
    """Control law, predictor and differential inverse kinematics of one arm."""

    def __init__(self, robot: Robot, settings: Settings, methods: GivenMethods | None = None) -> None:
        """Creates the components; for ``methods`` see :class:`ik_node.control.controller.Controller`.

        Raises:
            SettingsError: A list of limits does not match the number of joints, or an own method cannot be loaded.
            SceneError: The scene file cannot be used.
            UnknownNameError: ``obstacles`` names a link that does not exist.
        """
        self._robot = robot
        self._settings = settings
        self._control, self._singular_below = settings.control, settings.singularity.threshold
        self._task = TaskFeedback(robot, settings)
        self.solver = DifferentialIkSolver(robot, settings, methods)
        self._locked = settings.control.locked_joints
        self.task_note = task_note(robot, self._task.tolerance, self._locked, proposes=True)
        """What of the task the arm cannot follow in general; empty for nothing."""
        self._ik = IkDifference(robot, self._task.tolerance, self._locked)
        self._integral = IntegralAction()
        self._rest = RestOffTarget(robot, self._task.tolerance, self._locked)
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self._smith_predictor = SmithPredictor(robot.n, settings.control)
        self.velocity = np.zeros(robot.n)
        self.commanded_ns = 0
        self.task_scale = 1.0
        self.truncated = False
        self.off_direction = NO_WARNING
        self._slowing = ""

    def configure(self, settings: Settings) -> None:
        """Applies changed settings; raises SettingsError, without any change, when limits do not match the robot."""
        self.solver.configure(settings)
        self._settings = settings
        self._control, self._singular_below = settings.control, settings.singularity.threshold
        before, self._locked = self._locked, settings.control.locked_joints
        is_other_task = self._task.configure(settings)
        if is_other_task:
            self.solver.reset()
        if is_other_task or self._locked != before:
            self._ik.configure(self._task.tolerance, self._locked)
            self._rest.configure(self._task.tolerance, self._locked)
            self.task_note = task_note(self._robot, self._task.tolerance, self._locked, proposes=False)
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self._smith_predictor.configure(settings.control)

    def set_rate(self, rate_hz: float) -> None:
        """Sets the expected rate of control steps; limits hold for ``limits.hold_periods`` of its periods."""
        if rate_hz != self._control.rate_hz:
            self.configure(self._settings.with_values({"rate_hz": rate_hz}))

    def capture(self) -> VelocityControllerSnapshot:
        """Snapshot for :meth:`restore`."""
        return VelocityControllerSnapshot(
            capture(self, CommandSnapshot),
            capture(self._ik, IkDifferenceSnapshot),
            capture(self._integral, IntegralSnapshot),
            capture(self._smith_predictor, SmithPredictorSnapshot),
            self.solver.capture(),
            capture(self._task, TaskFeedbackSnapshot),
            capture(self._rest, RestSnapshot),
        )

    def restore(self, snapshot: VelocityControllerSnapshot) -> None:
        """Continues, bit for bit, from a snapshot."""
        restore(self, snapshot.command)
        restore(self._ik, snapshot.ik_difference)
        restore(self._integral, snapshot.integral)
        restore(self._smith_predictor, snapshot.smith_predictor)
        self.solver.restore(snapshot.solver)
        restore(self._task, snapshot.task)
        restore(self._rest, snapshot.rest)

    def start(self, time_ns: int, commanded_ns: int) -> None:
        """Resets all components for an arm at rest.

        Args:
            time_ns: Monotonic time of the measurement.
            commanded_ns: Monotonic time from which the command of zero is assumed; the time of the last command if
                that is later, so that the first command keeps the acceleration limit.
        """
        self.commanded_ns = max(commanded_ns, self.commanded_ns)
        self._smith_predictor.reset(time_ns)
        self._ik.solution = None
        self._integral.reset()
        self._rest.reset()
        self.solver.reset()
        self.task_scale, self.truncated, self.off_direction = 1.0, False, NO_WARNING

    def slowing(self) -> str:
        """Status text that names the joints whose last command exceeds a lowered velocity limit; empty for none."""
        names = self.solver.exceeding(self.velocity)
        if not names:
            return ""
        return f"a velocity limit was lowered; reduced to it within the acceleration limit: {', '.join(names)}"

    def slowed(self, velocity: Array, now: Instant) -> Array:
        """``velocity`` (n,) of a ramp, rad/s (m/s), within the velocity limits; see ``lower_velocity_limits``."""
        self.solver.lower_velocity_limits(self.velocity, (now.monotonic_ns - self.commanded_ns) / NS)
        limit = self.solver.limits.velocity
        return np.minimum(np.maximum(velocity, -limit), limit)

    def command(self, velocity: Array, time_ns: int) -> None:
        """Records a command (n,), rad/s (m/s), given at a monotonic time, from this or another source."""
        self.velocity, self.commanded_ns = velocity, time_ns
        self._smith_predictor.command(velocity, time_ns)

    def compute(
        self, state: JointState, pose_sb: Array, motion: Motion, interval_s: float, now: Instant, foreseen: bool = False
    ) -> ControlOutput:
        """Computes the command of one control step, and records it as given.

        Args:
            state: Measured joint state.
            pose_sb: Pose of the tool at ``state.position``, (4, 4).
            motion: Desired motion.
            interval_s: Expected time until the next command, s.
            now: Present time.
            foreseen: True on a path whose rate is one that the joints can follow, now and ahead.

        Returns:
            The command with the intermediate results.

        Raises:
            InputError: No finite solution exists.
        """
        control, task = self._control, self._task
        desired = task.twist(pose_sb, motion, control)
        position, predicted = state.position, motion
        if self._smith_predictor.total_delay_s > 0.0:
            # Predicted position of the arm, and the target extrapolated by the same time.
            position = position + self._smith_predictor.predicted_offset(state.time_ns)
            predicted = self._smith_predictor.target(motion, interval_s)
            at_prediction = task.twist(self._robot.pose(position), predicted, control)
            desired = at_prediction._replace(error_b=desired.error_b)
        # Jacobian and feed-forward are evaluated at the middle of the interval in which the command is held.
        to_middle_s = (now.monotonic_ns - state.time_ns) / NS + 0.5 * interval_s
        elapsed_s = (now.monotonic_ns - self.commanded_ns) / NS
        q_middle = extrapolated(position, self.velocity, to_middle_s)
        self._slowing = self.slowing()
        self.solver.lower_velocity_limits(self.velocity, elapsed_s)
        arm = ArmState(position, q_middle, self.velocity, elapsed_s, now.monotonic_ns, foreseen)
        rows = task.rows(predicted, to_middle_s)
        if control.control_law == "ik_difference":
            velocity = self._ik.velocity(position, motion, interval_s, control.ik_difference_gain)
            twist_b = self.solver.twist_of(arm, velocity, rows)
            desired = desired._replace(twist_b=twist_b)
            solution = self.solver.solve_velocity(arm, velocity, rows)
            if solution.task_scale < 1.0:
                # One joint at its limit would slow the whole arm. Its twist is resolved within the limits instead, and
                # the next theta_d is the one nearest to the measured position, so that this joint does not fall behind.
                solution = self.solver.solve_twist(arm, twist_b, rows)
                self._ik.solution = None
        else:
            self._ik.solution = None
            if not self._integral.idle(control):
                frozen = self.task_scale < 1.0 or self.truncated
                integral = self._integral.twist(desired.error_b, elapsed_s, frozen, control)
                desired = desired._replace(twist_b=desired.twist_b + integral)
            solution = self.solver.solve_twist(arm, desired.twist_b, rows, foresight=True)
        held_since_ns = self.commanded_ns if elapsed_s > self.solver.limits.dt_max_s else 0
        self.command(solution.joint_velocity, now.monotonic_ns)
        self.task_scale = solution.progress
        self.truncated = _is_noticeable(solution.truncated_b)
        self._rest.update(
            state.position, motion, desired.error_b, solution, self.solver.limits, self._row_scale, now.monotonic_ns
        )
        if solution.off_direction_limits or self.off_direction.text:
            self.off_direction = updated_warning(
                self.off_direction,
                now.monotonic_ns,
                solution.off_direction_b,
                desired.twist_b,
                solution.off_direction_limits,
                control.characteristic_length,
            )
        return ControlOutput(desired, solution, held_since_ns)

    def conditions(self, output: ControlOutput) -> list[str]:
        """Conditions of a control step for the status text."""
        solution, control, solver = output.solution, self._control, self.solver
        found = []
        if self.truncated and _is_noticeable(solution.truncated_b - solution.deferred_b):
            found.append("near a singularity: a component of the twist is truncated")
        if self._is_deferred(output):
            found.append(f"{DEFERRED}: the joints cannot follow it along its direction")
        if solution.singularity_scale < 0.99:
            near = solution.singular_values[-1] < self._singular_below
            found.append("slowed down near a singularity" if near else "slowed down ahead of joint limits")
        if solution.task_scale < solution.singularity_scale:
            found.append("slowed down by joint limits")
        if solution.relaxed:
            found.append("a joint limit was relaxed")
        if not self._ik.converged:
            found.append("inverse kinematics found no solution near the last one")
        if self._rest.text:
            found.append(self._rest.text)
        if self._slowing:
            found.append(self._slowing)
        if solver.unlimited:
            found.append(f"no velocity limit in the URDF or limits.velocity: {', '.join(solver.unlimited)}")
        if solver.method.note:
            found.append(solver.method.note)
        if solver.without_effect:
            found.append(solver.without_effect)
        if control.control_law == "ik_difference" and control.ik_difference_gain > MAX_GAIN_WITH_LAG:
            found.append("ik_difference_gain is stable only for an arm without lag")
        return found

    def _is_deferred(self, output: ControlOutput) -> bool:
        """True if more of the twist is deferred than off its direction without a warning."""
        deferred, twist = output.solution.deferred_b, output.desired.twist_b
        if deferred is NO_TRUNCATION:
            return False
        scale = np.repeat((1.0, self._control.characteristic_length), 3)
        return bool(np.linalg.norm(scale * deferred) > max(MIN_RATIO * np.linalg.norm(scale * twist), MIN_SPEED))


def _is_noticeable(part: Array) -> bool:
    """True if a part of the twist (6,) is more than rounding."""
    return part is not NO_TRUNCATION and bool(np.abs(part).max() > 1e-6)


@compiled
def extrapolated(q: Array, qd: Array, time_s: float) -> Array:
    """Joint positions after ``time_s`` at constant velocity: q + time_s qd, (n,)."""
    return q + time_s * qd
