"""Parameter file for an arm that is known by its URDF only.

The file has a section for the node and one for the simulated arm. Every value has its source: the URDF, a choice by
measures, or an assumption that has to be checked before a real arm moves.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

from ik_node.collision.monitor import CollisionMonitor
from ik_node.control.start_posture import StartPosture, choose_start_posture
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.robot.catalogue import read_file
from ik_node.robot.robot import Robot
from ik_node.robot.simulator_parameters import SIMULATOR
from ik_node.robot.task_rank import task_rank
from ik_node.settings.groups import Settings

ACCELERATION_TIME_S = 0.2
"""Time in which a joint is assumed to reach its velocity limit; UR5, Panda and xArm 7 need 0.1 to 0.3 s."""
MAX_ACCELERATION = 10.0
"""Largest acceleration that is assumed, rad/s2 (m/s2)."""
REGULATED_FRACTION = 0.25
"""Regulation near singularities of a small arm starts at this fraction of the smallest singular value at its best
posture. The configured arms with six and seven joints have 0.124 m there and more, above the default threshold."""
LEAST_THRESHOLD_M = 0.01
"""Least valid value of ``singularity.threshold``."""
ASSUMED_VELOCITY = {True: 1.0, False: 0.1}
"""Velocity limit where the URDF has none: of revolute joints, rad/s, and of prismatic joints, m/s."""
ASSUMED_RANGE = {True: (-math.pi, math.pi), False: (0.0, 0.1)}
"""Position limits of a joint whose limits in the URDF cannot be meant, rad and m."""
UNLIMITED = 1.0e6
"""Position limit that stands for none in a list in which another joint needs one."""


def arm_configuration(path: Path, base_frame: str = "", tip_frame: str = "") -> str:
    """Text of a parameter file for an arm.

    Args:
        path: URDF file.
        base_frame: Frame {s}; default: the root of the model.
        tip_frame: Tool frame {b}; default: the end of the longest chain, without the joints of a gripper.

    Returns:
        YAML with sections ``ik_node`` and ``ik_simulator``.

    Raises:
        RobotError: The file cannot be read, is no valid URDF, or has no joint to control.
    """
    path = path.expanduser().absolute()
    robot = Robot(read_file(path), base_frame, tip_frame)
    start = choose_start_posture(robot)
    arm = (f"robot_description: {_text(str(path))}", f"base_frame: {_text(robot.base_frame)}")
    tip = f"tip_frame: {_text(robot.tip_frame)}"
    if not tip_frame:
        tip += f"  # {robot.default_tip_text}"
    node = (
        f"{arm[0]}  # without this line: the topic robot_description",
        arm[1],
        tip,
        "# The order of the commands, which is that of your controller's parameter joints.",
        *_list("joints", ((_text(name), comment) for name, comment in zip(robot.joints, _ranges(robot), strict=True))),
        "rate_hz: 500.0  # assumed: the update_rate of your controller_manager",
        "method: plain",
        *_task(robot),
        *_singularity(start),
        "limits:",
        *(f"  {line}" for line in _limits(robot)),
    )
    simulator = (
        *arm,
        tip.partition("  #")[0],
        "rate_hz: 500.0",
        f"# Chosen: {start.measures}.",
        f"initial_position: [{', '.join(_number(value) for value in start.position.tolist())}]",
    )
    pairs = CollisionMonitor(robot, Settings().obstacles).pairs.partition("; adjacent")[0]
    lines = (
        f"# {robot.name}, written by ik_config. Before a real arm moves, check what is marked as assumed.",
        f"# {pairs}",
        "/**:",
        *_section("ik_node", node),
        *_section(SIMULATOR, simulator),
    )
    return "".join(f"{line}\n" for line in lines)


def _section(name: str, lines: Iterable[str]) -> Iterator[str]:
    yield f"  {name}:"
    yield "    ros__parameters:"
    yield from (f"      {line}" for line in lines)


def _list(name: str, entries: Iterable[tuple[str, str]]) -> Iterator[str]:
    yield f"{name}:"
    yield from (f"  - {value}  # {comment}" for value, comment in entries)


def _text(value: str) -> str:
    """A text as YAML, without quotation marks where none are needed."""
    plain = value.replace("_", "").replace("/", "").replace("-", "")
    return value if plain.isalpha() or (value[:1].isalpha() and plain.isalnum()) else json.dumps(value)


def _number(value: float) -> str:
    """A number as a double of YAML, to four significant digits."""
    return repr(float(f"{value:.4g}"))


def _ranges(robot: Robot) -> Iterator[str]:
    """Kind and position limits of each joint."""
    faults = {fault.joint for fault in robot.limit_faults if fault.quantity == "position"}
    limits = zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True)
    for name, revolute, (lower, upper) in zip(robot.joints, robot.revolute.tolist(), limits, strict=True):
        kind, unit = ("revolute", "rad") if revolute else ("prismatic", "m")
        if name in faults:
            yield f"{kind}; its position limits in the URDF cannot be meant: see position_lower"
        elif math.isinf(lower) and math.isinf(upper):
            yield f"{kind}, no position limits: URDF"
        else:
            yield f"{kind}, {lower:.4g} to {upper:.4g} {unit}: URDF"


def _limits(robot: Robot) -> Iterator[str]:
    faults = {fault.joint: fault.text for fault in robot.limit_faults if fault.quantity == "position"}
    kinds = robot.revolute.tolist()
    if faults:
        for name, side, values in (
            ("position_lower", 0, robot.limits.lower),
            ("position_upper", 1, robot.limits.upper),
        ):
            entries = []
            for joint, revolute, value in zip(robot.joints, kinds, values.tolist(), strict=True):
                if joint in faults:
                    entries.append((_number(ASSUMED_RANGE[revolute][side]), f"{joint}: assumed; {faults[joint]}"))
                elif math.isinf(value):
                    entries.append((_number(math.copysign(UNLIMITED, value)), f"{joint}: none in the URDF"))
                else:
                    entries.append((_number(value), f"{joint}: URDF"))
            yield from _list(name, entries)
    velocities, accelerations = [], []
    for joint, revolute, velocity in zip(robot.joints, kinds, robot.limits.velocity.tolist(), strict=True):
        unit = "rad/s" if revolute else "m/s"
        if math.isinf(velocity):
            limit = ASSUMED_VELOCITY[revolute]
            velocities.append((_number(limit), f"{joint}, {unit}: assumed, the URDF has none"))
        else:
            limit = velocity
            velocities.append((_number(limit), f"{joint}, {unit}: URDF"))
        acceleration = min(limit / ACCELERATION_TIME_S, MAX_ACCELERATION)
        accelerations.append((_number(acceleration), f"{joint}, {unit}2: assumed"))
    yield from _list("velocity", velocities)
    yield f"# A URDF has no acceleration limits. Assumed: {ACCELERATION_TIME_S:g} s to the velocity limit, and at most"
    yield f"# {MAX_ACCELERATION:g} rad/s2 (m/s2). Set what your arm and its payload can do."
    yield from _list("acceleration", accelerations)


def _task(robot: Robot) -> Iterator[str]:
    """For an arm that cannot follow whole poses: the part of them that it can follow."""
    rank = task_rank(robot, TaskTolerance())
    if rank.followed:
        return
    yield f"# {rank.text(TaskTolerance())}."
    if rank.proposal is not None:
        widths = ", ".join(".inf" if free else _number(width) for width, free in _widths(rank.proposal))
        yield "# Chosen: that. Without these lines whole poses are followed with the least deviation."
        yield "task:"
        yield f"  tolerance: [{widths}]"
        yield f"  frame: {rank.proposal.frame}"


def _singularity(start: StartPosture) -> Iterator[str]:
    """For an arm that the default threshold would regulate at every posture: a threshold of its own."""
    default = Settings().singularity.threshold
    if start.singular_value < default:
        threshold = max(REGULATED_FRACTION * start.singular_value, LEAST_THRESHOLD_M)
        yield f"# A small arm: the smallest singular value is below the default of {default:g} m at every posture."
        yield "singularity:"
        yield f"  threshold: {_number(threshold)}  # m"


def _widths(tolerance: TaskTolerance) -> Iterator[tuple[float, bool]]:
    return zip(tolerance.half_widths, (bool(free) for free in tolerance.free), strict=True)
