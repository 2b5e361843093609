"""Files of poses: every supported format is read as documented; ambiguous files are refused with an error that names
the problem.

Small generated files in each format, then the real ones where the shared folder exists. Not tested here: how the arm
follows them.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import shared_path

from ik_node.errors import InputError, TrajectoryFileError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.trajectory.pose_file import load
from ik_node.trajectory.pose_file_format import PoseFileFormat
from ik_node.trajectory.sampled import SampledTrajectory

START = se3.exp(np.array([0.3, 0.1, 0.5, 3.0, 0.2, -0.1]))


def motion(count: int = 21) -> tuple[Array, Array]:
    """Positions (N, 3) in m and quaternions (N, 4) x, y, z, w of a smooth motion; the quaternions change sign."""
    phase = np.linspace(0.0, 2.0, count)
    positions = np.column_stack((0.4 + 0.1 * np.sin(phase), 0.1 * phase, 0.3 + 0.05 * np.cos(phase)))
    turns = Rotation.from_rotvec(np.column_stack((3.0 - 0.3 * phase, 0.2 * phase, 0.1 * np.sin(phase))))
    signs = np.where(np.arange(count) % 3 == 0, -1.0, 1.0)
    return positions, turns.as_quat() * signs[:, None]


def expected(positions: Array, quaternions: Array) -> Array:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    return poses


def assert_poses(trajectory: SampledTrajectory, poses: Array) -> None:
    got = np.array([sample.pose for sample in trajectory.samples()])
    assert got.shape == poses.shape
    assert np.abs(got - poses).max() < 1e-12


def write(path: Path, header: str, columns: Array, separator: str = ",") -> Path:
    lines = [separator.join(repr(float(value)) for value in row) for row in columns]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path


def test_npy_of_demonstrations_in_centimetres_w_first(tmp_path: Path) -> None:
    """Kinesthetic demonstrations: (demonstrations, samples, 7), without time, so that the duration is given."""
    positions, quaternions = motion()
    rows = np.column_stack((100.0 * positions, np.roll(quaternions, 1, axis=1)))
    file = tmp_path / "demos.npy"
    np.save(file, np.stack((rows[::-1], rows)))
    trajectory = load(file, PoseFileFormat(units="cm", order="wxyz", demo=1, duration_s=8.0))
    assert_poses(trajectory, expected(positions, quaternions))
    assert trajectory.duration_s == 8.0
    assert [sample.time_s for sample in trajectory.samples()] == pytest.approx(np.linspace(0.0, 8.0, 21))
    assert "demonstration 1 of 2" in trajectory.describe()
    assert "[wxyz]" in trajectory.describe()
    with pytest.raises(TrajectoryFileError, match="demo is 2, valid: 0 to 1"):
        load(file, PoseFileFormat(units="cm", order="wxyz", demo=2))


def test_npy_of_letters_takes_height_and_orientation_from_the_start_pose(tmp_path: Path) -> None:
    """Handwriting: x and y only. Missing coordinates come from the arm's start pose; without a start pose they are an
    error."""
    positions, _ = motion()
    file = tmp_path / "letter.npy"
    np.save(file, 100.0 * positions[None, :, :2])
    trajectory = load(file, PoseFileFormat(units="cm"), START)
    wanted = np.tile(START, (21, 1, 1))
    wanted[:, :2, 3] = positions[:, :2]
    assert_poses(trajectory, wanted)
    assert "10 s (no time in the file)" in trajectory.describe()
    with pytest.raises(TrajectoryFileError, match="no z and no orientation, and no start pose"):
        load(file, PoseFileFormat(units="cm"))


def test_csv_with_goal_and_measured_pose_and_time_in_another_file(tmp_path: Path) -> None:
    """Task board: the goal is used unless a prefix selects another pose; w first by name; stamps in ms."""
    positions, quaternions = motion()
    w_first = np.roll(quaternions, 1, axis=1) * 1.00002
    columns = [f"{kind}_{part}" for kind in ("current", "goal") for part in ("pos_x", "pos_y", "pos_z")]
    turns = [f"{kind}_orientation_{axis}" for kind in ("current", "goal") for axis in "wxyz"]
    names = [*columns[:3], *turns[:4], *columns[3:], *turns[4:], "force_x", "force_y", "force_z", "joint_1"]
    data = np.column_stack((positions + 1.0, w_first[::-1], positions, w_first, np.zeros((21, 4))))
    file = write(tmp_path / "data.csv", ",".join(names), data)
    stamps = np.cumsum(np.r_[1117248.0, np.tile((50.0, 0.0, 49.0, 128.0), 5)])
    times = write(tmp_path / "seq.csv", "pose_header_seq,goal_stamp_sec", np.column_stack((stamps, np.zeros(21))))
    how = PoseFileFormat(time="pose_header_seq", time_file=str(times), time_unit="ms")
    goal = load(file, how)
    assert_poses(goal, expected(positions, quaternions))
    assert [s.time_s for s in goal.samples()] == pytest.approx((stamps - stamps[0]) / 1000.0)
    assert "goal_pos_x" in goal.describe()
    measured = load(file, dataclasses.replace(how, prefix="current_"))
    assert_poses(measured, expected(positions + 1.0, quaternions[::-1]))
    with pytest.raises(TrajectoryFileError, match="'goal_stamp_sec' spans 0 s"):
        load(file, dataclasses.replace(how, time="goal_stamp_sec", time_unit=""))


def test_two_poses_of_which_none_is_the_goal_are_refused_with_their_prefixes(tmp_path: Path) -> None:
    """Choosing one of two equal candidates could move the arm to a wrong place."""
    file = write(
        tmp_path / "two.csv", "a_pos_x,a_pos_y,a_pos_z,b_pos_x,b_pos_y,b_pos_z", np.random.default_rng(0).random((5, 6))
    )
    with pytest.raises(TrajectoryFileError, match="'a_', 'b_'"):
        load(file, start_pose=START)
    assert load(file, PoseFileFormat(prefix="b_"), START).duration_s == 10.0


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_text_with_stamps_and_a_commented_header(tmp_path: Path, separator: str) -> None:
    """Motion capture: comments, the last naming the columns; any separator; epoch stamps in seconds."""
    positions, quaternions = motion()
    stamps = 1305031098.6659 + np.linspace(0.0, 2.0, 21)
    header = "# ground truth\n# file: 'something.bag'\n# timestamp tx ty tz qx qy qz qw"
    file = write(tmp_path / "truth.txt", header, np.column_stack((stamps, positions, quaternions)), separator)
    trajectory = load(file)
    assert_poses(trajectory, expected(positions, quaternions))
    assert trajectory.duration_s == pytest.approx(2.0, abs=1e-6)
    assert "time 'timestamp' [s]" in trajectory.describe()


def test_csv_of_positions_and_velocities_is_laid_at_the_start_pose(tmp_path: Path) -> None:
    """Co-manipulation: positions in another frame, no orientation. Relative poses keep the axes of the base."""
    positions, _ = motion()
    file = write(tmp_path / "symbol.csv", "x,y,z,vx,vy,vz", np.column_stack((positions, 9.0 * positions)))
    trajectory = load(file, PoseFileFormat(relative=True, scale=0.5, offset=(0.0, 0.0, 0.1)), START)
    wanted = np.tile(START, (21, 1, 1))
    wanted[:, :3, 3] += 0.5 * (positions - positions[0]) + (0.0, 0.0, 0.1)
    assert_poses(trajectory, wanted)


def test_relative_turns_as_the_file_turns_seen_from_the_base(tmp_path: Path) -> None:
    """With orientation: the first pose becomes the start pose, and R_k R_0' is applied to it in the base axes."""
    positions, quaternions = motion()
    file = write(tmp_path / "p.csv", "x,y,z,qx,qy,qz,qw", np.column_stack((positions, quaternions)))
    trajectory = load(file, PoseFileFormat(relative=True), START)
    original = expected(positions, quaternions)
    assert np.abs(trajectory.pose(0.0) - START).max() < 1e-12
    for sample, pose in zip(trajectory.samples(), original, strict=True):
        turned = pose[:3, :3] @ original[0, :3, :3].T @ START[:3, :3]
        assert np.abs(sample.pose[:3, :3] - turned).max() < 1e-12
    with pytest.raises(TrajectoryFileError, match="relative needs"):
        load(file, PoseFileFormat(relative=True))


