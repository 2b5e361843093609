"""The law of one tick: from a measured state and a desired motion to a command, with everything it remembers.

It composes the twist of the control law (or the difference of inverse kinematics), integral action, the model of a late
arm, and the optimum within the limits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.control.feedback import DesiredTwist, IkDifference, IkDifferenceSnapshot, twist_feedback
from ik_node.control.integral_action import IntegralAction, IntegralSnapshot
from ik_node.control.joint_states import JointState
from ik_node.control.smith_predictor import LateArm, SmithPredictorSnapshot
from ik_node.differential_ik.solution import NOTHING_LOST, Moment, Outcome
from ik_node.differential_ik.solver import SolverSnapshot, TickSolver
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.snapshot import capture, restore
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

HIGHEST_GAIN_FOR_LATE_ARMS = 100.0
"""Gain [1/s] up to which ik_difference was seen to stay stable with 20 ms of lag and one sample of delay."""


class Decision(NamedTuple):
    """What one tick came to."""

    asked: DesiredTwist
    """Its error is that of the tool now; its twists are what was asked for."""
    outcome: Outcome
    elapsed_s: float
    """For how long the last command had stood."""


class CommandSnapshot(NamedTuple):
    """What a :class:`Law` itself remembers; its attributes of the same names."""

    velocity: Array
    """The command that stands, (n,), rad/s (m/s)."""
    commanded_ns: int
    """Since when."""
    pace: float
    """s of the last tick."""
    gives_up: bool
    """Whether a part of the twist was given up at the last tick."""


class VelocityControllerSnapshot(NamedTuple):
    """Everything that decides what the law does next, beside its robot and its settings."""

    command: CommandSnapshot
    ik_difference: IkDifferenceSnapshot
    integral: IntegralSnapshot
    late: SmithPredictorSnapshot
    solver: SolverSnapshot


class Law:
    """One instance belongs to one controller."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        """Raises SettingsError when limits do not fit the robot, and as the solver's surroundings do."""
        self._robot = robot
        self._control = settings.control
        self.solver = TickSolver(robot, settings)
        self._ik = IkDifference(robot)
        self._integral = IntegralAction()
        self._late = LateArm(robot.n, settings.control)
        self.velocity = np.zeros(robot.n)
        self.commanded_ns = 0
        self.pace = 1.0
        self.gives_up = False

    def configure(self, settings: Settings) -> None:
        """Other settings from now on; raises SettingsError, changing nothing, when limits do not fit the robot."""
        self.solver.configure(settings)
        self._control = settings.control
        self._late.configure(settings.control)

    def capture(self) -> VelocityControllerSnapshot:
        """For :meth:`restore`."""
        return VelocityControllerSnapshot(
            capture(self, CommandSnapshot),
            capture(self._ik, IkDifferenceSnapshot),
            capture(self._integral, IntegralSnapshot),
            capture(self._late, SmithPredictorSnapshot),
            self.solver.capture(),
        )

    def restore(self, snapshot: VelocityControllerSnapshot) -> None:
        """Goes on, bit for bit, from ``snapshot``."""
        restore(self, snapshot.command)
        restore(self._ik, snapshot.ik_difference)
        restore(self._integral, snapshot.integral)
        restore(self._late, snapshot.late)
        self.solver.restore(snapshot.solver)

    def begin(self, time_ns: int, commanded_ns: int) -> None:
        """The arm begins anew, at rest at the measurement of ``time_ns``."""
        self.commanded_ns = commanded_ns
        self._late.begin(time_ns)
        self._ik.solution = None
        self._integral.reset()
        self.solver.begin()
        self.pace, self.gives_up = 1.0, False

    def command(self, velocity: Array, time_ns: int) -> None:
        """``velocity`` (n,) is what is commanded from now on, whoever says so."""
        self.velocity, self.commanded_ns = velocity, time_ns
        self._late.command(velocity, time_ns)

    def decide(self, state: JointState, pose_sb: Array, motion: Motion, interval_s: float, now: Instant) -> Decision:
        """The command for the tool at ``pose_sb`` (4, 4) that should do ``motion``; it counts as given.

        ``interval_s``: for how long it will stand, as far as is known. Raises InputError when no finite answer exists.
        """
        control = self._control
        asked = twist_feedback(pose_sb, motion, control)
        position = state.position
        if self._late.lateness_s > 0.0:
            # Where the arm is going to be by what it has been told, towards the target of that time.
            position = position + self._late.lead(state.time_ns)
            later = self._late.target(motion, interval_s)
            asked = twist_feedback(self._robot.pose(position), later, control)._replace(error_b=asked.error_b)
        # The Jacobian belongs to the middle of the interval in which the command will stand, as the feed-forward does.
        ahead_s = (now.monotonic_ns - state.time_ns) / NS + 0.5 * interval_s
        elapsed_s = (now.monotonic_ns - self.commanded_ns) / NS
        q_middle = carried_on(position, self.velocity, ahead_s)
        moment = Moment(position, q_middle, self.velocity, elapsed_s, now.monotonic_ns)
        if control.control_law == "ik_difference":
            wanted = self._ik.velocity(position, motion, interval_s, control.ik_difference_gain)
            outcome = self.solver.follow_velocity(moment, wanted)
        else:
            self._ik.solution = None
            if not self._integral.idle(control):
                frozen = self.pace < 1.0 or self.gives_up
                more = self._integral.twist(asked.error_b, elapsed_s, frozen, control)
                asked = asked._replace(twist_b=asked.twist_b + more)
            outcome = self.solver.follow_twist(moment, asked.twist_b)
        self.command(outcome.joint_velocity, now.monotonic_ns)
        self.pace = outcome.scale
        self.gives_up = outcome.lost_b is not NOTHING_LOST and bool(np.abs(outcome.lost_b).max() > 1e-6)
        return Decision(asked, outcome, elapsed_s)

    def conditions(self, decision: Decision) -> list[str]:
        """What a person should know of a decision."""
        outcome, control, solver = decision.outcome, self._control, self.solver
        found = []
        if self.gives_up:
            found.append("near a singularity, part of the twist is given up")
        if outcome.pace < 0.99:
            found.append("slowing down to pass a singularity")
        if outcome.scale < outcome.pace:
            found.append("slowed down by joint limits")
        if outcome.conceded:
            found.append("a joint limit had to give way")
        if decision.elapsed_s > solver.limits.dt_max_s:
            found.append("a command stood for longer than hold_periods")
        if not self._ik.converged:
            found.append("inverse kinematics finds no solution near the last one")
        if solver.without_effect:
            found.append(solver.without_effect)
        if control.control_law == "ik_difference" and control.ik_difference_gain > HIGHEST_GAIN_FOR_LATE_ARMS:
            found.append("ik_difference_gain is stable only for an arm that answers without lag")
        return found


@compiled
def carried_on(q: Array, qd: Array, time_s: float) -> Array:
    """Where joints at ``q`` (n,) are after ``time_s`` at ``qd`` (n,)."""
    return q + time_s * qd
