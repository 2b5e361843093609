"""Formats of files of poses: each is written by another program's writer and read back to the same poses.

Ambiguous conventions are refused with one line that names the option to give, and so is every option without effect.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import loaded_program, shared_path

from ik_node.errors import IkNodeError, RecordingError, TrajectoryFileError
from ik_node.math.types import Array
from ik_node.trajectory.pose_file import load
from ik_node.trajectory.pose_file_format import PoseFileFormat
from ik_node.trajectory.pose_reader import read_poses

COUNT = 24
TIMES: Array = 0.05 * np.arange(float(COUNT))
EPOCH_S = 1_700_000_000
PHASE: Array = np.linspace(0.0, 2.0, COUNT)
POSITION: Array = np.column_stack((0.4 + 0.1 * np.sin(PHASE), 0.1 * PHASE - 0.05, 0.3 + 0.05 * np.cos(PHASE)))
TURN = Rotation.from_rotvec(np.column_stack((2.5 - 0.3 * PHASE, 0.2 * PHASE, 0.1 * np.sin(PHASE))))
XYZW: Array = TURN.as_quat()
WXYZ: Array = np.roll(XYZW, 1, axis=1)
MATRICES: Array = np.tile(np.eye(4), (COUNT, 1, 1))
MATRICES[:, :3, :3] = TURN.as_matrix()
MATRICES[:, :3, 3] = POSITION
MATRICES_3X4: Array = MATRICES[:, :3].reshape(COUNT, 12)
RPY_DEG: Array = TURN.as_euler("xyz", degrees=True)
STAMPS_NS = EPOCH_S * 10**9 + np.round(TIMES * 1e9).astype(np.int64)


def assert_read(path: Path, how: PoseFileFormat | None = None, *, timed: bool = True, within: float = 1e-9) -> str:
    """Check poses and times, and return the description."""
    trajectory = load(path, how)
    samples = trajectory.samples()
    assert np.abs(np.array([sample.pose for sample in samples]) - MATRICES).max() < within
    if timed:
        assert [sample.time_s for sample in samples] == pytest.approx(TIMES, abs=1e-9)
    return trajectory.describe()


def assert_refused(path: Path, *messages: str, how: PoseFileFormat | None = None) -> None:
    with pytest.raises(IkNodeError) as caught:
        load(path, how, np.eye(4))
    said = str(caught.value)
    assert "\n" not in said
    for message in messages:
        assert message in said, said


def save_csv(path: Path, header: str, *columns: Array, delimiter: str = ",", comments: str = "") -> Path:
    np.savetxt(path, np.column_stack(columns), "%.18g", delimiter, header=header, comments=comments)
    return path


def save_rows(path: Path, header: str, stamps: Sequence[object], *columns: Array) -> Path:
    """Write stamps as they are, beside numbers."""
    rows = [
        ",".join([str(stamp), *(repr(float(value)) for value in row)])
        for stamp, row in zip(stamps, np.column_stack(columns), strict=True)
    ]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


# --- matrices --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [4, 3])
def test_npy_of_matrices(tmp_path: Path, rows: int) -> None:
    file = tmp_path / "poses.npy"
    np.save(file, MATRICES[:, :rows])
    assert "matrix" in assert_read(file, timed=False)
    np.save(file, np.stack((MATRICES[::-1, :rows], MATRICES[:, :rows])))
    assert "demonstration 1 of 2" in assert_read(file, PoseFileFormat(demo=1), timed=False)


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("kind", ["3x4", "4x4 by rows", "4x4 by columns"])
def test_text_of_matrices_without_names(tmp_path: Path, kind: str, timed: bool) -> None:
    """KITTI (12 columns), 16 columns by rows as numpy writes them, and by columns as libfranka has them."""
    entries = {
        "3x4": MATRICES_3X4,
        "4x4 by rows": MATRICES.reshape(COUNT, 16),
        "4x4 by columns": MATRICES.transpose(0, 2, 1).reshape(COUNT, 16),
    }[kind]
    columns = (TIMES, entries) if timed else (entries,)
    assert_read(save_csv(tmp_path / "kitti.txt", "", *columns, delimiter=" "), timed=timed)
    assert_read(save_csv(tmp_path / "poses.csv", "", *columns), timed=timed)


@pytest.mark.parametrize("names", ["r{i}{j}", "T_{i}_{j}", "pose[{i}][{j}]"])
@pytest.mark.parametrize("first", [0, 1])
def test_matrices_with_names(tmp_path: Path, names: str, first: int) -> None:
    header = ",".join(names.format(i=i + first, j=j + first) for i in range(3) for j in range(4))
    assert_read(save_csv(tmp_path / "m.csv", f"time_s,{header}", TIMES, MATRICES_3X4))
    turns = ",".join(names.format(i=i + first, j=j + first) for i in range(3) for j in range(3))
    assert_read(save_csv(tmp_path / "r.csv", f"t,x,y,z,{turns}", TIMES, POSITION, TURN.as_matrix().reshape(COUNT, 9)))


def test_matrices_that_are_no_poses(tmp_path: Path) -> None:
    """Scaled and mirrored rotations, other last rows, other numbers in as many columns, and rotations stored in an
    order that the file does not show."""
    scaled, mirrored, other = MATRICES.copy(), MATRICES.copy(), MATRICES.copy()
    scaled[5, :3, :3] *= 1.01
    mirrored[7, :3, 0] *= -1.0
    other[:, 3, 0] = 0.5
    for number, matrices, message in ((5, scaled, "a rotation"), (7, mirrored, "a rotation"), (0, other, "0 0 0 1")):
        np.save(tmp_path / "m.npy", matrices)
        assert_refused(tmp_path / "m.npy", message, *([f"sample {number} is"] if number else []))
    assert_refused(save_csv(tmp_path / "joints.csv", "", np.random.default_rng(0).random((5, 12))), "a rotation")
    turning = MATRICES.copy()
    turning[:, :3, 3] = 0.0
    assert_refused(save_csv(tmp_path / "turn.csv", "", turning.reshape(COUNT, 16)), "by rows or by columns")
    rounded = np.round(MATRICES, 4)
    np.save(tmp_path / "m.npy", rounded)
    poses = np.array([sample.pose for sample in load(tmp_path / "m.npy").samples()])
    gram = poses[:, :3, :3].transpose(0, 2, 1) @ poses[:, :3, :3]
    assert np.abs(gram - np.eye(3)).max() < 1e-14


# --- formats of data sets and tools ----------------------------------------------------------------------------------


def test_euroc(tmp_path: Path) -> None:
    """Names, units and order are in the header; the stamps are whole nanoseconds since 1970."""
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    header += ", ".join(f"{name}_RS_R_{axis} [m s^-1]" for name in ("v", "b_w", "b_a") for axis in "xyz")
    file = save_rows(tmp_path / "data.csv", header, STAMPS_NS.tolist(), POSITION, WXYZ, np.ones((COUNT, 9)))
    assert "time 'timestamp' [ns]" in assert_read(file)
    given = PoseFileFormat(position=("1", "2", "3"), order="wxyz", units="m", time="0", time_unit="ns")
    assert_refused(file, "--order has no effect", how=given)
    assert_refused(file, "--units has no effect", "state m", how=PoseFileFormat(units="m"))
    named = save_rows(
        tmp_path / "named.csv",
        header.replace("timestamp,", "timestamp [ns],"),
        STAMPS_NS.tolist(),
        POSITION,
        WXYZ,
        np.ones((COUNT, 9)),
    )
    assert_read(named)
    assert_refused(named, "--time-unit has no effect", "states ns", how=PoseFileFormat(time_unit="ns"))


def test_tum(tmp_path: Path) -> None:
    """Eight columns separated by blanks: the order is that of the format. With commas it is not known."""
    columns = (EPOCH_S + TIMES, POSITION, XYZW)
    for header in ("", "timestamp tx ty tz qx qy qz qw"):
        file = save_csv(tmp_path / "tum.txt", header, *columns, delimiter=" ", comments="# ")
        trajectory = load(file)
        assert trajectory.duration_s == pytest.approx(TIMES[-1], abs=1e-6)
        assert np.abs(np.array([sample.pose for sample in trajectory.samples()]) - MATRICES).max() < 1e-9
    assert_refused(save_csv(tmp_path / "c.csv", "", *columns), "--order xyzw or wxyz")


def test_topic_echo(tmp_path: Path) -> None:
    """``ros2 topic echo --csv`` has no names, and words in between; ``rostopic echo -p`` has names after a percent."""
    rows = [
        f"{stamp // 10**9},{stamp % 10**9},base," + ",".join(repr(float(v)) for v in (*position, *quaternion))
        for stamp, position, quaternion in zip(STAMPS_NS.tolist(), POSITION, XYZW, strict=True)
    ]
    file = tmp_path / "echo.csv"
    file.write_text("\n".join(rows))
    assert_read(file)
    names = [f"field.pose.position.{axis}" for axis in "xyz"] + [f"field.pose.orientation.{axis}" for axis in "xyzw"]
    header = ",".join(("%time", "field.header.seq", "field.header.stamp", "field.header.frame_id", *names))
    rows = [
        f"{stamp},{number},{stamp},base," + ",".join(repr(float(v)) for v in (*position, *quaternion))
        for number, (stamp, position, quaternion) in enumerate(zip(STAMPS_NS.tolist(), POSITION, XYZW, strict=True))
    ]
    file.write_text("\n".join([header, *rows]))
    assert "[ns]" in assert_read(file)


@pytest.mark.parametrize(
    "names",
    [
        "__time,/p/pose/position/x,/p/pose/position/y,/p/pose/position/z,"
        "/p/pose/orientation/x,/p/pose/orientation/y,/p/pose/orientation/z,/p/pose/orientation/w",
        "Time [s],TX,TY,TZ,QX,QY,QZ,QW",
        "time,posX,posY,posZ,quatX,quatY,quatZ,quatW",
        "elapsed_time,position_0,position_1,position_2,quat_xyzw_0,quat_xyzw_1,quat_xyzw_2,quat_xyzw_3",
        "seconds,tool.position.x,tool.position.y,tool.position.z,"
        "tool.rotation.x,tool.rotation.y,tool.rotation.z,tool.rotation.w",
    ],
)
def test_names_of_other_tools(tmp_path: Path, names: str) -> None:
    assert_read(save_csv(tmp_path / "named.csv", names, TIMES, POSITION, XYZW))


# --- units and conventions -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("header", ["w,x,y,z", "qw,qx,qy,qz"])
def test_the_names_state_the_order_of_columns(tmp_path: Path, header: str) -> None:
    """Columns in any order: w first, z before x, the time last."""
    names = f"tz,tx,ty,{header if header[0] == 'q' else 'rot_w,rot_x,rot_y,rot_z'},t"
    file = save_csv(tmp_path / "o.csv", names, POSITION[:, [2, 0, 1]], WXYZ, TIMES)
    assert_read(file)
    assert_refused(file, "--order has no effect", how=PoseFileFormat(order="xyzw"))


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("x [mm],y [mm],z [mm]", (1e3, 1e3, 1e3)),
        ("x (mm),y (mm),z (mm)", (1e3, 1e3, 1e3)),
        ("x_cm,y_cm,z_cm", (1e2, 1e2, 1e2)),
        ("x [mm],y [m],z [cm]", (1e3, 1.0, 1e2)),
    ],
)
def test_units_of_length_in_the_header(tmp_path: Path, header: str, factors: tuple[float, float, float]) -> None:
    """Each column has its own unit."""
    columns = (1e3 * TIMES, POSITION * factors, XYZW)
    assert_read(save_csv(tmp_path / "u.csv", f"time [ms],{header},qx,qy,qz,qw", *columns))
    rows = save_csv(
        tmp_path / "n.csv", "t,x,y,z,qx,qy,qz,qw\n[ms],[mm],[mm],[mm],,,,", 1e3 * TIMES, 1e3 * POSITION, XYZW
    )
    assert_read(rows)


def test_units_that_are_unknown_or_missing(tmp_path: Path) -> None:
    file = save_csv(tmp_path / "i.csv", "t,x [inch],y [inch],z [inch]", TIMES, POSITION)
    assert_refused(file, "unit 'inch' of column 'x [inch]' is not known; valid: m, cm, mm")
    assert_refused(save_csv(tmp_path / "mm.csv", "t,x,y,z", TIMES, 1e3 * POSITION), "--units: m, cm, mm")
    mixed = save_csv(tmp_path / "mixed.csv", "t,x,y,z", TIMES, POSITION * (1.0, 1.0, 1e3))
    assert_refused(mixed, "further than an arm")
    milliseconds = save_csv(tmp_path / "ms.csv", "t,x,y,z", 1e3 * TIMES, POSITION)
    assert_refused(milliseconds, "50 s apart", "--time-unit")
    assert load(milliseconds, PoseFileFormat(time_unit="ms"), np.eye(4)).duration_s == pytest.approx(TIMES[-1])


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_since_1970_have_one_unit_only(tmp_path: Path, unit: str) -> None:
    factor = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}[unit]
    stamps = [f"{stamp // factor}" if unit != "s" else f"{stamp / 1e9:.9f}" for stamp in STAMPS_NS.tolist()]
    file = save_rows(tmp_path / "t.csv", "stamp,x,y,z,qx,qy,qz,qw", stamps, POSITION, XYZW)
    trajectory = load(file)
    assert trajectory.duration_s == pytest.approx(TIMES[-1], abs=1e-6)


@pytest.mark.parametrize("header", ["roll [deg],pitch [deg],yaw [deg]", "roll_deg,pitch_deg,yaw_deg"])
def test_roll_pitch_yaw(tmp_path: Path, header: str) -> None:
    """Angles about the fixed axes x, y, z, as scipy's "xyz"; the unit must be known."""
    assert_read(save_csv(tmp_path / "e.csv", f"t,x,y,z,{header}", TIMES, POSITION, RPY_DEG))
    radians = save_csv(tmp_path / "r.csv", "t,x,y,z,roll,pitch,yaw", TIMES, POSITION, np.radians(RPY_DEG))
    assert_read(radians, PoseFileFormat(angle_unit="rad"))
    assert_refused(radians, "--angle-unit rad or deg")
    turned = save_csv(tmp_path / "y.csv", "t,x,y,z,yaw_deg,pitch_deg,roll_deg", TIMES, POSITION, RPY_DEG[:, ::-1])
    assert_read(turned)
    assert_refused(turned, "--angle-unit has no effect", how=PoseFileFormat(angle_unit="deg"))
    unnamed = save_csv(tmp_path / "six.txt", "", POSITION, RPY_DEG)
    assert_refused(unnamed, "6 columns without names", "--rpy")
    how = PoseFileFormat(position=("0", "1", "2"), rpy=("3", "4", "5"), angle_unit="deg", time="none")
    assert_read(unnamed, how, timed=False)


