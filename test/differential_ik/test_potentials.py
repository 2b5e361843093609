"""Potentials and velocity dampers: gradients agree with finite differences, are bounded and have the correct sign;
approach is slowed, retreat is free; scenes are read from files.

Not tested here: distances themselves (test_collision.py), the optimum (test_constrained.py).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import ball_arm, random_position
from loop import make_robot

from ik_node.collision import avoidance
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.avoidance import LOOK_AHEAD_S, avoidance_terms
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.scene import EXTRAPOLATION_S, Scene, obstacle, read_scene, shape
from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import constrained, posture
from ik_node.differential_ik.manipulability import manipulability_potential
from ik_node.differential_ik.methods import METHODS
from ik_node.errors import InputError, SceneError
from ik_node.math.types import Array
from ik_node.robot.joint_limits import joint_bounds, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings, ObstacleSettings

SETTINGS = ObstacleSettings()


def at(x: float, y: float, z: float) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def value_and_gradient(
    clearance: DistanceQuery, scene: Scene, q: Array, settings: ObstacleSettings
) -> tuple[float, Array]:
    still = np.zeros(len(q))
    found = avoidance_terms(clearance, scene, q, still, still, settings, 0.01, 0).potential
    return found.value, found.gradient


def by_differences(clearance: DistanceQuery, scene: Scene, q: Array, settings: ObstacleSettings, step: float) -> Array:
    result = np.zeros(len(q))
    for joint in range(len(q)):
        up, down = q.copy(), q.copy()
        up[joint] += step
        down[joint] -= step
        high, low = (value_and_gradient(clearance, scene, p, settings)[0] for p in (up, down))
        result[joint] = (high - low) / (2.0 * step)
    return result


def test_psi_is_smooth_bounded_and_one_sided() -> None:
    """Zero beyond the range, continuously differentiable at both joints, slope at most 1, never attractive."""
    span = np.full(4001, 0.15)
    distance = np.linspace(-0.2, 0.2, 4001)
    value, slope = avoidance.repulsion_profile(distance, span)
    assert (value >= 0.0).all()
    assert (slope <= 0.0).all()
    assert (slope >= -1.0).all()
    assert (value[distance > 0.15] == 0.0).all()
    assert np.gradient(value, distance)[1:-1] == pytest.approx(slope[1:-1], abs=2e-3)
    assert np.abs(np.diff(slope)).max() < 3e-3  # No jump.


@pytest.mark.parametrize("base_offset", ["0 0 0", "0.3 -0.1 0.5"])
def test_repulsion_is_the_gradient_of_its_potential(base_offset: str) -> None:
    """1e-6 relative, with pairs in range, in contact and in penetration, obstacles and the arm's own links."""
    robot = ball_arm(base_offset=base_offset)
    clearance, rng = DistanceQuery(collision_geometry.load(robot)), np.random.default_rng(1)
    settings, active = ObstacleSettings(repulsion_range=(0.3, 0.2)), 0
    for _ in range(15):
        q, scene = random_position(robot, rng), Scene()
        for index in range(8):
            scene = scene.put(obstacle(str(index), shape("sphere", (0.08,)), at(*rng.uniform(-0.8, 0.8, 3))))
        _, gradient = value_and_gradient(clearance, scene, q, settings)
        reference = by_differences(clearance, scene, q, settings, 1e-5)
        assert np.abs(gradient - reference).max() <= 1e-6 * max(1.0, np.abs(reference).max())
        active += bool(reference.any())
    assert active > 10


def test_repulsion_of_hulls_within_a_measured_tolerance() -> None:
    """Links of a Panda: nearest points on flat faces move faster than the distance changes; 1e-3 relative there."""
    robot = make_robot("panda")
    clearance, rng, errors = DistanceQuery(collision_geometry.load(robot)), np.random.default_rng(2), []
    for _ in range(30):
        q, scene = random_position(robot, rng), Scene()
        for index in range(6):
            scene = scene.put(obstacle(str(index), shape("box", (0.2, 0.1, 0.1)), at(*rng.uniform(-0.7, 0.7, 3))))
        _, gradient = value_and_gradient(clearance, scene, q, SETTINGS)
        reference = by_differences(clearance, scene, q, SETTINGS, 1e-6)
        if reference.any():
            errors.append(float(np.abs(gradient - reference).max() / np.abs(reference).max()))
    assert len(errors) > 20
    assert np.median(errors) < 1e-6
    assert np.quantile(errors, 0.9) < 1e-3