def test_explicit_columns_by_name_or_number_win(tmp_path: Path) -> None:
    """A file with uninformative names: every column is given, by name in one case and by number in the other."""
    positions, quaternions = motion()
    stamps = np.linspace(0.0, 4e9, 21)
    data = np.column_stack((np.zeros(21), positions[:, ::-1], stamps, quaternions))
    names = ("zero", "up", "left", "ahead", "tick", "i", "j", "k", "real")
    file = write(tmp_path / "odd.csv", ",".join(names), data)
    named = PoseFileFormat(
        position=("ahead", "left", "up"), quaternion=("i", "j", "k", "real"), order="xyzw", time="tick", time_unit="ns"
    )
    numbered = dataclasses.replace(named, position=("3", "2", "1"), quaternion=("5", "6", "7", "8"), time="4")
    for how in (named, numbered):
        trajectory = load(file, how)
        assert_poses(trajectory, expected(positions, quaternions))
        assert trajectory.duration_s == pytest.approx(4.0)
    held = load(file, dataclasses.replace(named, quaternion=("none",), order="", time="none", time_unit=""), START)
    assert np.abs(held.pose(5.0)[:3, :3] - START[:3, :3]).max() < 1e-12
    assert held.duration_s == 10.0


def test_window_and_speed(tmp_path: Path) -> None:
    """A part of a recording, slower: the duration scales the file's own stamps before the window selects."""
    positions, quaternions = motion()
    stamps = np.linspace(5.0, 7.0, 21)
    file = write(tmp_path / "w.csv", "time_s,x,y,z,qx,qy,qz,qw", np.column_stack((stamps, positions, quaternions)))
    trajectory = load(file, PoseFileFormat(duration_s=4.0, start_s=0.99, end_s=3.01))
    assert_poses(trajectory, expected(positions, quaternions)[5:16])
    assert trajectory.duration_s == pytest.approx(2.0)
    with pytest.raises(TrajectoryFileError, match="no motion between --start 7"):
        load(file, PoseFileFormat(start_s=7.0))


