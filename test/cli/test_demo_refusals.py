"""``ik_demo``, ``ik_report`` and ``ik_replay`` check all arguments and files first: exit code 2, nothing started."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import PROJECT, shared_path

from ik_node.cli import demo, export, replay, report, view
from ik_node.recording.run_reader import load_run
from ik_node.ros.demo.options import CheckedRun

POSES = "t,x,y,z,qx,qy,qz,qw\n0.0,0.4,0.1,0.3,0,0,0,1\n0.1,0.4,0.2,0.3,0,0,0,1\n"


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The command line sets these variables if they are not set; work in an empty folder."""
    for name, value in (
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
        ("ROS_DOMAIN_ID", "1"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROJECT / "config" / "fastdds_quick_discovery.xml")),
    ):
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "poses.csv").write_text(POSES)
    (tmp_path / "turns.csv").write_text(POSES.replace("qx,qy,qz,qw", "rx,ry,rz,n"))
    (tmp_path / "poses.mat").write_bytes(b"MATLAB 5.0 MAT-file\x00\x81\xff")
    (tmp_path / "scene.yaml").write_text("obstacles: 3\n")
    (tmp_path / "arm.urdf").write_text((PROJECT / "test" / "lift_arm.urdf").read_text())
    (tmp_path / "file").write_text("")
    for name, simulator in (("start", "initial_position: [0.0, 1.0]"), ("other", "robot: ur5"), ("odd", "lag: 0.1")):
        node = "/**:\n  ik_node:\n    ros__parameters: {robot: panda}\n"
        text = f"{node}  ik_simulator:\n    ros__parameters: {{{simulator}}}\n"
        (tmp_path / f"{name}.yaml").write_text(text)


REFUSED = (
    ("--trajectory circle --units mm", "--units: no effect, 'circle' is no file of poses"),
    ("--order wxyz --relative", "--order, --relative: no effect"),
    ("--trajectory absent.csv", "no trajectory 'absent.csv'; valid: figure_of_eight"),
    ("--trajectory poses.mat", "poses.mat is no text"),
    ("--trajectory turns.csv", "rx, ry, rz may be an orientation"),
    ("--trajectory poses.csv --order wxyz", "--order has no effect"),
    ("--trajectory poses.csv --end 5", "--end 5 has no effect: the motion ends at 0.1 s"),
    ("--trajectory poses.csv --topic /pose", "--topic has no effect"),
    ("--trajectory poses.csv --quaternion none --rpy a b c", "--quaternion and --rpy are given"),
    ("--method plain --set method=plain", "--method and --set method=plain set the same"),
    ("--rate 100 --set rate_hz=100.0", "--rate and --set rate_hz=100.0 set the same"),
    ("--set method=plain --set method=gravity_gradient", "--set method=... is given twice"),
    ("--set recording.enabled=false", "--set recording.enabled=false has no effect"),
    ("--set nonsense=1", "unknown parameter 'nonsense'"),
    ("--set gain", "'gain' is no assignment"),
    ("--target-rate 0", "--target-rate is 0"),
    ("--target-rate nan", "--target-rate is nan"),
    ("--rate -5", "rate_hz is -5"),
    ("--robot nobody", "unknown robot 'nobody'"),
    ("--config absent.yaml", "absent.yaml"),
    ("--scene scene.yaml", "has no list 'obstacles'"),
    ("--urdf absent.urdf", "URDF file '{here}/absent.urdf' cannot be read: No such file or directory"),
    ("--urdf poses.mat", "'{here}/poses.mat' cannot be read: 'utf-8' codec"),
    ("--urdf .", "Is a directory"),
    ("--urdf scene.yaml", "not a valid URDF: not XML"),
    ("--urdf arm.urdf --robot ur5", "--urdf and --robot exclude each other"),
    ("--urdf arm.urdf --set robot=ur5", "--urdf and --set robot=ur5 exclude each other"),
    ("--urdf arm.urdf --tip nowhere", "unknown frame 'nowhere'; valid: base, carriage"),
    ("--tip panda_link8 --set tip_frame=panda_link8", "--tip and --set tip_frame=panda_link8 set the same"),
    ("--config start.yaml", "initial_position of ik_simulator has 2 values; expected 7, in the order panda_joint1"),
    ("--config other.yaml", "ik_simulator has no joint panda_joint1, panda_joint2"),
    ("--config odd.yaml", "unknown parameter 'lag'; nearest: lag_s"),
    ("--out file/run", "folder 'file/run' cannot be created: Not a directory"),
    ("--set obstacles.srdf=absent", "absent"),
    ("--set limits.acceleration=[1.0,2.0]", "limits.acceleration has 2 values; expected 1 or 7"),
    ("--out .", "folder '.' exists already"),
)