def test_the_repulsion_points_away_on_both_sides_of_contact() -> None:
    """Away from a ball beside the tool, at any depth down to its centre, by at most F times a lever arm."""
    robot = ball_arm()
    clearance, q = DistanceQuery(collision_geometry.load(robot)), np.array([0.3, -0.5, 0.7, 0.2, -0.4, 0.6])
    tip = robot.pose(q)
    end = tip[:3, 3] + 0.3 * tip[:3, 2]
    jacobian = robot.evaluate(q).jacobian_b
    linear = tip[:3, :3] @ (jacobian[:3] + np.cross(jacobian[3:].T, [0.0, 0.0, 0.3]).T)
    for offset in np.linspace(0.29, 0.01, 57):
        scene = Scene().put(obstacle("ball", shape("sphere", (0.1,)), at(end[0] + offset, end[1], end[2])))
        _, gradient = value_and_gradient(clearance, scene, q, ObstacleSettings(repulsion_range=(0.2, 0.001)))
        assert (linear @ -gradient)[0] < 0.0
        assert np.abs(gradient).max() <= SETTINGS.repulsion_force * 1.9


def around(q: Array) -> list[Array]:
    """Return positions one step up and down along every joint."""
    return [q + sign * 1e-6 * row for row in np.eye(len(q)) for sign in (1.0, -1.0)]


def central(values: list[float]) -> Array:
    """Return central differences of the values at ``around``."""
    return np.asarray((np.array(values[::2]) - np.array(values[1::2])) / 2e-6)


def test_the_push_also_comes_from_what_lies_ahead() -> None:
    """Out of range now, but reached soon at the present velocity: repelled already, by the gradient at the predicted
    position."""
    robot = ball_arm()
    clearance, q, qd = (
        DistanceQuery(collision_geometry.load(robot)),
        np.array([0.3, -0.5, 0.7, 0.2, -0.4, 0.6]),
        np.zeros(6),
    )
    qd[0] = 0.5
    there = robot.pose(q + LOOK_AHEAD_S * qd)
    end = there[:3, 3] + 0.3 * there[:3, 2] + (0.2, 0.0, 0.0)
    scene = Scene().put(obstacle("ball", shape("sphere", (0.1,)), at(*end)))
    still = np.zeros(6)
    settings = ObstacleSettings(repulsion_range=(0.2, 0.001))
    assert not avoidance_terms(clearance, scene, q, still, still, settings, 0.01, 0).potential.gradient.any()
    ahead = avoidance_terms(clearance, scene, q, qd, still, settings, 0.01, 0).potential
    same = avoidance_terms(clearance, scene, q + LOOK_AHEAD_S * qd, still, still, settings, 0.01, 0).potential
    assert ahead.gradient == pytest.approx(same.gradient, abs=1e-9)
    assert ahead.value == pytest.approx(same.value)
    assert ahead.gradient.any()


def test_dexterity_is_the_gradient_along_the_null_space() -> None:
    """Compared with finite differences of its value; zero while the arm is not stretched, and without a null space."""
    robot, rng, pushed = make_robot("panda"), np.random.default_rng(4), 0
    scale = np.repeat((1.0, 0.3), 3)

    def jacobian_at(q: Array) -> Array:
        return robot.evaluate(q).jacobian_b

    for _ in range(60):
        q = random_position(robot, rng)
        found = manipulability_potential(jacobian_at, q, scale, 30_000.0)
        null = np.linalg.svd(scale[:, None] * jacobian_at(q))[2][-1]
        step = 1e-5
        difference = manipulability_potential(jacobian_at, q + step * null, scale, 30_000.0).value
        difference -= manipulability_potential(jacobian_at, q - step * null, scale, 30_000.0).value
        assert found.gradient @ null == pytest.approx(difference / (2.0 * step), rel=1e-4, abs=1e-3)
        assert np.linalg.norm(found.gradient - (found.gradient @ null) * null) < 1e-9
        pushed += bool(found.gradient.any())
    assert 3 < pushed < 50
    six = make_robot("ur5")
    assert not manipulability_potential(
        lambda q: six.evaluate(q).jacobian_b, np.zeros(6), scale, 30_000.0
    ).gradient.any()


def test_secondary_gradients() -> None:
    """Centring and posture against finite differences; gravity against Pinocchio's energy; continuous joints
    separately."""
    rng = np.random.default_rng(3)
    for name in ("panda", "kinova"):
        robot = make_robot(name)
        q, wanted = random_position(robot, rng), random_position(robot, rng)
        for gradient, values in (
            (
                posture.joint_centering(robot, q, 2.0).gradient,
                [posture.joint_centering(robot, p, 2.0).value for p in around(q)],
            ),
            (
                posture.posture_potential(robot, q, wanted, 3.0).gradient,
                [posture.posture_potential(robot, p, wanted, 3.0).value for p in around(q)],
            ),
        ):
            assert gradient == pytest.approx(central(values), abs=1e-7)
        assert (posture.joint_centering(robot, q, 2.0).gradient[robot.continuous] == 0.0).all()
    robot = make_robot("panda")
    q = random_position(robot, rng)
    energy = central([pin.computePotentialEnergy(robot.model, robot.data, p) for p in around(q)])
    gravity = METHODS["gravity_gradient"](robot, q, None).gradient
    assert gravity is not None
    assert 0.5 * gravity == pytest.approx(0.5 * energy, abs=1e-6)


