"""Obstacles: how many are accepted, which a deletion removes, and what is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import ball_arm

from ik_node.collision.monitor import MAX_REPORTED, CollisionMonitor
from ik_node.collision.scene import MAX_OBSTACLES, Scene, obstacle, shape
from ik_node.errors import InputError, SceneError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import ObstacleSample
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.settings.groups import ObstacleSettings

ROBOT = ball_arm()
NOW = Instant(NS, 10**18)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def marker(name: str, action: str = "add", kind: str = "box", quaternion: Array = UPRIGHT) -> ObstacleSample:
    size = {"box": (0.1, 0.1, 0.1), "sphere": (0.1,)}.get(kind, ())
    position = np.array([2.0, 0.0, 0.5])
    return ObstacleSample(0, ROBOT.base_frame, name, action, kind, size, position, quaternion, 0)


def monitor_of(settings: ObstacleSettings | None = None) -> CollisionMonitor:
    return CollisionMonitor(ROBOT, settings or ObstacleSettings(geometry="none"))


def update(monitor: CollisionMonitor, *samples: ObstacleSample) -> str:
    return monitor.update_obstacles(samples, Frames(ROBOT), NOW, NS)


@pytest.fixture
def with_file(tmp_path: Path) -> CollisionMonitor:
    path = tmp_path / "scene.yaml"
    entry = "{name: %s, sphere: {radius: 0.1}, position: [2, 0, 0]}"
    path.write_text("obstacles:\n" + "".join(f"  - {entry % name}\n" for name in ("post", "shelf/3")))
    return monitor_of(ObstacleSettings(geometry="none", scene=str(path)))


def test_delete_all_removes_the_obstacles_of_its_namespace(with_file: CollisionMonitor) -> None:
    """Marker.msg: DELETEALL deletes all objects, or those with the given namespace."""
    assert not update(with_file, marker("human/1"), marker("table/1"), marker("table/leg/1"), marker("/4"))
    update(with_file, marker("table/0", "delete_all"))
    assert set(with_file.scene.obstacles) == {"post", "shelf/3", "human/1", "table/leg/1", "/4"}
    update(with_file, marker("/0", "delete_all"))
    assert set(with_file.scene.obstacles) == {"post", "shelf/3"}


def test_an_obstacle_of_the_scene_file_is_removed_only_by_name(with_file: CollisionMonitor) -> None:
    update(with_file, marker("/0", "delete_all"), marker("other/3", "delete"), marker("post/0", "delete_all"))
    assert set(with_file.scene.obstacles) == {"post", "shelf/3"}
    update(with_file, marker("shelf/0", "delete_all"))
    assert set(with_file.scene.obstacles) == {"post"}


def test_a_sphere_needs_no_orientation() -> None:
    monitor = monitor_of()
    assert not update(monitor, marker("a/1", kind="sphere", quaternion=np.zeros(4)))
    assert "a/2" in update(monitor, marker("a/2", kind="box", quaternion=np.zeros(4)))
    assert set(monitor.scene.obstacles) == {"a/1"}


def test_no_more_obstacles_than_the_bound() -> None:
    monitor = monitor_of()
    errors = update(monitor, *(marker(f"a/{number}") for number in range(MAX_OBSTACLES + 20)))
    assert len(monitor.scene.obstacles) == MAX_OBSTACLES
    assert f"a/{MAX_OBSTACLES}: there are {MAX_OBSTACLES} obstacles already" in errors
    assert errors.endswith(f"and {20 - MAX_REPORTED} more")
    assert not update(monitor, marker("a/0"))  # a change of one that is there
    assert not update(monitor, marker("a/0", "delete"), marker("b/0"))


def test_a_scene_file_above_the_bound_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("obstacles:\n" + "  - {sphere: {radius: 0.1}, position: [2, 0, 0]}\n" * (MAX_OBSTACLES + 1))
    with pytest.raises(SceneError, match=f"there are {MAX_OBSTACLES} obstacles already"):
        monitor_of(ObstacleSettings(scene=str(path)))


@pytest.mark.parametrize("value", [101.0, 1e160, 1e308])
def test_what_is_too_far_or_too_large_is_refused(value: float) -> None:
    pose = np.eye(4)
    pose[0, 3] = -value
    with pytest.raises(InputError, match="a is more than 100 m away"):
        obstacle("a", shape("sphere", (0.1,)), pose)
    with pytest.raises(InputError, match=r"a has radius .*; expected more than 0 and at most 100"):
        shape("sphere", (value,), "a")


def test_an_obstacle_that_is_sent_again_is_where_a_new_one_would_be() -> None:
    """The way that is faster for obstacles at rest gives what the whole way gives: sizes, places and lifetimes that
    change, an obstacle that moves and rests, a turned box, and one in another frame."""
    rng, turned = np.random.default_rng(3), np.array([0.1, 0.2, 0.3, 0.927361849549570])
    monitor, frames = monitor_of(), Frames(ROBOT)
    fresh = monitor_of()
    for message in range(30):
        samples = []
        for number in range(6):
            moved = rng.integers(3) == 0
            samples.append(
                ObstacleSample(
                    stamp_ns=(message + 1) * 10**8,
                    frame_id=("", ROBOT.base_frame)[number % 2],
                    name=f"a/{number}",
                    action="add",
                    kind=("sphere", "box")[number % 2],
                    size=((0.1,), (0.1, 0.2, 0.3))[number % 2]
                    if message < 20
                    else ((0.2,), (0.1, 0.2, 0.4))[number % 2],
                    position=np.array([1.0, 0.1 * number, 0.05 * message if moved else 0.5]),
                    quaternion=turned / np.linalg.norm(turned),
                    lifetime_ns=10**9 if number == 3 else 0,
                )
            )
        now = Instant((message + 1) * 10**8 + 5, (message + 1) * 10**8 + 5)
        assert not monitor.update_obstacles(tuple(samples), frames, now, 10**9)
        # Equal obstacles, but not the ones that the monitor has made.
        fresh.scene = Scene({name: entry._replace(name=name[:]) for name, entry in fresh.scene.obstacles.items()})
        assert not fresh.update_obstacles(tuple(samples), frames, now, 10**9)
        for name, entry in monitor.scene.obstacles.items():
            for one, other in zip(entry, fresh.scene.obstacles[name], strict=True):
                assert bool(np.all(one == other))
