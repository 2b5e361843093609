"""`ik_benchmark ik` in small: its figures are honest, and the experiment of Haviland and Corke gives their own figures
where the method is not chaotic (the damped ones): same draws, same counts."""

from __future__ import annotations

import json

import pytest

from benchmarks import haviland_corke
from benchmarks.__main__ import main
from benchmarks.haviland_corke import levenberg_marquardt
from benchmarks.ik import METHODS, reach
from benchmarks.published import HAVILAND_CORKE, TRAC_IK
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot


@pytest.mark.parametrize("name", list(TRAC_IK))
def test_reach_solves_and_does_not_boast(name: str) -> None:
    result = reach(name, 300)
    assert result.solved_percent >= 99.9
    assert result.outside_limits == result.false_claims == 0
    assert result.max_iterations <= 3000


@pytest.mark.parametrize("refuse", [False, True])
def test_published_figures_come_out(refuse: bool) -> None:
    # Panda, 10,000 problems: mean and median iterations, infeasible, searches, limit violations, all as published.
    arm = catalogue.find("panda")
    robot = Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)
    table = next(table for table in HAVILAND_CORKE if table.robot == "panda" and table.refuse_outside is refuse)
    row = next(row for row in table.rows if row.method == "LM Chan 0.1")
    ours = haviland_corke.run(
        robot, levenberg_marquardt("Chan", 0.1), seed=10, problems=10_000, steps=30, searches=100, refuse_outside=refuse
    )
    assert round(ours.mean_iterations, 2) == row.mean_iterations
    assert ours.median_iterations == row.median_iterations
    assert round(ours.infeasible_percent, 2) == row.infeasible_percent
    assert round(ours.mean_searches, 2) == row.mean_searches
    assert ours.max_searches == row.max_searches
    assert round(ours.outside_percent, 2) == row.outside_percent


def test_every_published_method_is_implemented() -> None:
    assert {row.method for table in HAVILAND_CORKE for row in table.rows} <= set(METHODS)


def test_command(capsys: pytest.CaptureFixture[str]) -> None:
    # Table, document, list of parts, and messages.
    assert main(["ik", "--problems", "20", "--only", "reach", "--robots", "panda", "ur5"]) == 0
    assert "TRAC-IK" in capsys.readouterr().out
    assert main(["ik", "--problems", "12", "--draws", "1", "--robots", "kinova", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [entry["robot"] for entry in document["reach"]] == ["kinova"]
    assert len(document["haviland_corke"]) == len(HAVILAND_CORKE)
    assert main([]) == 0
    assert "random poses solved" in capsys.readouterr().out
    assert main(["ik", "--robots", "no_such"]) == 2
    assert "unknown robot 'no_such'" in capsys.readouterr().err
    assert main(["ik", "--problems", "0"]) == 2
    assert "--problems is 0" in capsys.readouterr().err