@pytest.mark.parametrize("names", ["rx,ry,rz", "a,b,c", "alpha,beta,gamma", "euler_x,euler_y,euler_z", "q0,q1,q2"])
def test_other_angles_are_not_guessed(tmp_path: Path, names: str) -> None:
    """What may be an orientation is neither left out nor guessed; given as a rotation vector it is read."""
    file = save_csv(tmp_path / "v.csv", f"t,x,y,z,{names}", TIMES, POSITION, TURN.as_rotvec())
    assert_refused(file, names.partition(",")[0], "may be an orientation", "--rotation-vector")
    assert_read(file, PoseFileFormat(rotation_vector=tuple(names.split(","))))
    kept = load(file, PoseFileFormat(quaternion=("none",)), np.eye(4))
    assert np.abs(kept.samples()[3].pose[:3, :3] - np.eye(3)).max() == 0.0


def test_quaternions_by_number_need_the_order(tmp_path: Path) -> None:
    file = save_csv(tmp_path / "q.csv", "t,x,y,z,q0,q1,q2,q3", TIMES, POSITION, WXYZ)
    assert_refused(file, "q0, q1, q2, q3", "--order xyzw or wxyz")
    assert_read(file, PoseFileFormat(order="wxyz"))


def test_joints_beside_a_position_are_no_orientation(tmp_path: Path) -> None:
    """Seven columns q1 to q7; four would be a quaternion of unknown order."""
    names = ",".join(f"q{number}" for number in range(1, 8))
    file = save_csv(tmp_path / "joints.csv", f"t,x,y,z,{names}", TIMES, POSITION, MATRICES_3X4[:, :7])
    assert "orientation held" in load(file, None, np.eye(4)).describe()


