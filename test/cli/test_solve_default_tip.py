"""ik_solve with a URDF file: the tool frame that it takes without --tip, and a file that is not text."""

from __future__ import annotations

from pathlib import Path

import pytest

from ik_node.cli.solve import main
from ik_node.robot import catalogue

POSE = "0.4 0.1 0.5 1 0 0 0"


def test_a_tip_that_was_not_chosen_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(catalogue.read_urdf(catalogue.find("panda")))
    main(["--urdf", str(path), "--target", POSE])
    assert "warning: --tip is missing: 'panda_hand_tcp'" in (said := capsys.readouterr().err)
    assert "its last joint is 'panda_joint7'; left out as a gripper's: panda_finger_joint1" in said
    main(["--urdf", str(path), "--tip", "panda_hand_tcp", "--target", POSE])
    assert "warning" not in capsys.readouterr().err


def test_a_file_that_is_not_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.urdf"
    path.write_bytes(b"\xff\xfe<robot/>")
    assert main(["--urdf", str(path), "--target", POSE]) == 2
    assert "arm.urdf' cannot be read" in capsys.readouterr().err
