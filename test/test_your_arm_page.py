"""docs/your_arm.md: its scene is read, its commands are those of the executables, its numbers those of the code."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import yaml
from support import PROJECT

from ik_node.collision.scene import MAX_OBSTACLES, SIZES, read_scene
from ik_node.control import arm_configuration
from ik_node.robot.catalogue import load_robot
from ik_node.settings.groups import Settings

PAGE = PROJECT / "docs" / "your_arm.md"
TEXT = PAGE.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
COMMANDS = [shlex.split(line) for kind, body in BLOCKS if kind == "sh" for line in body.splitlines()]
OWN = load_robot(PROJECT / "test" / "lift_arm.urdf")


def test_the_scene_has_every_shape_and_key(tmp_path: Path) -> None:
    (body,) = [body for kind, body in BLOCKS if kind == "yaml" and body.startswith("obstacles:")]
    path = tmp_path / "scene.yaml"
    path.write_text(body)
    scene = read_scene(path, lambda frame: OWN.frame_pose(np.zeros(OWN.n), frame))
    assert {obstacle.shape.kind for obstacle in scene.obstacles.values()} == set(SIZES)
    keys = {key for entry in yaml.safe_load(body)["obstacles"] for key in entry}
    assert keys == {"name", "position", "orientation", "frame", "velocity", *SIZES}
    assert f"at most {MAX_OBSTACLES} obstacles" in TEXT


def test_the_controller_has_the_joints_of_the_arm() -> None:
    (body,) = [body for kind, body in BLOCKS if kind == "yaml" and body.startswith("controller_manager:")]
    assert tuple(yaml.safe_load(body)["my_velocity_controller"]["ros__parameters"]["joints"]) == OWN.joints


@pytest.mark.parametrize("words", [words for words in COMMANDS if words[0] == "BIN"], ids=lambda words: words[1])
def test_the_commands_have_these_options(words: list[str]) -> None:
    module = import_module(f"ik_node.cli.{words[1].removeprefix('ik_')}")
    module.parser().parse_args(words[2 : words.index(">") if ">" in words else None])


def test_the_parameters_and_assumptions_are_those_of_the_code() -> None:
    names = set(Settings().flat())
    for name in re.findall(r"`(limits\.\w+|obstacles\.\w+|tool_offset|joint_prefix)`", TEXT):
        assert name in names or name == "limits.position_"
    assert f"{arm_configuration.ACCELERATION_TIME_S:g} s to the velocity limit" in TEXT
    assert f"at most {arm_configuration.MAX_ACCELERATION:g} rad/s2" in TEXT
    velocity = arm_configuration.ASSUMED_VELOCITY
    assert f"{velocity[True]:g} rad/s or {velocity[False]:g} m/s" in TEXT
