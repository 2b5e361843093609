"""Mimic joints move with their masters in poses, Jacobians, masses, gravity and distances.

References: the same description without <mimic>, all of whose joints are controlled, under the constraint q_m = A q + b
that the test defines itself; finite differences. Not tested: Pinocchio's own mimic joints, which are not used.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from arms import random_position
from loop import READY, Loop
from stopping import LIMITS, pairs_that_must_stop

from ik_node.collision import geometry as collision_geometry
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.errors import RobotError
from ik_node.interfaces.step import Mode
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.description import read_description
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ArmSettings, Settings
from ik_node.settings.method_names import METHOD_NAMES

GENERATOR = np.random.default_rng(21)
RATIO = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.05, 0.0], [0.3, 0.0, 0.0]]
)
"""Of the arm below: joint3 mimics joint1, slide5 mimics joint2, and nod6 mimics joint3, hence joint1."""
OFFSET = np.array([0.0, 0.0, 0.4, 0.0, 0.02, -0.1 - 0.5 * 0.4])


def description(mimicking: bool = True, kinds: dict[str, str] | None = None, tags: dict[str, str] | None = None) -> str:
    """Six links in a row and a finger beside them; each with its own mass and a ball of 4 cm at its end."""
    own = {"joint3": '<mimic joint="joint1" multiplier="-0.6" offset="0.4"/>',
           "slide5": '<mimic joint="joint2" multiplier="0.05" offset="0.02"/>',
           "nod6": '<mimic joint="joint3" multiplier="-0.5" offset="-0.1"/>',
           "finger": '<mimic joint="joint4"/>'}  # fmt: skip
    told = {**own, **(tags or {})} if mimicking else {}
    names = ("joint1", "joint2", "joint3", "joint4", "slide5", "nod6", "finger")
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 0 1", "0 1 0", "0 1 0")
    parts = ['<robot name="m"><link name="root"/>']
    for index, (name, axis) in enumerate(zip(names, axes, strict=True)):
        kind = (kinds or {}).get(name, "prismatic" if name == "slide5" else "revolute")
        parent = "root" if index == 0 else "link4" if name == "finger" else f"link{index}"
        shift = "0.1 0.05 0.1" if name == "finger" else f"{0.02 * index} 0.01 0.25"
        parts.append(
            f'<link name="link{index + 1}"><inertial><mass value="{1.0 + 0.3 * index}"/><origin xyz="0.02 0.01 0.1"/>'
            f'<inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0.001" ixz="0" iyz="0.002"/></inertial>'
            '<collision><origin xyz="0 0 0.2"/><geometry><sphere radius="0.04"/></geometry></collision></link>'
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="link{index + 1}"/>'
            f'<origin xyz="{shift}" rpy="0.1 {0.1 * index} 0"/><axis xyz="{axis}"/>{told.get(name, "")}'
            f'<limit lower="{-0.3 if kind == "prismatic" else -2}" upper="{0.3 if kind == "prismatic" else 2}" '
            'velocity="2" effort="9"/></joint>'
        )
    return "".join(parts) + "</robot>"


def pair() -> tuple[Robot, Robot]:
    """Return the arm, and the one with all joints of the chain controlled. The finger mimics joint4 in the first."""
    return Robot(description(), tip_frame="link6"), Robot(description(mimicking=False), tip_frame="link6")


def test_masters_of_the_chain_are_what_is_controlled() -> None:
    robot, free = pair()
    assert robot.joints == ("joint1", "joint2", "joint4")
    assert free.joints == ("joint1", "joint2", "joint3", "joint4", "slide5", "nod6")
    aside = Robot(description(), tip_frame="link7", joints=("joint4", "joint1"))
    assert aside.joints == ("joint4", "joint1")
    with pytest.raises(
        RobotError, match=r"'nod6' mimics 'joint1' and cannot be controlled by itself; control 'joint1'"
    ):
        Robot(description(), tip_frame="link6", joints=("joint1", "nod6"))


def test_poses_and_jacobians_are_those_of_the_constraint() -> None:
    robot, free = pair()
    for _ in range(10):
        q = random_position(robot, GENERATOR)
        whole = RATIO @ q + OFFSET
        assert np.abs(robot.pose(q) - free.pose(whole)).max() < 1e-14
        found = robot.evaluate(q)
        assert np.abs(found.pose_sb - robot.pose(q)).max() == 0.0
        assert np.abs(found.jacobian_b - free.evaluate(whole).jacobian_b @ RATIO).max() < 1e-14
        for joint in range(3):
            shift = 1e-6 * np.eye(3)[joint]
            moved = se3.inverse(robot.pose(q - shift)) @ robot.pose(q + shift)
            assert np.abs(se3.log(moved) / 2e-6 - found.jacobian_b[:, joint]).max() < 1e-8


def test_mass_and_gravity_are_those_of_the_constraint() -> None:
    """M_c = A' M A, g_c = A' g: a joint carries the mass and weight of its mimic joints. The finger counts although it
    is not in the chain: it is a seventh joint here."""
    robot = pair()[0]
    ratio, offset = np.vstack((RATIO, [0.0, 0.0, 1.0])), np.append(OFFSET, 0.0)
    for _ in range(5):
        q = random_position(robot, GENERATOR)
        found = robot.dynamics(q)
        assert np.array_equal(found.mass_matrix, found.mass_matrix.T)
        # Kinetic energy link by link, from differences of the positions of the bodies: crba is not used.
        energy = np.zeros((3, 3))
        height = np.zeros(3)
        moved = [(ratio @ (q + d) + offset, ratio @ (q - d) + offset) for d in 1e-5 * np.eye(3)]
        for index in range(7):
            tip = f"link{index + 1}"
            body = Robot(description(mimicking=False), tip_frame=tip)
            order = [("joint1", "joint2", "joint3", "joint4", "slide5", "nod6", "finger").index(j) for j in body.joints]
            centre = np.eye(4)
            centre[:3, 3] = (0.02, 0.01, 0.1)
            poses = [(body.pose(up[order]) @ centre, body.pose(down[order]) @ centre) for up, down in moved]
            columns = np.array([se3.log(se3.inverse(down) @ up) / 2e-5 for up, down in poses]).T
            mass = 1.0 + 0.3 * index
            inertia = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, 0.002], [0.0, 0.002, 0.01]])
            energy += mass * columns[:3].T @ columns[:3] + columns[3:].T @ inertia @ columns[3:]
            height += 9.81 * mass * np.array([(up[2, 3] - down[2, 3]) / 2e-5 for up, down in poses])
        assert np.abs(found.mass_matrix - energy).max() < 1e-7
        qd = np.array([1.0, -0.5, 0.3])
        assert robot.kinetic_energy(q, qd) == pytest.approx(0.5 * qd @ energy @ qd, rel=1e-6)
        assert np.abs(found.gravity - height).max() < 1e-7


def test_joints_that_are_not_controlled_are_held_where_their_masters_are() -> None:
    """Their masters are at zero, so they are at their offset, also in a series of them."""
    robot = Robot(description(), tip_frame="link6", joints=("joint2", "joint4"))
    free = pair()[1]
    q = np.array([0.3, -0.7])
    whole = RATIO @ np.array([0.0, *q]) + OFFSET
    assert np.abs(robot.pose(q) - free.pose(whole)).max() < 1e-14


def test_limits_leave_the_mimic_joints_within_theirs() -> None:
    robot = pair()[0]
    # nod6 = -0.3 + 0.3 joint1 and joint3 = 0.4 - 0.6 joint1 within +-2: joint1 from -8/3 to 4 and within its own.
    # slide5 = 0.02 + 0.05 joint2 within +-0.3 does not bind.
    assert robot.limits.lower.tolist() == [-2.0, -2.0, -2.0]
    assert robot.limits.upper.tolist() == [2.0, 2.0, 2.0]
    steep = {"joint3": '<mimic joint="joint1" multiplier="-4" offset="1"/>'}
    robot = Robot(description(tags=steep), tip_frame="link6")
    assert robot.limits.lower[0] == pytest.approx((1.0 - 2.0) / 4.0)
    assert robot.limits.upper[0] == pytest.approx((1.0 + 2.0) / 4.0)
    assert robot.limits.velocity[0] == pytest.approx(2.0 / 4.0)
    # Limits that leave an empty range are an error.
    absurd = {"joint3": '<mimic joint="joint1" multiplier="1" offset="9"/>'}
    assert Robot(description(tags=absurd), tip_frame="link6").limits.upper[0] == 2.0


def test_a_turn_of_a_master_is_no_turn_of_what_mimics_it() -> None:
    """A continuous master with a multiplier of -0.6: taking the short way round would move joint3 elsewhere."""
    kinds = {"joint1": "continuous", "joint3": "continuous", "joint4": "continuous", "nod6": "continuous"}
    robot, free = (Robot(description(m, kinds), tip_frame="link6") for m in (True, False))
    for _ in range(5):
        q = GENERATOR.uniform(-9.0, 9.0, 3)
        assert np.abs(robot.pose(q) - free.pose(RATIO @ q + OFFSET)).max() < 1e-13
    assert robot.difference(np.zeros(3), np.full(3, 6.5)).tolist()[0] == 6.5
    assert not robot.continuous[0]


def everything(robot: Robot, scene: Scene, q: Array) -> tuple[Array, Array]:
    """Distances and gradients of all pairs that both arms check."""
    geometry = collision_geometry.load(robot, self_collision=False)
    fresh = DistanceQuery(geometry)
    fresh.set_scene(scene, 0)
    near = fresh.measure(q, np.inf)[0]
    return near.distance, near.slope


def test_distances_and_their_slopes_follow() -> None:
    robot = pair()[0]
    pose = np.eye(4)
    pose[:3, 3] = (0.5, 0.3, 0.6)
    scene = Scene().put(obstacle("ball", shape("sphere", (0.1,)), pose))
    for _ in range(10):
        q = random_position(robot, GENERATOR)
        distance, slope = everything(robot, scene, q)
        assert len(distance) == 7, "including the finger"
        ends = [robot.frame_pose(q, f"link{i + 1}")[:3] @ (0.0, 0.0, 0.2, 1.0) for i in range(7)]
        reference = [np.linalg.norm(end - pose[:3, 3]) - 0.14 for end in ends]
        assert np.abs(np.sort(distance) - np.sort(reference)).max() < 1e-9
        for joint in range(3):
            shift = 1e-6 * np.eye(3)[joint]
            change = (everything(robot, scene, q + shift)[0] - everything(robot, scene, q - shift)[0]) / 2e-6
            assert np.abs(change - slope[:, joint]).max() < 1e-6


def test_lazy_distances_and_speeds_stay_bounds() -> None:
    """The bounds that allow pairs to be skipped include the motion of mimic joints: lazy results equal a full
    computation bit for bit, and no pair is left out that could not stop any more."""
    robot = pair()[0]
    geometry = collision_geometry.load(robot)
    lazy, scene = DistanceQuery(geometry), Scene()
    for index in range(4):
        pose = se3.exp(GENERATOR.normal(size=6))
        pose[:3, 3] = GENERATOR.uniform(-0.8, 0.8, 3)
        scene = scene.put(obstacle(f"o{index}", shape("sphere", (0.1,)), pose))
    q, compared = random_position(robot, GENERATOR), 0
    for tick in range(200):
        q = random_position(robot, GENERATOR) if tick % 50 == 49 else q + GENERATOR.normal(size=3) * 0.02
        lazy.set_scene(scene, 0)
        near, closest = lazy.measure(q, 0.2)
        fresh = DistanceQuery(geometry)
        fresh.set_scene(scene, 0)
        whole, truth = fresh.measure(q, np.inf)
        inside = whole.distance < 0.2
        assert near.pair.tolist() == np.flatnonzero(inside).tolist()
        assert (near.slope == whole.slope[inside]).all()
        assert closest.distance == truth.distance
        compared += len(near.pair)
        qd, change = GENERATOR.normal(size=3), np.zeros(3)
        count = lazy.query(q, LIMITS, qd, change)
        assert pairs_that_must_stop(whole, qd, change) <= set(lazy.rows.pair[:count].tolist())
    assert compared > 50


# --- descriptions of real robots ---


def test_the_second_finger_of_a_panda() -> None:
    """The first finger's joint moves its tip in the opposite direction; the hand carries both."""
    urdf = catalogue.read_urdf(catalogue.find("panda"))
    robot = Robot(urdf, "panda_link0", "panda_rightfinger")
    assert robot.joints == (*(f"panda_joint{i}" for i in range(1, 8)), "panda_finger_joint1")
    free = Robot(re.sub(r"<mimic [^>]*/>", "", urdf), "panda_link0", "panda_rightfinger")
    assert free.joints[-1] == "panda_finger_joint2"
    ready = np.array([0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398, 0.03])
    assert np.abs(robot.pose(ready) - free.pose(ready)).max() < 1e-14
    assert np.abs(robot.evaluate(ready).jacobian_b - free.evaluate(ready).jacobian_b).max() < 1e-14
    left, right = (robot.frame_pose(ready, f"panda_{side}finger")[:3, 3] for side in ("left", "right"))
    assert np.linalg.norm(left - right) == pytest.approx(0.06), "both fingers moved"
    # Opening moves two fingers of about 0.1 kg, not one; neither is a counterweight of the other.
    fingers = robot.dynamics(ready).mass_matrix[-1, -1]
    alone = free.dynamics(ready).mass_matrix[-1, -1]
    assert fingers == pytest.approx(2.0 * alone)
    held = catalogue.robot_from_settings(ArmSettings(robot="panda"))
    both = [held.frame_pose(ready[:7], f"panda_{side}finger") for side in ("left", "right")]
    assert np.abs(both[0][:3, 3] - both[1][:3, 3]).max() < 1e-12, "closed, as the master is fixed"


