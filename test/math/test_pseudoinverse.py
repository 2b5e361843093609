"""The pseudoinverse is checked against its definition (the four Penrose conditions), against exact rational inverses,
against 50-digit references where the printed formula loses its digits, and on every kind of rank."""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
from support import shared_path

from ik_node.errors import InputError
from ik_node.math.pseudoinverse import decompose, pseudoinverse
from ik_node.math.types import Array

SHAPES = [(6, 7), (6, 6), (6, 3), (3, 7), (2, 3), (1, 1), (1, 5), (5, 1)]


def random_matrix(seed: int, m: int, n: int, sigma_min: float = 0.1) -> Array:
    rng = np.random.default_rng(seed)
    size = min(m, n)
    u, v = np.linalg.qr(rng.normal(size=(m, m)))[0], np.linalg.qr(rng.normal(size=(n, n)))[0]
    return np.asarray(u[:, :size] * np.geomspace(2.0, sigma_min if size > 1 else 2.0, size) @ v[:, :size].T)


@pytest.mark.parametrize("shape", SHAPES)
def test_penrose_conditions_at_full_rank(shape: tuple[int, int]) -> None:
    # The four conditions define the pseudoinverse uniquely.
    for seed in range(20):
        j = random_matrix(seed, *shape)
        p = pseudoinverse(j).matrix
        np.testing.assert_allclose(j @ p @ j, j, atol=1e-13)
        np.testing.assert_allclose(p @ j @ p, p, atol=1e-12)
        np.testing.assert_allclose(j @ p, (j @ p).T, atol=1e-13)
        np.testing.assert_allclose(p @ j, (p @ j).T, atol=1e-13)


def test_kind_follows_shape_and_rank() -> None:
    # Square by LU, fat by the right inverse, tall by the left one; the result states the formula and the rank.
    assert pseudoinverse(random_matrix(1, 6, 6)).kind == "square"
    assert pseudoinverse(random_matrix(1, 6, 7)).kind == "right inverse"
    assert pseudoinverse(random_matrix(1, 6, 3)).kind == "left inverse"
    deficient = random_matrix(1, 6, 2) @ random_matrix(2, 2, 7)
    assert pseudoinverse(deficient)[1:2] + pseudoinverse(deficient)[4:] == (2, "truncated")
    assert pseudoinverse(deficient, damping=0.1)[1:2] + pseudoinverse(deficient, damping=0.1)[4:] == (2, "damped")


def test_notes_formulas_at_full_rank() -> None:
    # J'(JJ')^-1 and (J'J)^-1 J' of the notes, in exact rational arithmetic; the printed (JJ')^-1 J' of the tall case
    # does not have conformable factors.
    fat = [[1, 2, 0], [0, 1, -1]]
    exact = mpmath.matrix([[1, 0], [2, 1], [0, -1]]) * mpmath.matrix([[5, 2], [2, 2]]) ** -1
    expected = [[float(exact[i, k]) for k in range(2)] for i in range(3)]
    np.testing.assert_allclose(pseudoinverse(fat).matrix, expected, atol=1e-15)
    np.testing.assert_allclose(pseudoinverse(np.transpose(fat)).matrix, np.transpose(expected), atol=1e-15)
    square = [[2, 1], [1, 1]]
    np.testing.assert_allclose(pseudoinverse(square).matrix, [[1, -1], [-1, 2]], atol=1e-15)


@pytest.mark.parametrize("shape", [(6, 7), (6, 6), (6, 3), (3, 7)])
def test_keeps_digits_that_the_normal_equations_lose(shape: tuple[int, int]) -> None:
    # J^+ z against 60 digits at a smallest singular value of 1e-7: an error of cond, where J'(JJ')^-1 has cond^2.
    j = random_matrix(5, *shape, sigma_min=1e-7)
    with mpmath.workdps(60):
        exact = mpmath.matrix(j.tolist())
        fat = shape[0] <= shape[1]
        inverse = exact.T * (exact * exact.T) ** -1 if fat else (exact.T * exact) ** -1 * exact.T
        reference = np.array(inverse.tolist(), dtype=np.float64)
    scale = float(np.abs(reference).max())
    error = float(np.abs(pseudoinverse(j).matrix - reference).max()) / scale
    printed = j.T @ np.linalg.inv(j @ j.T) if fat else np.linalg.inv(j.T @ j) @ j.T
    assert error < 1e-7
    assert error < 1e-2 * float(np.abs(printed - reference).max()) / scale