def test_a_name_with_control_characters_is_described_printably(tmp_path: Path) -> None:
    """Found by the fuzzer: the description goes to a terminal."""
    file = tmp_path / "control.csv"
    file.write_bytes(b"\x00\x00x\ty\n1\t2\n2\t3\n")
    said = load(file, None, np.eye(4)).describe()
    assert "x00x" in said
    assert said.isprintable()


@pytest.mark.parametrize("names", ["sec,nanosec", "secs,nsecs", "seconds,nanoseconds", "stamp.sec,stamp.nanosec"])
def test_seconds_and_nanoseconds_are_one_time(tmp_path: Path, names: str) -> None:
    file = tmp_path / "s.csv"
    rows = [
        f"{stamp // 10**9},{stamp % 10**9}," + ",".join(repr(float(v)) for v in row)
        for stamp, row in zip(STAMPS_NS.tolist(), np.column_stack((POSITION, XYZW)), strict=True)
    ]
    file.write_text("\n".join([f"{names},x,y,z,qx,qy,qz,qw", *rows]))
    assert_read(file)


def test_a_column_named_twice_is_refused(tmp_path: Path) -> None:
    assert_refused(save_csv(tmp_path / "d.csv", "t,x,y,z,x,y,z", TIMES, POSITION, POSITION), "several columns", "'x'")
    assert_refused(save_csv(tmp_path / "u.csv", "t,x_m,x_mm,y,z", TIMES, POSITION[:, :1], POSITION), "'x_mm'")


