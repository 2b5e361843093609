"""The reduced model: compared with finite differences, and errors for invalid descriptions."""

from __future__ import annotations

import numpy as np
import pytest
from loop import make_robot

from ik_node.errors import RobotError, UnknownNameError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ArmSettings

ARMS = ["panda", "ur5", "kinova", "xarm7", "talos_arm"]
GENERATOR = np.random.default_rng(11)


def random_position(robot: Robot) -> Array:
    lower = np.maximum(robot.limits.lower, -np.pi)
    return GENERATOR.uniform(lower, np.minimum(robot.limits.upper, np.pi))


@pytest.mark.parametrize("name", ARMS)
def test_the_body_jacobian_is_the_derivative_of_the_pose(name: str) -> None:
    robot = make_robot(name)
    step = 1e-6
    for _ in range(5):
        q = random_position(robot)
        kinematics = robot.evaluate(q)
        assert np.array_equal(kinematics.pose_sb, robot.pose(q))
        for joint, column in enumerate(kinematics.jacobian_b.T):
            shift = step * np.eye(robot.n)[joint]
            moved = se3.inverse(robot.pose(q - shift)) @ robot.pose(q + shift)
            assert np.abs(se3.log(moved) / (2 * step) - column).max() < 1e-8


@pytest.mark.parametrize("name", ARMS)
def test_mass_matrix_and_gravity_belong_to_one_energy(name: str) -> None:
    """Gravity is the gradient of a potential: its derivative is symmetric; M is symmetric and positive definite."""
    robot = make_robot(name)
    step = 1e-6
    for _ in range(3):
        q = random_position(robot)
        mass = robot.dynamics(q).mass_matrix
        assert np.array_equal(mass, mass.T)
        assert np.linalg.eigvalsh(mass).min() > 0.0
        qd = np.linspace(-1.0, 1.0, robot.n)
        assert robot.kinetic_energy(q, qd) == pytest.approx(0.5 * qd @ mass @ qd, rel=1e-12)
        shifts = step * np.eye(robot.n)
        hessian = np.array([robot.dynamics(q + d).gravity - robot.dynamics(q - d).gravity for d in shifts]) / (2 * step)
        assert np.abs(hessian - hessian.T).max() < 1e-6


def test_joints_may_be_a_subset_in_any_order() -> None:
    usual = make_robot("kinova")
    order = [3, 0, 5, 1, 4, 2]
    mixed = catalogue.robot_from_settings(ArmSettings(robot="kinova", joints=tuple(usual.joints[i] for i in order)))
    q = random_position(usual)
    assert np.allclose(mixed.pose(q[order]), usual.pose(q), atol=1e-14)
    assert np.allclose(mixed.evaluate(q[order]).jacobian_b, usual.evaluate(q).jacobian_b[:, order], atol=1e-14)
    assert np.allclose(mixed.dynamics(q[order]).mass_matrix, usual.dynamics(q).mass_matrix[np.ix_(order, order)])
    qd = np.linspace(-1.0, 1.0, usual.n)
    assert mixed.kinetic_energy(q[order], qd[order]) == pytest.approx(usual.kinetic_energy(q, qd), rel=1e-12)
    part = catalogue.robot_from_settings(ArmSettings(robot="ur5", joints=("shoulder_pan_joint", "elbow_joint")))
    assert part.n == 2
    assert part.evaluate(np.zeros(2)).jacobian_b.shape == (6, 2)


def test_a_rotated_and_offset_base_only_changes_where_poses_are_seen_from() -> None:
    world = make_robot("ur5")
    urdf = catalogue.read_urdf(catalogue.find("ur5"))
    moved = urdf.replace('<link name="world" />', '<link name="world"/>').replace(
        '<link name="world"/>',
        '<link name="world"/><link name="table"/><joint name="table_joint" type="fixed"><parent link="world"/>'
        '<child link="table"/><origin xyz="0.3 -0.2 0.7" rpy="0.4 -0.5 1.2"/></joint>',
    )
    assert moved != urdf
    robot = Robot(moved, base_frame="table", tip_frame="tool0")
    q = random_position(robot)
    table = robot.frame_pose(q, "base_link")
    assert np.abs(table @ world.pose(q) - robot.pose(q)).max() < 1e-12
    assert np.abs(table[:3, 3]).max() > 0.1
    assert np.array_equal(robot.evaluate(q).jacobian_b, world.evaluate(q).jacobian_b), (
        "the body Jacobian does not depend on the base"
    )