BROKEN = {
    "no_unit": ("x,y,z\n40,1,2\n41,1,2\n", {}, "positions reach 41.*m, cm, mm"),
    "no_order": ("0.1,0.2,0.3,1,0,0,0\n" * 2, {}, "order of the quaternion.*xyzw or wxyz"),
    "norm": ("x,y,z,qx,qy,qz,qw\n.1,.2,.3,0,0,0,1\n.1,.2,.3,0,0,0,1.01\n", {}, "sample 1: .*norm 1.01"),
    "not_finite": ("x,y,z\n.1,.2,.3\n.1,nan,.3\n", {}, "column 'y' is not finite in 1 of 2 rows, first in sample 1"),
    "empty_field": ("x,y,z\n.1,.2,.3\n.1,,.3\n", {}, "column 'y' is not finite"),
    "text": ("x,y,z\n.1,.2,.3\n.1,.2,up\n", {}, "sample 1, column 'z' holds 'up'"),
    "ragged": ("x,y,z\n.1,.2,.3\n.1,.2\n", {}, "sample 1 has 2 columns, the first has 3"),
    "unknown_column": (
        "x,y,z\n.1,.2,.3\n.1,.2,.4\n",
        {"position": ("x", "y", "h")},
        "no column 'h'; there are: x, y, z",
    ),
    "backwards": ("t,x,y,z\n0,.1,.2,.3\n2,.1,.2,.3\n1,.1,.2,.3\n", {}, "column 't' goes backwards at sample 2"),
    "wrong_unit_of_time": ("t,x,y,z\n0,.1,.2,.3\n9e9,.1,.2,.3\n", {}, "spans 9e.09 s when it is in s; say its unit"),
    "one_sample": ("x,y,z\n.1,.2,.3\n", {}, "a motion needs two"),
    "no_position": ("a,b,c\n1,2,3\n1,2,3\n", {}, "no position x, y, z .*there are: a, b, c"),
    "velocities_only": ("vx,vy,vz\n1,2,3\n1,2,3\n", {}, "no position x, y, z"),
    "columns_without_names": ("1,2,3,4,5\n" * 2, {}, "5 columns without names"),
    "header_only": ("x,y,z\n", {}, "a header and no data"),
    "empty": ("", {}, "holds no data"),
    "demo_of_text": ("x,y,z\n.1,.2,.3\n.1,.2,.4\n", {"demo": 1}, "holds one demonstration"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_cannot_be_understood_is_refused_by_name(tmp_path: Path, name: str) -> None:
    """Each message names the invalid sample or column, or lists the valid ones. Ambiguous data are never guessed."""
    text, options, message = BROKEN[name]
    file = tmp_path / "broken.csv"
    file.write_text(text)
    how = dataclasses.replace(PoseFileFormat(), **options)  # type: ignore[arg-type]
    with pytest.raises(TrajectoryFileError, match=message):
        load(file, how, START)


def test_files_that_are_none(tmp_path: Path) -> None:
    """Missing files, random bytes, arrays of other shapes, and a time file of another length."""
    with pytest.raises(TrajectoryFileError, match=r"absent\.csv cannot be read"):
        load(tmp_path / "absent.csv")
    for name in ("rubbish.csv", "rubbish.npy"):
        (tmp_path / name).write_bytes(b"\x93\xff\xfe\x00" * 30)
        with pytest.raises(TrajectoryFileError, match="rubbish"):
            load(tmp_path / name)
    np.save(tmp_path / "flat.npy", np.zeros(5))
    with pytest.raises(TrajectoryFileError, match=r"shape \(5,\)"):
        load(tmp_path / "flat.npy")
    file = write(tmp_path / "p.csv", "x,y,z", np.zeros((4, 3)))
    times = write(tmp_path / "t.csv", "time", np.zeros((3, 1)))
    with pytest.raises(TrajectoryFileError, match=r"t.csv holds 3 samples, p.csv holds 4"):
        load(file, PoseFileFormat(time_file=str(times)), START)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": "zyxw"}, "order is 'zyxw'; valid: xyzw, wxyz"),
        ({"units": "inch"}, "units is 'inch'; valid: m, cm, mm"),
        ({"time_unit": "h"}, "time_unit is 'h'"),
        ({"position": ("x",)}, "position names 1"),
        ({"quaternion": ("x", "y", "z")}, "quaternion names 3"),
        ({"duration_s": -1.0}, "duration_s is -1"),
        ({"scale": math.inf}, "must be finite"),
    ],
)
def test_a_description_out_of_range_is_refused(options: dict[str, object], message: str) -> None:
    """The format checks its own values, so that the error occurs before any file is opened."""
    with pytest.raises(TrajectoryFileError, match=message):
        PoseFileFormat(**options)  # type: ignore[arg-type]


