"""The tolerance of a task: what is refused, and how the components are interpreted."""

from __future__ import annotations

from math import inf, nan, pi
from typing import Any

import pytest

from ik_node.errors import IkNodeError, InputError, UnknownNameError
from ik_node.math.task_error import LOG, SWING, TWIST
from ik_node.math.task_tolerance import TaskTolerance


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0.0] * 5, "has 5 numbers; expected 6: x y z rx ry rz"),
        ([], "has 0 numbers"),
        (0.0, "expected 6 numbers"),
        ([[0.0] * 6], "expected 6 numbers"),
        (["a"] * 6, "expected 6 numbers"),
        (None, "expected 6 numbers"),
        ([0, 0, 0, -0.1, 0, 0], "rx is -0.1; expected a number >= 0, or inf for free"),
        ([0, nan, 0, 0, 0, 0], "y is nan; expected"),
        ([0, 0, -inf, 0, 0, 0], "z is -inf; expected"),
        ([inf] * 6, "all six components free"),
        ([inf, inf, inf, 4.0, 4.0, pi], "all six components free"),
    ],
)
def test_undefined_tolerances_are_refused(values: Any, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("+", r"\+")) as refusal:
        TaskTolerance(values)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("frame", ["world", "", None, 3])
def test_unknown_frames_are_refused(frame: Any) -> None:
    with pytest.raises(UnknownNameError, match="valid: base, tool") as refusal:
        TaskTolerance(frame=frame)
    assert isinstance(refusal.value, IkNodeError)


def test_the_default_is_the_whole_pose() -> None:
    tolerance = TaskTolerance()
    assert tolerance.is_exact
    assert tolerance.exact.all()
    assert not tolerance.free.any()
    assert TaskTolerance([0, 0.0, -0.0, 0, 0, 0]).text() == "0 0 0 0 0 0"


def test_a_rotation_of_half_a_turn_or_more_is_free() -> None:
    assert TaskTolerance([4.0, 0, 0, 0, 0, 3.5]).free.tolist() == [False] * 5 + [True]
    assert TaskTolerance([0, 0, 0, 0, 0, 3.14]).free.tolist() == [False] * 6


@pytest.mark.parametrize(
    ("rotation", "form", "axis", "shortest"),
    [
        ([0, 0, 0], LOG, 2, True),
        ([0.1, 0.1, 0.1], LOG, 2, False),
        ([0.1, 0, 0.1], LOG, 2, False),
        ([inf, inf, inf], LOG, 2, False),
        ([0, 0, inf], SWING, 2, True),
        ([inf, 0, 0.1], SWING, 0, False),
        ([0, 0.5, 0], SWING, 1, True),
        ([inf, inf, 0], TWIST, 2, False),
        ([0.1, inf, inf], TWIST, 0, False),
    ],
)
def test_the_form_of_the_rotation_follows_from_what_is_free(
    rotation: list[float], form: int, axis: int, shortest: bool
) -> None:
    chosen = TaskTolerance([0, 0, 0, *rotation]).form
    assert (chosen.rotation, chosen.shortest) == (form, shortest)
    if form != LOG:
        assert chosen.axis == axis