@pytest.mark.parametrize("name", ["tiago_pro", "baxter", "pr2", "romeo", "talos_full_v2"])
def test_robots_with_grippers_load_and_their_fingers_follow(name: str) -> None:
    """Every mimic joint of example-robot-data, with its master controlled: its link has the same pose as in the
    description without <mimic>."""
    urdf = catalogue.read_urdf(catalogue.find(name))
    free = re.sub(r"<mimic\b[^>]*/>", "", urdf)
    tried = 0
    for joint, mimic in list(read_description(urdf).mimics.items())[:3]:
        found = re.search(rf'<joint[^>]*name="{joint}".*?<child\s+link="([^"]*)"', urdf, re.DOTALL)
        assert found is not None
        own, plain = Robot(urdf, tip_frame=found[1]), Robot(free, tip_frame=found[1])
        if mimic.master not in own.joints:
            continue
        q = random_position(own, GENERATOR)
        rates = read_description(urdf).mimics
        values = dict(zip(own.joints, q.tolist(), strict=True))
        whole = [
            rates[j].multiplier * values[rates[j].master] + rates[j].offset if j in rates else values[j]
            for j in plain.joints
        ]
        assert np.abs(own.pose(q) - plain.pose(np.array(whole))).max() < 1e-12
        tried += 1
    assert tried > 0