def test_rank_deficient_truncated() -> None:
    # A product of rank 2: the Penrose conditions hold at the reported rank, and the result stays bounded.
    j = random_matrix(3, 6, 2) @ random_matrix(4, 2, 7)
    result = pseudoinverse(j)
    assert result.rank == 2
    np.testing.assert_allclose(j @ result.matrix @ j, j, atol=1e-13)
    np.testing.assert_allclose(result.matrix, np.linalg.pinv(j, rcond=1e-10), atol=1e-12)


def test_caller_chooses_the_cutoff() -> None:
    # The same matrix has rank 6 with a cutoff of rounding, and rank 4 with a cutoff for its noise.
    j = random_matrix(6, 6, 7, sigma_min=1e-6)
    assert pseudoinverse(j).rank == 6
    coarse = pseudoinverse(j, rcond=1e-5)
    assert coarse.rank == 4
    assert np.linalg.norm(coarse.matrix, 2) < 1e4
    assert np.linalg.norm(pseudoinverse(j).matrix, 2) > 1e5


def test_damped_minimises_its_own_cost() -> None:
    # |z - J y|^2 + damping^2 |y|^2 has its gradient zero at y = J^+ z, at any rank and shape.
    for shape in SHAPES:
        j = random_matrix(7, *shape)
        z = np.arange(1.0, shape[0] + 1)
        y = pseudoinverse(j, damping=0.3).matrix @ z
        np.testing.assert_allclose(j.T @ (j @ y - z) + 0.09 * y, 0.0, atol=1e-13)


def test_zero_matrix() -> None:
    # The pseudoinverse of zero is zero.
    assert pseudoinverse(np.zeros((6, 7))).rank == 0
    np.testing.assert_array_equal(pseudoinverse(np.zeros((6, 7))).matrix, np.zeros((7, 6)))
    np.testing.assert_array_equal(pseudoinverse(np.zeros((2, 3)), damping=0.1).matrix, np.zeros((3, 2)))


def test_exact_inverse_of_hilbert_like_matrix() -> None:
    # LU against the exact rational inverse of the 4x4 Hilbert matrix (integers), relative to its condition.
    hilbert = np.array([[float(Fraction(1, i + k + 1)) for k in range(4)] for i in range(4)])
    exact = [
        [16, -120, 240, -140],
        [-120, 1200, -2700, 1680],
        [240, -2700, 6480, -4200],
        [-140, 1680, -4200, 2800],
    ]
    np.testing.assert_allclose(pseudoinverse(hilbert).matrix, exact, rtol=1e-11)


def _bad() -> list[tuple[str, dict[str, Any]]]:
    eye = np.eye(3)
    return [
        ("matrix", {"matrix": [[1.0, np.nan]]}),
        ("matrix", {"matrix": [[np.inf]]}),
        ("matrix", {"matrix": [1.0, 2.0]}),
        ("matrix", {"matrix": np.zeros((0, 3))}),
        ("damping", {"matrix": eye, "damping": -1.0}),
        ("damping", {"matrix": eye, "damping": float("nan")}),
        ("rcond", {"matrix": eye, "rcond": -1e-3}),
    ]


@pytest.mark.parametrize(("name", "arguments"), _bad())
def test_bad_input_is_named(name: str, arguments: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=name):
        pseudoinverse(**arguments)


def test_decompose_never_takes_nan_for_rank_zero() -> None:
    # Callers that skip the checks (the control loop) rely on this.
    with pytest.raises(InputError, match="jacobian"):
        decompose(np.full((6, 7), np.nan), "jacobian")


def test_shared_tall_cases() -> None:
    # Least squares references of 50 digits.
    cases = json.loads(shared_path("cases", "lsq_tall.json").read_text())["cases"]
    for case in cases:
        j, v = np.array(case["J"]), np.array(case["V"])
        y = pseudoinverse(j).matrix @ v
        reference = np.array(case["y_ref"])
        assert np.linalg.norm(y - reference) <= 1e-10 * np.linalg.norm(reference), case["name"]
        assert abs(np.linalg.norm(v - j @ y) - case["residual_norm"]) < 1e-14, case["name"]
