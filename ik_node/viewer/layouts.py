"""Layouts of Foxglove and PlotJuggler with the topics and joints of a recording, made from those in ``config/``."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

FOXGLOVE, PLOTJUGGLER = "foxglove_layout.json", "plotjuggler_layout.xml"
COLOURS = ("#1f77b4", "#d62728", "#1ac938", "#ff7f0e", "#9467bd", "#17becf", "#bcbd22")
_ELEMENT = re.compile(r"\[\d+\]$")
_JOINT_CURVE = re.compile(r"^(/.*)/panda_joint1/(\w+)$")


def write_layouts(
    templates: Path,
    folder: Path,
    topics: Mapping[str, str],
    joints: tuple[str, ...],
    base_frame: str,
    drawn: Mapping[str, bool],
) -> None:
    """Writes both layouts.

    Args:
        templates: Folder of the layouts to start from.
        folder: An existing folder.
        topics: Beginning of a topic in ``config/`` -> beginning in the recording.
        joints: Names of the controlled joints.
        base_frame: Frame in which the 3D panel is drawn.
        drawn: Topic -> whether the 3D panel shows it, besides those of ``config/``.
    """
    foxglove = json.loads((templates / FOXGLOVE).read_text(encoding="utf-8"))
    layout = _renamed(foxglove, topics)
    for panel in layout["configById"].values():
        if "paths" in panel:
            panel["paths"] = _paths_of_joints(panel["paths"], joints)
        if "followMode" in panel:
            panel["followTf"] = base_frame
            panel["topics"].update({topic: {"visible": shown} for topic, shown in drawn.items()})
    (folder / FOXGLOVE).write_text(json.dumps(layout, indent=1), encoding="utf-8")
    tree = ElementTree.parse(templates / PLOTJUGGLER)
    for plot in tree.iter("plot"):
        _curves_of_joints(plot, topics, joints)
    tree.write(folder / PLOTJUGGLER, encoding="UTF-8", xml_declaration=True)


def _renamed(value: Any, topics: Mapping[str, str]) -> Any:
    """JSON with other topics in all keys and texts."""
    if isinstance(value, dict):
        return {_topic(key, topics): _renamed(entry, topics) for key, entry in value.items()}
    if isinstance(value, list):
        return [_renamed(entry, topics) for entry in value]
    return _topic(value, topics) if isinstance(value, str) else value


def _topic(text: str, topics: Mapping[str, str]) -> str:
    for begin, replacement in topics.items():
        if text.startswith(begin):
            return replacement + text[len(begin) :]
    return text


def _paths_of_joints(paths: list[dict[str, Any]], joints: tuple[str, ...]) -> list[dict[str, Any]]:
    """Paths of array elements, of which the template has one per joint of a Panda, for ``joints``."""
    first = paths[0]
    if not _ELEMENT.search(first["value"]):
        return paths
    return [
        {**first, "value": _ELEMENT.sub(f"[{index}]", first["value"]), "label": joint}
        for index, joint in enumerate(joints)
    ]


def _curves_of_joints(plot: ElementTree.Element, topics: Mapping[str, str], joints: tuple[str, ...]) -> None:
    curves = plot.findall("curve")
    for curve in curves:
        curve.set("name", _topic(curve.get("name", ""), topics))
    found = _JOINT_CURVE.match(curves[0].get("name", "")) if curves else None
    if found is None:
        return
    for curve in curves:
        plot.remove(curve)
    for index, joint in enumerate(joints):
        name = f"{found.group(1)}/{joint}/{found.group(2)}"
        ElementTree.SubElement(plot, "curve", color=COLOURS[index % len(COLOURS)], name=name)