@pytest.mark.parametrize(
    ("tag", "words"),
    [
        ('<mimic joint="nobody"/>', "joint 'joint3' mimics 'nobody', which does not exist"),
        ('<mimic joint="joint3"/>', "mimics itself in a circle"),
        ('<mimic joint="nod6"/>', "mimics itself in a circle"),
        ('<mimic joint="joint1" multiplier="two"/>', "not a valid URDF"),
    ],
)
def test_what_cannot_be_followed_is_refused(tag: str, words: str) -> None:
    with pytest.raises(RobotError, match=words):
        Robot(description(tags={"joint3": tag}), tip_frame="link6")


def test_a_tag_with_numbers_that_are_none() -> None:
    with pytest.raises(RobotError, match="joint 'joint3' has a mimic multiplier or offset that is not a number"):
        read_description(description(tags={"joint3": '<mimic joint="joint1" multiplier="two"/>'}))
    with pytest.raises(
        RobotError, match="joint 'joint3' has offset 'nan' in <mimic>; expected finite numbers up to 1e"
    ):
        read_description(description(tags={"joint3": '<mimic joint="joint1" offset="nan"/>'}))


def test_a_master_that_is_missing_matters_only_in_the_chain() -> None:
    """Published descriptions of hands contain such names; arms with them must load."""
    urdf = description(tags={"finger": '<mimic joint="nobody" offset="0.3"/>'})
    robot = Robot(urdf, tip_frame="link6")
    assert robot.joints == ("joint1", "joint2", "joint4")
    with pytest.raises(RobotError, match="joint 'finger' mimics 'nobody', which does not exist"):
        Robot(urdf, tip_frame="link7")