# --- JSON ------------------------------------------------------------------------------------------------------------


def records(kind: str) -> list[dict[str, Any]]:
    """The poses as JSON objects of several shapes."""
    found: list[dict[str, Any]] = []
    for time_s, stamp, matrix, quaternion in zip(TIMES.tolist(), STAMPS_NS.tolist(), MATRICES, XYZW, strict=True):
        x, y, z, w = quaternion.tolist()
        place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
        turn = {"x": x, "y": y, "z": z, "w": w}
        header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "base"}
        found.append(
            {
                "message": {"header": header, "pose": {"position": place, "orientation": turn}},
                "flat": {"t": time_s, **place, "qx": x, "qy": y, "qz": z, "qw": w},
                "lists": {"t": time_s, "position": list(place.values()), "quaternion_wxyz": [w, x, y, z]},
                "matrix": {"timestamp": time_s, "pose": matrix.tolist()},
                "list of 16": {"time": time_s, "O_T_EE": matrix.T.ravel().tolist()},
            }[kind]
        )
    return found


KINDS = ("message", "flat", "lists", "matrix", "list of 16")


@pytest.mark.parametrize("kind", KINDS)
def test_json_lines_and_lists(tmp_path: Path, kind: str) -> None:
    lines, whole, inner = tmp_path / "poses.jsonl", tmp_path / "poses.json", tmp_path / "poses.txt"
    lines.write_text("\n".join(map(json.dumps, records(kind))))
    whole.write_text(json.dumps(records(kind), indent=1))
    inner.write_text(json.dumps({"camera": "none", "frames": records(kind)}))
    for file in (lines, whole, inner):
        assert_read(file)


