"""``ik_replay BAG --method all --report FILE``: one command writes table and picture of all methods on the same motion.

The figures are compared with those that are computed here from the recorded runs. What each method minimises is tested
in test_methods.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from loop import make_robot
from PIL import Image
from recorded_loop import finish, recorded_loop
from scipy.linalg import null_space
from support import PROJECT

from ik_node.cli import replay as command
from ik_node.recording.run_reader import load_run
from ik_node.report import compute_metrics
from ik_node.report.canvas import report_style
from ik_node.report.document import draw_pages
from ik_node.report.null_space import null_space_motion
from ik_node.report.reported_run import read_reported_runs
from ik_node.report.table import METHOD_LABELS, metric_rows
from ik_node.settings.method_names import METHOD_NAMES
from ik_node.trajectory.shapes import figure_of_eight

BAG = PROJECT / "bags" / "plain"


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder with the recordings and the picture, and the printed text."""
    folder = tmp_path_factory.mktemp("methods")
    with pytest.MonkeyPatch.context() as patch:
        printed: list[str] = []
        patch.setattr("builtins.print", lambda *texts, **_: printed.extend(map(str, texts)))
        arguments = ["--method", "all", "--jobs", "1", "--out", str(folder / "runs")]
        assert command.main([str(BAG), *arguments, "--report", str(folder / "methods.png")]) == 0
    return folder, "\n".join(printed)


def test_one_command_prints_the_table_and_writes_the_picture(compared: tuple[Path, str]) -> None:
    folder, printed = compared
    others = [name for name in METHOD_NAMES if name != "plain"]
    assert sorted(path.name for path in (folder / "runs").iterdir()) == sorted(["recorded", *others])
    for label in METHOD_LABELS:
        assert any(line.startswith(label) for line in printed.splitlines()), label
    picture = np.asarray(Image.open(folder / "methods.png").convert("L"))
    assert picture.shape[1] > 1000
    assert picture.std() > 10.0


@pytest.mark.parametrize("name", ["recorded", "inertia_weighted", "gravity_gradient", "obstacle_gradient"])
def test_figures_are_those_of_an_independent_computation(compared: tuple[Path, str], name: str) -> None:
    run = load_run(compared[0] / "runs" / name)
    robot = make_robot("panda")
    known = np.flatnonzero(np.isfinite(run.q).all(axis=1))
    kinetic, gravity, along_null_space = [], [], []
    for row in known.tolist():
        q, qd = run.q[row], run.joint_velocity[row]
        kinetic.append(0.5 * qd @ robot.dynamics(q).mass_matrix @ qd)
        gravity.append(robot.gravitational_energy(q))
        along_null_space.append(np.linalg.norm(null_space(robot.evaluate(q).jacobian_b).T @ qd))
    found = compute_metrics(run)
    assert found.energy.kinetic_mean_j == pytest.approx(np.mean(kinetic))
    assert found.energy.kinetic_max_j == pytest.approx(np.max(kinetic))
    assert found.energy.gravitational_mean_j == pytest.approx(np.mean(gravity))
    assert found.null_space.rms == pytest.approx(np.sqrt(np.mean(np.square(along_null_space))), abs=1e-12)
    assert found.null_space.max == pytest.approx(np.max(along_null_space), abs=1e-12)
    momentum = np.linalg.norm(run.multiplier_task[:, :3], axis=1)
    assert found.multiplier.task_linear_max == pytest.approx(np.nanmax(momentum))
    wrench = np.linalg.norm(run.multiplier_potential[:, :3], axis=1) / float(run.settings["gradient_gain"])  # type: ignore[arg-type]
    assert found.multiplier.potential_linear_max == pytest.approx(np.nanmax(wrench), abs=1e-12)