def sampled(times: Array) -> tuple[SampledTrajectory, Array]:
    positions, quaternions = motion(len(times))
    poses = expected(positions, quaternions)
    return SampledTrajectory(times, poses), poses


def test_interpolation_passes_the_samples_with_a_continuous_velocity() -> None:
    """On an uneven grid: the curve passes the samples with equal velocity before and after each; at rest outside."""
    times = np.cumsum(np.r_[0.0, np.tile((0.05, 0.02, 0.11, 0.05), 5)])
    trajectory, poses = sampled(times)
    h = 1e-6
    for time, pose in zip(times.tolist(), poses, strict=True):
        assert np.abs(trajectory.pose(time) - pose).max() < 1e-12
        before = se3.log(se3.inverse(trajectory.pose(time - h)) @ trajectory.pose(time)) / h
        after = se3.log(se3.inverse(trajectory.pose(time)) @ trajectory.pose(time + h)) / h
        assert np.abs(after - before).max() < 2e-3
    assert (trajectory.pose(-1.0) == trajectory.pose(0.0)).all()
    assert (trajectory.pose(99.0) == trajectory.pose(times[-1])).all()


def test_interpolation_finds_the_motion_between_the_samples() -> None:
    """With twice as many samples, the error is a quarter at most: second order, away from the ends."""
    worst = []
    for count in (41, 81):
        times = np.linspace(0.0, 2.0, count)
        trajectory, _ = sampled(times)
        positions, quaternions = motion(8 * (count - 1) + 1)
        truth = expected(positions, quaternions)
        dense = np.linspace(0.0, 2.0, len(truth))
        inside = (dense > 0.2) & (dense < 1.8)
        worst.append(
            max(np.abs(trajectory.pose(t) - p).max() for t, p in zip(dense[inside], truth[inside], strict=True))
        )
    assert worst[1] < 0.3 * worst[0]
    assert worst[0] < 1e-4


