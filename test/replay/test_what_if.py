"""Runs with other settings, with the loop closed in the simulator: without changes they equal the recorded run bit for
bit if the same simulated arm made it; a change shows in the figures that it affects. Not tested here: whether a method
has its intended effect (test_methods.py), and durations."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop import Loop
from made_steps import same_bits
from recorded_loop import finish, record, recorded_loop
from waiting import ENOUGH_S

from ik_node.cli import replay as command
from ik_node.errors import InputError, RecordingError, SettingsError
from ik_node.interfaces.samples import JointSample
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.replay.closed_loop import SimulatedRun, first_position, open_loop, simulate
from ik_node.replay.rerecord import record_simulation
from ik_node.replay.what_if import (
    RECORDED,
    Variant,
    VariantMetrics,
    compare,
    compare_open_loop,
    ground_truth_of,
    make_variants,
    metrics_of,
)
from ik_node.settings.groups import Settings
from ik_node.settings.method_names import METHOD_NAMES
from ik_node.settings.parameter_file import parse_assignment
from ik_node.settings.task import TaskSettings
from ik_node.trajectory.shapes import figure_of_eight

RATE = {"rate_hz": 100.0, "obstacles.geometry": "none"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Loop]:
    """A recorded figure of eight with a change of parameters during the run."""
    directory = tmp_path_factory.mktemp("what_if") / "bag"
    loop = recorded_loop(directory, RATE)
    trajectory = figure_of_eight(loop.pose())
    loop.follow(trajectory.pose, 3.0, 50.0)
    changed = loop.controller.settings.with_values({"gain": (10.0, 8.0)})
    loop.controller.apply(changed, loop.now)  # type: ignore[call-arg]
    loop.follow(lambda time_s: trajectory.pose(3.0 + time_s), 3.0, 50.0)
    finish(loop)
    return directory, loop


def test_with_nothing_changed_it_is_the_recorded_run(run: tuple[Path, Loop]) -> None:
    directory, loop = run
    assert same_bits(tuple(simulate(RecordingSource(directory), {}).steps), tuple(loop.steps))
    assert same_bits(tuple(open_loop(RecordingSource(directory), {})), tuple(loop.steps))


def test_it_begins_where_a_recording_of_the_middle_begins(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "first", RATE)
    trajectory = figure_of_eight(loop.pose())
    loop.follow(trajectory.pose, 2.0, 50.0)
    finish(loop)
    loop.controller = loop.controller.controller  # type: ignore[attr-defined]
    record(loop, tmp_path / "bag")
    before = len(loop.steps)
    loop.follow(lambda time_s: trajectory.pose(2.0 + time_s), 1.0, 50.0)
    finish(loop)
    assert same_bits(tuple(simulate(RecordingSource(tmp_path / "bag"), {}).steps), tuple(loop.steps[before:]))


def table(directory: Path, *wanted: Variant) -> dict[str, VariantMetrics]:
    opened = partial(RecordingSource, directory)
    return {found.name: found for found in compare(opened, (RECORDED, *wanted), ground_truth_of(directory, ""), 1)}


def test_every_method_follows_and_the_inertia_weighted_one_costs_least_energy(run: tuple[Path, Loop]) -> None:
    directory, _ = run
    wanted = make_variants(RecordingSource(directory).initial_settings, ["all"], {})
    assert [variant.name for variant in wanted] == [name for name in METHOD_NAMES if name != "plain"]
    found = table(directory, *wanted)
    assert list(found) == ["recorded", *(variant.name for variant in wanted)]
    for name, figure in found.items():
        assert figure.method == ("plain" if name == "recorded" else name)
        assert figure.position_rms_mm < 0.5
        assert figure.orientation_rms_mrad < 1.0
        assert figure.steps == found["recorded"].steps
        assert figure.faults == 0
    assert found["inertia_weighted"].energy_mean_j < found["recorded"].energy_mean_j
    assert found["gravity_gradient"].energy_mean_j > found["inertia_weighted"].energy_mean_j


def test_figures_are_those_of_the_steps(run: tuple[Path, Loop]) -> None:
    """Compared with figures computed from the Steps of the recorded run."""
    directory, loop = run
    source = RecordingSource(directory)
    found = metrics_of(source, RECORDED, SimulatedRun(loop.steps, 3, [TaskSettings()] * len(loop.steps)), None)
    velocity = np.array([step.joint_velocity for step in loop.steps])
    assert found.peak_speed == np.abs(velocity).max()
    limits = loop.robot.limits.velocity
    assert found.peak_speed_percent == pytest.approx(100.0 * (np.abs(velocity) / limits).max())
    energy = [
        0.5 * step.joint_velocity @ loop.robot.dynamics(step.joint_position).mass_matrix @ step.joint_velocity
        for step in loop.steps
    ]
    assert found.energy_mean_j == pytest.approx(np.mean(energy))
    assert found.energy_max_j == pytest.approx(np.max(energy))
    assert found.scale_min == min(step.scale for step in loop.steps)
    assert math.isnan(found.position_rms_mm)
    assert found.refused == 3


def test_other_settings_show(run: tuple[Path, Loop]) -> None:
    directory, _ = run
    slow = dict(map(parse_assignment, ["limits.velocity_fraction=0.1", "gain=[2, 10]"]))
    found = table(directory, *make_variants(RecordingSource(directory).initial_settings, [], slow))
    name = "limits.velocity_fraction=0.1, gain=[2, 10]"
    assert found[name].peak_speed_percent <= 100.0
    assert found[name].peak_speed < 0.5 * found["recorded"].peak_speed
    assert found[name].scaled_percent > 10.0 > found["recorded"].scaled_percent
    assert found[name].position_rms_mm > 3.0 * found["recorded"].position_rms_mm


def test_errors_are_those_of_what_the_task_asks(run: tuple[Path, Loop]) -> None:
    """Orientations do not count where they are free, and positions inside a band do not."""
    position = Variant("position", {"task.tolerance": (0.0, 0.0, 0.0, math.inf, math.inf, math.inf)})
    band = Variant("band", {"task.tolerance": (0.01, 0.01, 0.01, math.inf, math.inf, math.inf)})
    found = table(run[0], RECORDED, position, band)
    assert found["recorded"].orientation_max_mrad > 0.0
    assert found["position"].orientation_max_mrad == found["band"].orientation_max_mrad == 0.0
    assert 0.0 < found["position"].position_rms_mm < 2.0 * found["recorded"].position_rms_mm
    assert found["band"].position_max_mm < 0.1
    moved = simulate(RecordingSource(run[0]), band.changes).steps
    assert max(float(np.linalg.norm(step.pose_sb[:3, 3] - step.pose_sd[:3, 3])) for step in moved) > 0.005


def test_changes_outlast_recorded_changes(run: tuple[Path, Loop]) -> None:
    """Parameter changes in the recording are applied, except for the parameters that the user overrides."""
    directory, loop = run
    source = RecordingSource(directory)
    kept = simulate(source, {"gain": (5.0, 10.0)}).steps
    assert same_bits(kept[-1].joint_velocity, loop.steps[-1].joint_velocity) is False
    seen = [settings.control for settings in applied(source)]
    assert [control.gain for control in seen] == [(10.0, 8.0)]


def applied(source: RecordingSource) -> list[Settings]:
    events = [event for event in source.entries() if getattr(event, "call", None) and event.call.kind.name == "APPLY"]  # type: ignore[union-attr]
    return [source.settings(event) for event in events]  # type: ignore[arg-type]


def test_open_loop_says_how_far_commands_part(run: tuple[Path, Loop]) -> None:
    directory, loop = run
    opened = partial(RecordingSource, directory)
    found = compare_open_loop(opened, (Variant("same", {}), Variant("other", {"method": "inertia_weighted"})))
    assert (found[0].difference_max, found[0].steps) == (0.0, len(loop.steps))
    assert found[1].difference_max > 0.01
    assert found[1].difference_rms < found[1].difference_max


def test_joint_states_in_pieces_keep_their_pieces(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", RATE)
    names = loop.robot.joints
    for _ in range(50):
        loop.time_ns += loop.period_ns
        q = loop.position
        for part in (slice(3, None), slice(0, 3)):
            sample = JointSample(loop.now.ros_ns, (*names[part], "finger"), np.append(q[part], 7.0))
            loop.take(loop.controller.on_joint_state(sample, loop.now))
    finish(loop)
    source = RecordingSource(tmp_path / "bag")
    assert first_position(source, loop.robot, 0.1)[0] == pytest.approx(loop.steps[0].joint_position)
    assert same_bits(tuple(simulate(source, {}).steps), tuple(loop.steps))


def test_a_simulated_run_is_recorded_as_a_run(run: tuple[Path, Loop], tmp_path: Path) -> None:
    directory, _ = run
    steps, _, _ = record_simulation(RecordingSource(directory), {"method": "gravity_gradient"}, tmp_path / "out")
    again = replay(RecordingSource(tmp_path / "out"))
    assert again.first is None
    assert again.steps == len(steps)
    loaded = load_run(tmp_path / "out")
    assert loaded.settings["method"] == "gravity_gradient"
    assert same_bits(loaded.joint_velocity, np.array([step.joint_velocity for step in steps]))
    with pytest.raises(RecordingError, match="exists already"):
        record_simulation(RecordingSource(directory), {}, tmp_path / "out")


def test_processes_give_what_one_process_gives(run: tuple[Path, Loop]) -> None:
    directory, _ = run
    opened = partial(RecordingSource, directory)
    wanted = (Variant("a", {"method": "inertia_weighted"}), Variant("b", {"gain": (5.0, 10.0)}))
    truth = ground_truth_of(directory, "")
    assert compare(opened, wanted, truth, 2) == compare(opened, wanted, truth, 1)


# --- invalid requests ---


@pytest.mark.parametrize(
    ("assignment", "reason"),
    [
        ("gain", "no assignment"),
        ("gain=", "no assignment"),
        ("gain={", "no assignment"),
        ("gains=1", "unknown parameter 'gains'; nearest: gain"),
        ("gain_linear=1", "'gain_linear' was replaced by gain"),
        ("gain=[10, -1]", "valid: 0 to 200"),
        ("method=plainly", "valid: plain"),
    ],
)
def test_settings_that_are_none_are_refused(assignment: str, reason: str) -> None:
    with pytest.raises((InputError, SettingsError), match=reason):
        parse_assignment(assignment)


def test_values_are_read_as_their_parameter_wants_them() -> None:
    assert parse_assignment("gain=[3, 4]") == ("gain", (3.0, 4.0))
    assert parse_assignment("limits.velocity=[1, 2]") == ("limits.velocity", (1, 2))
    assert parse_assignment("obstacles.velocity_damper=false") == ("obstacles.velocity_damper", False)


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match="unknown method 'best'; valid: all, plain"):
        make_variants(Settings(), ["best"], {})


def test_a_recording_without_joint_states_is_refused(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", RATE)
    loop.controller.on_clock(loop.now)
    finish(loop)
    with pytest.raises(RecordingError, match=r"no run of ik_node|no position of panda_joint1"):
        simulate(RecordingSource(tmp_path / "bag"), {})


def test_the_command_prints_a_table_and_records(run: tuple[Path, Loop], tmp_path: Path) -> None:
    directory, _ = run
    arguments = [str(directory), "--method", "inertia_weighted", "--set", "gain=[5, 10]", "--open-loop"]
    call = [sys.executable, "-m", "ik_node.cli.replay", *arguments, "--out", str(tmp_path / "out"), "--json"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=ENOUGH_S, check=False, env=dict(os.environ))
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    assert [entry["name"] for entry in document["closed_loop"]] == ["recorded", "inertia_weighted, gain=[5, 10]"]
    assert document["open_loop"][0]["difference_max"] > 0.0
    assert document["against"] == "recorded targets"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["inertia_weighted__gain__5__10_", "recorded"]


def test_the_table_is_for_people(run: tuple[Path, Loop], capsys: pytest.CaptureFixture[str]) -> None:
    directory, _ = run
    assert command.main([str(directory), "--method", "inertia_weighted", "--jobs", "1"]) == 0
    said = capsys.readouterr().out
    assert "closed loop in the simulator" in said
    for row in (
        "position error rms [mm]",
        "kinetic energy mean [J]",
        "clearance min [mm]",
        "s min",
        "peak joint speed",
    ):
        assert row in said
    assert command.main([str(directory), "--method", "best"]) == 2
    assert "unknown method" in capsys.readouterr().err