def test_each_method_shows_what_it_is_for(compared: tuple[Path, str]) -> None:
    found = {bag.name: compute_metrics(load_run(bag)) for bag in (compared[0] / "runs").iterdir()}
    # plain moves in the null space only as far as it turns until the middle of the interval of the command
    # without weights of its own, joint_weighted moves as plain does
    others = [entry.null_space.rms for name, entry in found.items() if name not in ("recorded", "joint_weighted")]
    assert found["recorded"].null_space.rms < 0.05 * min(others)
    assert found["inertia_weighted"].energy.kinetic_mean_j < found["recorded"].energy.kinetic_mean_j
    lowest = min(found, key=lambda name: found[name].energy.gravitational_mean_j)
    assert lowest == "gravity_gradient"


def test_repulsion_is_largest_beside_the_obstacle() -> None:
    runs = read_reported_runs([PROJECT / "bags" / "obstacle"])
    series = runs[0].metrics.energy_series
    assert series.repulsion.max() > 0.0
    nearest = int(np.nanargmin(runs[0].metrics.clearance_series.obstacle))  # type: ignore[union-attr]
    assert series.repulsion[nearest] == pytest.approx(series.repulsion.max(), rel=0.2)
    assert runs[0].metrics.energy.repulsion_mean_j == pytest.approx(series.repulsion.mean())


def test_the_null_space_is_that_of_the_task_in_force(tmp_path: Path) -> None:
    """With a free spin of the tool the null space has one dimension more from the change on."""
    values = {"rate_hz": 100.0, "obstacles.geometry": "none", "method": "inertia_weighted"}
    loop = recorded_loop(tmp_path / "bag", values)
    figure = figure_of_eight(loop.pose())
    loop.follow(figure.pose, 1.0, 50.0)
    free = {"task.tolerance": (0.0, 0.0, 0.0, 0.0, 0.0, np.inf)}
    loop.controller.apply(loop.controller.settings.with_values(free), loop.now)  # type: ignore[call-arg]
    changed = len(loop.steps)
    loop.follow(lambda time_s: figure.pose(1.0 + time_s), 1.0, 50.0)
    finish(loop)
    run = load_run(tmp_path / "bag")
    _, series = null_space_motion(run, loop.robot)
    for row, (q, qd) in enumerate(zip(run.q, run.joint_velocity, strict=True)):
        rows = loop.robot.evaluate(q).jacobian_b[: 6 if row < changed else 5]
        assert series.speed[row] == pytest.approx(np.linalg.norm(null_space(rows).T @ qd), abs=1e-4)
    whole = np.linalg.norm(null_space(loop.robot.evaluate(run.q[-1]).jacobian_b).T @ run.joint_velocity[-1])
    assert series.speed[-1] > whole + 1e-3


def test_the_page_of_one_run_and_of_several_have_both_potentials(compared: tuple[Path, str]) -> None:
    folder = compared[0] / "runs"
    for bags in ([folder / "recorded"], sorted(folder.iterdir())):
        with report_style():
            page = draw_pages(read_reported_runs(bags))[2]
        titles = [axes.get_title(loc="left") for axes in page.figure.axes]
        titles += [text.get_text() for text in page.figure.texts]  # what is zero throughout
        for begin in ("Kinetic energy", "Gravitational energy", "Repulsion of near pairs", "Null-space speed"):
            assert any(title.startswith(begin) for title in titles), (begin, titles)


def test_labels_of_the_table_exist(compared: tuple[Path, str]) -> None:
    rows = metric_rows(read_reported_runs(sorted((compared[0] / "runs").iterdir())))
    assert set(METHOD_LABELS) <= {row.label for row in rows}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--report", "x.png"], "--report: no effect without --method"),
        (["--method", "all", "--report", "x.jpeg"], "ends in '.jpeg'; valid: .png"),
    ],
)
def test_a_report_that_cannot_be_written_is_refused_first(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main([str(BAG), *arguments]) == 2
    said = capsys.readouterr()
    assert reason in said.err
    assert said.out == ""