def test_json_of_columns(tmp_path: Path) -> None:
    """Lists of one length are columns: none is left out."""
    file = tmp_path / "columns.json"
    columns = {"t": TIMES.tolist(), "p": POSITION.tolist(), "quat_xyzw": XYZW.tolist()}
    file.write_text(json.dumps({"robot": "none", **columns}))
    assert_read(file)
    file.write_text(json.dumps({**columns, "t": TIMES[1:].tolist()}))
    assert_refused(file, "lists of different lengths: 't' 23, 'p' 24")


def test_json_of_numbers_is_read_as_an_array(tmp_path: Path) -> None:
    file = tmp_path / "m.json"
    file.write_text(json.dumps(MATRICES.tolist()))
    assert_read(file, timed=False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"x": 1}\n{"x": ', "line 2"),
        ('{"t":0,"x":0.1,"y":0.2,"z":0.3}\n{"t":1,"x":0.1,"y":0.2}', "sample 1 has no 'z'"),
        ('{"t":0,"x":0.1,"y":0.2,"z":null}\n{"t":1,"x":0.1,"y":0.2,"z":0.2}', "column 'z' is not finite"),
        ('{"t":0,"x":0.1,"y":0.2,"z":"up"}\n{"t":1,"x":0.1,"y":0.2,"z":0.2}', "holds 'up'"),
        ('{"t":0,"p":[1,2]}\n{"t":1,"p":[1,2]}', "no position x, y, z"),
        ("[" * 3000, "no JSON"),
        ("[[1,2],[1]]", "different lengths"),
        ("[]", "no samples"),
        ("{}", "holds 1 sample"),
        ('{"t":0,"p":[0.1,0.2,0.3],"quaternion":[0,0,0,1]}\n' * 2, "--order xyzw or wxyz"),
        ('{"t":1e999,"x":1,"y":1,"z":1}\n' * 2, "column 't' is not finite"),
        ('{"t":' + "9" * 400 + ',"x":1,"y":1,"z":1}\n' + '{"t":0,"x":1,"y":1,"z":1}', "not a number"),
    ],
)
def test_json_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "bad.jsonl"
    file.write_text(text)
    assert_refused(file, message)


