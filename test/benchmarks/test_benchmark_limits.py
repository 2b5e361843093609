"""Samples of `ik_benchmark limits` and `ik_benchmark obstacles`: their promises, on few ticks and scenes.

What they are made of is tested with the modules they measure; here the closed loops run, and the parts print.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import limit_stress, limits, obstacles, scenes
from benchmarks.reference_solvers import arm
from ik_node.collision import geometry as collision_geometry


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova"])
def test_hostile_targets_break_no_limit(name: str) -> None:
    """Jumps, poses out of reach, NaN, holds of 0.2 to 5 periods: nothing exceeded, nothing infeasible, and the
    limits were really met."""
    tally = limit_stress.drive(name, 2500, 3, 10.0)
    assert max(tally.position, tally.velocity, tally.acceleration) <= limit_stress.BROKEN
    assert tally.infeasible == 0
    assert tally.slowed > 100


def test_outside_and_under_lag() -> None:
    """From outside no further than braking needs; under lag the printed margin is enough."""
    assert limit_stress.outside()[1]
    bare = limit_stress.lagged(0.0, 1e-4, ticks=1500)
    assert 0.0 < bare < 0.1
    assert limit_stress.lagged(1.1 * bare, 1e-4, seed=2, ticks=1500) <= 0.0


def test_a_scene_is_driven_past_with_the_tool_on_its_path() -> None:
    """One of the seeded scenes: the elbow gives way by centimetres, the tool does not notice."""
    robot = arm("panda")
    found = scenes.pass_by(1015, robot, collision_geometry.load(robot, self_collision=False))
    assert found is not None
    assert found.gradient_m > found.plain_m + 0.03
    assert found.path_rms_m < 1e-4
    assert found.fastest < 1.0


def test_the_parts_print_their_figures(capsys: pytest.CaptureFixture[str]) -> None:
    """What a person calls; the exit code says whether all is within its bounds."""
    assert limits.main(["--only", "outside"]) == 0
    assert "unavoidable" in capsys.readouterr().out
    assert obstacles.main(["--only", "gradients", "--positions", "8"]) == 0
    printed = capsys.readouterr().out
    assert "panda" in printed
    assert "relative error" in printed
    assert np.isfinite([float(part) for part in printed.split() if part.replace(".", "").isdigit()]).all()