def drive(robot: Robot, scene: Scene, q: Array, twist_s: Array, ticks: int, settings: ObstacleSettings) -> list[Array]:
    """Move at ``twist_s`` (linear and angular along the base axes), 500 Hz; return rows of q, s and the distance."""
    limits = motion_limits(robot, LimitSettings(), 500.0)
    clearance, qd, rows = DistanceQuery(collision_geometry.load(robot)), np.zeros(robot.n), []
    for tick in range(ticks):
        bounds = joint_bounds(limits, q, qd, 0.002)
        change = np.maximum(bounds.hi - qd, qd - bounds.lo)
        around = avoidance_terms(clearance, scene, q, qd, change, settings, 0.01, tick * 2_000_000, repel=False)
        state = robot.evaluate(q)
        turn = state.pose_sb[:3, :3].T
        twist = np.concatenate((turn @ twist_s[:3], turn @ twist_s[3:]))
        answer = constrained.solve(state.jacobian_b, twist, bounds.lo, bounds.hi, dampers=around.dampers)
        qd = answer.joint_velocity
        rows.append(np.array([answer.task_scale, around.closest.distance, answer.damper_slack.sum(), *q]))
        q = q + 0.002 * qd
    return rows


def test_the_damper_stops_before_contact_and_permits_retreat() -> None:
    """Moving at 0.3 m/s towards an obstacle, the arm stops at the stop distance; moving away, it has full speed from
    the first steps on, as its acceleration limits allow without a damper."""
    robot, q = make_robot("ur5"), np.array([0.0, -1.2, 1.6, -1.97, -1.57, 0.0])
    ahead = robot.pose(q)[:3, 3] + (0.0, -0.45, 0.0)
    scene = Scene().put(obstacle("post", shape("sphere", (0.1,)), at(*ahead)))
    rows = drive(robot, scene, q, np.array([0.0, -0.3, 0.0, 0.0, 0.0, 0.0]), 1500, SETTINGS)
    clearances = np.array([row[1] for row in rows])
    assert clearances.min() > SETTINGS.stop_distance[0] - 1e-3
    assert clearances[-1] < SETTINGS.stop_distance[0] + 2e-3
    assert rows[-1][0] < 0.02  # s: at rest in front of the obstacle.
    assert sum(row[2] for row in rows) == 0.0  # No damper was relaxed.
    stopped = rows[-1][3:]
    back = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    damped, free = (drive(robot, world, stopped, back, 100, SETTINGS) for world in (scene, Scene()))
    assert all((a[3:] == b[3:]).all() for a, b in zip(damped, free, strict=True))


def test_an_obstacle_that_comes_nearer_by_itself() -> None:
    """A ball moves at 0.1 m/s towards an arm with zero twist: the arm moves away before contact."""
    robot, q = make_robot("ur5"), np.array([0.0, -1.2, 1.6, -1.97, -1.57, 0.0])
    start = robot.pose(q)[:3, 3] + (0.0, -0.4, 0.0)
    ball = obstacle("ball", shape("sphere", (0.1,)), at(*start), velocity_s=np.array([0.0, 0.1, 0.0]))
    rows = drive(robot, Scene().put(ball), q, np.zeros(6), 1800, SETTINGS)
    clearances = np.array([row[1] for row in rows])
    assert clearances.min() > 0.5 * SETTINGS.stop_distance[0]
    assert np.abs(rows[-1][3:] - q).max() > 0.05  # The arm moved.


