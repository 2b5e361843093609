"""Distances: conservative solids, the correct pairs, exact values independent of earlier queries, and gradients with
the correct sign on both sides of contact.

References: finite differences, closed forms for balls, computing every pair anew. Not tested here: coal itself, and the
use of distances in the controller (test_potentials.py).
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import coal
import numpy as np
import pytest
from arms import ball_arm, random_position
from loop import make_robot
from stopping import LIMITS, pairs_that_must_stop

from ik_node.collision import bounding_capsule, pair_selection
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.convex_distances import ConvexDistances
from ik_node.collision.distance_bounds import MOST_COMPUTED, Limits
from ik_node.collision.distance_kernels import NearPairs
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.geometry import CollisionGeometry
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.errors import CollisionUnavailableError, UnknownNameError
from ik_node.math.se3 import exp
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

KINDS = (("sphere", (0.1,)), ("box", (0.2, 0.1, 0.3)), ("capsule", (0.05, 0.3)), ("cylinder", (0.08, 0.3)))


@cache
def geometry_of(name: str) -> CollisionGeometry:
    return collision_geometry.load(ball_arm() if name == "balls" else make_robot(name))


def random_scene(rng: np.random.Generator, count: int, reach: float, kinds: tuple[str, ...] = ("sphere",)) -> Scene:
    scene = Scene()
    sizes = dict(KINDS)
    for index in range(count):
        kind = kinds[index % len(kinds)]
        pose = exp(rng.normal(size=6))
        pose[:3, 3] = rng.uniform(-reach, reach, 3)
        scene = scene.put(obstacle(f"o{index}", shape(kind, sizes[kind]), pose))
    return scene


def measured(geometry: CollisionGeometry, scene: Scene, q: Array, within: float = np.inf) -> NearPairs:
    """Compute all pairs with a new DistanceQuery."""
    fresh = DistanceQuery(geometry)
    fresh.set_scene(scene, 0)
    return fresh.measure(q, within)[0]


@pytest.mark.parametrize("name", ["panda", "kinova", "balls"])
def test_lazy_distances_equal_those_of_a_full_computation(name: str) -> None:
    """Bit for bit: a replay that starts in the middle must give the same results as the run. Small and large
    motions of the arm; obstacles that move, rotate, are added and removed."""
    geometry, rng = geometry_of(name), np.random.default_rng(1)
    robot = geometry.robot
    lazy, scene = DistanceQuery(geometry), random_scene(rng, 4, 0.6, ("sphere", "box"))
    q, compared = random_position(robot, rng), 0
    for tick in range(150):
        q = random_position(robot, rng) if tick % 50 == 49 else q + rng.normal(size=robot.n) * 0.02
        if tick % 10 == 5:
            name_of = f"o{rng.integers(5)}"
            pose = exp(rng.normal(size=6) * 0.3)
            scene = scene.put(obstacle(name_of, shape("sphere", (0.1,)), pose, tick * 10**8))
        if tick == 100:
            scene = scene.remove("o1")
        lazy.set_scene(scene, tick * 10**8)
        near, closest = lazy.measure(q, 0.2)
        fresh = DistanceQuery(geometry)
        fresh.set_scene(scene, tick * 10**8)
        everything, truth = fresh.measure(q, np.inf)
        inside = everything.distance < 0.2
        assert near.pair.tolist() == np.flatnonzero(inside).tolist()
        assert (near.distance == everything.distance[inside]).all()
        assert (near.slope == everything.slope[inside]).all()
        assert closest.distance == truth.distance == everything.distance.min()
        compared += len(near.pair)
    assert compared > 150


def test_lower_bounds_save_computations(monkeypatch: pytest.MonkeyPatch) -> None:
    """In slow motion only a few pairs are computed."""
    geometry, rng = geometry_of("panda"), np.random.default_rng(2)
    lazy, q, count = DistanceQuery(geometry), np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.5]), 0
    lazy.set_scene(random_scene(rng, 10, 1.5), 0)
    inner = ConvexDistances.rows

    def counted(distances: ConvexDistances, begin: int, end: int) -> list[tuple[Any, Any]]:
        nonlocal count
        count += end - begin
        return inner(distances, begin, end)

    monkeypatch.setattr(ConvexDistances, "rows", counted)
    for _ in range(200):
        q = q + 0.0005
        lazy.measure(q, 0.1)
    assert 0 < count < 0.2 * 200 * lazy.pairs


def slopes_by_differences(geometry: CollisionGeometry, scene: Scene, q: Array, step: float) -> Array:
    columns = []
    for joint in range(geometry.robot.n):
        up, down = q.copy(), q.copy()
        up[joint] += step
        down[joint] -= step
        difference = measured(geometry, scene, up).distance - measured(geometry, scene, down).distance
        columns.append(difference / (2.0 * step))
    return np.asarray(np.array(columns).T)


@pytest.mark.parametrize("joints", ["rrrrrr", "rprrpr"])
def test_slopes_between_balls_are_exact(joints: str) -> None:
    """Nearest points are unique and analytic: 1e-6 relative, separated and in penetration, revolute and prismatic
    joints, and a base frame that is translated and rotated relative to the root."""
    geometry, rng = collision_geometry.load(ball_arm(joints, "0.4 -0.2 0.7")), np.random.default_rng(3)
    assert len(geometry.watched()) > 5
    inside = 0
    for _ in range(40):
        q, scene = random_position(geometry.robot, rng), random_scene(rng, 8, 0.6)
        near = measured(geometry, scene, q)
        reference = slopes_by_differences(geometry, scene, q, 1e-5)
        fit = near.distance > -0.04  # Balls within each other have no direction at their centres.
        scale = np.abs(reference[fit]).max(axis=1)
        error = np.abs(near.slope - reference)[fit].max(axis=1)
        assert (error <= 1e-6 * np.maximum(scale, 1e-2)).all()
        inside += int((near.distance < 0.0).sum())
    assert inside > 5


@pytest.mark.parametrize(
    ("kind", "tolerance"), [("sphere", 1e-6), ("capsule", 1e-6), ("box", 1e-5), ("cylinder", 2e-3)]
)
def test_slopes_of_hulls(kind: str, tolerance: float) -> None:
    """Links of a Panda and each kind of obstacle: flat and curved surfaces. A pair whose nearest points jump within the
    step has no derivative there; comparing two step sizes finds such pairs, of which a few are allowed."""
    geometry, rng = geometry_of("panda"), np.random.default_rng(4)
    good = compared = 0
    for _ in range(6):
        q, scene = random_position(geometry.robot, rng), random_scene(rng, 4, 0.5, (kind,))
        near = measured(geometry, scene, q)
        coarse, fine = (slopes_by_differences(geometry, scene, q, step) for step in (2e-5, 1e-5))
        steady = (np.abs(coarse - fine).max(axis=1) < 0.2 * tolerance) & (near.distance > -0.02)
        error = np.abs(near.slope - fine).max(axis=1)[steady]
        compared += int(steady.sum())
        good += int((error <= tolerance).sum())
    assert compared > 150
    assert good >= 0.98 * compared


@pytest.mark.parametrize("kind", [kind for kind, _ in KINDS])
def test_no_flip_through_contact_and_either_order(kind: str) -> None:
    """An obstacle moves into a link: the distance decreases steadily and its gradient is continuous at zero. The same
    pair in the other order gives the same distance and gradient."""
    geometry = geometry_of("panda")
    backwards = dataclasses.replace(
        geometry, links=geometry.links[::-1], moves=geometry.moves[::-1], reach=geometry.reach[::-1]
    )
    q, size = np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.5]), dict(KINDS)[kind]
    tool = geometry.robot.frame_pose(q, "panda_hand")
    side = tool[:3, 1]
    previous, lowest = None, np.inf
    for step in range(90):
        pose = np.eye(4)
        pose[:3, 3] = tool[:3, 3] + side * (0.4 - 0.004 * step)
        scene = Scene().put(obstacle("thing", shape(kind, size), pose))
        found = {}
        for made in (geometry, backwards):
            clearance = DistanceQuery(made)
            clearance.set_scene(scene, 0)
            near, _ = clearance.measure(q, np.inf)
            rows = {frozenset(clearance.names(pair)): row for row, pair in enumerate(near.pair)}
            found[made is geometry] = near, rows
        (near, rows), (other, other_rows) = found[True], found[False]
        assert rows.keys() == other_rows.keys()
        order = [other_rows[key] for key in rows]
        tolerance = 1e-5 if kind == "cylinder" else 1e-9
        assert other.distance[order] == pytest.approx(near.distance, abs=1e-6)
        apart = near.distance > -0.005
        assert np.abs(other.slope[order] - near.slope)[apart].max() < max(tolerance, 5e-3 * (kind == "cylinder"))
        row = rows[frozenset(("panda_hand", "thing"))]
        distance, slope = float(near.distance[row]), near.slope[row]
        if previous is not None and -0.03 < distance < 0.1:
            assert 0.0 < previous[0] - distance < 0.0041
            assert slope @ previous[1] > 0.9 * np.linalg.norm(slope) * np.linalg.norm(previous[1])
        previous = distance, slope
        lowest = min(lowest, distance)
    assert lowest < -0.02


def test_self_pairs_either_order() -> None:
    """The sign must not depend on the order of the links."""
    geometry, rng = geometry_of("panda"), np.random.default_rng(5)
    swapped = dataclasses.replace(
        geometry, pairs=tuple(pair._replace(first=pair.second, second=pair.first) for pair in geometry.pairs)
    )
    for _ in range(30):
        q = random_position(geometry.robot, rng)
        one, two = measured(geometry, Scene(), q), measured(swapped, Scene(), q)
        assert two.distance == pytest.approx(one.distance, abs=1e-9)
        unique = np.abs(one.distance) > 1e-6
        assert np.quantile(np.abs(two.slope - one.slope)[unique].max(axis=1), 0.95) < 1e-9


def test_nearest_points_and_drift() -> None:
    """The distance between the nearest points is that of the pair, in the base frame; the obstacle's velocity is
    included."""
    robot = ball_arm(base_offset="0.1 0.2 0.3")
    clearance = DistanceQuery(collision_geometry.load(robot))
    q = np.array([0.3, -0.5, 0.7, 0.2, -0.4, 0.6])
    tip = robot.pose(q)
    pose = np.eye(4)
    pose[:3, 3] = np.array([0.3, 0.0, 0.0]) + tip[:3, 3] + 0.3 * tip[:3, 2]
    velocity = np.array([-0.5, 0.2, 0.0])
    ball = obstacle("ball", shape("sphere", (0.1,)), pose, velocity_s=velocity)
    clearance.set_scene(Scene().put(ball), 0)
    near, closest = clearance.measure(q, np.inf)
    assert closest.names == ("link6", "ball")
    assert closest.distance == pytest.approx(0.15)
    assert closest.points_s[1] - closest.points_s[0] == pytest.approx([0.15, 0.0, 0.0])
    row = [clearance.names(pair) for pair in near.pair].index(("link6", "ball"))
    assert near.drift[row] == pytest.approx(-0.5)
    clearance.set_scene(Scene().put(ball), 100_000_000)  # Extrapolated: 5 cm nearer, 2 cm aside.
    later = clearance.measure(q, np.inf)[1]
    assert later.distance == pytest.approx(np.hypot(0.25, 0.02) - 0.15)


def test_an_arm_of_one_joint_and_an_arm_without_pairs() -> None:
    """The smallest cases: a ball on a lever that rotates towards another ball, and an arm without pairs."""
    solid = '<collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>'
    robot = Robot(
        f'<robot name="lever"><link name="a"/><link name="b">{solid}</link><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    clearance, q = DistanceQuery(collision_geometry.load(robot)), np.zeros(1)
    near, closest = clearance.measure(q, 0.0)
    assert (len(near.pair), closest.distance, closest.names) == (0, np.inf, ())
    pose = np.eye(4)
    pose[:3, 3] = 0.5, 0.3, 0.0
    clearance.set_scene(Scene().put(obstacle("ball", shape("sphere", (0.1,)), pose)), 0)
    near, closest = clearance.measure(q, 1.0)
    assert closest.distance == pytest.approx(0.1)
    assert near.slope == pytest.approx(np.array([[-0.5]]))


def test_nan_counts_as_near() -> None:
    """A NaN among the requested ranges must not hide a pair."""
    clearance, q = DistanceQuery(geometry_of("panda")), np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.5])
    assert len(clearance.measure(q, np.nan)[0].pair) == clearance.pairs


def test_no_pair_that_could_not_stop_is_left_out() -> None:
    """Required by the velocity dampers: a pair is found where its speed of approach, bounded by its own slope, needs
    more than its distance to end."""
    geometry, rng = geometry_of("panda"), np.random.default_rng(6)
    lazy, scene, found = DistanceQuery(geometry), Scene(), 0
    for name, entry in random_scene(rng, 16, 0.5, tuple(kind for kind, _ in KINDS)).obstacles.items():
        scene = scene.put(obstacle(name, entry.shape, entry.pose_s, velocity_s=rng.normal(size=3) * 0.1))
    q = random_position(geometry.robot, rng)
    for tick in range(60):
        q = random_position(geometry.robot, rng) if tick % 10 == 0 else q + rng.normal(size=7) * 0.01
        qd, change = rng.normal(size=7) * 0.4, rng.uniform(0.0, 0.1, 7)
        fresh = DistanceQuery(geometry)
        for query in (fresh, lazy):
            query.set_scene(scene, tick * 10**7)
        near, _ = fresh.measure(q, np.inf)
        binding = pairs_that_must_stop(near, qd, change)
        count = lazy.query(q, LIMITS, qd, change)
        assert binding <= set(lazy.rows.pair[:count].tolist())
        found += len(binding)
    assert found > 100


def test_simplified_links_contain_the_meshes() -> None:
    """Distances must never be overestimated: every vertex of every collision element lies in its link's solid."""
    for name in ("panda", "ur5", "talos_arm"):
        for simplification in collision_geometry.SIMPLIFICATIONS:
            geometry = collision_geometry.load(make_robot(name), simplification, self_collision=False)
            for link in geometry.links:
                if isinstance(link.solid, coal.Cylinder):
                    continue  # Not simplified; its points are those of a circumscribed prism.
                where = coal.Transform3s(link.placement.rotation, link.placement.translation)
                for point in link.points[:: max(1, len(link.points) // 40)]:
                    request, result = coal.DistanceRequest(), coal.DistanceResult()
                    at = coal.Transform3s(np.eye(3), point)
                    coal.distance(coal.Sphere(1e-6), at, link.solid, where, request, result)
                    assert result.min_distance < 1e-5
    excess = geometry_of("panda").conservatism()
    assert 0.0 <= max(excess.values()) < 0.001  # The Panda's collision meshes are convex already.


def test_the_capsule_is_tight() -> None:
    """For points of a known capsule, the result is nearly that capsule."""
    rng = np.random.default_rng(7)
    rotation = exp(np.concatenate((np.zeros(3), rng.normal(size=3))))[:3, :3]
    directions = rng.normal(size=(800, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    ends = np.where(directions[:, 2:] > 0.0, 0.2, -0.2) * np.array([0.0, 0.0, 1.0])
    points = (ends + 0.05 * directions) @ rotation.T + (1.0, 2.0, 3.0)
    found = bounding_capsule.around(points)
    assert found.radius == pytest.approx(0.05, rel=0.03)
    assert found.length == pytest.approx(0.4, rel=0.03)
    assert abs(found.rotation[:, 2] @ rotation[:, 2]) > 0.999


def test_pairs_are_selected_with_a_reason() -> None:
    """Neighbours and pairs in permanent contact are not checked, the others are; settings override the selection, an
    SRDF replaces the sampling."""
    robot = make_robot("talos_arm")
    pairs = {(pair.first, pair.second): pair for pair in collision_geometry.load(robot).pairs}
    assert pairs["arm_left_5_link", "arm_left_7_link"].reason == "in collision in 100% of the samples"
    assert pairs["arm_left_1_link", "arm_left_2_link"].reason == "adjacent"
    assert pairs["arm_left_1_link", "arm_left_7_link"].watched
    chosen = collision_geometry.load(
        robot, ignored=("arm_left_1_link:arm_left_7_link",), watched=("arm_left_7_link:arm_left_5_link",)
    )
    assert ("arm_left_1_link", "arm_left_7_link", False, "listed in ignored_pairs") in chosen.pairs
    assert ("arm_left_5_link", "arm_left_7_link", True, "listed in watched_pairs") in chosen.pairs
    srdf = '<robot name="t"><disable_collisions link1="arm_left_7_link" link2="arm_left_2_link" reason="x"/></robot>'
    by_srdf = {(pair.first, pair.second): pair for pair in collision_geometry.load(robot, srdf=srdf).pairs}
    assert not by_srdf["arm_left_2_link", "arm_left_7_link"].watched
    assert by_srdf["arm_left_1_link", "arm_left_7_link"].reason == "not disabled by the SRDF"
    # An SRDF does not disable a pair in permanent contact, which would block the arm.
    forgotten = by_srdf["arm_left_5_link", "arm_left_7_link"]
    assert not forgotten.watched
    assert forgotten.reason == "not disabled by the SRDF, but in collision in 100% of the samples"
    silent = '<robot name="t"><group name="arm"/></robot>'
    assert collision_geometry.load(robot, srdf=silent).pairs == collision_geometry.load(robot).pairs, (
        "it does not mention pairs"
    )
    links, some = collision_geometry.load(robot).links, [(0, 3), (1, 5), (2, 7)]
    first, second = (pair_selection.sampled_distances(robot, links, some) for _ in range(2))
    assert np.array_equal(first, second)  # Deterministic.
    with pytest.raises(UnknownNameError, match="nonsense"):
        collision_geometry.load(robot, ignored=("nonsense:arm_left_7_link",))


def test_the_samples_of_a_robot_are_not_taken_for_another_one() -> None:
    """They are computed once per process for the same solids, frames and joints."""
    near, far = ball_arm(), ball_arm(base_offset="0.4 -0.2 0.7")
    wide = Robot(near.urdf.replace('radius="0.05"', 'radius="0.25"'), near.base_frame, near.tip_frame)
    found = [collision_geometry.load(robot).pairs for robot in (near, wide, far, near, ball_arm())]
    assert found[0] != found[1]
    assert found[0] == found[3] == found[4]
    hull, capsule = (collision_geometry.load(make_robot("panda"), kind) for kind in collision_geometry.SIMPLIFICATIONS)
    assert hull.pairs != capsule.pairs, "the reasons state how often each pair is in collision"


def test_missing_meshes_are_reported() -> None:
    """The rest of the node works without distances, so the reason must reach the status."""
    robot = make_robot("ur5")
    lost = Robot(robot.urdf.replace("meshes/ur5/collision/", "meshes/nowhere/"), robot.base_frame, robot.tip_frame)
    with pytest.raises(CollisionUnavailableError, match=r"nowhere.*Looked in"):
        collision_geometry.load(lost)
    bare = '<robot name="b"><link name="a"/><link name="c"/><joint name="j" type="continuous"><parent link="a"/>'
    bare += '<child link="c"/><axis xyz="0 0 1"/></joint></robot>'
    with pytest.raises(CollisionUnavailableError, match="no collision geometry"):
        collision_geometry.load(Robot(bare))


def test_a_crowd_of_obstacles_is_bounded_and_never_farther_than_it_is() -> None:
    """Beyond the number of pairs that one query computes, distances are those of capsules: shorter, with unit normals.
    The closest pair stays exact, and none of it depends on earlier queries."""
    geometry, rng = geometry_of("panda"), np.random.default_rng(8)
    scene = random_scene(rng, 200, 0.8, tuple(kind for kind, _ in KINDS))
    lazy, q = DistanceQuery(geometry), np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.5])
    still, limits = np.zeros(7), Limits(0.05, 1.0)
    shortened = 0
    for _ in range(3):
        q = q + rng.normal(size=7) * 0.01
        found = []
        for query in (lazy, fresh := DistanceQuery(geometry)):
            query.set_scene(scene, 0)
            count = query.query(q, limits, still, still)
            found.append([column[:count].copy() for column in query.rows])
        for one, other in zip(*found, strict=True):
            assert (one == other).all()
        pair, distance, slope = found[1][:3]
        assert fresh.closest().distance == lazy.closest().distance
        one_by_one: dict[tuple[str, str], float] = {}
        for name, entry in scene.obstacles.items():
            alone = DistanceQuery(geometry)
            alone.set_scene(Scene().put(entry), 0)
            near, _ = alone.measure(q, np.inf)
            one_by_one |= {(alone.names(p)[0], name): d for p, d in zip(near.pair, near.distance, strict=True)}
        exact = np.array([one_by_one.get(fresh.names(p), np.nan) for p in pair])
        obstacles = np.isfinite(exact) & (found[1][4] == 0.0)
        assert (distance <= exact)[obstacles].all()
        assert min(exact[obstacles]) == fresh.closest().distance
        wrong = int((distance < exact)[obstacles].sum())
        assert obstacles.sum() - wrong >= MOST_COMPUTED // 2
        assert np.isfinite(slope).all()
        shortened += wrong
    assert shortened > 100