# --- bags ------------------------------------------------------------------------------------------------------------


def message(types: Any, kind: str, header: Any, position: Array, quaternion: Array) -> Any:
    """One pose as a ROS message of a type."""
    turn = types["geometry_msgs/msg/Quaternion"](*quaternion.tolist())
    pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*position.tolist()), turn)
    transform = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](*position.tolist()), turn)
    stamped = types["geometry_msgs/msg/TransformStamped"]
    if kind == "tf2_msgs/msg/TFMessage":
        return types[kind]([stamped(header, child, transform) for child in ("tool", "target_tool")])
    if kind == "geometry_msgs/msg/PoseWithCovarianceStamped":
        return types[kind](header, types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)))
    if kind == "geometry_msgs/msg/TransformStamped":
        return stamped(header, "tool", transform)
    return pose if kind == "geometry_msgs/msg/Pose" else types[kind](header, pose)


def messages(store: Any, kind: str, *, seq: bool) -> Iterator[tuple[int, Any]]:
    """The poses as ROS messages of one type, and the times of reception, 7 ms later."""
    for number, (stamp, position, quaternion) in enumerate(zip(STAMPS_NS.tolist(), POSITION, XYZW, strict=True)):
        time = store.types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        header = store.types["std_msgs/msg/Header"](*([number] if seq else []), stamp=time, frame_id="base")
        yield stamp + 7_000_000, message(store.types, kind, header, position, quaternion)


