"""`ik_benchmark ik` with few problems: its figures are correct, and the experiment of Haviland and Corke gives their
published figures where the method is not chaotic (the damped ones): same draws, same counts."""

from __future__ import annotations

import pytest
from benchmark_runs import benchmark, started_benchmark

PUBLISHED = ("mean_iterations", "median_iterations", "infeasible_percent", "mean_searches", "max_searches",
             "outside_percent")  # fmt: skip
ROBOTS = ("panda", "ur3", "ur5", "ur10")


@pytest.mark.parametrize("problems", [300, pytest.param(10_000, marks=pytest.mark.exhaustive)])
def test_reach_solves_and_does_not_boast(problems: int) -> None:
    ran = benchmark("ik", "--only", "reach", "--problems", str(problems), "--robots", *ROBOTS, "--json")
    assert ran.code == 0
    found = ran.document()["reach"]
    assert tuple(result["robot"] for result in found) == ROBOTS
    for result in found:
        assert result["problems"] == problems
        assert result["solved_percent"] >= 99.9
        assert result["outside_limits"] == result["false_claims"] == 0
        assert result["max_iterations"] <= 3000


def test_published_figures_come_out() -> None:
    """Panda, 10,000 problems: mean and median iterations, infeasible, searches, limit violations equal the published
    ones."""
    which = ("--tables", "panda", "--methods", "LM Chan 0.1", "--draws", "0")
    ran = benchmark("ik", "--only", "haviland-corke", *which, "--json")
    assert ran.code == 0
    tables = ran.document()["haviland_corke"]
    assert len(tables) == 2
    for table in tables:
        (row,) = table["rows"]
        assert {name: round(row["ours"][name], 2) for name in PUBLISHED} == {
            name: row["published"][name] for name in PUBLISHED
        }


def test_the_command_prints_tables_and_documents() -> None:
    """With every published method, so that each one is implemented."""
    ran = benchmark("ik", "--problems", "20", "--only", "reach", "--robots", "panda", "ur5")
    assert ran.code == 0
    assert "TRAC-IK" in ran.out
    document = benchmark("ik", "--problems", "12", "--draws", "1", "--robots", "kinova", "--json").document()
    assert [entry["robot"] for entry in document["reach"]] == ["kinova"]
    assert all(table["rows"] for table in document["haviland_corke"])


def test_the_command_names_what_is_wrong() -> None:
    ran = started_benchmark()
    assert ran.code == 0
    assert "success rate and time on random poses" in ran.out
    for arguments, message in (
        (("--robots", "no_such"), "unknown robot 'no_such'"),
        (("--problems", "0"), "--problems is 0"),
    ):
        ran = benchmark("ik", *arguments)
        assert ran.code == 2
        assert message in ran.err
