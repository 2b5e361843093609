"""Paths and trajectories as they were sent, checked and brought into {s}."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import IkNodeError, TargetRefused
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import PathSample, TrajectorySample
from ik_node.math import se3
from ik_node.math.quaternion import Quaternion, from_matrix, normalised
from ik_node.math.so3 import relative_rotation_vectors
from ik_node.math.types import Array
from ik_node.settings.groups import PathSettings
from ik_node.targets.path.se3_spline import Knots
from ik_node.targets.path.spline_fit import estimated_accelerations
from ik_node.targets.path.time_parametrisation import nominal_knots

FramePose = Callable[[str], Array]
"""T_sf (4, 4) of a frame by name; raises one of our errors with the names that there are."""

FARTHEST_M = 100.0
"""Positions further from {s} are no target of an arm."""
MAX_POSES = 2000
"""Longer paths are refused: preparing 1000 poses takes 10 ms."""
MAX_AHEAD_S = 60.0
"""Paths that begin later than this from now are refused."""
FASTEST_M_S, FASTEST_RAD_S = 10.0, 30.0
"""Stamps and twists that ask for more than this are a mistake. What the arm cannot do slows the path down instead."""
SHORT_AFTER_EPOCH_NS = 365 * 86_400 * NS
"""Stamps before this are no dates but times from the start of the path."""


class PathRequest(NamedTuple):
    """N poses in {s} to be gone through in order."""

    times_s: Array
    """(N,), increasing from 0; where the poses came without times, what :func:`nominal_knots` says."""
    positions: Array
    """(N, 3), m."""
    orientations: tuple[Quaternion, ...]
    """N times R_sd, (w, x, y, z)."""
    knots: Knots | None
    """With rates and accelerations, where these were sent too."""
    begin_ns: int | None
    """When it begins on the monotonic clock; None: as soon as the arm is there."""
    warning: str
    """What a person should know about it; empty for nothing."""
    timed: bool = True
    """The poses came with times."""


def request_from_path(sample: PathSample, frame_pose: FramePose, now: Instant, settings: PathSettings) -> PathRequest:
    """The route of a nav_msgs/Path. Its poses hold at their own stamps; the path's own stamp says nothing.

    All stamps alike: a path without times. Raises TargetRefused, naming the pose by its number from 0.
    """
    count = len(sample.stamps_ns)
    _check_count(count)
    stamps = sample.stamps_ns
    bases = [(frame, _placed(frame_pose, frame, sample.frame_ids)) for frame in dict.fromkeys(sample.frame_ids)]
    positions, orientations = _in_base(sample.positions, sample.quaternions, sample.frame_ids, bases)
    if len(set(stamps)) == 1:
        knots = nominal_knots(positions, orientations, settings)
        return PathRequest(knots.times_s, knots.positions, knots.orientations, knots, None, "", False)
    times_s = _times([stamp - stamps[0] for stamp in stamps])
    _check_speeds(times_s, positions, orientations)
    begin_ns, warning = _begin("target_path", stamps[0], stamps[-1], now)
    return PathRequest(times_s, positions, orientations, None, begin_ns, warning)


def request_from_trajectory(sample: TrajectorySample, frame_pose: FramePose, now: Instant) -> PathRequest:
    """The route of a trajectory_msgs/MultiDOFJointTrajectory.

    Twists and accelerations are those of the tool point, written in the axes of the header's frame: ROS says no more
    than "velocity specified for the origin of the joint", and a TwistStamped is written in the frame of its header.
    Raises TargetRefused, naming the point by its number from 0.
    """
    count = len(sample.times_ns)
    _check_count(count)
    base = _placed(frame_pose, sample.frame_id, (sample.frame_id,))
    frames = (sample.frame_id,) * count
    positions, orientations = _in_base(sample.positions, sample.quaternions, frames, [(sample.frame_id, base)])
    times_s = _times([time - sample.times_ns[0] for time in sample.times_ns])
    _check_speeds(times_s, positions, orientations)
    first, last = sample.stamp_ns + sample.times_ns[0], sample.stamp_ns + sample.times_ns[-1]
    begin_ns: int | None = now.monotonic_ns + sample.times_ns[0]
    warning = ""
    if sample.stamp_ns != 0:
        begin_ns, warning = _begin("target_trajectory", first, last, now)
    knots = _knots(sample, base, times_s, positions, orientations)
    return PathRequest(times_s, positions, orientations, knots, begin_ns, warning)


def _knots(
    sample: TrajectorySample, base: Array, times_s: Array, positions: Array, orientations: tuple[Quaternion, ...]
) -> Knots | None:
    if not len(sample.twists):
        if len(sample.accelerations):
            raise TargetRefused("accelerations without velocities; expected both, velocities alone or neither")
        return None
    for name, values in (("velocity", sample.twists), ("acceleration", sample.accelerations)):
        _check_finite(values, f"{name} of pose")
    speeds = np.linalg.norm(sample.twists.reshape(-1, 2, 3), axis=2)
    _refuse_first(speeds[:, 0] > FASTEST_M_S, "pose {} has a velocity above " + f"{FASTEST_M_S:g} m/s")
    _refuse_first(speeds[:, 1] > FASTEST_RAD_S, "pose {} has an angular velocity above " + f"{FASTEST_RAD_S:g} rad/s")
    rotation = base[:3, :3]
    own = np.array([_matrix(orientation) for orientation in orientations])

    def halves(values: Array) -> tuple[Array, Array]:
        """Linear in {s}; angular in the knot's own frame."""
        return values[:, :3] @ rotation.T, np.einsum("nji,nj->ni", own, values[:, 3:] @ rotation.T)

    velocities, rates = halves(sample.twists)
    zeros = np.zeros_like(velocities)
    knots = Knots(times_s, positions, orientations, velocities, rates, zeros, zeros)
    if not len(sample.accelerations):
        return estimated_accelerations(knots)
    accelerations, angular = halves(sample.accelerations)
    return knots._replace(accelerations=accelerations, angular_accelerations=angular)


