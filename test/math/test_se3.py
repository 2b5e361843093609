"""Rigid motions against references of 50 digits, and the checks of received poses.

Exact rotations built from rational quaternions give the precision of mpmath, so that no second implementation of the
same floating-point formula serves as reference.
"""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from ik_node.errors import InputError
from ik_node.math import se3
from ik_node.math.types import Array

GENERATOR = np.random.default_rng(5)
ANGLES = [1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 2.0, 3.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi - 1e-12]


def random_twist(angle: float) -> Array:
    axis = GENERATOR.normal(size=3)
    return np.concatenate((GENERATOR.normal(size=3), angle * axis / np.linalg.norm(axis)))


@pytest.mark.parametrize("angle", ANGLES)
def test_log_inverts_exp_from_rounding_to_half_a_turn(angle: float) -> None:
    for _ in range(20):
        twist = random_twist(angle)
        assert np.abs(se3.log(se3.exp(twist)) - twist).max() < 1e-12


def test_exp_inverts_log_at_exactly_half_a_turn() -> None:
    for diagonal in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        pose = np.eye(4)
        pose[:3, :3] = np.diag(diagonal)
        pose[:3, 3] = (0.1, 0.2, 0.3)
        assert np.abs(se3.exp(se3.log(pose)) - pose).max() < 1e-14


def test_exp_matches_its_power_series() -> None:
    for _ in range(20):
        twist = random_twist(0.3)
        v, w = twist[:3], twist[3:]
        generator = np.zeros((4, 4))
        generator[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
        generator[:3, 3] = v
        term, series = np.eye(4), np.eye(4)
        for k in range(1, 30):
            term = term @ generator / k
            series = series + term
        assert np.abs(se3.exp(twist) - series).max() < 1e-14


def test_adjoint_carries_a_twist_between_frames() -> None:
    """T exp(V) T^-1 = exp(Ad(T) V)."""
    for _ in range(20):
        pose, twist = se3.exp(random_twist(2.0)), random_twist(0.5)
        moved = pose @ se3.exp(twist) @ se3.inverse(pose)
        assert np.abs(se3.log(moved) - se3.adjoint(pose) @ twist).max() < 1e-13


def test_what_is_no_number_stays_none() -> None:
    """One NaN in a pose or twist results in NaN."""
    for row in range(3):
        for column in range(4):
            pose = se3.exp(random_twist(1.0))
            pose[row, column] = np.nan
            for result in (se3.log(pose), se3.inverse(pose), se3.adjoint(pose)):
                assert np.isnan(result).any()
    for entry in range(6):
        twist = random_twist(1.0)
        twist[entry] = np.nan
        assert np.isnan(se3.exp(twist)).any()


def test_poses_are_read_however_they_lie_in_memory_and_in_no_other_shape() -> None:
    pose = se3.exp(random_twist(1.0))
    for same in (np.asfortranarray(pose), np.repeat(pose, 2, axis=1)[:, ::2], pose.tolist()):
        assert np.array_equal(se3.log(same), se3.log(pose))
        assert np.array_equal(se3.adjoint(same), se3.adjoint(pose))
    for function in (se3.log, se3.inverse, se3.adjoint, se3.exp, se3.exp_rotation, se3.log_rotation):
        with pytest.raises(InputError, match="shape"):
            function(np.zeros((2, 2)))


def test_quaternions_give_exact_rotations() -> None:
    for x, y, z, w in ((1, 2, 3, 4), (-2, 1, 0, 5), (3, -1, -2, 1), (1, 0, 0, 0)):
        n = Fraction(x * x + y * y + z * z + w * w)
        exact = [
            [1 - 2 * (y * y + z * z) / n, 2 * (x * y - z * w) / n, 2 * (x * z + y * w) / n],
            [2 * (x * y + z * w) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - x * w) / n],
            [2 * (x * z - y * w) / n, 2 * (y * z + x * w) / n, 1 - 2 * (x * x + y * y) / n],
        ]
        unit = np.array([x, y, z, w]) / np.sqrt(float(n))
        rotation = se3.rotation_from_quaternion(unit)
        assert np.abs(rotation - np.array(exact, dtype=np.float64)).max() < 1e-15
        assert np.array_equal(rotation, se3.rotation_from_quaternion(-unit)), "q and -q are the same rotation"
        back = se3.quaternion_from_rotation(rotation)
        assert min(np.abs(back - unit).max(), np.abs(back + unit).max()) < 1e-15
        assert back[3] >= 0.0


@pytest.mark.parametrize("norm", [0.9991, 1.0009])
def test_a_quaternion_within_a_thousandth_of_unit_norm_is_put_right(norm: float) -> None:
    rotation = se3.rotation_from_quaternion(norm * np.array([0.5, 0.5, 0.5, 0.5]))
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-15


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, 1.002), (0, 0, 0, 0.998), (np.nan, 0, 0, 1), (0, 0, 1)])
def test_other_quaternions_are_refused(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="orientation quaternion"):
        se3.rotation_from_quaternion(quaternion)


def test_a_matrix_near_a_rotation_is_projected_onto_the_nearest_one() -> None:
    pose = se3.exp(random_twist(1.0))
    near = pose.copy()
    near[:3, :3] += GENERATOR.uniform(-3e-4, 3e-4, (3, 3))
    fixed = se3.checked_pose(near)
    assert np.abs(fixed[:3, :3] @ fixed[:3, :3].T - np.eye(3)).max() < 4e-15
    assert np.linalg.norm(fixed[:3, :3] - near[:3, :3]) <= np.linalg.norm((pose - near)[:3, :3])


def bad_poses() -> list[tuple[Array, str]]:
    scaled, mirrored, nan, row = np.eye(4), np.eye(4), np.eye(4), np.eye(4)
    scaled[0, 0] = 1.01
    mirrored[2, 2] = -1.0
    nan[1, 3] = np.nan
    row[3, 0] = 0.1
    return [
        (scaled, "away from a rotation"),
        (mirrored, "away from a rotation"),
        (nan, "not finite"),
        (row, "last row"),
        (np.eye(3), r"shape \(3, 3\)"),
    ]


@pytest.mark.parametrize(("pose", "words"), bad_poses())
def test_other_matrices_are_refused(pose: Array, words: str) -> None:
    with pytest.raises(InputError, match=f"target.*{words}"):
        se3.checked_pose(pose, "target")


def test_the_order_of_halves_is_said_in_one_place() -> None:
    assert se3.angular_first(np.arange(6)).tolist() == [3, 4, 5, 0, 1, 2]
    jacobian = GENERATOR.normal(size=(6, 7))
    assert np.array_equal(se3.angular_first(se3.angular_first(jacobian)), jacobian)


def test_quaternions_of_a_long_run_do_not_fill_the_memory() -> None:
    """The binding once leaked a copy of its argument at every call: 10 MB per minute of a node at 1 kHz."""
    rotation = se3.exp_rotation(np.array([0.1, 0.2, 0.3]))

    def resident_bytes() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    for count in (5_000, 50_000):
        before = resident_bytes()
        for _ in range(count):
            se3.quaternion_from_rotation(rotation)
    assert resident_bytes() - before < 1_000_000
