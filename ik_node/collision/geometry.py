"""The robot's collision geometry, simplified once: one convex solid per link, and the pairs of links to watch.

The solids are those of the URDF's ``collision`` elements. A link with a single sphere, box, cylinder or capsule keeps
it. Everything else becomes one convex hull per link (``hull``), or the smallest capsule found around that hull
(``capsule``). Both contain the link: distances are never overstated. A hull is conservative where the link is concave,
by as much as :meth:`Geometry.conservatism` says; a capsule by centimetres.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_node.collision import bounding_capsule
from ik_node.errors import CollisionUnavailableError, RobotError, UnknownNameError
from ik_node.math.types import Array
from ik_node.robot.catalogue import robots_folder
from ik_node.robot.robot import Robot
from ik_node.robot.srdf import disabled_pairs

Flags = NDArray[np.bool_]

SIMPLIFICATIONS = ("hull", "capsule")
"""What a link becomes."""

CORNERS = 32
"""Corners of the prism that stands for a cylinder inside a hull, drawn around it: 0.5 % wider."""

SAMPLES = 1000
"""Positions at which pairs of links are looked at."""

ALWAYS = 0.95
"""Pairs that touch in this part of the samples always touch."""

CLOSE_M = 0.03
"""Pairs that never get further apart than this are neighbours whose solids cannot tell contact from closeness."""


LONGEST_STROKE_M = 100.0
"""A prismatic joint without limits goes no further than this."""


class Link(NamedTuple):
    """One convex solid."""

    name: str
    """Of the link."""
    parent: int
    """Joint of the model that it hangs on."""
    solid: Any
    """The coal shape."""
    placement: Any
    """SE3, seen from the joint."""
    points: Array
    """Its corners seen from the joint, (p, 3); of a primitive: corners of a solid around it."""
    mesh: Any
    """The coal mesh it was made of, or None."""


class PairOfLinks(NamedTuple):
    """Two links, and what became of them."""

    first: str
    second: str
    watched: bool
    reason: str
    """Why it is watched or not, for a person."""


@dataclass(frozen=True)
class Geometry:
    """Everything about the robot that distances need; made once."""

    robot: Robot
    links: tuple[Link, ...]
    pairs: tuple[PairOfLinks, ...]
    """All pairs on different joints, watched or not."""
    moves: Flags
    """(links, m), bool: which moving joints, mimic ones among them, move which link."""
    reach: Array
    """(links, n): no point of the link moves by more than this times the motion of the joint, m per rad (1 for m)."""

    def names(self) -> tuple[str, ...]:
        """Of the links, in order."""
        return tuple(link.name for link in self.links)

    def watched(self) -> list[tuple[int, int]]:
        """Pairs of link numbers whose distances count."""
        number = {link.name: index for index, link in enumerate(self.links)}
        return [(number[pair.first], number[pair.second]) for pair in self.pairs if pair.watched]

    def conservatism(self) -> dict[str, float]:
        """Per link made of a mesh: the largest distance found from the middles of the hull's faces to the mesh, m.

        It takes some seconds and belongs in reports, not in a controller.
        """
        return {link.name: _excess(link) for link in self.links if link.mesh is not None}


def package_folders(extra: Iterable[str] = ()) -> list[str]:
    """Where ``package://`` names are looked up: ``extra``, the ROS installation, and that of example-robot-data."""
    folders = [str(Path(place)) for place in extra if place]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            folders.append(str(Path(prefix, "share")))
    # Where it is not installed, what needs it is named by the loader.
    with contextlib.suppress(RobotError):
        folders.append(str(robots_folder().parent.parent))
    return folders


def load(
    robot: Robot,
    simplification: str = "hull",
    folders: Iterable[str] = (),
    srdf: str = "",
    ignored: Iterable[str] = (),
    checked: Iterable[str] = (),
    self_collision: bool = True,
) -> Geometry:
    """The geometry of ``robot``.

    ``folders``: further places of ``package://`` meshes. ``srdf``: text of an SRDF; the pairs it disables are not
    watched, all others are but for those that always touch. One that disables none of the arm's says nothing:
    pairs are then chosen by sampling, as without. ``ignored``, ``checked``: pairs ``link_a:link_b`` to leave out or to
    watch whatever sampling or the SRDF say.

    Raises CollisionUnavailableError with the reason where there are no solids or their meshes are missing, and
    UnknownNameError for a link that does not exist. SettingsError for an SRDF that is not XML.
    """
    if simplification not in SIMPLIFICATIONS:
        raise UnknownNameError("simplification", simplification, SIMPLIFICATIONS)
    places = package_folders(folders)
    try:
        model = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.GeometryType.COLLISION, None, places)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise CollisionUnavailableError(f"{reason} Looked in {', '.join(places) or 'no folder'}.") from error
    groups: dict[int, list[Any]] = {}
    for entry in model.geometryObjects:
        groups.setdefault(entry.parentFrame, []).append(entry)
    if not groups:
        raise CollisionUnavailableError("the URDF holds no collision geometry")
    links = tuple(_link(robot.model.frames[frame].name, group, simplification) for frame, group in groups.items())
    moves = np.array([robot.joint_moves(link.parent) for link in links])
    reach = robot.most_per_joint(np.where(moves, np.array([_reach(robot, link) for link in links]), 0.0))
    pairs = _pairs(robot, links, srdf, set(ignored), set(checked)) if self_collision else ()
    return Geometry(robot, links, pairs, moves, reach)


