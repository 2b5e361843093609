"""Visual geometry of a URDF as coloured triangles per joint.

Pinocchio locates and places the files. Colours are those of the URDF, or else those of the mesh files as read by
trimesh (COLLADA needs pycollada). For a file that trimesh cannot read, the triangles read by Pinocchio are used.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_node.collision.geometry import package_folders
from ik_node.errors import MissingPackageError, RobotError
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

DEFAULT_COLOUR = (0.75, 0.77, 0.80)
"""For geometry without a colour."""

Colour = tuple[float, float, float]


class MeshPart(NamedTuple):
    """Triangles of one colour, fixed to one joint."""

    name: str
    parent: int
    """Index of the joint in the model; 0: the fixed root."""
    vertices: Array
    """(v, 3), m, in the frame of the joint."""
    faces: NDArray[np.uint32]
    """(f, 3)."""
    colour: Colour
    """Red, green, blue, 0 to 1."""


def load(robot: Robot, folders: Iterable[str] = ()) -> tuple[MeshPart, ...]:
    """Loads the visual geometry of a robot.

    Args:
        robot: The robot.
        folders: Additional folders for ``package://`` names.

    Raises:
        RobotError: The URDF has no visual geometry, or a file is missing.
        MissingPackageError: trimesh is not installed.
    """
    package_paths = package_folders(folders)
    try:
        model = pin.buildGeomFromUrdfString(
            robot.model, robot.description.text, pin.GeometryType.VISUAL, None, package_paths
        )
    except (ValueError, RuntimeError) as error:
        raise RobotError(" ".join(str(error).split())) from error
    parts = tuple(part for entry in model.geometryObjects for part in _parts(entry))
    if not parts:
        raise RobotError("the URDF has no visual geometry")
    return parts


def import_trimesh() -> Any:
    """The module trimesh; raises MissingPackageError when it is not installed."""
    try:
        import trimesh
    except ImportError as error:
        raise MissingPackageError(error) from error
    return trimesh


def _parts(entry: Any) -> list[MeshPart]:
    placement = np.asarray(entry.placement.homogeneous)
    red, green, blue = (float(value) for value in entry.meshColor[:3])
    urdf_colour = (red, green, blue) if entry.overrideMaterial else None
    result = []
    for index, (mesh, colour) in enumerate(_coloured(entry)):
        vertices = np.asarray(mesh.vertices) @ placement[:3, :3].T + placement[:3, 3]
        faces = np.asarray(mesh.faces, dtype=np.uint32)
        result.append(MeshPart(f"{entry.name}_{index}", int(entry.parentJoint), vertices, faces, urdf_colour or colour))
    return result


def _coloured(entry: Any) -> list[tuple[Any, Colour]]:
    """Meshes (trimesh.Trimesh) and their colours, in the frame of the geometry."""
    trimesh = import_trimesh()
    if not entry.meshPath or not isinstance(entry.geometry, coal.BVHModelBase):
        return [(_shape(entry), DEFAULT_COLOUR)]
    try:
        loaded = trimesh.load_scene(entry.meshPath)
    # ImportError: pycollada is missing. The others are raised by the readers for invalid files.
    except (ImportError, ValueError, TypeError, KeyError, IndexError, AttributeError, OSError):
        return [(_shape(entry), DEFAULT_COLOUR)]
    scale = np.asarray(entry.meshScale).ravel()
    by_colour: dict[Colour, list[Any]] = {}
    for node in loaded.graph.nodes_geometry:
        pose, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            by_colour.setdefault(_colour(mesh), []).append(_PlacedMesh(mesh, pose, scale))
    return [(_merged(placed), colour) for colour, placed in sorted(by_colour.items())] or [
        (_shape(entry), DEFAULT_COLOUR)
    ]


class _PlacedMesh:
    """A mesh of a file, transformed to the frame of the geometry."""

    def __init__(self, mesh: Any, pose: Array, scale: Array) -> None:
        self.vertices = (np.asarray(mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]) * scale
        # Normals of the file: they decide which edges are smooth.
        normals = np.asarray(mesh.vertex_normals) @ np.linalg.inv(pose[:3, :3]) / scale
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        mirrored = np.linalg.det(pose[:3, :3]) * scale.prod() < 0.0
        self.faces = np.asarray(mesh.faces)[:, ::-1] if mirrored else np.asarray(mesh.faces)


def _colour(mesh: Any) -> Colour:
    """Main colour of a mesh."""
    visual = mesh.visual
    if visual.kind == "texture":
        colour = visual.material.main_color
    elif visual.kind in ("face", "vertex"):
        colour = visual.main_color
    else:
        return DEFAULT_COLOUR
    red, green, blue = (float(value) / 255.0 for value in colour[:3])
    return red, green, blue


def _merged(placed: list[_PlacedMesh]) -> Any:
    """One mesh in which triangles share vertices with equal normals, so that edges stay sharp and curves smooth."""
    trimesh = import_trimesh()
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in placed[:-1])])
    merged = trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in placed]),
        np.concatenate([mesh.faces + start for mesh, start in zip(placed, starts, strict=True)]),
        vertex_normals=np.concatenate([mesh.normals for mesh in placed]),
        process=False,
    )
    merged.merge_vertices(merge_norm=False, digits_vertex=6, digits_norm=1)
    return merged


def _shape(entry: Any) -> Any:
    """A geometry of Pinocchio as trimesh.Trimesh."""
    trimesh = import_trimesh()
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
    raise RobotError(f"visual geometry '{entry.name}' has the unsupported type {type(geometry).__name__}")