@pytest.mark.parametrize(("arguments", "message"), REFUSED)
def test_demo(arguments: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    before = set(tmp_path.iterdir())
    assert demo.main(["--headless", *arguments.split()]) == 2
    said = capsys.readouterr()
    assert message.format(here=tmp_path) in said.err
    assert len(said.err.splitlines()) == 1
    assert not said.out, "nothing is started"
    assert set(tmp_path.iterdir()) == before


@pytest.fixture(scope="module")
def bag() -> Path:
    return PROJECT / "bags" / "plain"


def save_truth(path: Path, bag: Path, factor: float = 1.0, later_s: float = 0.0) -> Path:
    """Write the recorded targets as TUM text."""
    targets = load_run(bag).targets
    stamps = targets.stamp_ns / 1e9 + later_s
    np.savetxt(path, np.column_stack((stamps, factor * targets.position, targets.quaternion_xyzw)), "%.9f")
    return path


def test_report_reads_any_file_of_poses(bag: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A text of stamps and poses, in another unit, and the bag itself, with the same figures."""
    truth = save_truth(tmp_path / "truth.txt", bag)
    outputs = []
    for arguments in (
        ["--truth", str(truth)],
        ["--truth", str(save_truth(tmp_path / "truth_mm.txt", bag, 1e3)), "--units", "mm"],
        ["--truth", str(bag), "--topic", "/ik_node/target_pose"],
    ):
        assert report.main([str(bag), "--json", *arguments]) == 0
        outputs.append(capsys.readouterr().out)
    figures = [[line for line in text.splitlines() if "position_rms_mm" in line] for text in outputs]
    assert figures[0]
    for other in figures[1:]:
        for first, second in zip(figures[0], other, strict=True):
            values = [float(line.split(":")[1].strip(" ,")) for line in (first, second)]
            assert values[0] == pytest.approx(values[1], abs=1e-3)


def test_report_refuses(bag: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    truth = str(save_truth(tmp_path / "truth.txt", bag))
    later = str(save_truth(tmp_path / "later.txt", bag, later_s=1e5))
    for arguments, message in (
        (["--units", "mm"], "--units: no effect, without --truth"),
        (["--truth", truth, "--prefix", "goal"], "--prefix has no effect"),
        (["--truth", later], "expected ROS time"),
        (["--truth", str(tmp_path / "turns.csv")], "may be an orientation"),
        (["--truth", str(tmp_path / "poses.mat")], "is no text"),
    ):
        assert report.main([str(bag), *arguments]) == 2
        said = capsys.readouterr()
        assert message in said.err
        assert len(said.err.splitlines()) == 1
        assert not said.out


def test_the_field_s_files_are_refused_or_read_before_the_start(capsys: pytest.CaptureFixture[str]) -> None:
    for case, arguments, message in (
        ("20-npy-4x4-hint/poses.npy", "--position 0 1 2", "--position has no effect"),
        ("21-kitti-3x4/poses.txt", "--position 3 7 11", "--position has no effect"),
        ("22-euroc-header/poses.csv", "--position 1 2 3 --order wxyz --units m --time 0", "--order has no effect"),
    ):
        path = shared_path("field_cases", *case.split("/"))
        assert demo.main(["--headless", "--trajectory", str(path), *arguments.split()]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--to /other", "--to: no effect without --ros"),
        ("--input target_pose", "--input: no effect without --ros"),
        ("--ros --method plain", "--method: no effect with --ros"),
        ("--open-loop", "--open-loop: no effect without --method"),
        ("--open-loop --robot panda", "--open-loop: no effect"),
        ("--out new --jobs 2", "--out, --jobs: no effect without --method"),
        ("--robot panda --node /ik_node", "--node: no effect for a bag of another program"),
    ],
)
def test_replay_refuses_options_without_effect(
    bag: Path, arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay.main([str(bag), *arguments.split()]) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert not said.out


@pytest.mark.parametrize("bag", ["tf_example", "tf_example.bag"])
def test_a_bag_of_another_program_is_named_alike_by_all(bag: str, capsys: pytest.CaptureFixture[str]) -> None:
    """rosbag2 in sqlite3 and rosbag1: one exit code, and the topics."""
    path = str(shared_path("data", "foreign_bags", bag))
    for main, arguments in (
        (report.main, [path]),
        (view.main, [path]),
        (export.main, [path, "out.csv"]),
        (replay.main, [path]),
    ):
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert len(said.splitlines()) == 1
        assert "/tf (tf2_msgs/msg/TFMessage, 517)" in said
        assert main is replay.main or "holds no run of ik_node" in said


@pytest.mark.parametrize(
    ("arguments", "robot", "rate_hz"),
    [
        ((), "panda", 500.0),
        (("--config", "ur5.yaml"), "ur5", 500.0),
        (("--robot", "ur5", "--rate", "250"), "ur5", 250.0),
        (("--robot", "pr2"), "pr2", 500.0),
        (("--set", "robot=ur5"), "ur5", 500.0),
        (("--urdf", str(PROJECT / "test" / "lift_arm.urdf"), "--rate", "100"), "lift_arm", 100.0),
    ],
)
def test_the_robot_is_that_of_the_arguments(arguments: tuple[str, ...], robot: str, rate_hz: float) -> None:
    """Without --robot the robot is that of the parameter file, which was overridden by the default before."""
    given = [str(PROJECT / "config" / each) if each.endswith(".yaml") else each for each in arguments]
    run = CheckedRun(demo.checked_options(demo.parser().parse_args(given)))
    assert run.robot_name == robot
    assert run.settings.arm.robot == ("" if "--urdf" in given else robot)
    assert run.settings.control.rate_hz == run.simulator["rate_hz"] == rate_hz
    assert run.out.name.startswith(f"ik_demo_{robot}_")
    assert run.simulated_robot.joints == run.robot.joints
    assert len(run.simulator["initial_position"]) == run.robot.n
    assert (run.start is None) == (robot != "pr2"), "chosen where none is configured"
