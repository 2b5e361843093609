"""``--help`` of every executable: printed without ROS, NumPy or numba, and in agreement with the code."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from typing import Any

import pytest
from support import PROJECT

from ik_node.cli import demo, ros_arguments
from ik_node.cli.entry import command_line
from ik_node.messages.encode import TYPES
from ik_node.recording.input_table import INPUTS
from ik_node.robot.simulator_parameters import PARAMETERS
from ik_node.trajectory.shapes import SHAPES

COMMANDS = sorted(
    path.stem
    for path in (PROJECT / "ik_node" / "cli").glob("*.py")
    if "\ndef main(" in path.read_text(encoding="utf-8")
)
NODES = ("node", "simulator", "watchdog")
HEAVY = ("numpy", "numba", "pinocchio", "scipy", "matplotlib", "rclpy", "yaml", "rosbags", "mcap", "viser")
CODE = f"""
import json, runpy, sys
name = sys.argv.pop(1)
try:
    runpy.run_module("ik_node.cli." + name, run_name="__main__", alter_sys=True)
except SystemExit as exit:
    loaded = [package for package in {HEAVY} if package in sys.modules]
    sys.stderr.write(json.dumps([exit.code, loaded]))
"""


def run(*arguments: str) -> tuple[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", CODE, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        check=True,
    )
    return done.stdout, json.loads(done.stderr.splitlines()[-1])


def help_of(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as end:
        import_module(f"ik_node.cli.{name}").main(["--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", COMMANDS)
def test_help_loads_no_other_package(name: str) -> None:
    printed, (code, loaded) = run(name, "--help")
    assert code == 0
    assert loaded == []
    assert printed.startswith(f"usage: {'ik_node' if name == 'node' else f'ik_{name}'}")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples_that_can_be_parsed(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Nodes also list their topics."""
    text = help_of(name, capsys)
    program = "ik_node" if name == "node" else f"ik_{name}"
    lines = re.findall(rf"^  ({program} .*?)(?:  .*)?$", text.partition("\nexample")[2], re.MULTILINE)
    assert lines
    for line in lines:
        words = shlex.split(line.partition(" > ")[0])[1:]
        module = import_module(f"ik_node.cli.{name}")
        if name in NODES:
            ros_arguments.parse(module.parser(), words)
        else:
            module.parser().parse_args([f" {word}" if re.match(r"-[\d.]", word) else word for word in words])
    assert name not in NODES or re.search(r"topics[ (:]", text)


def test_the_worked_example_needs_no_robot_model_and_no_pictures() -> None:
    printed, (code, loaded) = run("solve", "--example", "2r")
    assert code == 0
    assert "converged" in printed
    assert not {"pinocchio", "matplotlib", "rclpy"} & set(loaded)


def test_the_help_of_the_node_lists_its_topics(capsys: pytest.CaptureFixture[str]) -> None:
    text = help_of("node", capsys)
    for entry in INPUTS.values():
        assert re.search(rf"^  {re.escape(entry.topic)} ", text, re.MULTILINE), entry.topic
        assert entry.type_name.replace("/msg/", "/") in text
    for topic in TYPES:
        assert (topic if topic.startswith("/") else f"~/{topic}") in text
    for service in ("~/pause", "~/reset", "~/record"):
        assert service in text


def test_the_help_of_the_simulator_lists_its_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    text = help_of("simulator", capsys)
    names = [about.name for about in PARAMETERS]
    assert len(names) > 10
    for name in names:
        assert re.search(rf"\b{name}\b", text), name


def test_the_demonstration_offers_the_shapes_there_are() -> None:
    assert tuple(SHAPES) == demo.SHAPES


@pytest.mark.parametrize("name", NODES)
def test_an_unknown_option_does_not_start_a_node(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        import_module(f"ik_node.cli.{name}").main(["--no-such-option", "--ros-args", "-p", "rate_hz:=100.0"])
    assert end.value.code == 2
    assert "--no-such-option" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [[], ["--ros-args"], ["--ros-args", "--help"], ["--ros-args", "-p", "a:=1", "--"], ["--ros-args", "-r", "x:=y"]],
)
def test_arguments_for_ros_are_left_to_ros(arguments: list[str]) -> None:
    ros_arguments.parse(ros_arguments.node_parser("name", "", ""), arguments)


def test_help_behind_the_arguments_for_ros_is_ours(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        ros_arguments.parse(ros_arguments.node_parser("name", "About.", ""), ["--ros-args", "-p", "a:=1", "--", "-h"])
    assert "About." in capsys.readouterr().out


def test_a_missing_package_is_an_error_without_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    @command_line
    def main(arguments: object = None) -> int:
        raise ModuleNotFoundError("No module named 'viser'", name="viser")

    assert main([]) == 2
    assert "ik_node[view]" in capsys.readouterr().err


def test_a_missing_module_of_anything_else_is_raised() -> None:
    @command_line
    def main(arguments: object = None) -> int:
        raise ModuleNotFoundError("No module named 'ik_node.nothing'", name="ik_node.nothing")

    with pytest.raises(ModuleNotFoundError):
        main([])
