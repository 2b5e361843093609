"""Robot description: one reading of the XML, and the checks that precede Pinocchio's.

Pinocchio and urdfdom do not check everything: a loop of links is a segmentation fault, an axis of length zero gives
rotation matrices that are none, and infinite numbers reach the kinematics. :func:`read_description` therefore reads the
URDF, names the offending link or joint, and returns the text that Pinocchio gets, written from the tree that was
checked. Both hence see the same elements, also where XML parsers differ (encoding declarations, namespace prefixes).

Names are compared as urdfdom does, without regard to namespaces. Undeclared prefixes, which <gazebo> often contains,
are therefore valid. The syntax of numbers is left to urdfdom, whose reason reaches the user.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from html import unescape
from typing import NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

from ik_node.errors import RobotError
from ik_node.robot.mimic import Mimic, read_mimics

MAX_CHARACTERS = 2_000_000
"""Ten times the largest URDF of example-robot-data; reading it takes less than a second."""
MAX_DEPTH = 100
"""Largest depth of elements; URDFs have five levels, <gazebo> some more. Writing the tree is recursive."""
MAX_LINKS = 2000
"""Ten times the links of a humanoid with hands; Pinocchio's reading is recursive, and its time quadratic."""
MAX_NUMBER = 1e9
"""Largest origin, axis, inertia or dimension: products of much larger numbers overflow."""
MIN_AXIS = 1e-6
"""Shortest axis of a joint whose direction is meant, not a rounding error."""

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
"""Joint types of URDF."""

_NUMERIC = frozenset(
    ("xyz", "rpy", "value", "ixx", "iyy", "izz", "ixy", "ixz", "iyz", "lower", "upper", "velocity", "effort")
) | frozenset(("multiplier", "offset", "size", "radius", "length", "scale", "damping", "friction"))
"""Attributes of links and joints whose values are numbers."""
_UNLIMITED = frozenset(("limit", "safety_controller", "dynamics"))
"""Elements whose numbers may exceed ``MAX_NUMBER``, because exporters write huge limits for none."""
_NAME = re.compile(r"<(?:\w+:)?robot\b[^>]*\bname\s*=\s*[\"']([^\"']*)")
_DECLARATION = re.compile(r"\A\s*<\?xml\b[^>]*\?>")


class JointRecord(NamedTuple):
    """A <joint> as it is written."""

    name: str
    type: str
    """One of :data:`JOINT_TYPES`."""
    parent: str
    """Name of the parent link."""
    child: str
    """Name of the child link."""
    limit: Mapping[str, str] | None
    """Attributes of <limit>, as text; None without the element."""


class Description(NamedTuple):
    """A URDF that passed the checks."""

    text: str
    """The URDF for Pinocchio, written from the checked tree."""
    joints: Mapping[str, JointRecord]
    """All joints by name, in the order of the file."""
    masses: Mapping[str, float]
    """Mass of all links by name, kg; 0 without <inertial>."""
    mimics: Mapping[str, Mimic]
    """Mimic joints by name."""


def robot_name(urdf: str) -> str:
    """Value of the attribute ``name`` of a URDF's robot element; ``robot`` if there is none."""
    found = _NAME.search(urdf)
    return (found and unescape(found.group(1)).strip()) or "robot"


def read_description(urdf: str) -> Description:
    """Reads and checks a URDF.

    Args:
        urdf: Text of the URDF.

    Returns:
        The description. Its links and joints form one tree.

    Raises:
        RobotError: The text is too long or not XML, the links and joints are not a tree, a number is not finite, an
            axis is zero, or a mimic joint mimics itself; names the link or joint.
    """
    try:
        root = _parse(urdf)
        links = _named(root, "link")
        joints = {name: _joint(name, element) for name, element in _named(root, "joint").items()}
        _check_tree(tuple(links), joints.values())
        for kind in ("link", "joint"):
            for element in root.findall(kind):
                _check_numbers(f"{kind} '{element.get('name')}'", element)
        for element in root.findall("joint"):
            _check_axis(joints[str(element.get("name"))], element)
        tags = {str(element.get("name")): element.find("mimic") for element in root.findall("joint")}
        mimics = read_mimics({name: tag.attrib for name, tag in tags.items() if tag is not None})
    except RobotError as error:
        raise RobotError(f"robot_description is not a valid URDF: {error}") from error
    _without_negative_limits(root)
    masses = {name: _mass(element) for name, element in links.items()}
    _drop_negative_limits(root)
    return Description(ElementTree.tostring(root, encoding="unicode"), joints, masses, mimics)


# --- XML -------------------------------------------------------------------------------------------------------------


def _parse(urdf: str) -> ElementTree.Element:
    """Root element <robot>; names keep their prefixes, except the prefix of the root."""
    if len(urdf) > MAX_CHARACTERS:
        raise RobotError(f"it has {len(urdf)} characters; expected at most {MAX_CHARACTERS}")
    # The text is decoded already, so a declared encoding does not apply.
    text = _DECLARATION.sub("", urdf.removeprefix("\ufeff")).strip()
    if not text:
        raise RobotError("it is empty")
    builder, depth = ElementTree.TreeBuilder(), 0
    parser = expat.ParserCreate("utf-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise RobotError(f"its elements are nested more than {MAX_DEPTH} levels deep at <{tag}>")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def entity(name: str, *_: object) -> None:
        raise RobotError(f"it declares the entity '{name}'; URDFs have none")

    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = start, end, entity
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text.encode(), True)
    except (expat.ExpatError, UnicodeEncodeError) as error:
        raise RobotError(f"not XML: {error}") from error
    root = builder.close()
    prefix, colon, name = root.tag.rpartition(":")
    if name != "robot":
        raise RobotError(f"its root element is <{root.tag}>; expected <robot>")
    for element in root.iter():
        if element.tag.startswith("xacro:"):
            raise RobotError(f"it is a xacro file (<{element.tag}>); write the URDF with: xacro FILE > arm.urdf")
    if prefix:
        for element in root.iter():
            element.tag = element.tag.removeprefix(prefix + colon)
    return root


