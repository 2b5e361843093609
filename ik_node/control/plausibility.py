"""Decides whether measured joint positions are possible: within reach of the last ones, not far outside the limits.

A position further from the last accepted one than the joint can have moved is a jump. A jump is accepted after the new
positions were possible relative to each other for ``state.timeout_s``, without an accepted one in between: an arm that
was moved while it was not measured is used again, a single outlier is not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math.angles import joint_difference
from ik_node.math.types import Array
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

SPEED_FACTOR = 1.5
"""Measured speed / velocity limit that is still possible: an arm guided by hand exceeds the limits of its URDF."""
JITTER_S = 0.03
"""Error of the time between two positions: drivers stamp on arrival, and networks deliver in bursts."""
NOISE = 0.02
"""Difference of two measurements of a joint at rest that is possible, rad (m): noise, backlash of simple encoders."""
UNKNOWN_SPEED = 20.0
"""Speed assumed for a joint without a velocity limit, rad/s (m/s); no joint of an arm is faster."""
BEYOND_LIMIT = (0.5, 0.1)
"""Distance outside the position limits that is still possible, [rad, m]: errors of calibration are smaller, and an arm
that was switched off can lie on its mechanical stops."""
MAX_POSITION = 1e5
"""Largest position of a joint without limits, rad (m): about a day of turning at 1 rad/s."""

POSSIBLE, JUMPED, OUTSIDE, SETTLED = 0, 1, 2, 3


class Plausible(NamedTuple):
    """What positions of the joints are possible, (n,) each."""

    lower: Array
    """Smallest possible position, rad (m)."""
    upper: Array
    speed: Array
    """Largest possible speed, rad/s (m/s)."""
    continuous: NDArray[np.bool_]
    """Joints whose positions a full turn does not change."""


def plausible(robot: Robot, settings: Settings) -> Plausible:
    """Possible positions of a robot: the wider of the limits of the URDF and of the settings, with margins.

    Raises:
        SettingsError: The limits do not fit the robot.
    """
    used, urdf = motion_limits(robot, settings.limits, settings.control.rate_hz), robot.limits
    lower = np.where(np.isfinite(urdf.lower), np.minimum(urdf.lower, used.lower), used.lower)
    upper = np.where(np.isfinite(urdf.upper), np.maximum(urdf.upper, used.upper), used.upper)
    fastest = used.velocity / settings.limits.velocity_fraction
    fastest = np.where(np.isfinite(urdf.velocity), np.maximum(urdf.velocity, fastest), fastest)
    margin = np.where(robot.revolute, *BEYOND_LIMIT)
    return Plausible(
        np.maximum(lower - margin, -MAX_POSITION),
        np.minimum(upper + margin, MAX_POSITION),
        SPEED_FACTOR * np.where(np.isfinite(fastest), fastest, UNKNOWN_SPEED),
        robot.continuous,
    )


@compiled
def judge(
    limits: Plausible,
    own: NDArray[np.intp],
    position: Array,
    time_ns: int,
    now_ns: int,
    last: Array,
    last_ns: NDArray[np.int64],
    jumped: Array,
    jumped_ns: NDArray[np.int64],
    since_ns: NDArray[np.int64],
    timeout_ns: int,
) -> tuple[int, int]:
    """Judges the positions of one message.

    Args:
        limits: Possible positions.
        own: Indices of the joints, (k,).
        position: Their positions, (k,), rad (m), finite.
        time_ns: Monotonic time of the measurement.
        now_ns: Monotonic time of arrival.
        last: Last accepted positions, (n,); NaN for none.
        last_ns: Their times, (n,).
        jumped: Last positions after a jump that is not accepted, (n,); NaN for none. Changed.
        jumped_ns: Their times, (n,). Changed.
        since_ns: Times of arrival of the first positions after the jump, (n,). Changed.
        timeout_ns: Time after which a jump is accepted.

    Returns:
        POSSIBLE; SETTLED with a joint whose jump is accepted; JUMPED or OUTSIDE with the first such joint.
    """
    status, joint = 0, 0
    for k in range(len(own)):
        i = own[k]
        value, found = position[k], 0
        continues = not np.isnan(jumped[i]) and _reachable(limits, i, jumped[i], value, jumped_ns[i], time_ns, now_ns)
        # What continues a jump stays one, although a longer time since the last accepted position admits more.
        if continues and not np.isnan(last[i]):
            apart = abs(joint_difference(last[i], value, limits.continuous[i]))
            continues = abs(joint_difference(jumped[i], value, limits.continuous[i])) < apart
        if value < limits.lower[i] or value > limits.upper[i]:
            found = 2
        elif np.isnan(last[i]) or (
            not continues and _reachable(limits, i, last[i], value, last_ns[i], time_ns, now_ns)
        ):
            jumped[i] = np.nan
        else:
            if not continues:
                since_ns[i] = now_ns
            jumped[i], jumped_ns[i] = value, time_ns
            found = 3 if now_ns - since_ns[i] >= timeout_ns else 1
        if found != 0 and (status == 0 or (status == 3 and found != 3)):
            status, joint = found, i
    return status, joint


@compiled
def _reachable(
    limits: Plausible, joint: int, begin: float, end: float, begin_ns: int, end_ns: int, now_ns: int
) -> bool:
    elapsed_s = max(now_ns - begin_ns, begin_ns - end_ns) * 1e-9 + JITTER_S
    distance = abs(joint_difference(begin, end, limits.continuous[joint]))
    return bool(distance <= limits.speed[joint] * elapsed_s + NOISE)