def _link(name: str, group: list[Any], simplification: str) -> Link:
    only = group[0]
    if len(group) == 1 and not isinstance(only.geometry, (coal.BVHModelBase, coal.Convex)):
        points = _placed(_corners(only.geometry, name), only.placement)
        return Link(name, only.parentJoint, only.geometry, only.placement, points, None)
    points = np.concatenate([_placed(_corners(entry.geometry, name), entry.placement) for entry in group])
    hull = convex_hull(points)
    points = np.array(hull.points())
    mesh = only.geometry if len(group) == 1 and isinstance(only.geometry, coal.BVHModelBase) else None
    if simplification == "capsule":
        found = bounding_capsule.around(points)
        placement = pin.SE3(found.rotation, found.centre)
        return Link(name, only.parentJoint, coal.Capsule(found.radius, found.length), placement, points, None)
    if mesh is not None and not only.placement.isIdentity():
        mesh = None
    return Link(name, only.parentJoint, hull, pin.SE3.Identity(), points, mesh)


def convex_hull(points: Array) -> Any:
    """The coal solid around ``points`` (p, 3)."""
    listed = coal.StdVec_Vec3s()
    for point in points:
        listed.append(point)
    return coal.Convex.convexHull(listed, True, "Qt")


def _placed(points: Array, placement: Any) -> Array:
    return np.asarray(points @ placement.rotation.T + placement.translation)


def _corners(solid: Any, name: str) -> Array:
    """Points whose hull contains the solid."""
    if isinstance(solid, coal.BVHModelBase):
        return np.array(solid.vertices())
    if isinstance(solid, coal.Convex):
        return np.array(solid.points())
    signs = np.array([[a, b, c] for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)])
    if isinstance(solid, coal.Box):
        return np.asarray(signs * np.asarray(solid.halfSide).ravel())
    if isinstance(solid, coal.Sphere):
        return np.asarray(signs * solid.radius)
    if isinstance(solid, (coal.Cylinder, coal.Capsule)):
        angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
        radius = solid.radius / np.cos(np.pi / CORNERS)
        half = solid.halfLength + (solid.radius if isinstance(solid, coal.Capsule) else 0.0)
        ring = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(CORNERS, half)))
        return np.concatenate((ring, ring * (1.0, 1.0, -1.0)))
    raise CollisionUnavailableError(
        f"link '{name}' has a solid of a kind that is not supported: {type(solid).__name__}"
    )


def _reach(robot: Robot, link: Link) -> Array:
    """(m,): how far from moving joint j a point of the link can ever be: the links in between, stretched out."""
    model = robot.model
    reach = np.zeros(len(robot.moving_revolute))
    farthest = float(np.sqrt((link.points**2).sum(axis=1)).max())
    if isinstance(link.solid, coal.Capsule):
        ends = _placed(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]) * link.solid.halfLength, link.placement)
        farthest = float(np.sqrt((ends**2).sum(axis=1)).max()) + link.solid.radius
    joint, distance = link.parent, farthest
    while joint > 0:
        column = robot.joint_moves(joint) & ~robot.joint_moves(model.parents[joint])
        turning = bool(robot.moving_revolute[column].all()) if column.any() else True
        reach[column] = distance if turning else 1.0
        distance += float(np.linalg.norm(model.jointPlacements[joint].translation))
        if not turning:
            distance += min(float(robot.strokes[column].max()), LONGEST_STROKE_M)
        joint = model.parents[joint]
    return reach


