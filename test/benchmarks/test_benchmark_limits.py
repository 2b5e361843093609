"""Samples of `ik_benchmark limits` and `ik_benchmark obstacles`: their promises, on few ticks and scenes.

What they are made of is tested with the modules they measure; here the closed loops run, and the parts print.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmark_runs import benchmark

BROKEN = 1e-9
"""More than this beyond a limit is a broken limit."""


def assert_nothing_broken(*arguments: str) -> None:
    ran = benchmark("limits", "--only", "stress", "--json", *arguments)
    assert ran.code == 0
    for row in ran.rows():
        assert max(row["position"], row["velocity"], row["acceleration"]) <= BROKEN
        assert row["infeasible"] == 0
        assert row["slowed"] > row["ticks"] / 25, "the limits were really met"


def test_stress_targets_break_no_limit() -> None:
    """Jumps, poses out of reach, NaN, holds of 0.2 to 5 periods: nothing exceeded, nothing infeasible."""
    assert_nothing_broken("--robots", "panda", "ur5", "kinova", "--ticks", "13500", "--seed", "3")


@pytest.mark.exhaustive
def test_a_million_stress_ticks_break_no_limit() -> None:
    assert_nothing_broken()


def test_outside_and_under_lag() -> None:
    """From outside no further than braking needs; under lag the printed margin is enough."""
    ran = benchmark("limits", "--only", "outside", "lag", "--lag-ticks", "1500", "--json")
    assert ran.code == 0
    outside, *lags = ran.rows()
    assert outside["beyond_unavoidable"] < BROKEN
    assert [row["noise"] for row in lags] == [0.0, 1e-4, 1e-3]
    for row in lags:
        assert 0.0 < row["bare"] < 0.1
        assert row["rest"] <= 0.0


def test_a_scene_is_driven_past_with_the_tool_on_its_path() -> None:
    """One of the seeded scenes: the elbow gives way by centimetres, the tool does not notice."""
    ran = benchmark("obstacles", "--only", "scenes", "--scenes", "1", "--json")
    assert ran.code == 0
    (row,) = ran.rows()
    assert row["gradient_m"] > row["plain_m"] + 0.03
    assert row["path_rms_m"] < 1e-4
    assert row["fastest"] < 1.0


def test_the_parts_print_their_figures() -> None:
    """What a person reads; the exit code says whether all is within its bounds."""
    ran = benchmark("limits", "--only", "outside")
    assert ran.code == 0
    assert "unavoidable" in ran.out
    ran = benchmark("obstacles", "--only", "gradients", "--positions", "8")
    assert ran.code == 0
    assert "panda" in ran.out
    assert "relative error" in ran.out
    assert np.isfinite([float(part) for part in ran.out.split() if part.replace(".", "").isdigit()]).all()
