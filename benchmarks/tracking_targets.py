"""Targets and arm of ``ik_benchmark tracking``.

Circle, figure of eight and a path through waypoints are known as a whole: the node receives each as one message, the
baselines receive the current pose at every control step. Generated streams are moved into the workspace of the arm.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from benchmarks.stream_data import Stream
from ik_node import resources
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Trajectory
from ik_node.interfaces.samples import PathSample, TrajectorySample
from ik_node.math import se3
from ik_node.math.quaternion import from_matrix
from ik_node.math.types import Array
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import read_settings
from ik_node.targets.path.se3_spline import RigidSpline
from ik_node.targets.path.spline_fit import through_poses
from ik_node.trajectory import shapes

KNOTS_HZ = 50.0
"""Points of a trajectory message per second: quintics between them are within 1e-12 m of these shapes."""
DIFFERENCE_S = 2e-3
"""Step of the finite differences of fourth order that give twists."""
DIAMETER_M, SPEED_M_S = 0.24, 0.15
"""Diameter and speed on the circle."""


READY = np.array((0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398))
"""Usual posture of the arm, rad."""
STREAMS_AT_M = (0.45, 0.0, 0.4)
"""Start of streams without a position: about the middle of the workspace."""


def panda(rate_hz: float) -> tuple[Robot, Settings]:
    """Return the arm and its settings for control at ``rate_hz``."""
    settings = read_settings(resources.config_file("panda.yaml")).with_values({"rate_hz": rate_hz})
    return robot_from_settings(settings.arm), settings


def start_of_streams(robot: Robot) -> Array:
    """Return the start of streams without a position, (4, 4)."""
    pose = robot.pose(READY)
    pose[:3, 3] = STREAMS_AT_M
    return pose


class KnownTarget(NamedTuple):
    """A target that is known as a whole before the motion."""

    name: str
    truth: Trajectory
    message: PathSample | TrajectorySample
    """Stamps count from time 0."""

    def stream(self, rate_hz: float) -> Stream:
        """Return its pose at every control step."""
        times = np.arange(int(self.truth.duration_s * rate_hz) + 1) / rate_hz
        return Stream(self.name, times, np.array([self.truth.pose(time) for time in times.tolist()]), self.truth)


def known(robot: Robot, start_pose: Array) -> tuple[KnownTarget, ...]:
    """Return all known targets, from rest at ``start_pose`` (4, 4)."""
    circle = shapes.circle(start_pose, DIAMETER_M, period_s=pi * DIAMETER_M / SPEED_M_S, ramp_s=1.0)
    eight = shapes.figure_of_eight(start_pose, period_s=6.0, ramp_s=1.0)
    times, poses = waypoints(start_pose)
    return (
        KnownTarget("circle", circle, trajectory_message(circle, robot.base_frame)),
        KnownTarget("figure of eight", eight, trajectory_message(eight, robot.base_frame)),
        KnownTarget("waypoints", Through(times, poses), path_message(times, poses, robot.base_frame)),
    )


def trajectory_message(motion: Trajectory, frame: str) -> TrajectorySample:
    """Return a trajectory message with poses, twists and accelerations of ``motion``."""
    count = int(np.ceil(motion.duration_s * KNOTS_HZ))
    times = np.linspace(0.0, motion.duration_s, count + 1)
    poses = np.array([motion.pose(time) for time in times.tolist()])
    rates = np.array([_derivatives(motion, time) for time in times.tolist()])
    return TrajectorySample(
        0,
        frame,
        tuple(np.round(times * NS).astype(np.int64).tolist()),
        poses[:, :3, 3],
        np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
        rates[:, 0],
        rates[:, 1],
    )


def _derivatives(motion: Trajectory, time_s: float) -> tuple[Array, Array]:
    """Return the twist and its derivative, (6,) each, in {s}."""
    here = motion.pose(time_s)
    steps = []
    for offset in (-2, -1, 1, 2):
        there = motion.pose(time_s + offset * DIFFERENCE_S)
        turn = here[:3, :3] @ se3.log_rotation(here[:3, :3].T @ there[:3, :3])
        steps.append(np.concatenate((there[:3, 3] - here[:3, 3], turn)))
    a, b, c, d = steps
    first = (a - 8.0 * b + 8.0 * c - d) / (12.0 * DIFFERENCE_S)
    # at the base point, the second derivative of the rotation vector is the angular acceleration
    second = (-a + 16.0 * b + 16.0 * c - d) / (12.0 * DIFFERENCE_S**2)
    return first, second


class Through:
    """The C2 spline through timed poses of :mod:`ik_node.targets.path.follower`, from rest to rest."""

    def __init__(self, times_s: Array, poses: Array) -> None:
        """``times_s`` (N,) from 0; ``poses`` (N, 4, 4)."""
        orientations = tuple(from_matrix(pose) for pose in poses)
        self._spline = RigidSpline(through_poses(times_s, poses[:, :3, 3], orientations, False))
        self.duration_s = float(times_s[-1])

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        position, (w, x, y, z) = self._spline.pose(time_s)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = se3.rotation_from_quaternion((x, y, z, w)), position
        return pose


def path_message(times_s: Array, poses: Array, frame: str) -> PathSample:
    """Return the path message of these poses."""
    return PathSample(
        (frame,) * len(poses),
        tuple(np.round(times_s * NS).astype(np.int64).tolist()),
        poses[:, :3, 3],
        np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
    )


WAYPOINTS = (
    (0.0, 0.00, 0.00, 0.00, 0.0, 0.0, 0.0),
    (1.5, 0.05, 0.12, 0.05, 0.2, 0.0, 0.3),
    (2.5, 0.08, 0.15, -0.10, 0.0, 0.3, 0.4),
    (4.0, 0.00, 0.02, -0.18, -0.3, 0.2, 0.0),
    (5.2, -0.06, -0.12, -0.06, -0.2, -0.2, -0.3),
    (6.2, -0.03, -0.14, 0.06, 0.1, -0.2, -0.3),
    (8.0, 0.00, 0.00, 0.00, 0.0, 0.0, 0.0),
)
"""s, m along the axes of {s} and rad about those of the start pose."""


def waypoints(start_pose: Array) -> tuple[Array, Array]:
    """Return times (N,) and poses (N, 4, 4)."""
    table = np.array(WAYPOINTS)
    poses = np.repeat(start_pose[None], len(table), axis=0)
    for pose, row in zip(poses, table, strict=True):
        pose[:3, 3] += row[1:4]
        pose[:3, :3] = pose[:3, :3] @ se3.exp_rotation(row[4:])
    return table[:, 0], poses


class Placed:
    """A motion about the origin, moved to a pose."""

    def __init__(self, start_pose: Array, motion: Trajectory) -> None:
        """``motion`` is moved so that it starts at ``start_pose`` (4, 4)."""
        begin = motion.pose(0.0)
        self._motion, self._start, self._first = motion, start_pose, begin
        self.duration_s = motion.duration_s

    def pose(self, time_s: float) -> Array:
        """T_sd, (4, 4)."""
        moved = self._motion.pose(time_s)
        pose: Array = self._start.copy()
        pose[:3, 3] += moved[:3, 3] - self._first[:3, 3]
        pose[:3, :3] = self._start[:3, :3] @ (self._first[:3, :3].T @ moved[:3, :3])
        return pose


def laid_at(start_pose: Array, stream: Stream) -> Stream:
    """Return ``stream`` with truth and samples moved so that the truth starts at ``start_pose``; noise is kept."""
    truth = Placed(start_pose, stream.truth)
    return Stream(stream.name, stream.times_s, np.array([truth.pose(t) for t in stream.times_s.tolist()]), truth)
