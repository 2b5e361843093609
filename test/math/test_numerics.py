"""Smoothstep, low-discrepancy points, and the checks of input."""

from __future__ import annotations

import numpy as np
import pytest

from ik_node.errors import InputError
from ik_node.math.numerics import (
    check_count,
    check_not_negative,
    check_positive,
    checked_positive_vector,
    checked_vector,
    low_discrepancy_points,
    smoothstep,
    smoothstep_ratio,
)


def test_smoothstep_rises_smoothly_from_0_to_1() -> None:
    # phi(x) / x <= 9/8 with equality at 3/4.
    x = np.linspace(0.0, 2.0, 2001)
    phi = np.array([smoothstep(value) for value in x.tolist()])
    assert (np.diff(phi) >= 0.0).all()
    assert phi[0] == 0.0
    assert (phi[x >= 1.0] == 1.0).all()
    assert float(np.max(phi[1:] / x[1:])) <= 9.0 / 8.0
    assert abs(smoothstep(0.75) / 0.75 - 9.0 / 8.0) < 1e-15
    assert smoothstep(-1.0) == 0.0
    assert np.isnan(smoothstep(np.nan))
    assert [smoothstep_ratio(value) * value for value in (0.1, 0.5, 1.0)] == pytest.approx([0.028, 0.5, 1.0])


@pytest.mark.parametrize("dimensions", [1, 2, 6, 7])
def test_low_discrepancy_points_fill_the_cube_evenly(dimensions: int) -> None:
    points = low_discrepancy_points(np.arange(400), dimensions)
    assert points.shape == (400, dimensions)
    assert (points[0] == 0.5).all()
    assert (points[7] == low_discrepancy_points(7, dimensions)).all()
    counts = np.array([np.histogram(column, 10, (0.0, 1.0))[0] for column in points.T])
    assert (np.abs(counts - 40) <= 16).all()


def test_checks_name_the_argument() -> None:
    for call in (
        lambda: checked_vector([1.0, np.nan], 2, "name"),
        lambda: checked_vector([1.0], 2, "name"),
        lambda: checked_positive_vector(0.0, 2, "name"),
        lambda: check_positive(name=0.0),
        lambda: check_positive(name=np.inf),
        lambda: check_not_negative(name=-1.0),
        lambda: check_count(name=-1),
        lambda: check_count(1, name=0),
    ):
        with pytest.raises(InputError, match=r"^name (is|has) "):
            call()
    check_positive(name=1.0)
    check_not_negative(name=0.0)
    check_count(name=0)
    assert (checked_positive_vector(2.0, 2, "name") == 2.0).all()
