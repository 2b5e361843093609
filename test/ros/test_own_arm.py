"""An arm that is in no package, by the README's commands: from its URDF to reports. A failed demonstration."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from domains import own_domain
from support import PROJECT

from ik_node.recording.run_reader import load_run
from ik_node.robot.catalogue import robots_folder
from ik_node.ros.demo.new_folder import new_folder

OWN = PROJECT / "test" / "lift_arm.urdf"
PATIENCE_S = 600.0
SECTION = re.compile(r"^## An arm of your own\n.*?```sh\n(.*?)```", re.DOTALL | re.MULTILINE)


def readme_commands() -> list[list[str]]:
    """Words of the commands below the heading; a comment behind a command is left out."""
    found = SECTION.search((PROJECT / "README.md").read_text())
    assert found is not None
    return [shlex.split(line, comments=True) for line in found.group(1).splitlines()]


def run(words: list[str], folder: Path, domain: int) -> str:
    """Run a line of the README in ``folder`` with the interpreter of the test instead of bootstrap.py's."""
    assert words[:2] == ["python3", "bootstrap.py"]
    output = words[words.index(">") + 1] if ">" in words else ""
    name, *arguments = words[2 : words.index(">") if output else None]
    done = subprocess.run(
        [sys.executable, "-m", f"ik_node.cli.{name.removeprefix('ik_')}", *arguments],
        cwd=folder,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, (words, done.stdout, done.stderr)
    if output:
        (folder / output).write_text(done.stdout)
    return done.stdout


def test_the_readme_leads_from_a_urdf_to_a_report(tmp_path: Path) -> None:
    """A lift (prismatic), six revolute joints and a gripper with two jaws."""
    assert not any("lift_arm" in path.read_text(errors="replace") for path in robots_folder().rglob("*.urdf"))
    (tmp_path / "my_arm.urdf").write_text(OWN.read_text())
    commands = readme_commands()
    assert [words[2] for words in commands] == ["ik_demo", "ik_config", "ik_demo", "ik_report"]
    with own_domain() as domain:
        printed = [run(words, tmp_path, domain) for words in commands]
    assert "starting lift_arm" in printed[0]
    assert "start posture" not in printed[0], "it is in the parameter file"
    for folder in ("my_arm_run", "my_arm_again"):
        made = {path.name for path in (tmp_path / folder).iterdir()}
        assert {"bag", "report.json", "report.png", "trajectory.csv"} <= made
        report = json.loads((tmp_path / folder / "report.json").read_text())
        assert report["robot"] == "lift_arm"
        recorded = load_run(tmp_path / folder / "bag")
        assert recorded.joints == ("lift", "turn", "raise", "bend", "roll", "tilt", "spin")
        assert recorded.robot == ""
        assert abs(recorded.joint_velocity).max() > 0.0
        assert abs(recorded.joint_velocity[:, 0]).max() <= 0.25
    pages = list(tmp_path.glob("report_*.html"))
    assert len(pages) == 1
    assert "lift_arm" in pages[0].read_text()


def child_of(parent: int, module: str) -> int | None:
    """Process id of the child that runs ``module``."""
    for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        if module.encode() in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    return None


def test_a_demonstration_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    out = tmp_path / "new" / "run"
    demonstration = [sys.executable, "-m", "ik_node.cli.demo", "--headless", "--out", str(out), "--trajectory", "hold"]
    # A background job of a shell and its children ignore SIGINT.
    command = ["sh", "-c", "trap '' INT; exec \"$@\"", "sh", *demonstration]
    with own_domain() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        demo = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        try:
            assert demo.stdout is not None
            for line in demo.stdout:
                if line.startswith("starting"):
                    break
            node = None
            while node is None:  # the demonstration starts it next, or ends, which ends the loop with an OSError
                node = child_of(demo.pid, "ik_node.cli.node")
            os.kill(node, signal.SIGKILL)
            _, said = demo.communicate(timeout=PATIENCE_S)
        finally:
            if demo.poll() is None:
                demo.kill()
                demo.wait()
    assert demo.returncode == 1
    assert "error: ik_node.cli.node ended with code -9" in said
    assert "end of ik_node.log:" in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == [], "neither the folder nor its new parents"


def test_a_new_folder_goes_with_what_failed_in_it_and_nothing_else(tmp_path: Path) -> None:
    with new_folder(tmp_path / "kept" / "run") as folder:
        (folder / "file").write_text("")
    assert folder.is_dir()

    def failing() -> None:
        with new_folder(tmp_path / "kept" / "a" / "b") as made:
            (made / "file").write_text("")
            (tmp_path / "kept" / "a" / "of others").write_text("")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        failing()
    assert [path.name for path in (tmp_path / "kept" / "a").iterdir()] == ["of others"]
