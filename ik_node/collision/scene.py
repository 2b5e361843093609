"""Obstacles: what they are, where they are, how they move; and the YAML files that hold them.

A scene file::

    obstacles:
      - name: post                       # unique; default: obstacle_0, obstacle_1, ...
        cylinder: {radius: 0.05, length: 0.6}
        position: [0.45, 0.1, 0.3]       # m, of the centre
        orientation: [0, 0, 0, 1]        # x y z w; default: none
        frame: panda_link0               # any frame of the robot model; default: the base frame
        velocity: [0, 0.1, 0]            # m/s in that frame; default: at rest

with one of ``sphere: {radius}``, ``box: {size: [x, y, z]}``, ``cylinder: {radius, length}``, ``capsule: {radius,
length}`` each. Cylinders and capsules stand along z; a capsule's length is that between the centres of its ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from ik_node.errors import InputError, SceneError
from ik_node.interfaces.clock import NS
from ik_node.math.se3 import log_rotation, pose_from, vector
from ik_node.math.types import Array

SIZES = {
    "sphere": ("radius",),
    "box": ("x", "y", "z"),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
"""Kinds of shapes and the names of their measures."""

FASTEST = 3.0
"""An obstacle that seems faster than this, m/s, was put somewhere else; it did not move there."""

LONGEST_GAP_S = 0.5
"""Two positions further apart in time say nothing about a speed."""

AHEAD_S = 0.1
"""How long a moving obstacle is carried on between its messages."""


class Shape(NamedTuple):
    """A solid, centred at its own origin."""

    kind: str
    """A key of :data:`SIZES`."""
    size: tuple[float, ...]
    """Measures in the order of :data:`SIZES`, m, > 0."""

    @property
    def reach(self) -> float:
        """Largest distance of its points from its origin, m."""
        if self.kind == "box":
            return 0.5 * math.sqrt(sum(side * side for side in self.size))
        if self.kind == "cylinder":
            return math.hypot(self.size[0], 0.5 * self.size[1])
        return self.size[0] + (0.5 * self.size[1] if self.kind == "capsule" else 0.0)


def shape(kind: str, size: Iterable[float], name: str = "obstacle") -> Shape:
    """A checked shape; InputError naming ``name``, with the valid kinds, or the measure that is not positive."""
    if kind not in SIZES:
        raise InputError(f"{name} is a '{kind}'; valid: {', '.join(SIZES)}")
    numbers = vector(tuple(size), len(SIZES[kind]), f"size of {name}")
    for measure, value in zip(SIZES[kind], numbers.tolist(), strict=True):
        if value <= 0.0:
            raise InputError(f"{name} has {measure} {value:g}; expected more than 0")
    return Shape(kind, tuple(numbers.tolist()))


class Obstacle(NamedTuple):
    """A solid in the base frame {s}."""

    name: str
    shape: Shape
    pose_s: Array
    """Pose of its origin, (4, 4)."""
    velocity_s: Array
    """Velocity of its origin, (3,), m/s, along the axes of {s}."""
    spin_s: Array
    """Its angular velocity, (3,), rad/s, along the axes of {s}."""
    time_ns: int
    """Monotonic time at which the pose held."""
    expires_ns: int | None = None
    """Monotonic time from which it is gone; None: it stays."""
    steady: bool = False
    """True: it goes on at its velocity for ever (a scene file says so); False: the velocity is an estimate."""

    @property
    def moves(self) -> bool:
        """True where it has a velocity."""
        return any(self.velocity_s.tolist()) or any(self.spin_s.tolist())

    def at(self, time_ns: int) -> Obstacle:
        """Itself a little later: carried on at its velocity, an estimated one for ``AHEAD_S`` only; an estimate that
        was not renewed for ``LONGEST_GAP_S`` is no longer believed."""
        if not self.moves:
            return self
        age_s = max((time_ns - self.time_ns) / NS, 0.0)
        pose = self.pose_s.copy()
        pose[:3, 3] += self.velocity_s * (age_s if self.steady else min(age_s, AHEAD_S))
        if self.steady or age_s <= LONGEST_GAP_S:
            return self._replace(pose_s=pose)
        return self._replace(pose_s=pose, velocity_s=np.zeros(3), spin_s=np.zeros(3))


def obstacle(
    name: str,
    solid: Shape,
    pose_s: Array,
    time_ns: int = 0,
    velocity_s: Array | None = None,
    expires_ns: int | None = None,
) -> Obstacle:
    """An obstacle at rest, or one that goes on steadily at ``velocity_s`` (3,), m/s."""
    velocity = np.zeros(3) if velocity_s is None else np.ascontiguousarray(velocity_s, dtype=np.float64)
    pose = np.ascontiguousarray(pose_s, dtype=np.float64)
    return Obstacle(name, solid, pose, velocity, np.zeros(3), time_ns, expires_ns, bool(velocity.any()))


@dataclass(frozen=True)
class Scene:
    """The obstacles that there are, by name. Every change makes a new scene."""

    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)

    def put(self, new: Obstacle) -> Scene:
        """With ``new`` added, or in the place of the one of its name, whose motion gives it a velocity.

        The velocity is the mean of the last estimate and of the difference between the two poses, where these are no
        more than ``LONGEST_GAP_S`` apart. A leap faster than ``FASTEST`` is none: the obstacle was put elsewhere.
        """
        old = self.obstacles.get(new.name)
        if old is not None and not new.moves:
            new = _with_velocity(old, new)
        return Scene({**self.obstacles, new.name: new})

    def remove(self, name: str) -> Scene:
        """Without the obstacle ``name``; the same where there is none."""
        return Scene({key: value for key, value in self.obstacles.items() if key != name})

    def at(self, time_ns: int) -> Scene:
        """Without those whose time is over."""
        if not self.obstacles:
            return self
        kept = {
            key: value
            for key, value in self.obstacles.items()
            if value.expires_ns is None or time_ns < value.expires_ns
        }
        return self if len(kept) == len(self.obstacles) else Scene(kept)


def _with_velocity(old: Obstacle, new: Obstacle) -> Obstacle:
    elapsed_s = (new.time_ns - old.time_ns) / NS
    if not 0.0 < elapsed_s <= LONGEST_GAP_S:
        # Two messages of one moment: what was known holds on.
        same = elapsed_s == 0.0
        return new._replace(velocity_s=old.velocity_s, spin_s=old.spin_s) if same else new
    velocity = (new.pose_s[:3, 3] - old.pose_s[:3, 3]) / elapsed_s
    spin = log_rotation(new.pose_s[:3, :3] @ old.pose_s[:3, :3].T) / elapsed_s
    if float(np.linalg.norm(velocity)) > FASTEST:
        return new
    if old.moves:
        velocity, spin = 0.5 * (velocity + old.velocity_s), 0.5 * (spin + old.spin_s)
    return new._replace(velocity_s=velocity, spin_s=spin)


def read_scene(path: str | Path, pose_of_frame: Callable[[str], Array] | None = None) -> Scene:
    """The scene of a YAML file. ``pose_of_frame``: T_sf of a frame of the robot; it may raise for unknown ones.

    Raises SceneError naming the file, the obstacle and what is wrong with it.
    """
    try:
        content = yaml.safe_load(Path(path).read_text())
    except OSError as error:
        raise SceneError(f"scene {path} cannot be read: {error.strerror}") from error
    except yaml.YAMLError as error:
        raise SceneError(f"scene {path} is not YAML: {error}") from error
    entries = content.get("obstacles") if isinstance(content, dict) else None
    if not isinstance(entries, list):
        raise SceneError(f"scene {path} holds no list 'obstacles'")
    scene = Scene()
    for index, entry in enumerate(entries):
        name = str(entry.get("name", f"obstacle_{index}")) if isinstance(entry, dict) else f"obstacle_{index}"
        if name in scene.obstacles:
            raise SceneError(f"scene {path} holds two obstacles called '{name}'")
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
    solid = shape(kinds[0], _measures(kinds[0], entry[kinds[0]]), name)
    pose = pose_from(entry.get("position", (0.0, 0.0, 0.0)), entry.get("orientation", (0.0, 0.0, 0.0, 1.0)), name)
    velocity = vector(entry.get("velocity", (0.0, 0.0, 0.0)), 3, f"velocity of {name}")
    if entry.get("frame"):
        if pose_of_frame is None:
            raise InputError(f"frame '{entry['frame']}' cannot be looked up without a robot")
        frame = pose_of_frame(str(entry["frame"]))
        pose, velocity = frame @ pose, frame[:3, :3] @ velocity
    return obstacle(name, solid, pose, velocity_s=velocity)


def _measures(kind: str, values: Any) -> tuple[float, ...]:
    if not isinstance(values, dict):
        raise InputError(f"{kind} is {values!r}; expected a mapping")
    names = ("size",) if kind == "box" else SIZES[kind]
    if set(values) != set(names):
        raise InputError(f"{kind} has {', '.join(map(str, values)) or 'nothing'}; expected {', '.join(names)}")
    return tuple(float(v) for v in (values["size"] if kind == "box" else [values[name] for name in names]))
