"""Mimic joints of a URDF: q_mimic = multiplier q_master + offset.

A mimic joint is no coordinate of its own. The model keeps it as a joint, and all that is per joint is folded onto the
controlled ones: with the positions of all moving joints q_m = A q + b, a Jacobian becomes J A, a mass matrix A' M A, a
gradient A' g. (Pinocchio 4.1 has a mimic joint model, but its reduced models do not hold together: holding a master
fails, holding both counts a velocity too many.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ik_node.errors import RobotError
from ik_node.math.types import Array


class Mimic(NamedTuple):
    """What one joint does after another."""

    master: str
    """A joint that mimics none."""
    multiplier: float
    """rad (m) per rad (m) of the master."""
    offset: float
    """rad (m)."""


class Following(NamedTuple):
    """How all moving joints, m of them, hang on the n controlled ones, which come first: q_m = ``ratio`` q +
    ``offset``."""

    ratio: Array
    """A, (m, n)."""
    offset: Array
    """b, (m,), rad (m)."""


def read_mimics(urdf: str) -> dict[str, Mimic]:
    """The mimic joints of a URDF by name; one that mimics a mimic joint is told after the last in the row.

    Masters are not looked for: descriptions name ones that do not exist. Raises RobotError naming the joint when it
    mimics itself in a circle, or its numbers are none.
    """
    if "<mimic" not in urdf:
        return {}
    try:
        root = ElementTree.fromstring(urdf.strip().encode())
    except ElementTree.ParseError as error:
        raise RobotError(f"robot_description is no XML: {error}") from error
    joints = {str(joint.get("name")): joint.find("mimic") for joint in root.findall("joint")}
    told = {name: _told(name, tag) for name, tag in joints.items() if tag is not None}
    return {name: _resolved(name, told) for name in told}


def _told(name: str, tag: ElementTree.Element) -> Mimic:
    try:
        multiplier, offset = (float(tag.get(key, usual)) for key, usual in (("multiplier", "1"), ("offset", "0")))
    except ValueError as error:
        raise RobotError(f"joint '{name}' mimics by a number that is none: {error}") from error
    if not np.isfinite((multiplier, offset)).all():
        raise RobotError(f"joint '{name}' mimics by {multiplier:g} and {offset:g}; expected finite numbers")
    return Mimic(tag.get("joint", ""), multiplier, offset)


def _resolved(name: str, told: Mapping[str, Mimic]) -> Mimic:
    seen, result = {name}, told[name]
    while result.master in told:
        if result.master in seen:
            raise RobotError(f"joint '{name}' mimics itself in a circle")
        seen.add(result.master)
        master, multiplier, offset = told[result.master]
        result = Mimic(master, result.multiplier * multiplier, result.multiplier * offset + result.offset)
    return result


def following(controlled: Sequence[str], followers: Sequence[Mimic]) -> Following:
    """How the controlled joints and, after them, ``followers`` move with the controlled ones."""
    n = len(controlled)
    ratio = np.vstack((np.eye(n), np.zeros((len(followers), n))))
    offset = np.zeros(len(ratio))
    for row, mimic in enumerate(followers, n):
        ratio[row, controlled.index(mimic.master)] = mimic.multiplier
        offset[row] = mimic.offset
    return Following(ratio, offset)


def masters_range(mimic: Mimic, master: tuple[float, float], own: tuple[float, float]) -> tuple[float, float]:
    """Where the master may be, so that both are within their limits (lower, upper).

    A mimic joint's own limits that leave the master nowhere to go cannot be meant, and are ignored: descriptions often
    copy the master's without a thought for the multiplier.
    """
    if mimic.multiplier == 0.0:
        return master
    ends = sorted((end - mimic.offset) / mimic.multiplier for end in own)
    lower, upper = max(master[0], ends[0]), min(master[1], ends[1])
    return (lower, upper) if lower < upper else master
