"""Assembly of the Step of a control step from the results of the components."""

from __future__ import annotations

import numpy as np

from ik_node.control.joint_states import JointState
from ik_node.control.velocity_controller import ControlOutput
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.step import Status, Step, bare_step
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.targets.arbiter import TargetArbiter


def closed_loop_step(
    tick: int,
    now: Instant,
    state: JointState,
    pose_sb: Array,
    motion: Motion,
    output: ControlOutput,
    targets: TargetArbiter,
    status: Status,
) -> Step:
    """Assembles the Step of a command that the control law has computed.

    Args:
        tick: Number of the control step.
        now: Present time.
        state: Measured joint state.
        pose_sb: Pose of the tool at ``state.position``, (4, 4).
        motion: Desired motion.
        output: Command and intermediate results.
        targets: For the progress on a path.
        status: Status of the controller.

    Returns:
        The Step.
    """
    desired, solution, _ = output
    return Step(
        tick=tick,
        now=now,
        state_time_ns=state.time_ns,
        joint_position=state.position,
        joint_velocity=solution.joint_velocity,
        pose_sb=pose_sb,
        pose_sd=motion.pose_sd,
        error_b=desired.error_b,
        feedforward_b=desired.feedforward_b,
        twist_b=desired.twist_b,
        truncated_b=solution.truncated_b,
        off_direction_b=solution.off_direction_b,
        scale=solution.task_scale,
        multiplier_task=solution.multiplier_task,
        multiplier_potential=solution.multiplier_potential,
        singular_values=solution.singular_values,
        binding=solution.binding,
        off_direction_limits=solution.off_direction_limits,
        progress=targets.progress,
        path_distance=targets.distance_m,
        clearance=solution.closest.distance,
        closest_points=solution.closest.points_s,
        closest_pair=solution.closest.names,
        status=status,
    )


def open_loop_step(
    tick: int, now: Instant, state: JointState | None, robot: Robot, velocity: Array, status: Status
) -> Step:
    """Assembles the Step of a command that no control law has computed.

    Args:
        tick: Number of the step.
        now: Time of the command.
        state: Last joint state; None when none is valid, and position and pose are NaN.
        robot: The arm.
        velocity: Command, (n,), rad/s (m/s).
        status: Status in force.

    Returns:
        The Step.
    """
    if state is None:
        nothing = np.full(robot.n, np.nan), np.full((4, 4), np.nan)
        return bare_step(tick, now, now.monotonic_ns, *nothing, velocity, status)
    return bare_step(tick, now, state.time_ns, state.position, robot.pose(state.position), velocity, status)
