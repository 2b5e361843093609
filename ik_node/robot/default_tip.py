"""Default tool frame: the end of the longest chain of joints that move an arm, not a gripper.

A gripper ends the longest chain of most URDFs. Its joints follow another driver and must not take part in the arm's
motion. The last joints of the chain are those of a gripper if one of four conditions holds:

- a joint mimics another, or is mimicked by one that is not above the tool (coupled fingers);
- the link that carries it carries further chains of joints that are short or many (the fingers of a hand);
- the link that carries it has a tool frame, a fixed link with a name such as ``tcp``, beside it (a jaw);
- its name, or that of its link, is a gripper's (``jaw``, ``finger_joint1``) and no wrist's (``gripper_roll``).

At least one joint is always left: the legs of a robot without an arm, or the fingers of a hand alone, are chains too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ik_node.robot.mimic import Mimic

LONGEST_FINGER = 4
"""Joints of a finger; chains with more, beside others on one link, are arms or legs unless they are many."""
FINGERS_OF_A_HAND = 4
"""Chains on one link that are fingers however long they are; a torso has two arms and a head."""
SHORTEST_ARM = 3
"""Joints before a link whose further chains are taken for fingers; a torso with a head and an arm has fewer."""
GRIPPER_WORDS = frozenset(
    ("gripper", "finger", "fingers", "jaw", "claw", "knuckle", "thumb", "hand", "grasp", "pincer")
)
WRIST_WORDS = frozenset(("roll", "pitch", "yaw", "rotate", "rotation", "wrist", "twist", "pan", "tilt", "flex"))
TOOL_WORDS = ("gripper", "flange", "tip", "grasp", "effector", "eef", "ee", "tool", "tool0", "tcp")
"""Words of tool frames; of several links the one with the latest word is taken."""
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+\d?")


class DefaultTip(NamedTuple):
    """The default tool frame."""

    frame: str
    """Name of a link."""
    gripper: tuple[str, ...]
    """Joints at the end of the longest chain that are a gripper's and are left out."""


def default_tip(model: Any, mimics: Mapping[str, Mimic]) -> DefaultTip:
    """Finds the end of an arm.

    Args:
        model: Complete Pinocchio model.
        mimics: Mimic joints by name.

    Returns:
        A link that the last joint of the arm moves: where a gripper is left out, one that is named as a tool, else the
        last one in the URDF.
    """
    depth = max(len(model.supports[frame.parentJoint]) for frame in model.frames)
    deepest = next(frame for frame in model.frames if len(model.supports[frame.parentJoint]) == depth)
    chain = [index for index in model.supports[deepest.parentJoint] if index > 0]
    arm = chain[: _first_of_gripper(model, chain, mimics)]
    links = _links(model, arm[-1] if arm else deepest.parentJoint)
    frame = links[-1] if len(arm) == len(chain) else max(reversed(links), key=_tool_rank)
    return DefaultTip(frame, tuple(model.names[index] for index in chain[len(arm) :]))


def _first_of_gripper(model: Any, chain: list[int], mimics: Mapping[str, Mimic]) -> int:
    """Position in the chain of the first joint of the gripper; the length of the chain without a gripper."""
    first = len(chain)
    for position in range(len(chain) - 1, 0, -1):
        carrier, joint = chain[position - 1], chain[position]
        depths = [_depth(model, child) for child in _children(model, carrier) if child != joint]
        are_short = len(chain) - position <= LONGEST_FINGER and min(depths, default=np.inf) <= LONGEST_FINGER
        are_fingers = position >= SHORTEST_ARM and (are_short or len(depths) + 1 >= FINGERS_OF_A_HAND)
        if are_fingers or (first == position + 1 and _is_of_gripper(model, chain, position, mimics)):
            first = position
    return first if first == len(chain) or not _is_named_gripper(model.names[chain[first - 1]]) else len(chain)


def _is_of_gripper(model: Any, chain: list[int], position: int, mimics: Mapping[str, Mimic]) -> bool:
    """Whether a joint, of which all later ones of the chain are a gripper's or none, is a gripper's by itself."""
    name = model.names[chain[position]]
    above = {model.names[index] for index in chain[:position]}
    if name in mimics or any(mimic.master == name and other not in above for other, mimic in mimics.items()):
        return not (name in mimics and mimics[name].master in above)
    words = _words(name)
    if position == len(chain) - 1:
        beside = _leaves(model, chain[position - 1])
        if any(_tool_rank(link) >= 0 for link in beside):
            return True
        words = words | frozenset().union(*(_words(link) for link in _links(model, chain[position])[:1]))
    return bool(GRIPPER_WORDS & words) and not WRIST_WORDS & _words(name)


def _is_named_gripper(joint: str) -> bool:
    return bool(GRIPPER_WORDS & _words(joint)) and not WRIST_WORDS & _words(joint)


def _tool_rank(link: str) -> int:
    """Position in :data:`TOOL_WORDS` of the latest word of a link's name; -1 for none."""
    return max((TOOL_WORDS.index(word) for word in _words(link) if word in TOOL_WORDS), default=-1)


def _words(name: str) -> frozenset[str]:
    return frozenset(word.lower() for word in _WORD.findall(name))


def _children(model: Any, joint: int) -> Iterator[int]:
    return (index for index in range(1, model.njoints) if model.parents[index] == joint)


def _depth(model: Any, joint: int) -> int:
    """Number of joints of the longest chain that begins with ``joint``."""
    return 1 + max((_depth(model, child) for child in _children(model, joint)), default=0)


def _links(model: Any, joint: int) -> list[str]:
    """Links that a joint moves, without those of further joints, in the order of the URDF."""
    return [str(f.name) for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint]


def _leaves(model: Any, joint: int) -> list[str]:
    """Links fixed to another link that ``joint`` moves, which carry nothing."""
    carrying = {frame.parentFrame for frame in model.frames if frame.type != pin.FrameType.BODY}
    return [
        str(frame.name)
        for index, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
        and frame.parentJoint == joint
        and index not in carrying
        and model.frames[frame.parentFrame].type == pin.FrameType.FIXED_JOINT
    ]
