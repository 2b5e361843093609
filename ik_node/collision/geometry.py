"""Collision geometry of the robot: one convex solid per link, and the pairs of links whose distances are computed.

The solids come from the ``collision`` elements of the URDF. A link with a single sphere, box, cylinder or capsule keeps
it. All other links are replaced by one convex hull per link (``hull``), or by the smallest capsule found around that
hull (``capsule``). Both contain the link, so distances are never overestimated. A hull underestimates distances where
the link is concave, by up to :meth:`CollisionGeometry.conservatism`; a capsule underestimates them by centimetres.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_node.collision import bounding_capsule
from ik_node.collision.pair_selection import Link, LinkPair, select_pairs
from ik_node.errors import CollisionUnavailableError, RobotError, UnknownNameError
from ik_node.math.types import Array
from ik_node.robot.catalogue import robots_folder
from ik_node.robot.robot import Robot

Flags = NDArray[np.bool_]

SIMPLIFICATIONS = ("hull", "capsule")
"""Valid replacements of meshes and compound solids."""

CYLINDER_CORNERS = 32
"""Corners of the prism circumscribed about a cylinder that becomes part of a hull; the prism is 0.5 % wider."""

MAX_STROKE_M = 100.0
"""Stroke that is assumed for a prismatic joint without limits."""


@dataclass(frozen=True)
class CollisionGeometry:
    """The links and link pairs of a robot for distance computation; immutable."""

    robot: Robot
    links: tuple[Link, ...]
    pairs: tuple[LinkPair, ...]
    """All pairs of links on different joints, watched or not."""
    moves: Flags
    """(links, m), bool: True where a moving joint (including mimic joints) moves the link."""
    reach: Array
    """(links, n): upper bound of the motion of any point of the link per motion of the joint, m per rad (1 for m)."""
    capsules: Array
    """(links, 7): a capsule around each solid in its frame: one end, vector to the other end, radius, m."""

    def names(self) -> tuple[str, ...]:
        """Names of the links, in order."""
        return tuple(link.name for link in self.links)

    def watched(self) -> list[tuple[int, int]]:
        """Pairs of link indices whose distances are computed."""
        number = {link.name: index for index, link in enumerate(self.links)}
        return [(number[pair.first], number[pair.second]) for pair in self.pairs if pair.watched]

    def conservatism(self) -> dict[str, float]:
        """Largest distance from the centres of the hull's faces to the mesh, m, for each link made of a mesh.

        The computation takes some seconds; it is meant for reports.
        """
        return {link.name: _excess(link) for link in self.links if link.mesh is not None}


def package_folders(extra: Iterable[str] = ()) -> list[str]:
    """Folders in which ``package://`` names are looked up: ``extra``, the ROS installation, example-robot-data."""
    folders = [str(Path(place)) for place in extra if place]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            folders.append(str(Path(prefix, "share")))
    # Without example-robot-data, the loader reports the missing mesh.
    with contextlib.suppress(RobotError):
        folders.append(str(robots_folder().parent.parent))
    return folders


def load(
    robot: Robot,
    simplification: str = "hull",
    folders: Iterable[str] = (),
    srdf: str = "",
    ignored: Iterable[str] = (),
    watched: Iterable[str] = (),
    self_collision: bool = True,
) -> CollisionGeometry:
    """Builds the collision geometry of a robot.

    Args:
        robot: The robot.
        simplification: One of :data:`SIMPLIFICATIONS`.
        folders: Additional folders in which ``package://`` meshes are looked up.
        srdf: Text of an SRDF. Its disabled pairs are not watched; all other pairs are, except those in permanent
            contact. When it disables no pair of this robot, pairs are selected by sampling, as without an SRDF.
        ignored: Pairs ``link_a:link_b`` that are not watched, whatever sampling or the SRDF give.
        watched: Pairs ``link_a:link_b`` that are watched, whatever sampling or the SRDF give.
        self_collision: False for no pairs of links at all.

    Returns:
        The geometry.

    Raises:
        CollisionUnavailableError: The URDF has no collision elements, or a mesh is missing.
        UnknownNameError: A link or the simplification does not exist.
        SettingsError: The SRDF is not XML.
    """
    if simplification not in SIMPLIFICATIONS:
        raise UnknownNameError("simplification", simplification, SIMPLIFICATIONS)
    places = package_folders(folders)
    try:
        model = pin.buildGeomFromUrdfString(
            robot.model, robot.description.text, pin.GeometryType.COLLISION, None, places
        )
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
    reach = robot.bounds_per_joint(np.where(moves, np.array([_reach(robot, link) for link in links]), 0.0))
    pairs = select_pairs(robot, links, srdf, set(ignored), set(watched)) if self_collision else ()
    return CollisionGeometry(robot, links, pairs, moves, reach, np.array([_capsule(link) for link in links]))


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


def _capsule(link: Link) -> Array:
    """(7,): a capsule around the solid in its frame: one end, vector to the other end, radius, m."""
    solid = link.solid
    if isinstance(solid, coal.Sphere):
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, solid.radius])
    if isinstance(solid, (coal.Capsule, coal.Cylinder)):
        return np.array([0.0, 0.0, -solid.halfLength, 0.0, 0.0, 2.0 * solid.halfLength, solid.radius])
    found = bounding_capsule.fast(_corners(solid, link.name))
    half = 0.5 * found.length * found.rotation[:, 2]
    return np.array([*(found.centre - half), *(2.0 * half), found.radius])


def convex_hull(points: Array) -> Any:
    """The coal convex hull of ``points`` (p, 3)."""
    listed = coal.StdVec_Vec3s()
    for point in points:
        listed.append(point)
    return coal.Convex.convexHull(listed, True, "Qt")


def _placed(points: Array, placement: Any) -> Array:
    return np.asarray(points @ placement.rotation.T + placement.translation)


def _corners(solid: Any, name: str) -> Array:
    """Points whose convex hull contains the solid, (p, 3)."""
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
        angle = 2.0 * np.pi * np.arange(CYLINDER_CORNERS) / CYLINDER_CORNERS
        radius = solid.radius / np.cos(np.pi / CYLINDER_CORNERS)
        half = solid.halfLength + (solid.radius if isinstance(solid, coal.Capsule) else 0.0)
        ring = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(CYLINDER_CORNERS, half)))
        return np.concatenate((ring, ring * (1.0, 1.0, -1.0)))
    raise CollisionUnavailableError(
        f"link '{name}' has a collision solid of an unsupported type: {type(solid).__name__}"
    )


def _reach(robot: Robot, link: Link) -> Array:
    """(m,): largest possible distance of a point of the link from moving joint j, with the chain between stretched."""
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
            distance += min(float(robot.strokes[column].max()), MAX_STROKE_M)
        joint = model.parents[joint]
    return reach


def _excess(link: Link) -> float:
    """Largest distance from the centres of the hull's faces to the mesh, m."""
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
