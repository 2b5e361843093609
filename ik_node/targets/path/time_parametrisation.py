"""Times for a path without time stamps: as fast as the bounds allow, from rest to rest.

The path T(z) is the spline of least bending, where z is the time that the way from pose to pose takes at
``path.speed``. For z(t), every bounded quantity y of the path (the position of the tool, its orientation, each joint)
requires ::

    |y' z'| <= speed ,    |y''| z'^2 <= c a ,    |y'| |z''| <= a - |y''| z'^2 ,    c = 0.7

where the last condition is evaluated at the largest z' that the others allow. So the bounds on z'^2 and z'' are numbers
at each point, and at most a fraction c of the acceleration bound a is used for bending. A backward and a forward pass
along the path give the largest z' (the two passes of Pham and Pham, "A new approach to time-optimal path
parameterization based on reachability analysis", IEEE T-RO 34, 2018, on boxes instead of polygons). Finally z(t) is
averaged over ``WINDOW_S``: acceleration becomes continuous, and each bound still holds, since it was the minimum over
all points that the average can reach.

Why not the library toppra (0.6.10): its work, 8 ms for 200 points, cannot be spread over control steps; the smoothed
result of a trial exceeded the acceleration bound of the joints by 10 %; it takes a second to import. In the one trial,
where the bounds of the joints were active, its time was shorter by a quarter (3.5 s instead of 4.6 s).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError, TargetRefused
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.math.quaternion import Quaternion
from ik_node.math.se3 import inverse, log
from ik_node.math.so3 import relative_rotation_vectors
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import PathSettings, Settings
from ik_node.targets.bounds import PATH_ACCELERATION_FRACTION
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.path.se3_spline import Knots, RigidSpline
from ik_node.targets.path.spline_fit import REPEATED, through_poses
from ik_node.targets.path.time_scaling import TimeScalingTable

PER_INTERVAL, MOST_POINTS = 6, 1500
"""Points per interval at which bounds are evaluated, and their largest total number; each pose is one of them."""
BENDING_SHARE = 0.7
"""c: fraction of the acceleration bounds for bending."""
WINDOW_S = 0.1
"""Time over which z(t) is averaged."""
FASTEST = 3.0
"""Largest z': the largest multiple of the nominal speed."""
JOINT_POINTS = 200
"""Approximate number of points at which joint bounds are evaluated."""
JOINT_SHARE = 0.8
"""Fraction of the joint limits that a path may use; the rest is for feedback."""
POINTS_PER_TICK = 3
"""Number of these points per control step."""
DAMPING = 1e-6
"""Damping of the inverse kinematics along the path [m2], for finite results at singularities."""
CORRECTIONS = 2
"""Newton steps from one point to the next."""


class PathBounds(NamedTuple):
    """Bounds on z' and z'' at points of a path."""

    places: Array
    """(M,): z."""
    squared_rate: Array
    """(M,): largest z'^2."""
    change: Array
    """(M,): largest |z''|."""


class JointSearch(NamedTuple):
    """Joint positions along a path, as far as they have been computed; plain data."""

    places: tuple[float, ...]
    start: tuple[float, ...]
    """Joint positions at the begin of the search, rad (m)."""
    positions: tuple[tuple[float, ...], ...]


def nominal_knots(positions: Array, orientations: tuple[Quaternion, ...], settings: PathSettings) -> Knots:
    """Fits the spline of least bending over z through the poses, without repeated poses.

    Args:
        positions: Positions (N, 3) [m].
        orientations: N unit quaternions (w, x, y, z).
        settings: ``speed`` defines z.

    Returns:
        The knots over z.

    Raises:
        TargetRefused: All poses are equal.
    """
    linear = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    angular = np.linalg.norm(relative_rotation_vectors(orientations), axis=1)
    kept = [0, *(np.flatnonzero((linear > REPEATED) | (angular > REPEATED)) + 1).tolist()]
    if len(kept) < 2:
        raise TargetRefused("a path without time stamps whose poses are all the same")
    remaining = tuple(orientations[index] for index in kept)
    lengths = np.linalg.norm(np.diff(positions[kept], axis=0), axis=1)
    angles = np.linalg.norm(relative_rotation_vectors(remaining), axis=1)
    steps = np.maximum(lengths / settings.speed[0], angles / settings.speed[1])
    places = np.concatenate(([0.0], np.cumsum(steps)))
    return through_poses(places, positions[kept], remaining, moving_start=True, moving_end=True)


