"""Whatever a table of poses holds, reading it ends with a table or with a TrajectoryFileError of one line."""

from __future__ import annotations

import io
import random
import struct
from pathlib import Path

import numpy as np
import pytest

from ik_node.errors import TrajectoryFileError
from ik_node.trajectory.pose_reader import read_table


def npy(header: str) -> bytes:
    text = header.encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


CONTENTS = {
    "claims 5 TiB.npy": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 7)}\n"),
    "deep header.npy": npy("(" * 5000 + "\n"),
    "open header.npy": npy("{'descr': '<f8', 'shape': (\n"),
    "object.npy": npy("{'descr': '|O', 'fortran_order': False, 'shape': (2, 7)}\n"),
    "zip.npy": b"PK\x03\x04" + bytes(40),
    "empty.npy": b"",
    "long field.csv": b"a,b\n1," + b"9" * 200_000 + b"\n",
    "quotes.csv": b'"1,2\n3,4\n',
    "binary.csv": b"\xff\xfe\x00",
    "empty.csv": b"",
}


@pytest.mark.parametrize("name", CONTENTS)
def test_no_table(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(CONTENTS[name])
    with pytest.raises(TrajectoryFileError) as caught:
        read_table(path).column("0")
    assert "\n" not in str(caught.value)


def test_mutated_tables_raise_errors_of_this_package(tmp_path: Path) -> None:
    chance = random.Random(18)
    stream = io.BytesIO()
    np.save(stream, np.arange(21.0).reshape(3, 7))
    for suffix, whole in ((".npy", stream.getvalue()), (".csv", b"t,x,y\n0,1,2\n1,2,3\n")):
        for _ in range(300):
            data = bytearray(whole)
            for _ in range(chance.randrange(1, 4)):
                data[chance.randrange(min(len(data), 128))] = chance.choice([0, 10, 34, 39, 40, 44, 57, 255])
            path = tmp_path / f"mutated{suffix}"
            path.write_bytes(data)
            try:
                read_table(path).column("1")
            except TrajectoryFileError as error:
                assert "\n" not in str(error)
