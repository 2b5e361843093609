"""Mimic joints of a URDF: q_mimic = multiplier q_master + offset.

A mimic joint is not a coordinate. The model keeps it as a joint, and quantities per joint are transformed to the
controlled joints: with the positions of all moving joints q_m = A q + b, a Jacobian becomes J A, a mass matrix A' M A,
a gradient A' g. (The mimic joints of Pinocchio 4.1 do not work with reduced models: fixing a master fails, and fixing
both counts one velocity too many.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ik_node.errors import RobotError
from ik_node.math.types import Array


class Mimic(NamedTuple):
    """Coupling of a mimic joint to its master."""

    master: str
    """A joint that is not a mimic joint."""
    multiplier: float
    """rad (m) per rad (m) of the master."""
    offset: float
    """rad (m)."""


class MimicMap(NamedTuple):
    """Positions of all m moving joints from the n controlled ones, which come first: q_m = ``ratio`` q + ``offset``."""

    ratio: Array
    """A, (m, n)."""
    offset: Array
    """b, (m,), rad (m)."""


def read_mimics(tags: Mapping[str, Mapping[str, str]]) -> dict[str, Mimic]:
    """Mimic joints by name; a chain of mimic joints is resolved to its last master.

    Masters are not checked for existence, because URDFs name joints that do not exist.

    Args:
        tags: Name of each mimic joint -> attributes of its <mimic> element.

    Raises:
        RobotError: A joint mimics itself, or its multiplier or offset is not a finite number; names the joint.
    """
    mimics = {name: _read(name, tag) for name, tag in tags.items()}
    return {name: _resolved(name, mimics) for name in mimics}


def _read(name: str, tag: Mapping[str, str]) -> Mimic:
    try:
        multiplier, offset = (float(tag.get(key, usual)) for key, usual in (("multiplier", "1"), ("offset", "0")))
    except ValueError as error:
        raise RobotError(f"joint '{name}' has a mimic multiplier or offset that is not a number: {error}") from error
    if not np.isfinite((multiplier, offset)).all():
        raise RobotError(
            f"joint '{name}' has mimic multiplier {multiplier:g} and offset {offset:g}; expected finite numbers"
        )
    return Mimic(tag.get("joint", ""), multiplier, offset)


def _resolved(name: str, mimics: Mapping[str, Mimic]) -> Mimic:
    visited, result = {name}, mimics[name]
    while result.master in mimics:
        if result.master in visited:
            raise RobotError(f"joint '{name}' mimics itself in a circle")
        visited.add(result.master)
        master, multiplier, offset = mimics[result.master]
        result = Mimic(master, result.multiplier * multiplier, result.multiplier * offset + result.offset)
    return result


def mimic_map(controlled: Sequence[str], followers: Sequence[Mimic]) -> MimicMap:
    """Map from the controlled joints to the controlled joints and, after them, the mimic joints ``followers``."""
    n = len(controlled)
    ratio = np.vstack((np.eye(n), np.zeros((len(followers), n))))
    offset = np.zeros(len(ratio))
    for row, mimic in enumerate(followers, n):
        ratio[row, controlled.index(mimic.master)] = mimic.multiplier
        offset[row] = mimic.offset
    return MimicMap(ratio, offset)


def master_range(mimic: Mimic, master: tuple[float, float], own: tuple[float, float]) -> tuple[float, float]:
    """Range (lower, upper) of the master in which both joints are within their limits.

    Limits of the mimic joint that leave no range are ignored, because URDFs often copy the limits of the master
    without regard to the multiplier.
    """
    if mimic.multiplier == 0.0:
        return master
    ends = sorted((end - mimic.offset) / mimic.multiplier for end in own)
    lower, upper = max(master[0], ends[0]), min(master[1], ends[1])
    return (lower, upper) if lower < upper else master