def _matrix(orientation: Quaternion) -> Array:
    w, x, y, z = orientation
    return se3.rotation_from_quaternion((x, y, z, w))


def _check_count(count: int) -> None:
    if count < 2:
        raise TargetRefused(f"a path of {count} poses; expected at least 2 (target_pose takes single ones)")
    if count > MAX_POSES:
        raise TargetRefused(f"a path of {count} poses; at most {MAX_POSES} are accepted")


def _placed(frame_pose: FramePose, frame: str, frame_ids: tuple[str, ...]) -> Array:
    try:
        return frame_pose(frame)
    except IkNodeError as error:
        raise TargetRefused(f"pose {frame_ids.index(frame)}: {error}") from error


def _in_base(
    positions: Array, quaternions: Array, frame_ids: tuple[str, ...], bases: list[tuple[str, Array]]
) -> tuple[Array, tuple[Quaternion, ...]]:
    """Checked poses, brought into {s} from their frames; ``bases`` are T_sf of each frame that occurs."""
    _check_finite(positions, "position of pose")
    _check_finite(quaternions, "orientation of pose")
    norms = np.linalg.norm(quaternions, axis=1)
    _refuse_first(
        np.abs(norms - 1.0) > se3.ROTATION_TOLERANCE,
        "orientation of pose {} is no unit quaternion; accepted: norm 1 within " + f"{se3.ROTATION_TOLERANCE:g}",
    )
    placed, turned = np.empty_like(positions), np.empty_like(quaternions)
    for frame, base in bases:
        here = np.array([name == frame for name in frame_ids])
        placed[here] = positions[here] @ base[:3, :3].T + base[:3, 3]
        turned[here] = (quaternions[here] / norms[here, None]) @ _left_product(from_matrix(base)).T
    _refuse_first(np.abs(placed).max(axis=1) > FARTHEST_M, "pose {} is more than " + f"{FARTHEST_M:g} m away")
    return placed, tuple(normalised((w, x, y, z)) for w, x, y, z in turned.tolist())


def _left_product(a: Quaternion) -> Array:
    """The matrix (4, 4) that turns b as x y z w into the product a b as w x y z."""
    w, x, y, z = a
    return np.array([[-x, -y, -z, w], [w, -z, y, x], [z, w, -x, y], [-y, x, w, z]])


def _times(times_ns: list[int]) -> Array:
    for index, (before, after) in enumerate(pairwise(times_ns), start=1):
        if after <= before:
            raise TargetRefused(f"pose {index} is not later than pose {index - 1}, by {(before - after) / NS:g} s")
    return np.array(times_ns) / NS


def _begin(name: str, first_ns: int, last_ns: int, now: Instant) -> tuple[int | None, str]:
    """When a path with these first and last stamps (ROS time) begins on the monotonic clock, and what to remark."""
    if last_ns <= now.ros_ns:
        relative = first_ns < SHORT_AFTER_EPOCH_NS
        return None, "" if relative else f"stamps of {name} are in the past altogether; it began on arrival"
    ahead_s = (first_ns - now.ros_ns) / NS
    if ahead_s > MAX_AHEAD_S:
        raise TargetRefused(f"it begins in {ahead_s:.6g} s; at most {MAX_AHEAD_S:g} s are accepted")
    return now.monotonic_ns + first_ns - now.ros_ns, ""


def _check_speeds(times_s: Array, positions: Array, orientations: tuple[Quaternion, ...]) -> None:
    steps = np.diff(times_s)
    linear = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    angular = np.linalg.norm(relative_rotation_vectors(orientations), axis=1)
    before = "the stamps of pose {} and the one before it ask for more than "
    for fast, text in (
        (linear > FASTEST_M_S * steps, f"{FASTEST_M_S:g} m/s"),
        (angular > FASTEST_RAD_S * steps, f"{FASTEST_RAD_S:g} rad/s"),
    ):
        _refuse_first(np.append(False, fast), before + text)


def _check_finite(values: Array, what: str) -> None:
    _refuse_first(~np.isfinite(values).all(axis=1), what + " {} is not finite")


def _refuse_first(bad: ArrayLike, text: str) -> None:
    """TargetRefused with the number of the first pose that is ``bad`` put into ``text``."""
    found = np.flatnonzero(bad)
    if found.size:
        raise TargetRefused(text.format(int(found[0])))