def test_continuous_joints_have_no_limits_and_the_short_way_round() -> None:
    robot = make_robot("kinova")
    assert robot.continuous.tolist() == [True, False, False, True, False, True]
    assert np.isinf(robot.limits.upper[robot.continuous]).all()
    turn = np.where(robot.continuous, 2 * np.pi, 0.0)
    q = random_position(robot)
    assert np.allclose(robot.pose(q + turn), robot.pose(q), atol=1e-12)
    assert np.abs(robot.difference(q, q + turn + 0.1) - 0.1).max() < 1e-12


def test_fingers_beyond_the_tool_are_fixed() -> None:
    assert all("finger" not in name for name in make_robot("panda").joints)


def urdf_of(joints: str) -> str:
    links = "".join(f'<link name="{name}"/>' for name in ("base", "arm", "other", "tool"))
    return f'<robot name="r">{links}{joints}</robot>'


def test_limits_that_are_not_stated_are_infinite() -> None:
    joint = (
        '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 0 1"/>'
        '<origin xyz="0.1 0 0"/><limit lower="-1" upper="1" velocity="0" effort="1"/></joint>'
    )
    fixed = '<joint name="f" type="fixed"><parent link="base"/><child link="other"/></joint>'
    urdf = urdf_of(joint.format("a", "revolute", "base", "arm") + joint.format("b", "prismatic", "arm", "tool") + fixed)
    robot = Robot(urdf)
    assert robot.base_frame == "base"
    assert robot.tip_frame == "tool"
    assert np.isinf(robot.limits.velocity).all()


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"urdf": "no urdf"}, RobotError, "not a valid URDF"),
        ({"urdf": ""}, RobotError, "not a valid URDF"),
        ({"base_frame": "floor"}, UnknownNameError, "unknown frame 'floor'; valid: .*base_link"),
        ({"tip_frame": "nose"}, UnknownNameError, "unknown frame 'nose'"),
        ({"joints": ("knee",)}, UnknownNameError, "unknown joint 'knee'; valid: .*elbow_joint"),
        ({"joints": ("elbow_joint", "elbow_joint")}, RobotError, "twice"),
        ({"tip_frame": "shoulder_link", "joints": ("elbow_joint",)}, RobotError, "does not move tip frame"),
        ({"tip_frame": "base_link"}, RobotError, "no movable joint"),
        ({"base_frame": "tool0", "tip_frame": "shoulder_link"}, RobotError, "not between the root and tip"),
    ],
)
def test_invalid_arguments_are_refused_by_name(
    arguments: dict[str, object], error: type[Exception], words: str
) -> None:
    usual: dict[str, object] = {"urdf": catalogue.read_urdf(catalogue.find("ur5"))}
    with pytest.raises(error, match=words):
        Robot(**(usual | arguments))  # type: ignore[arg-type]


def test_an_unknown_robot_is_refused_with_the_list() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown robot 'pandora'; valid: .*panda"):
        catalogue.find("pandora")
    with pytest.raises(RobotError, match="no robot"):
        catalogue.robot_from_settings(ArmSettings())


def test_precedence_is_description_then_name_then_topic() -> None:
    urdf = catalogue.read_urdf(catalogue.find("ur5"))
    assert (
        catalogue.robot_from_settings(ArmSettings(robot="panda", robot_description=urdf)).joints[0]
        == "shoulder_pan_joint"
    )
    assert catalogue.robot_from_settings(ArmSettings(robot="panda"), urdf).n == 7
    assert catalogue.robot_from_settings(ArmSettings(tip_frame="tool0"), urdf).tip_frame == "tool0"
