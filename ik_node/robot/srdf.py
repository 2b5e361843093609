"""SRDF: pairs of links that its author has excluded from collision checking."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

from ik_node.errors import RobotError, SettingsError
from ik_node.robot.catalogue import find, robots_folder
from ik_node.settings.groups import ArmSettings, Settings
from ik_node.settings.yaml_text import bounded_text

SHIPPED = "shipped"
"""Value that selects the SRDF of the robot in example-robot-data."""

Pair = frozenset[str]


def with_srdf_text(settings: Settings) -> Settings:
    """Settings with the text of the SRDF instead of its path, so a recording contains it.

    Raises SettingsError as :func:`read_srdf` does.
    """
    source = settings.obstacles.srdf
    text = read_srdf(source, settings.arm)
    if text == source:
        return settings
    return dataclasses.replace(settings, obstacles=dataclasses.replace(settings.obstacles, srdf=text))


def read_srdf(source: str, arm: ArmSettings) -> str:
    """Reads an SRDF.

    Args:
        source: Text of an SRDF, path of a file, ``shipped`` for that of example-robot-data, or empty.
        arm: Settings with the name of the robot, for ``shipped``.

    Returns:
        The text; empty for an empty ``source``.

    Raises:
        SettingsError: The file cannot be read or is not XML, or example-robot-data has no SRDF of the robot.
    """
    if not source:
        return ""
    text = source
    if not source.lstrip().startswith("<"):
        path = shipped(arm) if source == SHIPPED else Path(source)
        try:
            text = bounded_text(path)
        except (OSError, ValueError) as error:  # InputError, or a NUL in the path
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
    """Path of the SRDF of a robot in example-robot-data; raises SettingsError when it has none."""
    if not arm.robot or arm.robot_description:
        raise SettingsError(f"obstacles.srdf is '{SHIPPED}', which needs a robot by name: set `robot`")
    try:
        entry, root = find(arm.robot), robots_folder()
    except RobotError as error:
        raise SettingsError(f"obstacles.srdf is '{SHIPPED}': {error}") from error
    package = root / Path(entry.urdf).parts[0]
    path = package / (entry.srdf or f"srdf/{Path(entry.urdf).stem}.srdf")
    if path.is_file():
        return path
    existing = ", ".join(str(entry.relative_to(root)) for entry in sorted(package.rglob("*.srdf")))
    raise SettingsError(
        f"example-robot-data has no SRDF for '{arm.robot}'; in its folder: {existing or 'none'} (specify a path)"
    )


def disabled_pairs(text: str, links: Iterable[str]) -> set[Pair]:
    """Pairs of ``links`` that an SRDF disables: ``disable_collisions``, and ``disable_default_collisions`` without
    ``enable_collisions``. Raises SettingsError when it is not XML."""
    try:
        root = _parse(text)
    except ElementTree.ParseError as error:
        raise SettingsError(f"the SRDF is not XML: {error}") from error
    disabled = {entry.get("link", "") for entry in root.iter("disable_default_collisions")}
    by_default = {frozenset(pair) for pair in combinations(sorted(set(links)), 2) if disabled & set(pair)}
    return (by_default - _listed(root, "enable_collisions")) | _listed(root, "disable_collisions")


def _listed(root: ElementTree.Element, kind: str) -> set[Pair]:
    return {frozenset((entry.get("link1", ""), entry.get("link2", ""))) for entry in root.iter(kind)}


def _parse(text: str) -> ElementTree.Element:
    # The text is decoded already, so a declared encoding, which may not exist, does not apply.
    parser = ElementTree.XMLParser(encoding="utf-8")
    return ElementTree.fromstring(text.strip().encode(errors="replace"), parser)
