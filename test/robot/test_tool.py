"""The tool offset: the tip is at the offset for any rotation, and everything else is unchanged."""

from __future__ import annotations

import numpy as np
import pytest

from ik_node.errors import InputError, RobotError
from ik_node.math import se3
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.robot.tool import with_tool

PANDA = catalogue.find("panda")
URDF = catalogue.read_urdf(PANDA)
Q = np.array([0.1, -0.7, 0.2, -2.2, 0.1, 1.6, 0.7])
GENERATOR = np.random.default_rng(5)
TURNS = [
    np.zeros(3),
    *GENERATOR.normal(size=(5, 3)),
    *(angle * axis for axis in np.eye(3) for angle in (np.pi / 2, -np.pi / 2, np.pi)),
]


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_the_tip_is_where_the_offset_says(turn: np.ndarray) -> None:
    offset = np.eye(4)
    offset[:3, :3] = se3.exp_rotation(turn)
    offset[:3, 3] = (0.01, -0.02, 0.15)
    numbers = (*offset[:3, 3].tolist(), *se3.quaternion_from_rotation(offset[:3, :3]).tolist())
    changed = with_tool(URDF, PANDA.tip_frame, numbers)
    plain = Robot(URDF, PANDA.base_frame, PANDA.tip_frame)
    tooled = Robot(changed.urdf, PANDA.base_frame, changed.tip_frame)
    assert tooled.joints == plain.joints
    assert np.abs(tooled.pose(Q) - plain.pose(Q) @ offset).max() < 1e-12
    moved = se3.adjoint(se3.inverse(offset)) @ plain.evaluate(Q).jacobian_b
    assert np.abs(tooled.evaluate(Q).jacobian_b - moved).max() < 1e-12
    assert np.abs(tooled.dynamics(Q).mass_matrix - plain.dynamics(Q).mass_matrix).max() < 1e-12
    assert tooled.moves_with_tool(PANDA.tip_frame)


@pytest.mark.parametrize(
    ("tip", "offset", "error", "reason"),
    [
        ("panda_hand_tcp", (0.0,) * 6, RobotError, "tool_offset has 6 numbers; expected 7"),
        ("panda_hand_tcp", (0.0,) * 7, InputError, "tool_offset quaternion has norm 0"),
        ("panda_hand_tcp", (np.nan, 0, 0, 0, 0, 0, 1), InputError, "tool_offset position is not finite"),
        (
            "panda_joint8",
            (0, 0, 0, 0, 0, 0, 1),
            RobotError,
            "needs a link as tip_frame, not 'panda_joint8'; links: pan",
        ),
    ],
)
def test_what_is_no_tool_is_refused(tip: str, offset: tuple[float, ...], error: type[Exception], reason: str) -> None:
    with pytest.raises(error, match=reason):
        with_tool(URDF, tip, offset)


def test_a_second_tool_is_refused() -> None:
    once = with_tool(URDF, "panda_hand_tcp", (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0))
    with pytest.raises(RobotError, match="which exists already"):
        with_tool(once.urdf, "panda_hand_tcp", (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0))
