"""The start posture of arms without a configuration: not singular, away from limits, links and obstacles, always the
same; an arm follows a circle from there. Field case 24: zeros are singular and in self-collision for tiago_no_hand.

They run in a process of their own: after the collision geometry of a1, tiago_no_hand or pr2 has been built, coal
computes distances of other arms that differ by up to 1e-12 m, so that recordings do not replay bit for bit there.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from loop import Loop, make_robot
from support import Run

from ik_node.collision.monitor import CollisionMonitor
from ik_node.control.start_posture import CLEARANCE_M, LIMIT_MARGIN, choose_start_posture
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import circle

LEAST_SINGULAR_VALUE = {"tiago_no_hand": 0.15, "pr2": 0.15, "baxter": 0.095, "so101": 0.04, "panda": 0.15, "a1": 0.1}
"""m; the largest that 100,000 random postures have is at most 2.3 times as large."""


def clearance(robot: Robot, q: Array, settings: Settings) -> float:
    rest = np.zeros(robot.n)
    terms = CollisionMonitor(robot, settings.obstacles).update(q, rest, rest, 0.0, 0, False)
    assert terms is not None
    return terms.closest.distance


@pytest.mark.parametrize("name", LEAST_SINGULAR_VALUE)
def test_it_is_regular_and_away_from_limits_and_links(in_own_process: Run, name: str) -> None:
    in_own_process(check_regular, name)


def check_regular(name: str) -> None:
    robot = make_robot(name)
    chosen = choose_start_posture(robot)
    jacobian = robot.evaluate(chosen.position).jacobian_b.copy()
    jacobian[3:] *= Settings().control.characteristic_length
    least = math.sqrt(np.linalg.eigvalsh(jacobian.T @ jacobian if robot.n < 6 else jacobian @ jacobian.T)[0])
    assert chosen.singular_value == pytest.approx(least, rel=1e-6)
    assert least > LEAST_SINGULAR_VALUE[name]
    lower, upper = robot.limits.lower, robot.limits.upper
    limited = np.isfinite(upper - lower)
    nearest = np.minimum(chosen.position - lower, upper - chosen.position)[limited]
    assert (nearest >= LIMIT_MARGIN * (upper - lower)[limited] - 1e-12).all()
    assert clearance(robot, chosen.position, Settings()) == pytest.approx(chosen.clearance_m, abs=1e-9)
    assert chosen.clearance_m > 0.01
    assert (choose_start_posture(make_robot(name)).position == chosen.position).all()
    said = chosen.describe(robot.joints)
    assert all(f"{joint} {value:.3f}" in said for joint, value in zip(robot.joints, chosen.position, strict=True))


def test_it_is_away_from_obstacles(tmp_path: Path) -> None:
    """A box where the tool would be."""
    robot = make_robot("ur5")
    without = choose_start_posture(robot)
    x, y, z = robot.pose(without.position)[:3, 3].tolist()
    scene = tmp_path / "scene.yaml"
    scene.write_text(f"obstacles:\n- name: box\n  box: {{size: [0.2, 0.2, 0.2]}}\n  position: [{x}, {y}, {z}]\n")
    settings = Settings().with_values({"obstacles.scene": str(scene)})
    assert clearance(robot, without.position, settings) < 0.0
    chosen = choose_start_posture(robot, settings)
    assert clearance(robot, chosen.position, settings) > 0.5 * CLEARANCE_M
    assert chosen.singular_value > 0.1


@pytest.mark.parametrize("method", ["plain", "inertia_weighted"])
def test_an_arm_without_a_configuration_follows_a_circle(in_own_process: Run, method: str) -> None:
    in_own_process(check_circle, method)


def check_circle(method: str) -> None:
    robot = make_robot("tiago_no_hand")
    loop = Loop(
        robot, choose_start_posture(robot).position, Settings().with_values({"rate_hz": 250.0, "method": method})
    )
    loop.run(0.1)
    trajectory = circle(loop.pose())
    begin, errors = len(loop.steps), []
    loop.follow(trajectory.pose, trajectory.duration_s, 50.0)
    for number, step in enumerate(loop.steps[begin:]):
        wanted = trajectory.pose((number + 1) / 250.0)
        errors.append(float(np.linalg.norm(step.pose_sb[:3, 3] - wanted[:3, 3])))
    assert math.sqrt(float(np.mean(np.square(errors)))) < 1e-3