def test_a_master_that_does_not_move_holds_what_mimics_it() -> None:
    """A description in which the gripper's motor is fixed."""
    robot = Robot(description(kinds={"joint1": "fixed"}), tip_frame="link6")
    assert robot.joints == ("joint2", "joint4")
    held = Robot(description(), tip_frame="link6", joints=("joint2", "joint4"))
    assert np.abs(robot.pose(np.array([0.2, 0.5])) - held.pose(np.array([0.2, 0.5]))).max() < 1e-14


@pytest.mark.parametrize("method", METHOD_NAMES)
def test_the_control_loop_carries_a_finger_that_mimics(method: str) -> None:
    """From target to command with eight joints, of which nine move; the finger stays within its 4 cm."""
    urdf = catalogue.read_urdf(catalogue.find("panda"))
    robot = Robot(urdf, "panda_link0", "panda_rightfinger")
    loop = Loop(robot, (*READY["panda"], 0.02), Settings().with_values({"method": method}))
    goal = loop.pose()
    goal[:3, 3] += (0.02, 0.06, -0.05)
    loop.run(2.0, lambda: loop.target(goal) if loop.steps else None)
    assert np.linalg.norm(loop.pose()[:3, 3] - goal[:3, 3]) < 5e-4
    positions = np.array([step.joint_position for step in loop.steps])
    assert positions[:, 7].min() >= -1e-9
    assert positions[:, 7].max() <= 0.04 + 1e-9
    assert loop.mode() is Mode.TRACKING


def test_inverse_kinematics_counts_no_whole_turns_of_a_master() -> None:
    """Solutions are within the limits and reach the pose; a whole turn of joint1 would move joint3."""
    kinds = {"joint1": "continuous", "joint3": "continuous", "joint4": "continuous", "nod6": "continuous"}
    robot = Robot(description(kinds=kinds), tip_frame="link6")
    assert robot.turning.tolist() == [False, False, False]
    assert robot.revolute.tolist() == [True, True, True]
    solver = PoseSolver(robot, eps_omega=1e-8, eps_v=1e-8)
    for _ in range(5):
        q = GENERATOR.uniform((-9.0, -1.5, -1.9), (9.0, 1.5, 1.9))
        found = solver.solve(robot.pose(q), q + 0.05)
        assert found.converged
        assert np.abs(robot.pose(found.q) - robot.pose(q)).max() < 1e-7