def test_interpolation_rests_where_a_sample_repeats_and_never_overshoots_a_step() -> None:
    """A stream that holds, steps by 10 cm and half a turn, and holds: the curve stays between the two poses."""
    poses = np.tile(np.eye(4), (8, 1, 1))
    poses[4:, :3, 3] = (0.1, 0.0, 0.0)
    poses[4:, :3, :3] = se3.exp_rotation(np.array([0.0, 0.0, math.pi]))
    trajectory = SampledTrajectory(0.05 * np.arange(8), poses)
    for time in np.linspace(0.0, 0.35, 400).tolist():
        pose = trajectory.pose(time)
        assert -1e-15 <= pose[0, 3] <= 0.1 + 1e-15
        if time <= 0.15 or time >= 0.2:
            assert np.abs(pose - poses[0 if time <= 0.15 else 7]).max() < 1e-12


def test_of_samples_at_one_time_the_last_counts_and_all_are_handed_on() -> None:
    """Duplicate stamps do not cause a division by zero; the replayed stream keeps every sample."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (0.0, 0.1, 0.2, 0.3)
    trajectory = SampledTrajectory(np.array([0.0, 1.0, 1.0, 2.0]), poses)
    assert trajectory.pose(1.0)[0, 3] == pytest.approx(0.2)
    assert [sample.time_s for sample in trajectory.samples()] == [0.0, 1.0, 1.0, 2.0]
    for times in ([0.0, 1.0, 0.5, 2.0], [0.0] * 4, [1.0, 2.0, 3.0, 4.0], [0.0, 1.0, math.nan, 2.0], [0.0, 1.0]):
        with pytest.raises(InputError):
            SampledTrajectory(np.array(times), poses)


REAL = {
    "open_box": ("robottasks/openbox.npy", PoseFileFormat(units="cm", order="wxyz"), 10.0, 1000),
    "bottle": (
        "robottasks/bottle2shelf.npy",
        PoseFileFormat(units="cm", order="wxyz", demo=8, duration_s=12.0),
        12.0,
        1000,
    ),
    "letter": ("handwriting/e.npy", PoseFileFormat(units="cm", duration_s=10.0), 10.0, 1000),
    "symbol": ("comanipulation/symbol17_rec0.csv", PoseFileFormat(relative=True, duration_s=5.52), 5.52, 5520),
    "camera": ("hand_held_camera/freiburg1_xyz-groundtruth.txt", PoseFileFormat(relative=True), 30.09, 3000),
}


@pytest.mark.parametrize("name", REAL)
def test_real_files_run_as_they_are(name: str) -> None:
    """Each public recording opens with at most unit, order and duration given, and is within an arm's reach."""
    file, how, duration_s, count = REAL[name]
    trajectory = load(shared_path("data", *file.split("/")), how, START)
    assert trajectory.duration_s == pytest.approx(duration_s, abs=0.02)
    samples = trajectory.samples()
    assert len(samples) == count
    assert np.linalg.norm([sample.pose[:3, 3] for sample in samples], axis=1).max() < 1.2


def test_the_real_task_board_both_ways() -> None:
    """Goal and measured pose of one recording: same stamps and duration, tool near its goal (RMS < 2 cm)."""
    data = shared_path("data", "taskboard_20hz", "data_trial1.csv")
    stamps = shared_path("data", "taskboard_20hz", "seq_trial1.csv")
    how = PoseFileFormat(time_file=str(stamps), time="pose_header_seq", time_unit="ms", end_s=60.0)
    goal, measured = load(data, how), load(data, dataclasses.replace(how, prefix="current_"))
    assert goal.duration_s == measured.duration_s == pytest.approx(60.0, abs=0.1)
    gap = [a.pose[:3, 3] - b.pose[:3, 3] for a, b in zip(goal.samples(), measured.samples(), strict=True)]
    assert np.sqrt((np.array(gap) ** 2).sum(1).mean()) < 0.02
    with pytest.raises(TrajectoryFileError, match="'goal_header_seq' goes backwards at sample 78"):
        load(data, dataclasses.replace(how, time="goal_header_seq"))
