"""Every parameter of the node: default, both ends, beyond, wrong type, wrong length; at start and in a running node."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from domains import own_domain

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")

from loop import READY, Loop, make_robot  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from ik_node.errors import IkNodeError, SettingsError  # noqa: E402
from ik_node.interfaces.step import Mode  # noqa: E402
from ik_node.ros import parameters, start_arguments  # noqa: E402
from ik_node.ros.node import IkNode  # noqa: E402
from ik_node.settings.groups import Settings, describe  # noqa: E402
from ik_node.settings.schema import Descriptor, limits_per_element  # noqa: E402

ALL = pytest.mark.parametrize("about", describe(), ids=lambda about: about.name)
NAMES = {about.name for about in describe()}
NOTHING_TO_FOLLOW = [math.inf] * 6
"""Within the limits of every element of ``task.tolerance``, but refused: at least one has to be finite."""


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    with own_domain() as found:
        yield found


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    """A context with a node that keeps its participant until the end.

    Fast DDS can wait forever when a participant is destroyed while it discovers another one of the same process: it
    delivers inside the process by calling the other one. So this one has a domain of its own and is destroyed once.
    """
    found = Context()
    with own_domain() as domain:
        rclpy.init(context=found, domain_id=domain)
        keeper = Node("keeper", context=found, start_parameter_services=False, enable_rosout=False)
        yield found
        keeper.destroy_node()
        rclpy.shutdown(context=found)


@pytest.fixture(scope="module")
def running(domain: int) -> Iterator[IkNode]:
    """The node itself, configured and active, in this process."""
    arguments = ["--ros-args", "-p", "robot:=panda", "-p", "obstacles.geometry:=none", "-p", "gain:=[10, 9.5]"]
    # Without its own context a node takes the default one.
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        start_arguments.initialise([*arguments, "-r", "__node:=ik_here"])
    node = IkNode(arguments)
    yield node
    node.destroy_node()
    rclpy.shutdown()


def test_a_configured_node_leaves_little_to_collect(running: IkNode) -> None:
    """A full garbage collection of all that was loaded and compiled takes 0.1 s, in which no command is published."""
    assert running.get_name() == "ik_here"
    assert gc.get_freeze_count() > 50_000


def good(about: Descriptor) -> list[Any]:
    """The default and both ends, and whole numbers for doubles."""
    default: Any = list(about.default) if isinstance(about.default, tuple) else about.default
    if about.choices:
        return [default, *about.choices]
    if isinstance(default, bool):
        return [True, False]
    lows, highs = limits_per_element(about)
    values: list[Any] = [default]
    if isinstance(about.default, str) or about.element is str:
        return values
    for ends in (lows, highs):
        if all(end is not None for end in ends):
            values.append(list(ends) if about.size else [ends[0]] if isinstance(default, list) else ends[0])
    whole = [max(1, math.ceil(low or 0)) for low in lows]
    if all(high is None or number <= high for number, high in zip(whole, highs, strict=True)):
        values.append(whole if about.size else [whole[0]] if isinstance(default, list) else whole[0])
    return [value for value in values if (about.name, value) != ("task.tolerance", NOTHING_TO_FOLLOW)]


def bad(about: Descriptor) -> list[Any]:
    """Beyond both ends, not finite, wrong type, wrong length."""
    default: Any = list(about.default) if isinstance(about.default, tuple) else about.default
    if isinstance(default, str):
        return [1, 1.5, True, ["a"]] + (["none of them"] if about.choices else [])
    if isinstance(default, bool):
        return [1, 0.5, "maybe", [True]]
    if isinstance(default, list) and about.element is str:
        return ["a", 1.0, True, [1], [True]]
    lows, highs = limits_per_element(about)
    numbers = [math.nan, math.inf]
    numbers += [] if lows[0] is None else [lows[0] - 1.0, math.floor(lows[0]) - 1]
    numbers += [] if highs[0] is None else [highs[0] * 2.0 + 1.0]
    if highs[0] == math.inf:  # a component of task.tolerance that is free
        numbers = [number for number in numbers if number != math.inf]
    if not isinstance(default, list):
        return ["text", True, [1.0], *numbers]
    rest = list(default[1:]) if about.size else []
    lists: list[Any] = [[float(number), *rest] for number in numbers]
    return ["text", 1.0, True, ["a"], [True], *lists] + ([[*default, 1.0], default[:1], []] if about.size else [])


def started(context: Context, name: str, value: Any) -> Settings:
    kind = Parameter.Type.DOUBLE_ARRAY if value == [] else None
    node = Node(
        "ik_node",
        context=context,
        parameter_overrides=[Parameter(name, kind, value)],
        start_parameter_services=False,
        enable_rosout=False,
    )
    try:
        parameters.declare(node)
        return parameters.read(node)
    finally:
        node.destroy_node()


@ALL
def test_at_start_a_parameter_takes_what_is_valid_and_names_itself_otherwise(
    context: Context, about: Descriptor
) -> None:
    for value in good(about):
        want = Settings().with_values({about.name: value})
        assert started(context, about.name, value) == want
    for value in bad(about):
        with pytest.raises(SettingsError) as caught:
            started(context, about.name, value)
        assert_names(str(caught.value), about.name)


def assert_names(reason: str, name: str) -> None:
    assert name in reason
    assert "\n" not in reason
    assert "valid" in reason or "read-only" in reason or "expected" in reason, reason


@ALL
def test_in_a_running_node_too(running: IkNode, about: Descriptor) -> None:
    before = running.get_parameter(about.name)
    for value in good(about):
        kind = Parameter.Type.INTEGER_ARRAY if value == [] else None  # whatever type an empty list comes with
        result = running.set_parameters_atomically([Parameter(about.name, kind, value)])
        if about.read_only or not result.successful:
            assert not result.successful
            assert_names(result.reason, about.name)
        else:
            want = Settings().with_values({about.name: value})
            assert parameters.read(running).flat()[about.name] == want.flat()[about.name]
    running.set_parameters_atomically([before])
    for value in bad(about):
        if value == []:
            continue
        result = running.set_parameters_atomically([Parameter(about.name, None, value)])
        assert not result.successful, value
        assert_names(result.reason, about.name)
    result = running.set_parameters_atomically([Parameter(about.name)])  # `ros2 param delete`
    assert not result.successful
    assert_names(result.reason, about.name)
    assert running.get_parameter(about.name).value == before.value


def test_an_unknown_parameter_is_refused_with_the_nearest(context: Context, running: IkNode) -> None:
    for name, nearest in (("gains", "gain"), ("target.time_out_s", "target.timeout_s"), ("autostrat", "autostart")):
        with pytest.raises(SettingsError, match=f"unknown parameter '{name}'; nearest: {nearest}$"):
            started(context, name, 1.0)
        result = running.set_parameters_atomically([Parameter(name, None, 1.0)])
        assert not result.successful
        assert result.reason == f"unknown parameter '{name}'; nearest: {nearest}"
    with pytest.raises(SettingsError, match=r"'gain_linear' was replaced by gain = \[linear, angular\]"):
        started(context, "gain_linear", 1.0)
    for name, value in (("use_sim_time", False), ("qos_overrides./tf.subscription.depth", 3), ("autostart", False)):
        assert started(context, name, value) == Settings()


def test_every_parameter_has_a_value_and_its_type(running: IkNode) -> None:
    names = set(running.list_parameters([], 0).names)
    assert names == NAMES | {"autostart", "use_sim_time", "start_type_description_service"}
    values = running.get_parameters(sorted(names))  # raises for a parameter without a value
    types = {entry.name: entry.type_ for entry in values}
    for about in describe():
        if about.default == ():
            text = about.element is str
            assert types[about.name] is (Parameter.Type.STRING_ARRAY if text else Parameter.Type.DOUBLE_ARRAY)
        assert running.describe_parameter(about.name).read_only == about.read_only
    assert parameters.read(running).control.gain == (10.0, 9.5)


def test_a_file_for_another_node_is_named(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text("/**:\n  ik_node:\n    ros__parameters: {robot: ur5}\n")
    arguments = ["--ros-args", "--params-file", str(file)]
    assert list(start_arguments.unused_files(arguments, "/cell/ik_node")) == []
    (line,) = start_arguments.unused_files(arguments, "/left_arm")
    assert line == f"'{file}' has no parameters for node /left_arm; it has some for /**/ik_node"
    assert list(start_arguments.unused_files(["--params-file", str(file)], "/left_arm")) == []


@pytest.fixture(scope="module")
def moving() -> Loop:
    loop = Loop(make_robot("ur5"), READY["ur5"], Settings().with_values({"obstacles.geometry": "none"}))
    loop.run(0.1)
    return loop


@pytest.mark.parametrize("about", [about for about in describe() if not about.read_only], ids=lambda about: about.name)
def test_while_the_arm_moves(moving: Loop, about: Descriptor) -> None:
    """A change is accepted, or refused with a line that names the parameter; the arm keeps moving in both cases."""
    before = moving.controller.settings
    goal = moving.pose()
    goal[2, 3] += -0.1 if goal[2, 3] > 0.5 else 0.1
    moving.target(goal)
    moving.run(0.1, lambda: moving.target(goal))
    for value in (*good(about), *bad(about)):
        try:
            changed = before.with_values({about.name: value})
            moving.controller.check(changed)
        except IkNodeError as error:
            assert_names(str(error), about.name)
            continue
        moving.controller.apply(changed)
        moving.run(0.01, lambda: moving.target(goal))
        assert np.isfinite(moving.steps[-1].joint_velocity).all()
        assert moving.mode() is not Mode.FAULT
    moving.controller.apply(before)
    moving.run(0.05, lambda: moving.target(goal))
