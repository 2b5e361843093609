"""SRDF: which pairs of links need no watching, as its author knows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

from ik_node.errors import RobotError, SettingsError
from ik_node.robot.catalogue import find, robots_folder
from ik_node.settings.groups import ArmSettings, Settings

SHIPPED = "shipped"
"""Stands for the SRDF that example-robot-data has for the robot."""

Pair = frozenset[str]


def with_srdf_text(settings: Settings) -> Settings:
    """``settings`` with the SRDF itself in place of its file's name, so that a recording holds what counted.

    Raises SettingsError as :func:`read_srdf` does.
    """
    wanted = settings.obstacles.srdf
    text = read_srdf(wanted, settings.arm)
    if text == wanted:
        return settings
    return dataclasses.replace(settings, obstacles=dataclasses.replace(settings.obstacles, srdf=text))


def read_srdf(wanted: str, arm: ArmSettings) -> str:
    """The text of an SRDF: ``wanted`` itself, of the file it names, or for ``shipped`` of example-robot-data's.

    Raises SettingsError where there is none, or it is no SRDF.
    """
    if not wanted:
        return ""
    text = wanted
    if not wanted.lstrip().startswith("<"):
        path = shipped(arm) if wanted == SHIPPED else Path(wanted)
        try:
            text = path.read_text()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise SettingsError(
                f"obstacles.srdf cannot be read: {path}: {reason}; valid: SRDF text, the path of a file, {SHIPPED}"
            ) from error
    try:
        _parse(text)
    except ElementTree.ParseError as error:
        raise SettingsError(f"obstacles.srdf is not XML: {error}") from error
    return text


def shipped(arm: ArmSettings) -> Path:
    """Where example-robot-data has the SRDF of the robot that ``arm`` names; SettingsError where it has none."""
    if not arm.robot or arm.robot_description:
        raise SettingsError(f"obstacles.srdf is '{SHIPPED}', which needs a robot by name: set `robot`")
    try:
        known, root = find(arm.robot), robots_folder()
    except RobotError as error:
        raise SettingsError(f"obstacles.srdf is '{SHIPPED}': {error}") from error
    package = root / Path(known.urdf).parts[0]
    path = package / (known.srdf or f"srdf/{Path(known.urdf).stem}.srdf")
    if path.is_file():
        return path
    there = ", ".join(str(entry.relative_to(root)) for entry in sorted(package.rglob("*.srdf")))
    raise SettingsError(
        f"example-robot-data has no SRDF for '{arm.robot}'; in its folder: {there or 'none'} (give a path to use one)"
    )


def disabled_pairs(text: str, links: Iterable[str]) -> set[Pair]:
    """Pairs of ``links`` that an SRDF disables: ``disable_collisions``, and ``disable_default_collisions`` less
    ``enable_collisions``. SettingsError when it is not XML."""
    try:
        root = _parse(text)
    except ElementTree.ParseError as error:
        raise SettingsError(f"the SRDF is not XML: {error}") from error
    quiet = {entry.get("link", "") for entry in root.iter("disable_default_collisions")}
    by_default = {frozenset(pair) for pair in combinations(sorted(set(links)), 2) if quiet & set(pair)}
    return (by_default - _listed(root, "enable_collisions")) | _listed(root, "disable_collisions")


def _listed(root: ElementTree.Element, kind: str) -> set[Pair]:
    return {frozenset((entry.get("link1", ""), entry.get("link2", ""))) for entry in root.iter(kind)}


def _parse(text: str) -> ElementTree.Element:
    # The parser refuses text with an encoding declaration that is not its own; bytes it takes.
    return ElementTree.fromstring(text.strip().encode())
