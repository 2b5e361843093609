"""What the arm looks like: the visual geometry of its URDF as coloured triangles per joint.

Pinocchio finds the files and places them. Colours are those of the mesh files (trimesh reads them; COLLADA needs
pycollada), unless the URDF gives one. A file that trimesh cannot read keeps its shape: Pinocchio has read that already.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_node.collision.geometry import package_folders
from ik_node.errors import RobotError
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

PLAIN = (0.75, 0.77, 0.80)
"""Colour of what has none."""

Colour = tuple[float, float, float]


class Part(NamedTuple):
    """Triangles of one colour that move with one joint."""

    name: str
    parent: int
    """Joint of the model; 0: the root, which does not move."""
    vertices: Array
    """(v, 3), m, seen from the joint."""
    faces: NDArray[np.uint32]
    """(f, 3)."""
    colour: Colour
    """Red, green, blue, 0 to 1."""


def load(robot: Robot, folders: Iterable[str] = ()) -> tuple[Part, ...]:
    """Everything to be seen of ``robot``; ``folders``: further places of ``package://`` names.

    Raises RobotError with the reason where there is nothing to be seen or a file is missing.
    """
    places = package_folders(folders)
    try:
        model = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.GeometryType.VISUAL, None, places)
    except (ValueError, RuntimeError) as error:
        raise RobotError(" ".join(str(error).split())) from error
    parts = tuple(part for entry in model.geometryObjects for part in _parts(entry))
    if not parts:
        raise RobotError("the URDF holds no visual geometry")
    return parts


def _parts(entry: Any) -> list[Part]:
    placement = np.asarray(entry.placement.homogeneous)
    red, green, blue = (float(value) for value in entry.meshColor[:3])
    own = (red, green, blue) if entry.overrideMaterial else None
    result = []
    for index, (mesh, colour) in enumerate(_coloured(entry)):
        vertices = np.asarray(mesh.vertices) @ placement[:3, :3].T + placement[:3, 3]
        faces = np.asarray(mesh.faces, dtype=np.uint32)
        result.append(Part(f"{entry.name}_{index}", int(entry.parentJoint), vertices, faces, own or colour))
    return result


def _coloured(entry: Any) -> list[tuple[Any, Colour]]:
    """Trimesh objects and their colours, in the frame of the geometry."""
    import trimesh

    if not entry.meshPath or not isinstance(entry.geometry, coal.BVHModelBase):
        return [(_solid(entry), PLAIN)]
    try:
        loaded = trimesh.load_scene(entry.meshPath)
    # ImportError: no pycollada. The others are what its readers raise for files that they do not understand.
    except (ImportError, ValueError, TypeError, KeyError, IndexError, AttributeError, OSError):
        return [(_solid(entry), PLAIN)]
    scale = np.asarray(entry.meshScale).ravel()
    by_colour: dict[Colour, list[Any]] = {}
    for node in loaded.graph.nodes_geometry:
        pose, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            by_colour.setdefault(_colour(mesh), []).append(_Piece(mesh, pose, scale))
    return [(_merged(pieces), colour) for colour, pieces in sorted(by_colour.items())] or [(_solid(entry), PLAIN)]


class _Piece:
    """A mesh of a file, placed."""

    def __init__(self, mesh: Any, pose: Array, scale: Array) -> None:
        self.vertices = (np.asarray(mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]) * scale
        # As the file states them; only what comes together here too is to look smooth.
        normals = np.asarray(mesh.vertex_normals) @ np.linalg.inv(pose[:3, :3]) / scale
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        mirrored = np.linalg.det(pose[:3, :3]) * scale.prod() < 0.0
        self.faces = np.asarray(mesh.faces)[:, ::-1] if mirrored else np.asarray(mesh.faces)


def _colour(mesh: Any) -> Colour:
    """The colour of a mesh as a whole."""
    visual = mesh.visual
    if visual.kind == "texture":
        colour = visual.material.main_color
    elif visual.kind in ("face", "vertex"):
        colour = visual.main_color
    else:
        return PLAIN
    red, green, blue = (float(value) / 255.0 for value in colour[:3])
    return red, green, blue


def _merged(pieces: list[_Piece]) -> Any:
    """One mesh, in which triangles share a vertex where their normals agree: edges stay sharp, curves smooth."""
    import trimesh

    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    whole = trimesh.Trimesh(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=True)]),
        vertex_normals=np.concatenate([piece.normals for piece in pieces]),
        process=False,
    )
    whole.merge_vertices(merge_norm=False, digits_vertex=6, digits_norm=1)
    return whole


def _solid(entry: Any) -> Any:
    """What Pinocchio read, as a trimesh."""
    import trimesh

    geometry = entry.geometry
    if isinstance(geometry, coal.BVHModelBase):
        triangles = [geometry.tri_indices(index) for index in range(geometry.num_tris)]
        faces = np.array([[triangle[0], triangle[1], triangle[2]] for triangle in triangles])
        return trimesh.Trimesh(np.array(geometry.vertices()), faces, process=False)
    if isinstance(geometry, coal.Box):
        return trimesh.creation.box(2.0 * np.asarray(geometry.halfSide).ravel())
    if isinstance(geometry, coal.Sphere):
        return trimesh.creation.icosphere(3, geometry.radius)
    if isinstance(geometry, coal.Cylinder):
        return trimesh.creation.cylinder(geometry.radius, 2.0 * geometry.halfLength)
    if isinstance(geometry, coal.Capsule):
        return trimesh.creation.capsule(2.0 * geometry.halfLength, geometry.radius)
    raise RobotError(f"'{entry.name}' has a visual of a kind that is not supported: {type(geometry).__name__}")
