"""Selection of the link pairs whose distances are computed.

As in MoveIt's setup assistant, pairs of adjacent links and pairs in permanent contact are left out. With an SRDF its
disabled pairs are left out; without one the pairs are judged by their distances at positions spread evenly over the
joint ranges. Pairs named in the settings override both.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ik_node.errors import UnknownNameError
from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.srdf import disabled_pairs

SAMPLES = 1000
"""Number of sampled joint positions."""

PERMANENT_CONTACT = 0.95
"""Ratio of samples in collision from which a pair counts as in permanent contact."""

CLOSE_M = 0.03
"""Pairs that never exceed this distance are neighbours; their simplified solids do not resolve contact."""

REMEMBERED = 16
"""Robots of which the sampled distances are kept: a process makes several controllers of one arm, also to warm up."""


class Link(NamedTuple):
    """One convex solid."""

    name: str
    """Name of the link."""
    parent: int
    """Index of the joint of the model to which the link is attached."""
    solid: Any
    """The coal shape."""
    placement: Any
    """Pose of the solid in the joint's frame, pin.SE3."""
    points: Array
    """Corners in the joint's frame, (p, 3); for a primitive: corners of a polyhedron around it."""
    mesh: Any
    """The coal mesh from which the solid was made, or None."""


class LinkPair(NamedTuple):
    """A pair of links, and whether its distance is computed."""

    first: str
    second: str
    watched: bool
    reason: str
    """Why the pair is watched or not, as text."""


def select_pairs(
    robot: Robot, links: tuple[Link, ...], srdf: str, ignored: set[str], watched: set[str]
) -> tuple[LinkPair, ...]:
    """Lists every pair of links on different joints, and whether it is watched.

    Args:
        robot: The robot.
        links: Its links with collision geometry.
        srdf: Text of an SRDF, or empty.
        ignored: Pairs ``link_a:link_b`` that are not watched.
        watched: Pairs ``link_a:link_b`` that are watched; takes precedence over ``ignored``.

    Returns:
        The pairs, each with the reason for the decision.

    Raises:
        UnknownNameError: ``ignored`` or ``watched`` names a link without collision geometry.
        SettingsError: The SRDF is not XML.
    """
    names = {link.name for link in links}
    for text in sorted(ignored | watched):
        for name in text.split(":"):
            if name not in names:
                raise UnknownNameError("link with collision geometry", name, names)
    possible = [(a, b) for a, b in combinations(range(len(links)), 2) if links[a].parent != links[b].parent]
    disabled = {pair for pair in disabled_pairs(srdf, names) if pair <= names} if srdf else set()
    open_pairs = [(a, b) for a, b in possible if frozenset((links[a].name, links[b].name)) not in disabled]
    distances = dict(zip(open_pairs, _remembered_distances(robot, links, open_pairs).T, strict=True))
    result = []
    for a, b in possible:
        first, second = links[a].name, links[b].name
        spellings = {f"{first}:{second}", f"{second}:{first}"}
        if spellings & watched:
            active, reason = True, "listed in watched_pairs"
        elif spellings & ignored:
            active, reason = False, "listed in ignored_pairs"
        elif (a, b) not in distances:
            active, reason = False, "disabled by the SRDF"
        elif disabled:
            active, reason = _judge_enabled(distances[a, b])
        elif links[a].parent in (robot.model.parents[links[b].parent], links[b].parent) or (
            robot.model.parents[links[a].parent] == links[b].parent
        ):
            active, reason = False, "adjacent"
        else:
            active, reason = _judge(distances[a, b])
        result.append(LinkPair(first, second, active, reason))
    return tuple(result)


def summary(pairs: Iterable[LinkPair]) -> str:
    """Number of watched pairs, and the pairs that are not watched, by reason, as text."""
    pairs = list(pairs)
    reasons: dict[str, list[str]] = {}
    for pair in pairs:
        if not pair.watched:
            reasons.setdefault(pair.reason, []).append(f"{pair.first}:{pair.second}")
    left_out = [f"{reason}: {', '.join(reasons[reason])}" for reason in sorted(reasons)]
    count = sum(pair.watched for pair in pairs)
    return "; ".join([f"{count} of {len(pairs)} link pairs are watched", *left_out])


def _judge_enabled(distances: Array) -> tuple[bool, str]:
    """Decides on a pair that the SRDF does not disable: a pair in permanent contact would block the arm."""
    touching = float(np.mean(distances <= 0.0))
    if touching >= PERMANENT_CONTACT:
        return False, f"not disabled by the SRDF, but in collision in {touching:.0%} of the samples"
    return True, "not disabled by the SRDF"


def _judge(distances: Array) -> tuple[bool, str]:
    """Decides on a pair by its distances (SAMPLES,), m."""
    touching = float(np.mean(distances <= 0.0))
    if touching >= PERMANENT_CONTACT:
        return False, f"in collision in {touching:.0%} of the samples"
    farthest = float(distances.max())
    if farthest <= CLOSE_M:
        return False, f"distance never exceeds {farthest * 1e3:.0f} mm"
    return True, f"in collision in {touching:.1%} of the samples"


_sampled: dict[tuple[Any, ...], Array] = {}


def _remembered_distances(robot: Robot, links: tuple[Link, ...], pairs: list[tuple[int, int]]) -> Array:
    """:func:`sampled_distances`, computed once per process for the same robot with the same solids."""
    solids = [(link.name, link.parent, type(link.solid), link.points.tobytes(), _pose_bytes(link)) for link in links]
    key = (robot.urdf, robot.base_frame, robot.tip_frame, robot.joints, tuple(pairs), tuple(solids))
    if key not in _sampled:
        while len(_sampled) >= REMEMBERED:
            _sampled.pop(next(iter(_sampled)))
        _sampled[key] = sampled_distances(robot, links, pairs)
    return _sampled[key]


def _pose_bytes(link: Link) -> bytes:
    return np.asarray(link.placement.homogeneous).tobytes()


def sampled_distances(robot: Robot, links: tuple[Link, ...], pairs: list[tuple[int, int]]) -> Array:
    """(SAMPLES, pairs): distances at positions spread evenly over the joint ranges, m; deterministic."""
    model = pin.GeometryModel()
    for link in links:
        add(model, link.name, link.parent, link.solid, link.placement)
    for a, b in pairs:
        model.addCollisionPair(pin.CollisionPair(a, b))
    data = pin.GeometryData(model)
    lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
    upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
    found = list(data.distanceResults)  # updated in place by computeDistances
    result = np.empty((SAMPLES, len(pairs)))
    for row, part in enumerate(low_discrepancy_points(np.arange(1, SAMPLES + 1), robot.n)):
        robot.root_jacobian(lower + part * (upper - lower))
        pin.updateGeometryPlacements(robot.model, robot.data, model, data)
        pin.computeDistances(model, data)
        result[row] = [pair.min_distance for pair in found]
    return result


def add(model: Any, name: str, parent: int, solid: Any, placement: Any) -> int:
    """Adds a solid to a geometry model and returns its index."""
    return int(model.addGeometryObject(pin.GeometryObject(name, parent, 0, placement, solid)))
