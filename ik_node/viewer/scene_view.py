"""The 3-D scene of the page: the arm, its paths, frames, multiplier and obstacles.

The world frame of viser is the root frame of the model, so that its z axis points up; everything expressed in the base
frame {s} is a child of the node ``/base``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ik_node.collision.scene import Scene, Shape
from ik_node.math import se3
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.viewer import decimation
from ik_node.viewer.meshes import MeshPart, import_trimesh
from ik_node.viewer.timeline import TimelineFrame
from ik_node.viewer.tolerance_view import ToleranceView

Rgb = tuple[int, int, int]
TOOL: Rgb = (0, 114, 178)
DESIRED: Rgb = (150, 160, 170)
TARGET: Rgb = (213, 94, 0)
LAMBDA_TASK: Rgb = (170, 0, 110)
LAMBDA_POTENTIAL: Rgb = (215, 130, 0)
OBSTACLE: Rgb = (190, 80, 60)
CLOSEST: Rgb = (0, 158, 115)
LINK: Rgb = (90, 100, 110)

LAYERS = {
    "robot": ("robot", "The arm at the displayed time"),
    "tool_path": ("tool path", "Measured path of the tool: blue line"),
    "desired_path": ("desired path", "Desired path: grey dashes"),
    "targets": ("targets", "Positions of the received targets: dots"),
    "frames": ("frames", "Tool frame (short axes) and desired pose (long, thin axes)"),
    "tolerance": ("tolerance", "Free axes: yellow lines, dashed for rotations; bands: green boxes, cones and sectors"),
    "multiplier_linear": ("\u03bb linear", "Linear parts of the multiplier: task term magenta, potential term yellow"),
    "multiplier_angular": ("\u03bb angular", "Angular parts of the multiplier, in the same colours"),
    "obstacles": ("obstacles", "Obstacles at the displayed time"),
    "clearance": ("clearance", "Line between the closest points: green"),
    "grid": ("grid", "Grid of 0.1 m"),
}
"""Layer -> label and tooltip of its checkbox."""
HIDDEN_AT_FIRST = frozenset({"multiplier_angular"})

DASH_M = 0.01
"""Length of a dash of the desired path, and of the gap after it."""
ARROW_M = 0.25
"""Length of an arrow with the reference norm."""
MAX_ARROW_RATIO = 1.6
"""Arrows are clipped at this multiple of ``ARROW_M``."""
MIN_ARROW_M = 0.006
_UNIT = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
"""Unit segment along x, placed between two points by :func:`_stretch`."""
_MULTIPLIERS = (
    ("task", "multiplier_task", LAMBDA_TASK),
    ("potential", "multiplier_potential", LAMBDA_POTENTIAL),
)


class SceneView:
    """Draws frames of a timeline; :meth:`update` moves existing objects and recreates only those of another shape."""

    def __init__(self, server: Any, robot: Robot, parts: Iterable[MeshPart]) -> None:
        """Adds all objects to the scene.

        Args:
            server: viser.ViserServer.
            robot: The robot.
            parts: Its visual geometry; without it the arm is drawn as lines between its joints.
        """
        self._scene = server.scene
        self._robot = robot
        self._visible = {layer: layer not in HIDDEN_AT_FIRST for layer in LAYERS}
        self._root_base = se3.inverse(robot.pose_base_root)
        wxyz, position = _placement(self._root_base)
        self._scene.add_frame("/base", show_axes=False, wxyz=wxyz, position=position)
        self._scene.add_frame("/base/origin", axes_length=0.1, axes_radius=0.003, origin_radius=0.006)
        self._joints: dict[int, Any] = {}
        self._links: Any = None
        self.lowest = 0.0
        """Height of the lowest point of the fixed links in the root frame, m."""
        self._build_arm(tuple(parts))
        self._paths: dict[str, Any] = {}
        self._frames = {
            "tool": self._frame("tool", 0.09, 0.004, TOOL),
            "desired": self._frame("desired", 0.13, 0.0022, TARGET),
        }
        self._tolerance = ToleranceView(self._scene)
        self._arrows = {
            f"{name}_{part}": self._arrow(f"{name}_{part}", colour)
            for name, _, colour in _MULTIPLIERS
            for part in ("linear", "angular")
        }
        self.reference_norms = np.zeros((2, 2))
        """Norms drawn with length ``ARROW_M``: (task, potential term) x (linear, angular)."""
        self._obstacles: dict[str, tuple[Shape, Any]] = {}
        self._clearance = self._scene.add_line_segments(
            "/base/clearance", _UNIT, CLOSEST, thickness=3.0, thickness_units="screen", visible=False
        )
        self._clearance_label = self._scene.add_label("/base/clearance_label", "", anchor="bottom-left", visible=False)
        self._grid = self._scene.add_grid(
            "/grid",
            4.0,
            4.0,
            cell_size=0.1,
            section_size=0.5,
            position=(0.0, 0.0, self.lowest),
            cell_color=(226, 229, 233),
            section_color=(196, 202, 208),
            fade_distance=12.0,
        )

    # --- building ----------------------------------------------------------------------------------------------------

    def _build_arm(self, parts: tuple[MeshPart, ...]) -> None:
        self._scene.add_frame("/robot", show_axes=False)
        fixed = [part.vertices[:, 2].min() for part in parts if part.parent == 0 and len(part.vertices)]
        self.lowest = min(0.0, *(float(height) for height in fixed)) if fixed else 0.0
        for part in parts:
            if part.parent not in self._joints:
                name = f"/robot/{part.parent}"
                self._joints[part.parent] = self._scene.add_frame(name, show_axes=False)
            colour = tuple(round(255 * value) for value in part.colour)
            self._scene.add_mesh_simple(f"/robot/{part.parent}/{part.name}", part.vertices, part.faces, color=colour)
        if not parts:
            self._links = self._scene.add_line_segments(
                "/base/links", np.zeros((self._robot.n + 1, 2, 3)), LINK, thickness=0.02
            )
            self._joint_points = self._scene.add_point_cloud(
                "/base/joint_points",
                np.zeros((self._robot.n + 2, 3)),
                LINK,
                point_size=0.02,
                point_shape="circle",
                precision="float32",
            )

    def _frame(self, name: str, length: float, radius: float, colour: Rgb) -> Any:
        return self._scene.add_frame(
            f"/base/{name}",
            axes_length=length,
            axes_radius=radius,
            origin_radius=2.2 * radius,
            origin_color=colour,
            visible=False,
        )

    def _arrow(self, name: str, colour: Rgb) -> Any:
        return self._scene.add_arrows(
            f"/base/lambda_{name}",
            _UNIT,
            colour,
            shaft_radius=0.02,
            head_radius=0.05,
            head_length=0.13,
            visible=False,
        )

    # --- layers ------------------------------------------------------------------------------------------------------

    def set_visible(self, layer: str, visible: bool) -> None:
        """Shows or hides a layer; moving objects follow at the next :meth:`update`."""
        self._visible[layer] = visible
        if layer == "robot":
            for handle in (*self._joints.values(), *self._link_handles()):
                handle.visible = visible
        elif layer == "grid":
            self._grid.visible = visible
        elif layer in self._paths:
            self._paths[layer].visible = visible
        elif layer == "obstacles":
            for _, handle in self._obstacles.values():
                handle.visible = visible

    def _link_handles(self) -> tuple[Any, ...]:
        return () if self._links is None else (self._links, self._joint_points)

    # --- objects that change rarely ----------------------------------------------------------------------------------

    def draw_paths(self, tool: Array, desired: Array) -> None:
        """Draws the paths of the tool and of the desired pose, (k, 3) each, m, in the base frame."""
        dashes = decimation.path(desired, step_m=DASH_M)
        self._path("desired_path", decimation.segments(dashes)[::2], DESIRED, 9.0)
        self._path("tool_path", decimation.segments(decimation.path(tool)), TOOL, 4.5)

    def _path(self, layer: str, segments: Array, colour: Rgb, width: float) -> None:
        handle = self._paths.get(layer)
        if handle is not None and len(segments):
            handle.points = segments.astype(np.float32)
        elif len(segments):
            self._paths[layer] = self._scene.add_line_segments(
                f"/base/{layer}",
                segments,
                colour,
                thickness=width,
                thickness_units="screen",
                visible=self._visible[layer],
            )

    def draw_targets(self, points: Array) -> None:
        """Draws the positions of the received targets, (m, 3), m, in the base frame."""
        finite = points[np.isfinite(points).all(axis=1)]
        if not len(finite):
            return
        known = self._paths.get("targets")
        if known is not None:
            known.points = finite.astype(np.float32)
            return
        self._paths["targets"] = self._scene.add_point_cloud(
            "/base/targets",
            finite,
            TARGET,
            point_size=0.003,
            point_shape="circle",
            precision="float32",
            visible=self._visible["targets"],
        )

    @property
    def joints(self) -> tuple[int, ...]:
        """The model's joints whose links are to be seen, by number; 0 is what does not move."""
        return tuple(self._joints)

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of the obstacles that are drawn, sorted."""
        return tuple(sorted(self._obstacles))

    # --- moving objects ----------------------------------------------------------------------------------------------

    def update(self, frame: TimelineFrame, scene: Scene, tolerance: TaskTolerance) -> None:
        """Draws a frame.

        Args:
            frame: Values that are NaN leave the arm unchanged and hide other objects.
            scene: Obstacles at that time.
            tolerance: The task at that time.
        """
        if np.isfinite(frame.joint_position).all():
            self._pose_arm(frame.joint_position)
        for name, pose in (("tool", frame.pose_sb), ("desired", frame.pose_sd)):
            self._set_pose(self._frames[name], pose, "frames")
        self._tolerance.update(tolerance, frame.pose_sb, frame.pose_sd, self._visible["tolerance"])
        for (name, field, _), norms in zip(_MULTIPLIERS, self.reference_norms.tolist(), strict=True):
            self._draw_multiplier(name, getattr(frame, field), norms, frame.pose_sb)
        self._draw_obstacles(scene)
        self._draw_closest_points(frame.closest_points, frame.clearance)

    def _pose_arm(self, q: Array) -> None:
        tool = self._robot.pose(q)
        placements = self._robot.data.oMi
        for joint, handle in self._joints.items():
            handle.wxyz, handle.position = _placement(placements[joint].homogeneous)
        if self._links is not None:
            joint_points = np.vstack((np.zeros(3), self._robot.joint_origins(q), tool[:3, 3]))
            self._links.points = decimation.segments(joint_points).astype(np.float32)
            self._joint_points.points = joint_points.astype(np.float32)

    def _set_pose(self, handle: Any, pose: Array, layer: str) -> None:
        known = bool(np.isfinite(pose).all())
        if known:
            handle.wxyz, handle.position = _placement(pose)
        handle.visible = known and self._visible[layer]

    def _draw_multiplier(self, name: str, wrench_b: Array, reference_norms: list[float], pose_sb: Array) -> None:
        """Draws the linear and angular part of a multiplier term as arrows at the tool."""
        for index, (part, layer) in enumerate((("linear", "multiplier_linear"), ("angular", "multiplier_angular"))):
            handle = self._arrows[f"{name}_{part}"]
            wrench_s = pose_sb[:3, :3] @ wrench_b[3 * index : 3 * index + 3]
            norm = float(np.linalg.norm(wrench_s))
            length = ARROW_M * min(norm / max(reference_norms[index], 1e-12), MAX_ARROW_RATIO)
            drawn = self._visible[layer] and bool(np.isfinite(norm)) and length > MIN_ARROW_M
            if drawn:
                _stretch(handle, pose_sb[:3, 3], pose_sb[:3, 3] + length / norm * wrench_s, ARROW_M)
            handle.visible = drawn

    def _draw_obstacles(self, scene: Scene) -> None:
        for name in [name for name in self._obstacles if name not in scene.obstacles]:
            self._obstacles.pop(name)[1].remove()
        for name, entry in scene.obstacles.items():
            known = self._obstacles.get(name)
            if known is None or known[0] != entry.shape:
                if known is not None:
                    known[1].remove()
                self._obstacles[name] = (entry.shape, self._add_shape(name, entry.shape))
            handle = self._obstacles[name][1]
            handle.wxyz, handle.position = _placement(entry.pose_s)

    def _add_shape(self, name: str, shape: Shape) -> Any:
        node = f"/base/obstacles/{name.replace('/', '_')}"
        appearance = {"color": OBSTACLE, "opacity": 0.75, "visible": self._visible["obstacles"]}
        if shape.kind == "sphere":
            return self._scene.add_icosphere(node, shape.size[0], **appearance)
        if shape.kind == "box":
            return self._scene.add_box(node, dimensions=shape.size, **appearance)
        if shape.kind == "cylinder":
            return self._scene.add_cylinder(node, shape.size[0], shape.size[1], **appearance)
        mesh = import_trimesh().creation.capsule(shape.size[1], shape.size[0])
        vertices = mesh.vertices - 0.5 * (mesh.bounds[0] + mesh.bounds[1])
        return self._scene.add_mesh_simple(node, vertices, np.asarray(mesh.faces), **appearance)

    def _draw_closest_points(self, points_s: Array, distance: float) -> None:
        drawn = bool(np.isfinite(points_s).all()) and self._visible["clearance"]
        if drawn:
            _stretch(self._clearance, points_s[0], points_s[1])
            self._clearance_label.position = points_s.mean(axis=0)
            self._clearance_label.text = f"{1e3 * distance:.0f} mm"
        self._clearance.visible = self._clearance_label.visible = drawn


def _placement(pose: Array) -> tuple[Array, Array]:
    """Quaternion (w, x, y, z) and position of a pose, in the convention of viser."""
    x, y, z, w = se3.quaternion_from_rotation(pose[:3, :3])
    return np.array([w, x, y, z]), pose[:3, 3].copy()


def _stretch(handle: Any, begin: Array, end: Array, width: float = 1.0) -> None:
    """Places an object of unit length along x between two points by pose and scale.

    viser applies poses faster than new points, and in the same frame as those of the arm.
    """
    difference = end - begin
    length = max(float(np.linalg.norm(difference)), 1e-9)
    x_axis = difference / length
    y_axis = np.cross(x_axis, np.eye(3)[int(np.abs(x_axis).argmin())])
    y_axis /= np.linalg.norm(y_axis)
    rotation = np.column_stack((x_axis, y_axis, np.cross(x_axis, y_axis)))
    x, y, z, w = se3.quaternion_from_rotation(rotation)
    handle.wxyz, handle.position, handle.scale = np.array([w, x, y, z]), begin.copy(), (length, width, width)