def _named(root: ElementTree.Element, kind: str) -> dict[str, ElementTree.Element]:
    """Children of the kind ``link`` or ``joint`` by name."""
    elements = root.findall(kind)
    names = [element.get("name", "") for element in elements]
    if "" in names:
        raise RobotError(f"{kind} number {names.index('') + 1} has no name")
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise RobotError(f"{kind} name '{repeated[0]}' occurs {names.count(repeated[0])} times")
    if kind == "link" and not 0 < len(names) <= MAX_LINKS:
        raise RobotError(f"it has {len(names)} links; expected 1 to {MAX_LINKS}")
    return dict(zip(names, elements, strict=True))


def _joint(name: str, element: ElementTree.Element) -> JointRecord:
    ends = []
    for role in ("parent", "child"):
        tag = element.find(role)
        link = "" if tag is None else tag.get("link", "")
        if not link:
            raise RobotError(f"joint '{name}' has no {role} link")
        ends.append(link)
    kind = element.get("type", "")
    if kind not in JOINT_TYPES:
        raise RobotError(f"joint '{name}' has type '{kind}'; valid: {', '.join(JOINT_TYPES)}")
    limit = element.find("limit")
    return JointRecord(name, kind, ends[0], ends[1], None if limit is None else dict(limit.attrib))


# --- tree ------------------------------------------------------------------------------------------------------------


def _check_tree(links: tuple[str, ...], joints: Iterable[JointRecord]) -> None:
    """Raises RobotError unless every link but one is the child of one joint, and no links form a loop."""
    known = set(links)
    above: dict[str, JointRecord] = {}
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in known:
                raise RobotError(f"joint '{joint.name}' has the {role} link '{link}', which does not exist")
        if joint.child in above:
            names = f"'{above[joint.child].name}', '{joint.name}'"
            raise RobotError(f"link '{joint.child}' has two parents: joints {names}")
        above[joint.child] = joint
    reaches_root: set[str] = set()
    for link in links:
        path: dict[str, str] = {}
        while link in above and link not in reaches_root:
            if link in path:
                loop = list(path)[list(path).index(link) :]
                joint_names = _listed(path[name] for name in loop)
                raise RobotError(f"links {_listed(loop)} form a loop: joints {joint_names}")
            path[link] = above[link].name
            link = above[link].parent  # noqa: PLW2901
        reaches_root.update(path)
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise RobotError(f"links {_listed(roots)} have no parent joint; expected one root link")


def _listed(names: Iterable[str], most: int = 6) -> str:
    """Quoted names; of many the first ``most``."""
    quoted = [f"'{name}'" for name in names]
    more = f" and {len(quoted) - most} more" if len(quoted) > most else ""
    return ", ".join(quoted[:most]) + more


# --- numbers ---------------------------------------------------------------------------------------------------------


def _check_numbers(owner: str, element: ElementTree.Element) -> None:
    """Raises RobotError naming the first number of a link or joint that is not finite or too large."""
    for part in element.iter():
        for attribute, text in part.attrib.items():
            if attribute not in _NUMERIC:
                continue
            bound = math.inf if part.tag in _UNLIMITED else MAX_NUMBER
            for number in _numbers(text):
                if not math.isfinite(number) or abs(number) > bound:
                    allowed = "finite numbers" if bound == math.inf else f"finite numbers up to {bound:g}"
                    raise RobotError(f"{owner} has {attribute} '{text}' in <{part.tag}>; expected {allowed}")


def _without_negative_limits(root: ElementTree.Element) -> None:
    """Sets negative velocity and effort limits to 0: Pinocchio refuses a model with them, without naming the joint.

    Efforts are not used; :func:`ik_node.robot.joint_limits.limit_faults` names velocities of 0 or less.
    """
    for limit in root.iterfind("joint/limit"):
        for attribute in ("velocity", "effort"):
            if any(number < 0.0 for number in _numbers(limit.get(attribute, ""))):
                limit.set(attribute, "0")


def _numbers(text: str) -> list[float]:
    """The numbers in a text; words that are none are left to urdfdom."""
    numbers = []
    for word in text.split():
        try:
            numbers.append(float(word))
        except ValueError:
            continue
    return numbers


def _check_axis(joint: JointRecord, element: ElementTree.Element) -> None:
    axis = element.find("axis")
    if axis is None or joint.type not in ("revolute", "continuous", "prismatic"):
        return
    text = axis.get("xyz")
    if text is None:  # urdfdom takes zero; without <axis> it takes x
        raise RobotError(f"joint '{joint.name}' has an <axis> without xyz")
    numbers = _numbers(text)
    if len(numbers) == 3 and math.hypot(*numbers) < MIN_AXIS:
        raise RobotError(f"joint '{joint.name}' has the axis '{text}'; expected a direction, not zero")


def _drop_negative_limits(root: ElementTree.Element) -> None:
    """Sets negative efforts and velocities to 0: Pinocchio refuses them without a name.

    Efforts are not used; velocities are judged by the records (:func:`ik_node.robot.joint_limits.limit_faults`).
    """
    for limit in root.findall("joint/limit"):
        for attribute in ("effort", "velocity"):
            if any(number < 0.0 for number in _numbers(limit.get(attribute, ""))):
                limit.set(attribute, "0")


def _mass(element: ElementTree.Element) -> float:
    tag = element.find("inertial/mass")
    numbers = [] if tag is None else _numbers(tag.get("value", ""))
    return numbers[0] if numbers else 0.0