BAG_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/TransformStamped",
    "tf2_msgs/msg/TFMessage",
)


def write_bag(path: Path, storage: str, topics: dict[str, str]) -> Path:
    """Write a bag with the poses on every topic; topic -> type. rosbags writes it."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    if storage == "rosbag1":
        store = get_typestore(Stores.ROS1_NOETIC)
        with Writer1(path) as writer:
            for topic, kind in topics.items():
                connection = writer.add_connection(topic, kind, typestore=store)
                for time_ns, sent in messages(store, kind, seq=True):
                    writer.write(connection, time_ns, store.serialize_ros1(sent, kind))
        return path
    store = get_typestore(Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=8, storage_plugin=plugin) as writer:
        for topic, kind in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for time_ns, sent in messages(store, kind, seq=False):
                writer.write(connection, time_ns, store.serialize_cdr(sent, kind))
    return path


@pytest.mark.parametrize(
    ("storage", "kind"),
    [
        (storage, kind)
        for storage in ("mcap", "sqlite3", "rosbag1")
        for kind in BAG_TYPES
        if (storage, kind) != ("rosbag1", "tf2_msgs/msg/TFMessage")  # unknown to the writer; a real one is below
    ],
)
def test_bags(tmp_path: Path, storage: str, kind: str) -> None:
    path = write_bag(tmp_path / ("poses.bag" if storage == "rosbag1" else "poses"), storage, {"/arm/pose": kind})
    said = assert_read(path)
    assert "topic /arm/pose" in said
    if storage == "mcap":
        assert_read(next(path.glob("*.mcap")))
    stamps = read_poses(path).stamps_ns
    assert stamps is not None
    later_ns = 7_000_000 if kind.endswith("/Pose") else 0
    assert (stamps == STAMPS_NS + later_ns).all()


def test_a_topic_of_a_bag_is_chosen(tmp_path: Path) -> None:
    stamped = "geometry_msgs/msg/PoseStamped"
    path = write_bag(tmp_path / "two", "mcap", {"/left": stamped, "/right": stamped})
    assert_refused(path, "give --topic: /left, /right")
    assert "topic /right" in assert_read(path, PoseFileFormat(topic="/right"))
    assert_refused(
        path, "no topic of poses '/up'", "/left (geometry_msgs/msg/PoseStamped)", how=PoseFileFormat(topic="/up")
    )
    goal = write_bag(tmp_path / "goal", "mcap", {"/pose": stamped, "/target_pose": stamped})
    assert "topic /target_pose" in assert_read(goal)
    received = read_poses(goal, PoseFileFormat(time="received_ns")).stamps_ns
    assert received is not None
    assert (received == STAMPS_NS + 7_000_000).all()
    tf = write_bag(tmp_path / "tf", "mcap", {"/tf": "tf2_msgs/msg/TFMessage"})
    assert "topic /tf:tool " in assert_read(tf, PoseFileFormat(topic="/tf:tool"))
    assert_refused(tf, "/tf:target_tool", how=PoseFileFormat(topic="/tf:hand"))


def test_bags_without_poses(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"no metadata\.yaml"):
        load(tmp_path / "empty")
    (tmp_path / "x.bag").write_bytes(b"no bag")
    with pytest.raises(RecordingError, match="cannot be read as a bag"):
        load(tmp_path / "x.bag")


def test_a_foreign_bag_of_transforms_is_read() -> None:
    said = load(shared_path("data", "foreign_bags", "tf_example.bag")).describe()
    assert "topic /tf:base_footprint in frame 'odom'" in said


# --- options without effect ------------------------------------------------------------------------------------------

POSES = "t,x,y,z,qx,qy,qz,qw"
WITHOUT_EFFECT: tuple[tuple[str, dict[str, Any], str], ...] = (
    (POSES, {"prefix": "x"}, "--prefix"),
    (POSES, {"topic": "/pose"}, "--topic"),
    (POSES, {"demo": 0}, "--demo"),
    (POSES, {"order": "xyzw"}, "--order"),
    (POSES, {"angle_unit": "deg"}, "--angle-unit"),
    (POSES, {"end_s": 99.0}, "--end"),
    (POSES, {"position": ("x", "y", "z"), "prefix": "x"}, "--prefix"),
    (POSES, {"time": "none", "time_unit": "s"}, "--time-unit"),
    (POSES, {"quaternion": ("none",), "order": "xyzw"}, "--order"),
    ("t [s],x [m],y [m],z [m],qx,qy,qz,qw", {"units": "mm"}, "--units"),
    ("t [s],x [m],y [m],z [m],qx,qy,qz,qw", {"time_unit": "ms"}, "--time-unit"),
    ("n,x,y,z,vx,vy,vz,force", {"time": "none"}, "--time"),
    ("n,x,y,z,vx,vy,vz,force", {"quaternion": ("none",)}, "--quaternion"),
    ("n,x,y,z,vx,vy,vz,force", {"time_unit": "s"}, "--time-unit"),
)


@pytest.mark.parametrize(("header", "options", "option"), WITHOUT_EFFECT)
def test_an_option_without_effect_is_refused(tmp_path: Path, header: str, options: dict[str, Any], option: str) -> None:
    file = save_csv(tmp_path / "p.csv", header, TIMES, POSITION, XYZW)
    assert_refused(file, f"{option} ", "no effect", how=PoseFileFormat(**options))
    load(file, dataclasses.replace(PoseFileFormat(), scale=0.5), np.eye(4))


def test_options_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(TrajectoryFileError, match="--quaternion and --rpy are given"):
        PoseFileFormat(quaternion=("a", "b", "c", "d"), rpy=("e", "f", "g"))


def test_unnamed_columns_are_not_left_out(tmp_path: Path) -> None:
    """With given positions, the time and the orientation of unnamed columns must be given, too."""
    file = save_csv(tmp_path / "k.txt", "", MATRICES_3X4, delimiter=" ")
    assert_refused(file, "--position has no effect", "KITTI", how=PoseFileFormat(position=("3", "7", "11")))
    file = save_csv(tmp_path / "nine.txt", "", TIMES, POSITION, XYZW, TIMES, delimiter=" ")
    assert_refused(file, "also give --quaternion", "--time (or none)", how=PoseFileFormat(position=("1", "2", "3")))
    how = PoseFileFormat(position=("1", "2", "3"), quaternion=("4", "5", "6", "7"), order="xyzw", time="0")
    assert_read(file, how)


@pytest.mark.parametrize("name", ["x.mat", "x.npz", "x.csv"])
def test_other_binary_files(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"MATLAB 5.0 MAT-file\x00\x81\xff" + bytes(100))
    assert_refused(tmp_path / name, "is no text", "readable: CSV, text, JSON, NPY, and ROS bags")


# --- cases from the field --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("case", "file"),
    [("20-npy-4x4-hint", "poses.npy"), ("21-kitti-3x4", "poses.txt"), ("22-euroc-header", "poses.csv")],
)
def test_files_from_the_field(case: str, file: str) -> None:
    """Three files of one motion: the same poses are read from each."""
    path = shared_path("field_cases", case, file)
    first = load(shared_path("field_cases", "20-npy-4x4-hint", "poses.npy"))
    poses = np.array([sample.pose for sample in load(path).samples()])
    assert np.abs(poses - [sample.pose for sample in first.samples()]).max() < 2e-6


def test_columns_from_the_field(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    path = shared_path("field_cases", "17-pose-file-columns", "check.py")
    monkeypatch.setenv("REPO", str(Path(__file__).parents[2]))
    with pytest.raises(SystemExit) as end:
        loaded_program(path)
    assert end.value.code == 0, capsys.readouterr().out
