"""Obstacles: shapes, poses and velocities, and the YAML files that define them.

A scene file::

    obstacles:
      - name: post                       # unique; default: obstacle_0, obstacle_1, ...
        cylinder: {radius: 0.05, length: 0.6}
        position: [0.45, 0.1, 0.3]       # m, of the centre
        orientation: [0, 0, 0, 1]        # x y z w; default: none
        frame: panda_link0               # any frame of the robot model; default: the base frame
        velocity: [0, 0.1, 0]            # m/s in that frame; default: at rest

Each obstacle has one of ``sphere: {radius}``, ``box: {size: [x, y, z]}``, ``cylinder: {radius, length}``, ``capsule:
{radius, length}``. The axis of cylinders and capsules is z; the length of a capsule is the distance between the centres
of its hemispheres.

Markers of :mod:`ik_node.messages.decode_obstacles` have names ``namespace/number``. An obstacle of a scene file is
changed only by markers that name it: one with its full name, or DELETEALL with its namespace (the part of its name
before the last slash). DELETEALL without a namespace removes all obstacles but those of the scene file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.errors import InputError, SceneError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import FARTHEST_M
from ik_node.math.numerics import checked_vector
from ik_node.math.se3 import log_rotation, pose_from
from ik_node.math.types import Array
from ik_node.settings.yaml_text import bounded_text, load_yaml

SIZES = {
    "sphere": ("radius",),
    "box": ("x", "y", "z"),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
"""Kinds of shapes and the names of their dimensions."""

MAX_OBSTACLES = 2000
"""Obstacles of a scene: two messages of as many markers as are accepted. Those far away cost nearly nothing, and of
those nearby :data:`ik_node.collision.distance_bounds.MOST_COMPUTED` bounds what a control step computes."""

MAX_SPEED = 3.0
"""A larger apparent speed, m/s, is a change of place, not a motion."""

MAX_GAP_S = 0.5
"""Two positions further apart in time give no velocity estimate."""

EXTRAPOLATION_S = 0.1
"""Longest extrapolation of a moving obstacle between its messages."""


class Shape(NamedTuple):
    """A solid whose centre is its origin."""

    kind: str
    """A key of :data:`SIZES`."""
    size: tuple[float, ...]
    """Dimensions in the order of :data:`SIZES`, m, > 0."""

    @property
    def reach(self) -> float:
        """Largest distance of a point of the solid from its origin, m."""
        if self.kind == "box":
            return 0.5 * math.sqrt(sum(side * side for side in self.size))
        if self.kind == "cylinder":
            return math.hypot(self.size[0], 0.5 * self.size[1])
        return self.size[0] + (0.5 * self.size[1] if self.kind == "capsule" else 0.0)


def shape(kind: str, size: Iterable[float], name: str = "obstacle") -> Shape:
    """Checks and returns a shape.

    Args:
        kind: A key of :data:`SIZES`.
        size: Dimensions in the order of :data:`SIZES`, m.
        name: Name of the obstacle, for error messages.

    Returns:
        The shape.

    Raises:
        InputError: The kind is unknown, or a dimension is missing, not positive, or above :data:`FARTHEST_M`.
    """
    size = tuple(size)
    try:
        return _valid_shape(kind, size)
    except InputError:
        return _checked_shape(kind, size, name)  # the error has the name


@lru_cache(maxsize=1024)
def _valid_shape(kind: str, size: tuple[float, ...]) -> Shape:
    return _checked_shape(kind, size, "obstacle")


def _checked_shape(kind: str, size: tuple[float, ...], name: str) -> Shape:
    if kind not in SIZES:
        raise InputError(f"{name} is a '{kind}'; valid: {', '.join(SIZES)}")
    numbers = checked_vector(size, len(SIZES[kind]), f"size of {name}")
    for dimension, value in zip(SIZES[kind], numbers.tolist(), strict=True):
        if not 0.0 < value <= FARTHEST_M:
            raise InputError(f"{name} has {dimension} {value:g}; expected more than 0 and at most {FARTHEST_M:g}")
    return Shape(kind, tuple(numbers.tolist()))


class Obstacle(NamedTuple):
    """A solid in the base frame {s}."""

    name: str
    shape: Shape
    pose_s: Array
    """Pose of the origin, (4, 4)."""
    velocity_s: Array
    """Velocity of the origin, (3,), m/s, in {s}."""
    spin_s: Array
    """Angular velocity, (3,), rad/s, in {s}."""
    time_ns: int
    """Monotonic time at which the pose was valid."""
    expires_ns: int | None = None
    """Monotonic time at which the obstacle is removed; None: never."""
    steady: bool = False
    """True: the velocity is constant, as in scene files; False: the velocity is an estimate."""
    from_file: bool = False
    """True for obstacles of the scene file, which DELETEALL without a namespace does not remove."""

    @property
    def namespace(self) -> str:
        """The part of the name before its last slash: the namespace of a marker."""
        return self.name.rpartition("/")[0]

    @property
    def moves(self) -> bool:
        """True when the velocity or the angular velocity is not zero."""
        return any(self.velocity_s.tolist()) or any(self.spin_s.tolist())

    def at(self, time_ns: int) -> Obstacle:
        """The obstacle extrapolated to a monotonic time.

        An estimated velocity is used for at most ``EXTRAPOLATION_S``, and set to zero when it is older than
        ``MAX_GAP_S``.
        """
        if not self.moves:
            return self
        age_s = max((time_ns - self.time_ns) / NS, 0.0)
        pose = self.pose_s.copy()
        pose[:3, 3] += self.velocity_s * (age_s if self.steady else min(age_s, EXTRAPOLATION_S))
        if self.steady or age_s <= MAX_GAP_S:
            return self._replace(pose_s=pose)
        return self._replace(pose_s=pose, velocity_s=np.zeros(3), spin_s=np.zeros(3))


def obstacle(
    name: str,
    solid: Shape,
    pose_s: Array,
    time_ns: int = 0,
    velocity_s: Array | None = None,
    expires_ns: int | None = None,
    from_file: bool = False,
) -> Obstacle:
    """Makes an obstacle.

    Args:
        name: Unique name.
        solid: Its shape.
        pose_s: Pose in the base frame, (4, 4).
        time_ns: Monotonic time at which the pose is valid.
        velocity_s: Constant velocity in the base frame, (3,), m/s; None for an obstacle at rest.
        expires_ns: Monotonic time at which it is removed; None for never.
        from_file: True for obstacles of a scene file.

    Raises:
        InputError: The position is further than :data:`FARTHEST_M` from the base, or the speed exceeds FARTHEST_M/s.
    """
    if not np.abs(pose_s[:3, 3]).max() <= FARTHEST_M:
        raise InputError(f"{name} is more than {FARTHEST_M:g} m away")
    if velocity_s is not None and not np.abs(velocity_s).max() <= FARTHEST_M:
        raise InputError(f"{name} is faster than {FARTHEST_M:g} m/s")
    velocity = np.zeros(3) if velocity_s is None else np.ascontiguousarray(velocity_s, dtype=np.float64)
    pose = np.ascontiguousarray(pose_s, dtype=np.float64)
    steady = bool(velocity.any())
    return Obstacle(name, solid, pose, velocity, np.zeros(3), time_ns, expires_ns, steady, from_file)


@dataclass(frozen=True)
class Scene:
    """Obstacles by name; immutable."""

    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)

    def put(self, new: Obstacle) -> Scene:
        """A scene with ``new`` added, or substituted for the obstacle of the same name.

        The velocity of a substitute is estimated: the mean of the last estimate and of the difference between the two
        poses, when these are at most ``MAX_GAP_S`` apart. When the speed exceeds ``MAX_SPEED``, the velocity is zero.

        Raises:
            InputError: ``new`` would be one more than :data:`MAX_OBSTACLES`.
        """
        obstacles = dict(self.obstacles)
        put_into(obstacles, new)
        return Scene(obstacles)

    def remove(self, name: str) -> Scene:
        """A scene without the obstacle ``name``; unknown names are ignored."""
        return Scene({key: value for key, value in self.obstacles.items() if key != name})

    def remove_all(self, namespace: str = "") -> Scene:
        """A scene without the obstacles of a namespace; an empty one removes all but those of the scene file."""
        if not namespace:
            return Scene({name: entry for name, entry in self.obstacles.items() if entry.from_file})
        return Scene({name: entry for name, entry in self.obstacles.items() if entry.namespace != namespace})

    def at(self, time_ns: int) -> Scene:
        """A scene without the obstacles that have expired at a monotonic time."""
        if time_ns < self._first_expiry_ns:
            return self
        kept = {
            key: value
            for key, value in self.obstacles.items()
            if value.expires_ns is None or time_ns < value.expires_ns
        }
        return Scene(kept)

    @cached_property
    def _first_expiry_ns(self) -> float:
        """Monotonic time at which the first obstacle expires; inf if none does."""
        times = [entry.expires_ns for entry in self.obstacles.values() if entry.expires_ns is not None]
        return min(times, default=math.inf)


def put_into(obstacles: dict[str, Obstacle], new: Obstacle) -> None:
    """:meth:`Scene.put` in place, for the obstacles of one message.

    Raises:
        InputError: As there.
    """
    old = obstacles.get(new.name)
    if old is None and len(obstacles) >= MAX_OBSTACLES:
        raise InputError(f"there are {MAX_OBSTACLES} obstacles already, and no more are accepted")
    if old is not None and not new.moves:
        new = _with_velocity(old, new)
    obstacles[new.name] = new


def _with_velocity(old: Obstacle, new: Obstacle) -> Obstacle:
    elapsed_s = (new.time_ns - old.time_ns) / NS
    if not 0.0 < elapsed_s <= MAX_GAP_S:
        # Two messages with the same stamp: the estimate is kept.
        same = elapsed_s == 0.0
        return new._replace(velocity_s=old.velocity_s, spin_s=old.spin_s) if same else new
    if new.pose_s.tobytes() == old.pose_s.tobytes():  # exactly zero, which the logarithm below is not
        return new._replace(velocity_s=0.5 * old.velocity_s, spin_s=0.5 * old.spin_s) if old.moves else new
    velocity = (new.pose_s[:3, 3] - old.pose_s[:3, 3]) / elapsed_s
    spin = log_rotation(new.pose_s[:3, :3] @ old.pose_s[:3, :3].T) / elapsed_s
    if float(np.linalg.norm(velocity)) > MAX_SPEED:
        return new
    if old.moves:
        velocity, spin = 0.5 * (velocity + old.velocity_s), 0.5 * (spin + old.spin_s)
    return new._replace(velocity_s=velocity, spin_s=spin)


def read_scene(path: str | Path, pose_of_frame: Callable[[str], Array] | None = None) -> Scene:
    """Reads a scene from a YAML file.

    Args:
        path: Path of the file.
        pose_of_frame: Returns the pose (4, 4) of a frame of the robot in the base frame; None when only the base
            frame is permitted.

    Returns:
        The scene.

    Raises:
        SceneError: The file cannot be read, is not YAML, or an obstacle in it is invalid; names the obstacle.
    """
    try:
        content = load_yaml(bounded_text(Path(path)))
    except OSError as error:
        raise SceneError(f"scene {path} cannot be read: {error.strerror}") from error
    except ValueError as error:  # InputError, or a NUL in the path
        raise SceneError(f"scene {path} cannot be read: {error}") from error
    entries = content.get("obstacles") if isinstance(content, dict) else None
    if not isinstance(entries, list):
        raise SceneError(f"scene {path} has no list 'obstacles'")
    scene = Scene()
    for index, entry in enumerate(entries):
        name = str(entry.get("name", f"obstacle_{index}")) if isinstance(entry, dict) else f"obstacle_{index}"
        if name in scene.obstacles:
            raise SceneError(f"scene {path} has two obstacles named '{name}'")
        try:
            scene = scene.put(_from_entry(name, entry, pose_of_frame))
        except (InputError, TypeError, ValueError) as error:
            raise SceneError(f"scene {path}, obstacle '{name}': {error}") from error
    return scene


def _from_entry(name: str, entry: Any, pose_of_frame: Callable[[str], Array] | None) -> Obstacle:
    if not isinstance(entry, dict):
        raise InputError(f"expected a mapping, found {entry!r}")
    known = {"name", "position", "orientation", "frame", "velocity", *SIZES}
    for key in entry:
        if key not in known:
            raise InputError(f"unknown key '{key}'; valid: {', '.join(sorted(known))}")
    kinds = [kind for kind in SIZES if kind in entry]
    if len(kinds) != 1:
        raise InputError(f"expected one of {', '.join(SIZES)}; found {', '.join(kinds) or 'none'}")
    solid = shape(kinds[0], _dimensions(kinds[0], entry[kinds[0]]), name)
    pose = pose_from(entry.get("position", (0.0, 0.0, 0.0)), entry.get("orientation", (0.0, 0.0, 0.0, 1.0)), name)
    velocity = checked_vector(entry.get("velocity", (0.0, 0.0, 0.0)), 3, f"velocity of {name}")
    if entry.get("frame"):
        if pose_of_frame is None:
            raise InputError(f"frame '{entry['frame']}' cannot be resolved without a robot")
        frame = pose_of_frame(str(entry["frame"]))
        pose, velocity = frame @ pose, frame[:3, :3] @ velocity
    return obstacle(name, solid, pose, velocity_s=velocity, from_file=True)


def _dimensions(kind: str, values: Any) -> tuple[float, ...]:
    if not isinstance(values, dict):
        raise InputError(f"{kind} is {values!r}; expected a mapping")
    names = ("size",) if kind == "box" else SIZES[kind]
    if set(values) != set(names):
        raise InputError(f"{kind} has {', '.join(map(str, values)) or 'nothing'}; expected {', '.join(names)}")
    return tuple(float(v) for v in (values["size"] if kind == "box" else [values[name] for name in names]))