def test_dampers_name_only_what_can_bind() -> None:
    """Rows cost time: distant or receding pairs are left out; the others are named link - obstacle."""
    robot, q = make_robot("panda"), np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.5])
    clearance, qd, change = DistanceQuery(collision_geometry.load(robot)), np.zeros(7), np.full(7, 0.02)
    near = robot.pose(q)[:3, 3] + (0.2, 0.0, 0.0)
    scene = Scene().put(obstacle("post", shape("sphere", (0.1,)), at(*near)))
    scene = scene.put(obstacle("far", shape("sphere", (0.1,)), at(3.0, 0.0, 0.0)))
    assert avoidance_terms(clearance, scene, q, qd, change, SETTINGS, 0.01, 0).dampers.names == ()
    fast = np.linalg.pinv(robot.evaluate(q).jacobian_b) @ np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    fast = fast + np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found: VelocityDampers = avoidance_terms(clearance, scene, q, fast, change, SETTINGS, 0.01, 0).dampers
    assert found.names
    assert all("post" in name or "panda" in name.split(" - ")[1] for name in found.names)
    assert not any("far" in name for name in found.names)
    off = ObstacleSettings(velocity_damper=False)
    assert avoidance_terms(clearance, scene, q, fast, change, off, 0.01, 0).dampers.names == ()


def test_obstacles_have_a_motion_of_their_own() -> None:
    """The velocity follows from two messages; a jump gives none; an old estimate is discarded; lifetimes expire."""
    ball, ms = shape("sphere", (0.1,)), 1_000_000
    scene = Scene().put(obstacle("b", ball, at(0.0, 0.0, 0.0), 0))
    scene = scene.put(obstacle("b", ball, at(0.01, 0.0, 0.0), 100 * ms))
    seen = scene.obstacles["b"]
    assert seen.velocity_s == pytest.approx([0.1, 0.0, 0.0])
    assert seen.at(150 * ms).pose_s[0, 3] == pytest.approx(0.015)
    assert seen.at(2000 * ms).pose_s[0, 3] == pytest.approx(0.01 + 0.1 * EXTRAPOLATION_S)
    assert not seen.at(2000 * ms).moves
    leapt = scene.put(obstacle("b", ball, at(1.0, 0.0, 0.0), 200 * ms))
    assert not leapt.obstacles["b"].moves
    assert not scene.put(obstacle("b", ball, at(0.2, 0.0, 0.0), 900 * ms)).obstacles["b"].moves
    short = scene.put(obstacle("c", ball, at(0.0, 0.0, 0.0), 0, expires_ns=300 * ms))
    assert set(short.at(299 * ms).obstacles) == {"b", "c"}
    assert set(short.at(300 * ms).obstacles) == {"b"}
    assert short.remove("b").remove("nothing").obstacles.keys() == {"c"}


def test_scene_files(tmp_path: Path) -> None:
    """All keys of a file, also in a frame of the robot; each error message names the mistake."""
    file = tmp_path / "scene.yaml"
    file.write_text(
        "obstacles:\n"
        "  - {name: post, cylinder: {radius: 0.05, length: 0.6}, position: [0.4, 0.1, 0.3]}\n"
        "  - {box: {size: [0.1, 0.2, 0.3]}, frame: link1, orientation: [0, 0, 0, 1], velocity: [0, 0, 0.1]}\n"
    )
    robot = ball_arm()
    scene = read_scene(file, lambda frame: robot.frame_pose(np.zeros(6), frame))
    assert scene.obstacles["post"].shape == ("cylinder", (0.05, 0.6))
    assert scene.obstacles["post"].pose_s[:3, 3] == pytest.approx([0.4, 0.1, 0.3])
    box = scene.obstacles["obstacle_1"]
    assert box.shape.reach == pytest.approx(0.5 * np.sqrt(0.14))
    frame = robot.frame_pose(np.zeros(6), "link1")
    assert box.pose_s == pytest.approx(frame)
    assert box.velocity_s == pytest.approx(0.1 * frame[:3, 2])
    for text, told in (
        ("[", "not YAML"),
        ("things: []", "no list 'obstacles'"),
        ("obstacles: [{position: [0, 0, 0]}]", "expected one of sphere, box"),
        ("obstacles: [{sphere: {radius: -1}}]", "radius -1"),
        ("obstacles: [{sphere: {radios: 1}}]", "radios; expected radius"),
        ("obstacles: [{sphere: {radius: 1}, colour: red}]", "unknown key 'colour'"),
        ("obstacles: [{name: a, sphere: {radius: 1}}, {name: a, sphere: {radius: 1}}]", "two obstacles named 'a'"),
        ("obstacles: [{sphere: {radius: 1}, frame: x}]", "without a robot"),
        ("obstacles: [{sphere: {radius: 1}, position: [0, .nan, 0]}]", "not finite"),
        ("obstacles: [3]", "expected a mapping"),
    ):
        file.write_text(text)
        with pytest.raises(SceneError, match=told):
            read_scene(file)
    with pytest.raises(SceneError, match="cannot be read"):
        read_scene(tmp_path / "nowhere.yaml")
    with pytest.raises(InputError, match="valid: sphere, box, cylinder, capsule"):
        shape("cone", (1.0,))