def tool_bounds(spline: RigidSpline, settings: Settings) -> PathBounds:
    """Bounds from the speed and the acceleration of the tool."""
    per_interval = min(max(MOST_POINTS // len(spline.knots.times_s), 1), PER_INTERVAL)
    places, first, second = spline.derivatives(per_interval)
    speeds = np.array(settings.path.speed)
    accelerations = np.array(PATH_ACCELERATION_FRACTION) * settings.target.max_acceleration
    slopes = np.linalg.norm(first.reshape(-1, 2, 3), axis=2)
    bends = np.linalg.norm(second.reshape(-1, 2, 3), axis=2)
    return _bounds(places, slopes, bends, speeds, accelerations)


def _bounds(places: Array, slopes: Array, bends: Array, speeds: Array, accelerations: Array) -> PathBounds:
    """Bounds from |y'| and |y''|, which are ``slopes`` and ``bends`` (M, k)."""
    with np.errstate(divide="ignore"):
        squared = np.minimum((speeds / slopes) ** 2, BENDING_SHARE * accelerations / bends).min(axis=1)
        squared = np.minimum(squared, FASTEST**2)
        change = ((accelerations - bends * squared[:, None]) / slopes).min(axis=1)
    return PathBounds(places, squared, np.minimum(change, 1e6))


def compute_time_scaling(bounds: PathBounds) -> TimeScalingTable:
    """The fastest time scaling within ``bounds``, averaged over ``WINDOW_S``."""
    places = bounds.places
    reach = WINDOW_S * float(bounds.squared_rate.max()) ** 0.5
    squared, change = (_least_within(places, values, reach) for values in bounds[1:])
    steps = np.diff(places).tolist()
    gains = (2.0 * np.diff(places) * np.minimum(change[:-1], change[1:])).tolist()
    highest: list[float] = squared.tolist()
    highest[0] = highest[-1] = 0.0
    for index in range(len(steps) - 1, -1, -1):
        highest[index] = min(highest[index], highest[index + 1] + gains[index])
    for index, gain in enumerate(gains):
        highest[index + 1] = min(highest[index + 1], highest[index] + gain)
    rates = np.sqrt(highest)
    durations = 2.0 * np.array(steps) / (rates[:-1] + rates[1:])
    return TimeScalingTable(np.concatenate(([0.0], np.cumsum(durations))), places, rates, WINDOW_S)


def _least_within(places: Array, values: Array, reach: float) -> Array:
    """At each place the smallest of the values up to ``reach`` away."""
    begins = np.maximum(np.searchsorted(places, places - reach) - 1, 0).tolist()
    ends = np.searchsorted(places, places + reach, side="right").tolist()
    return np.array([values[begin : end + 1].min() for begin, end in zip(begins, ends, strict=True)])


class PathTiming:
    """Computes time scalings; its state between control steps is passed by the caller."""

    def __init__(self, settings: Settings, robot: Robot | None) -> None:
        """``robot``: its joint limits are bounds too; None for those of the tool alone."""
        self._robot = robot
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Applies other settings."""
        self._settings = settings

    def begin(self, spline: RigidSpline, q: Array | None) -> JointSearch | None:
        """Begins the search for joint positions from q (n,); None if none is necessary."""
        return None if self._robot is None or q is None else begin_joint_search(spline, q)

    def advanced_search(self, spline: RigidSpline, search: JointSearch) -> JointSearch:
        """The search after the work of one control step."""
        if self._robot is None:
            raise InputError("a search for joint positions needs a robot")
        return advanced_search(search, spline, self._robot, self._settings.control.locked_joints)

    def time_scaling(self, spline: RigidSpline, search: JointSearch | None) -> TimeScalingTable:
        """The time scaling, after a completed search."""
        settings = self._settings
        bounds = tool_bounds(spline, settings)
        if search is not None and self._robot is not None:
            limits = motion_limits(self._robot, settings.limits, settings.control.rate_hz)
            bounds = both(bounds, joint_bounds(search, limits))
        return compute_time_scaling(bounds)


# --- joints ----------------------------------------------------------------------------------------------------------


def begin_joint_search(spline: RigidSpline, q: Array) -> JointSearch:
    """A search from the joint positions q (n,)."""
    count = min(JOINT_POINTS, 4 * len(spline.knots.times_s))
    places = np.linspace(spline.begin_s, spline.end_s, count)
    return JointSearch(tuple(places.tolist()), tuple(q.tolist()), ())


def advanced_search(
    search: JointSearch, spline: RigidSpline, robot: Robot, locked: tuple[str, ...] = ()
) -> JointSearch:
    """The search with the joint positions of a few more points, each computed from the previous one.

    Locked joints stay where the search began.
    """
    positions = search.positions
    if not positions:
        solver = PoseSolver(robot, locked=locked)
        start = solver.solve(_pose(spline, search.places[0]), np.array(search.start), restarts=0).q
        return search._replace(positions=(tuple(start.tolist()),))
    found = np.array(positions[-1])
    for place in search.places[len(positions) : len(positions) + POINTS_PER_TICK]:
        target_pose = _pose(spline, place)
        for _ in range(CORRECTIONS):
            kinematics = robot.evaluate(found)
            jacobian = np.where(np.isin(robot.joints, locked), 0.0, kinematics.jacobian_b) if locked else kinematics[1]
            error = log(inverse(kinematics.pose_sb) @ target_pose)
            found = found + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + DAMPING * np.eye(6), error)
        positions = (*positions, tuple(found.tolist()))
    return search._replace(positions=positions)


def _pose(spline: RigidSpline, place: float) -> Array:
    position, orientation = spline.pose(place)
    return pose_matrix(RigidMotion(position, orientation=orientation))


def is_done(search: JointSearch) -> bool:
    """True if the joint positions of all points are known."""
    return len(search.positions) == len(search.places)


def joint_bounds(search: JointSearch, limits: MotionLimits) -> PathBounds:
    """Bounds from the velocity and acceleration limits of the joints."""
    places, positions = np.array(search.places), np.array(search.positions)
    first = np.gradient(positions, places, axis=0, edge_order=2)
    second = np.gradient(first, places, axis=0, edge_order=2)
    velocity, acceleration = JOINT_SHARE * limits.velocity, JOINT_SHARE * limits.acceleration
    return _bounds(places, np.abs(first), np.abs(second), velocity, acceleration)


def both(tool: PathBounds, joints: PathBounds) -> PathBounds:
    """The tighter of both at the places of ``tool``; between two points of ``joints`` the tighter of these counts."""
    after = np.minimum(np.searchsorted(joints.places, tool.places), len(joints.places) - 1)
    before = np.maximum(after - 1, 0)
    squared, change = (np.minimum(values[before], values[after]) for values in joints[1:])
    return PathBounds(tool.places, np.minimum(tool.squared_rate, squared), np.minimum(tool.change, change))
