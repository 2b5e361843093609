"""Samples of `ik_benchmark limits` and `ik_benchmark obstacles` with few steps and scenes: figures are within their
bounds.

The modules that they measure have tests of their own; these tests run the closed loops and print the sections.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmark_runs import benchmark

BROKEN = 1e-9
"""An excess over a limit above this value counts as a violation."""


def assert_nothing_broken(*arguments: str) -> None:
    ran = benchmark("limits", "--only", "stress", "--json", *arguments)
    assert ran.code == 0
    for row in ran.rows():
        assert max(row["position"], row["velocity"], row["acceleration"]) <= BROKEN
        assert row["infeasible"] == 0
        assert row["slowed"] > row["ticks"] / 25, "the limits were active"


def test_stress_targets_break_no_limit() -> None:
    """Jumps, poses out of reach, NaN, holds of 0.2 to 5 periods: no limit is exceeded, no step is infeasible."""
    assert_nothing_broken("--robots", "panda", "ur5", "kinova", "--ticks", "13500", "--seed", "3")


@pytest.mark.exhaustive
def test_a_million_stress_ticks_break_no_limit() -> None:
    assert_nothing_broken()


def test_outside_and_under_lag() -> None:
    """From outside, the excess is no larger than braking requires; under lag, the printed margin is sufficient."""
    ran = benchmark("limits", "--only", "outside", "lag", "--lag-ticks", "1500", "--json")
    assert ran.code == 0
    outside, *lags = ran.rows()
    assert outside["beyond_unavoidable"] < BROKEN
    assert [row["noise"] for row in lags] == [0.0, 1e-4, 1e-3]
    for row in lags:
        assert 0.0 < row["bare"] < 0.1
        assert row["rest"] <= 0.0


def test_a_scene_is_driven_past_with_the_tool_on_its_path() -> None:
    """One seeded scene: the elbow moves aside by centimetres, the tool path does not change."""
    ran = benchmark("obstacles", "--only", "scenes", "--scenes", "1", "--json")
    assert ran.code == 0
    (row,) = ran.rows()
    assert row["gradient_m"] > row["plain_m"] + 0.03
    assert row["path_rms_m"] < 1e-4
    assert row["fastest"] < 1.0


def test_the_parts_print_their_figures() -> None:
    """The printed text; the exit code states whether all figures are within their bounds."""
    ran = benchmark("limits", "--only", "outside")
    assert ran.code == 0
    assert "unavoidable" in ran.out
    ran = benchmark("obstacles", "--only", "gradients", "--positions", "8")
    assert ran.code == 0
    assert "panda" in ran.out
    assert "relative error" in ran.out
    assert np.isfinite([float(part) for part in ran.out.split() if part.replace(".", "").isdigit()]).all()
