"""Path requests: received paths and trajectories, checked and transformed to {s}."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import IkNodeError, TargetRefused
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import FARTHEST_M, MAX_POSES, PathSample, TrajectorySample
from ik_node.math import se3
from ik_node.math.quaternion import Quaternion, from_matrix, to_matrix
from ik_node.math.so3 import relative_rotation_vectors
from ik_node.math.types import Array
from ik_node.settings.groups import PathSettings
from ik_node.targets.members import WHOLE_POSE, TaskMembers
from ik_node.targets.path.se3_spline import Knots
from ik_node.targets.path.spline_fit import estimated_accelerations
from ik_node.targets.path.time_parametrisation import nominal_knots

FramePose = Callable[[str], Array]
"""Function from the name of a frame {f} to T_sf (4, 4); raises IkNodeError with the known names."""

MAX_AHEAD_S = 60.0
"""Paths that begin later than this from now are refused."""
HARDEST = 1000.0
"""Larger accelerations of a trajectory, m/s2 and rad/s2, are refused as errors."""
FASTEST_M_S, FASTEST_RAD_S = 10.0, 30.0
"""Faster targets are refused as errors. A target within this that the arm cannot follow slows the path down."""
SHORT_AFTER_EPOCH_NS = 365 * 86_400 * NS
"""Stamps before this are times from the start of the path, not dates."""


class PathRequest(NamedTuple):
    """A checked path of N poses in {s}."""

    times_s: Array
    """(N,), increasing from 0; from :func:`nominal_knots` if the poses have no time stamps."""
    positions: Array
    """(N, 3), m."""
    orientations: tuple[Quaternion, ...]
    """N times R_sd, (w, x, y, z)."""
    knots: Knots | None
    """Knots with velocities and accelerations, if these were received; None if they are to be fitted."""
    begin_ns: int | None
    """Start on the monotonic clock; None: as soon as the arm has arrived at the first pose."""
    warning: str
    """Warning for the user; empty for none."""
    timed: bool = True
    """True if the poses have time stamps."""


def request_from_path(
    sample: PathSample, frame_pose: FramePose, now: Instant, settings: PathSettings, members: TaskMembers = WHOLE_POSE
) -> PathRequest:
    """Checks a nav_msgs/Path.

    The time of each pose is its own stamp; the stamp of the path is ignored. Equal stamps: a path without times.

    Args:
        sample: The path.
        frame_pose: Function from the name of a frame to its pose T_sf.
        now: Time of arrival.
        settings: Speed along a path without times.
        members: Replaces the poses by members of their families.

    Returns:
        The request.

    Raises:
        TargetRefused: The path is invalid; the message states the number of the pose, from 0.
    """
    count = len(sample.stamps_ns)
    _check_count(count)
    stamps = sample.stamps_ns
    bases = [(frame, _placed(frame_pose, frame, sample.frame_ids)) for frame in dict.fromkeys(sample.frame_ids)]
    positions, orientations = members.path(*_in_base(sample.positions, sample.quaternions, sample.frame_ids, bases))
    if len(set(stamps)) == 1:
        knots = nominal_knots(positions, orientations, settings)
        return PathRequest(knots.times_s, knots.positions, knots.orientations, knots, None, "", False)
    times_s = _times([stamp - stamps[0] for stamp in stamps])
    _check_speeds(times_s, positions, orientations)
    begin_ns, warning = _begin("target_path", stamps[0], stamps[-1], now)
    return PathRequest(times_s, positions, orientations, None, begin_ns, warning)


def request_from_trajectory(
    sample: TrajectorySample, frame_pose: FramePose, now: Instant, members: TaskMembers = WHOLE_POSE
) -> PathRequest:
    """Checks a trajectory_msgs/MultiDOFJointTrajectory.

    Twists and accelerations are those of the tool point in the axes of the frame of the header: ROS defines only
    "velocity specified for the origin of the joint", and a TwistStamped is expressed in the frame of its header.

    Args:
        sample: The trajectory.
        frame_pose: Function from the name of a frame to its pose T_sf.
        now: Time of arrival.
        members: Replaces the poses by members of their families.

    Returns:
        The request.

    Raises:
        TargetRefused: The trajectory is invalid; the message states the number of the point, from 0.
    """
    count = len(sample.times_ns)
    _check_count(count)
    base = _placed(frame_pose, sample.frame_id, (sample.frame_id,))
    frames = (sample.frame_id,) * count
    poses = _in_base(sample.positions, sample.quaternions, frames, [(sample.frame_id, base)])
    positions, orientations = members.path(*poses)
    times_s = _times([time - sample.times_ns[0] for time in sample.times_ns])
    _check_speeds(times_s, positions, orientations)
    first, last = sample.stamp_ns + sample.times_ns[0], sample.stamp_ns + sample.times_ns[-1]
    begin_ns: int | None = now.monotonic_ns + sample.times_ns[0]
    warning = ""
    if sample.stamp_ns != 0:
        begin_ns, warning = _begin("target_trajectory", first, last, now)
    knots = _knots(sample, base, times_s, poses, members)
    return PathRequest(times_s, positions, orientations, knots, begin_ns, warning)


def _knots(
    sample: TrajectorySample,
    base: Array,
    times_s: Array,
    poses: tuple[Array, tuple[Quaternion, ...]],
    members: TaskMembers,
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
    too_hard = (np.abs(sample.accelerations) > HARDEST).any(axis=1)
    _refuse_first(too_hard, "pose {} has an acceleration above " + f"{HARDEST:g} m/s2 or rad/s2")
    rotation = base[:3, :3]
    own = _rotations(poses[1])

    def halves(values: Array) -> tuple[Array, Array]:
        """Linear part in {s}, angular part in the frame of the knot."""
        return values[:, :3] @ rotation.T, np.einsum("nji,nj->ni", own, values[:, 3:] @ rotation.T)

    velocities, rates = halves(sample.twists)
    zeros = np.zeros_like(velocities)
    chosen = members.path(*poses)
    twists = members.path_twists(poses, chosen, velocities, rates)
    if twists is not None:
        return estimated_accelerations(Knots(times_s, *chosen, *twists, zeros, zeros))
    knots = Knots(times_s, *poses, velocities, rates, zeros, zeros)
    if not len(sample.accelerations):
        return estimated_accelerations(knots)
    accelerations, angular = halves(sample.accelerations)
    return knots._replace(accelerations=accelerations, angular_accelerations=angular)


def _rotations(orientations: tuple[Quaternion, ...]) -> Array:
    """Rotation matrices, (N, 3, 3)."""
    w, x, y, z = np.array(orientations).T
    norms = np.sqrt(x * x + y * y + z * z + w * w)
    return np.moveaxis(np.array(to_matrix((w / norms, x / norms, y / norms, z / norms))), -1, 0)


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
    """Checks poses and transforms them to {s}; ``bases`` holds T_sf of each frame."""
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
    _refuse_first(~(np.abs(placed).max(axis=1) <= FARTHEST_M), "pose {} is more than " + f"{FARTHEST_M:g} m away")
    w, x, y, z = turned.T
    turned = turned * (1.0 / np.sqrt(w * w + x * x + y * y + z * z))[:, None]
    return placed, tuple(map(tuple, turned.tolist()))


def _left_product(a: Quaternion) -> Array:
    """The matrix (4, 4) that maps b as x y z w to the product a b as w x y z."""
    w, x, y, z = a
    return np.array([[-x, -y, -z, w], [w, -z, y, x], [z, w, -x, y], [-y, x, w, z]])


def _times(times_ns: list[int]) -> Array:
    for index, (before, after) in enumerate(pairwise(times_ns), start=1):
        if after <= before:
            raise TargetRefused(f"pose {index} is not later than pose {index - 1}, by {(before - after) / NS:g} s")
    return np.array(times_ns) / NS


def _begin(name: str, first_ns: int, last_ns: int, now: Instant) -> tuple[int | None, str]:
    """Start on the monotonic clock of a path with these first and last stamps (ROS time), and a warning."""
    if last_ns <= now.ros_ns:
        relative = first_ns < SHORT_AFTER_EPOCH_NS
        return None, "" if relative else f"all stamps of {name} are in the past; it begins on arrival"
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
    """Raises TargetRefused with the number of the first ``bad`` pose inserted into ``text``."""
    found = np.flatnonzero(bad)
    if found.size:
        raise TargetRefused(text.format(int(found[0])))