def _pairs(
    robot: Robot, links: tuple[Link, ...], srdf: str, ignored: set[str], checked: set[str]
) -> tuple[PairOfLinks, ...]:
    """Every pair on different joints, and whether it is watched."""
    names = {link.name for link in links}
    for text in sorted(ignored | checked):
        for name in text.split(":"):
            if name not in names:
                raise UnknownNameError("link with collision geometry", name, names)
    possible = [(a, b) for a, b in combinations(range(len(links)), 2) if links[a].parent != links[b].parent]
    disabled = {pair for pair in disabled_pairs(srdf, names) if pair <= names} if srdf else set()
    open_pairs = [(a, b) for a, b in possible if frozenset((links[a].name, links[b].name)) not in disabled]
    distances = dict(zip(open_pairs, sampled_distances(robot, links, open_pairs).T, strict=True))
    result = []
    for a, b in possible:
        first, second = links[a].name, links[b].name
        wanted = {f"{first}:{second}", f"{second}:{first}"}
        if wanted & checked:
            watched, reason = True, "asked for"
        elif wanted & ignored:
            watched, reason = False, "to be ignored"
        elif (a, b) not in distances:
            watched, reason = False, "disabled by the SRDF"
        elif disabled:
            watched, reason = _left_open(distances[a, b])
        elif links[a].parent in (robot.model.parents[links[b].parent], links[b].parent) or (
            robot.model.parents[links[a].parent] == links[b].parent
        ):
            watched, reason = False, "joined by one joint"
        else:
            watched, reason = _judge(distances[a, b])
        result.append(PairOfLinks(first, second, watched, reason))
    return tuple(result)


def summary(pairs: Iterable[PairOfLinks]) -> str:
    """How many pairs are watched, and which are not for what reason."""
    pairs = list(pairs)
    reasons: dict[str, list[str]] = {}
    for pair in pairs:
        if not pair.watched:
            reasons.setdefault(pair.reason, []).append(f"{pair.first}:{pair.second}")
    left_out = [f"{reason}: {', '.join(reasons[reason])}" for reason in sorted(reasons)]
    count = sum(pair.watched for pair in pairs)
    return "; ".join([f"{count} of {len(pairs)} pairs of links are watched", *left_out])


def _left_open(distances: Array) -> tuple[bool, str]:
    """An SRDF that forgets a pair in lasting contact would hold the arm for ever."""
    touching = float(np.mean(distances <= 0.0))
    if touching >= ALWAYS:
        return False, f"not disabled by the SRDF, but touches in {touching:.0%} of the samples"
    return True, "the SRDF does not disable it"


def _judge(distances: Array) -> tuple[bool, str]:
    touching = float(np.mean(distances <= 0.0))
    if touching >= ALWAYS:
        return False, f"touches in {touching:.0%} of the samples"
    farthest = float(distances.max())
    if farthest <= CLOSE_M:
        return False, f"never further apart than {farthest * 1e3:.0f} mm"
    return True, f"touches in {touching:.1%} of the samples"


def sampled_distances(robot: Robot, links: tuple[Link, ...], pairs: list[tuple[int, int]]) -> Array:
    """(SAMPLES, pairs): distances at positions spread evenly over the joint limits, m; the same every time."""
    model = pin.GeometryModel()
    for link in links:
        add(model, link.name, link.parent, link.solid, link.placement)
    for a, b in pairs:
        model.addCollisionPair(pin.CollisionPair(a, b))
    data = pin.GeometryData(model)
    lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
    upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
    found = list(data.distanceResults)  # they stay where they are, and change with every measurement
    result = np.empty((SAMPLES, len(pairs)))
    for row, part in enumerate(_even(SAMPLES, robot.n)):
        robot.root_jacobian(lower + part * (upper - lower))
        pin.updateGeometryPlacements(robot.model, robot.data, model, data)
        pin.computeDistances(model, data)
        result[row] = [pair.min_distance for pair in found]
    return result


def _even(count: int, size: int) -> Array:
    """(count, size) points in the unit cube, evenly spread: the additive recurrence of the generalised golden ratio
    (Roberts 2018)."""
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (size + 1.0))
    steps = ratio ** -np.arange(1.0, size + 1.0)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)


def add(model: Any, name: str, parent: int, solid: Any, placement: Any) -> int:
    """Adds a solid to a geometry model; its number."""
    return int(model.addGeometryObject(pin.GeometryObject(name, parent, 0, placement, solid)))


def _excess(link: Link) -> float:
    """How far the hull's faces stand off the mesh: the largest distance from their middles, m."""
    hull = link.solid
    corners = np.array(hull.points())
    point, worst = coal.Sphere(1e-9), 0.0
    origin = coal.Transform3s()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    faces = [hull.polygons(index) for index in range(hull.num_polygons)]
    for face in faces:
        middle = corners[[face[0], face[1], face[2]]].mean(axis=0)
        result.clear()
        coal.distance(point, coal.Transform3s(np.eye(3), middle), link.mesh, origin, request, result)
        worst = max(worst, result.min_distance)
    return worst
