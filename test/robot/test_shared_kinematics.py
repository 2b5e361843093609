"""Reference cases beside the checkout for inverse kinematics and its models: 50-digit Newton iterates, the worked
example and the exercises of the notes, the documented examples of the textbook's library, and the values in the tests
of other libraries. test_newton_raphson.py, test_pose_solver.py and test_notes.py cover the same behaviour with their
own data."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from support import shared_path

from ik_node.differential_ik.closed_form import resolve
from ik_node.inverse_kinematics.newton_raphson import (
    PoseIterate,
    PoseSolution,
    TerminationReason,
    find_root,
    solve_pose_newton,
)
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.inverse_kinematics.worked_examples import planar_2r
from ik_node.math import se3
from ik_node.math.se3 import angular_first
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import GRAVITY, Robot
from ik_node.robot.screw_chain import ScrewChain, wrap_angle


def load(name: str) -> Any:
    return json.loads(shared_path("cases", name).read_text())


def robot(name: str) -> Robot:
    arm = catalogue.find("panda" if name == "panda7" else name)
    return Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)


def chain_from(home: Any, screws_b: Any) -> ScrewChain:
    """Build the chain from a file's M and its list of body screws, one row per joint, angular part first."""
    return ScrewChain.from_angular_first(home, body=np.transpose(screws_b))


def check_rows(iterates: Sequence[PoseIterate], rows: list[dict[str, Any]], tolerance: float) -> None:
    assert len(iterates) <= len(rows)
    for iterate, row in zip(iterates, rows, strict=False):
        theta = np.array(row["theta"] if "theta" in row else row["theta_rad"])
        np.testing.assert_allclose(iterate.theta, theta, atol=tolerance, rtol=0)
        twist = np.array(row["Vb_mr_order"])
        np.testing.assert_allclose(angular_first(iterate.twist), twist, atol=tolerance, rtol=0)
        assert iterate.norm_omega == pytest.approx(row["norm_omega"], abs=tolerance)
        assert iterate.norm_v == pytest.approx(row["norm_v"], abs=tolerance)
        if "position" in row:
            np.testing.assert_allclose(iterate.pose_sb[:3, 3], row["position"], atol=tolerance)


def test_newton_iterates() -> None:
    # Every iterate to 1e-9, the number of steps exactly; on the URDF and on the screws of the same arm.
    cases = load("ik_newton_iterates.json")
    arms = {name: (robot(name), chain_from(cases[name]["M"], cases[name]["B_mr_order"])) for name in ("ur5", "panda7")}
    for case in cases["cases"]:
        for chain in arms[case["robot"]]:
            for tolerance, (eps_omega, eps_v) in {"1e-3/1e-4": (1e-3, 1e-4), "1e-6/1e-6": (1e-6, 1e-6)}.items():
                solution = solve_pose_newton(chain, case["Tsd"], case["theta0"], eps_omega=eps_omega, eps_v=eps_v)
                assert solution.reason in {TerminationReason.CONVERGED, TerminationReason.LIMITS}
                assert solution.iterations == case["iterations_to_tol"][tolerance], case["name"]
                check_rows(solution.iterates, case["rows"], 1e-9)


def test_example_6_1() -> None:
    case = load("example_6_1.json")
    example = planar_2r()
    np.testing.assert_allclose(example.pose_sd, case["Tsd"], atol=1e-15)
    solution = solve_pose_newton(*example, eps_omega=case["eps_omega"], eps_v=case["eps_v"])
    assert (solution.converged, solution.iterations) == (case["converged"], case["iterations"])
    check_rows(solution.iterates, case["rows"], 1e-10)


def test_properties_runs() -> None:
    for case in load("properties.json")["numeric_cases"]:
        for tolerance, steps in case["iterations_to_tol"].items():
            eps_omega, eps_v = (float(text) for text in tolerance.split("/"))
            solution = solve_pose_newton(robot("ur5"), case["Tsd"], case["theta0"], eps_omega=eps_omega, eps_v=eps_v)
            assert solution.iterations == steps
            check_rows(solution.iterates, case["rows"], 1e-9)


def test_exercise_6_8() -> None:
    case = load("exercises.json")["6.8"]
    result = find_root(lambda theta: theta**2 - (4.0, 9.0), [1.0, 1.0], lambda theta: np.diag(2.0 * theta))
    for iterate, reference in zip(result.iterates, case["iterates"], strict=False):
        np.testing.assert_allclose(iterate.theta, reference, rtol=1e-14)


def test_exercise_6_9() -> None:
    # A half turn at the start: either of the two branches, depending on the logarithm.
    case = load("exercises.json")["6.9"]
    solution = solve_pose_newton(planar_2r().chain, case["Tsd"], np.deg2rad([0.0, 30.0]))
    branch = case["branch_plus_pi" if solution.iterates[0].twist[5] > 0.0 else "branch_minus_pi"]
    assert (solution.converged, solution.iterations) == (branch["converged"], branch["iterations"])
    check_rows(solution.iterates, branch["rows"], 1e-9)


def test_exercise_6_10() -> None:
    # A wrist of three axes, orientation only; the goal of ZXZ and ZYZ is singular and is tested by its error.
    case = load("exercises.json")["6.10"]
    axes = {"X": [1.0, 0.0, 0.0], "Y": [0.0, 1.0, 0.0], "Z": [0.0, 0.0, 1.0]}
    goal = np.eye(4)
    goal[:3, :3] = case["R_desired"]
    for letters, rows in case["variants"].items():
        screws = np.array([[*axes[letter], 0.0, 0.0, 0.0] for letter in letters]).T
        chain = ScrewChain.from_angular_first(np.eye(4), body=screws)
        solution = solve_pose_newton(chain, goal, np.deg2rad([0.0, 30.0, 0.0]), eps_omega=1e-9, eps_v=1e-9)
        np.testing.assert_allclose(solution.iterates[1].theta, rows[1]["theta_rad"], atol=1e-12)
        np.testing.assert_allclose(solution.iterates[0].twist[3:], rows[0]["omega_b"], atol=1e-12)
        assert solution.converged
        reached = chain.pose(solution.q)[:3, :3].T @ goal[:3, :3]
        assert np.linalg.norm(se3.log_rotation(reached)) < 1e-9


@pytest.mark.parametrize("name", ["6.12_UR5", "coursera_UR5_guess_B", "UR5_close_guess", "6.13_WAM", "WAM_close_guess"])
def test_exercises_with_screw_axes(name: str) -> None:
    # Some starts are nearly singular, so the path is chaotic: the final pose is tested, and theta of the regular cases.
    case = load("exercises.json")[name]
    chain = chain_from(case["M"], case["B_mr_order"])
    for form in ("body", "space"):
        tolerances = {"eps_omega": case["eps_omega"], "eps_v": case["eps_v"]}
        solution = solve_pose_newton(chain, case["Tsd"], case["theta0"], form=form, **tolerances)
        assert (solution.converged, solution.iterations) == (case["converged"], case["iterations"])
        np.testing.assert_allclose(chain.pose(solution.q), case["Tsd"], atol=1e-3)
        np.testing.assert_allclose(wrap_angle(solution.q), solution.q)
        np.testing.assert_allclose(solution.q, case["final_theta_wrapped"], atol=5e-3)
        if "close" in name and form == "body":
            check_rows(solution.iterates, case["rows"], 1e-9)


def test_exercise_6_4() -> None:
    # RRP arm, tip only: coordinate form from starts near each branch.
    case = load("exercises.json")["6.4"]
    axis_1, axis_2, tip = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.5, np.sqrt(0.75)]), np.array([0.0, 1.0, 0.0])

    def position(theta: Array) -> Array:
        return np.asarray(
            se3.exp_rotation(axis_1 * theta[0]) @ se3.exp_rotation(axis_2 * theta[1]) @ (tip * (1.0 + theta[2]))
        )

    goal = np.array([-6.0, 5.0, np.sqrt(3.0)])
    for answer in case["answer_b"]:
        expected = np.array([answer["theta1"], answer["theta2"], answer["theta3"]])
        result = find_root(lambda theta: position(theta) - goal, expected + np.array([0.2, -0.2, 0.5]))
        assert result.converged
        np.testing.assert_allclose(result.theta, expected, atol=1e-9)


def test_library_examples() -> None:
    # The documented examples of the textbook's library, by function.
    cases = {case["function"]: case for case in load("mr_library_cases.json")["cases"]}

    def check(name: str, ours: Any) -> None:
        case = cases[name]
        np.testing.assert_allclose(ours, case["full_precision_from_package_1_1_1"][0], atol=case["printed_tol"])

    def skew(w: Array) -> Array:
        return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])

    check("MatrixLog3", skew(se3.log_rotation(np.array(cases["MatrixLog3"]["inputs"]["R"]))))
    twist = se3.log(np.array(cases["MatrixLog6"]["inputs"]["T"]))
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = skew(twist[3:]), twist[:3]
    check("MatrixLog6", matrix)
    for form, key in (("Body", "Blist"), ("Space", "Slist")):
        inputs = cases[f"FKin{form}"]["inputs"]
        chain = ScrewChain.from_angular_first(inputs["M"], **{form.lower(): inputs[key]})
        check(f"FKin{form}", chain.pose(np.array(inputs["thetalist"])))
        inputs = cases[f"Jacobian{form}"]["inputs"]
        pose, jacobian = ScrewChain.from_angular_first(np.eye(4), **{form.lower(): inputs[key]}).evaluate(
            np.array(inputs["thetalist"])
        )
        check(f"Jacobian{form}", angular_first(jacobian if form == "Body" else se3.adjoint(pose) @ jacobian))
        inputs = cases[f"IKin{form}"]["inputs"]
        chain = ScrewChain.from_angular_first(inputs["M"], **{form.lower(): inputs[key]})
        tolerances = {"eps_omega": inputs["eomg"], "eps_v": inputs["ev"]}
        solution = solve_pose_newton(chain, inputs["T"], inputs["thetalist0"], form=form.lower(), **tolerances)
        assert solution.converged
        check(f"IKin{form}", solution.iterates[-1].theta)


def test_library_ur5() -> None:
    # The UR5 of the textbook is that of the URDF: pose, body Jacobian, mass matrix, gravity, at ten joint positions.
    case = load("mr_library_cases.json")["UR5"]
    arm = robot("ur5")
    screws = ScrewChain.from_angular_first(case["M_home"], space=case["Slist"])
    for vector in case["vectors"]:
        q = np.array(vector["q"])
        for pose, jacobian in (arm.evaluate(q), screws.evaluate(q)):
            np.testing.assert_allclose(pose, vector["T"], atol=1e-9)
            np.testing.assert_allclose(angular_first(jacobian), vector["Jb_mr_order"], atol=1e-9)
        mass, gravity = arm.dynamics(q)
        np.testing.assert_allclose(mass, vector["MassMatrix"], atol=1e-9)
        np.testing.assert_allclose(gravity, vector["GravityForces_981"], atol=1e-9)


def urdf_of(links: list[tuple[str, str, float, str, str]]) -> str:
    """Return a serial arm of revolute joints; per link: joint origin, axis, mass, centre of mass and rpy, inertia
    diagonal."""
    text = ['<robot name="test"><link name="l0"/>']
    for index, (origin, axis, mass, centre, inertia) in enumerate(links, 1):
        xx, yy, zz = inertia.split()
        text.append(
            f'<joint name="j{index}" type="continuous"><parent link="l{index - 1}"/><child link="l{index}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/></joint><link name="l{index}"><inertial><origin {centre}/>'
            f'<mass value="{mass!r}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
            "</link>"
        )
    return "".join(text) + "</robot>"


def test_library_mass_matrix_and_gravity() -> None:
    # The textbook's three-joint example, as a URDF built from its link frames. Its first screw is (1 0 1, 0 1 0): not
    # of unit length, so that joint turns sqrt 2 times as fast, about the line through (-1/2, 0, 1/2).
    cases = {case["function"]: case for case in load("mr_library_cases.json")["cases"]}
    inputs = cases["GravityForces"]["inputs"]
    joints = np.array([[-0.5, 0.0, 0.5], [0.0, 0.0, 0.089], [0.425, 0.0, 0.089]])
    root = float(np.sqrt(0.5))
    axes, speed = [f"{root!r} 0 {root!r}", "0 1 0", "0 1 0"], np.array([np.sqrt(2.0), 1.0, 1.0])
    links, frame = [], np.eye(4)
    for index in range(3):
        frame = frame @ np.array(inputs["Mlist"][index])
        origin = joints[index] - (joints[index - 1] if index else 0.0)
        centre, rpy = frame[:3, 3] - joints[index], pin.rpy.matrixToRpy(frame[:3, :3])
        inertia = np.array(inputs["Glist"][index])
        xyz, turn, diagonal = (" ".join(map(repr, map(float, part))) for part in (centre, rpy, np.diag(inertia)[:3]))
        joint = " ".join(map(repr, map(float, origin)))
        links.append((joint, axes[index], float(inertia[3, 3]), f'xyz="{xyz}" rpy="{turn}"', diagonal))
    arm = Robot(urdf_of(links))
    mass, gravity = arm.dynamics(speed * inputs["thetalist"])
    mass, gravity = speed[:, None] * mass * speed, speed * gravity
    np.testing.assert_allclose(mass, cases["MassMatrix"]["full_precision_from_package_1_1_1"][0], atol=1e-7)
    scaled = gravity * -inputs["g"][2] / GRAVITY
    np.testing.assert_allclose(scaled, cases["GravityForces"]["full_precision_from_package_1_1_1"][0], atol=1e-8)


def test_peer_spong_two_links() -> None:
    # Two links about y, unit lengths and masses, mass at the middle: gravity and mass matrix of the textbook.
    case = load("peer_rtb.json")["spong_2link"]
    centre, none = 'xyz="0.5 0 0" rpy="0 0 0"', "0 0 0"
    arm = Robot(urdf_of([("0 0 0", "0 1 0", 1.0, centre, none), ("1 0 0", "0 1 0", 1.0, centre, none)]))
    for sample in case["gravity_over_981"]:
        gravity = arm.dynamics(np.array(sample["q"])).gravity
        np.testing.assert_allclose(np.abs(gravity) / 9.81, np.abs(sample["tau"]), atol=1e-12)
    q = np.array(case["mass_matrix_at"]["q"])
    np.testing.assert_allclose(arm.dynamics(q).mass_matrix, case["mass_matrix_at"]["M"], atol=1e-12)


def aligned_jacobian(arm: Robot, q: Array) -> Array:
    """Return J_b rotated into the base axes at the tool point."""
    pose, jacobian = arm.evaluate(q)
    turn = np.kron(np.eye(2), pose[:3, :3])
    return np.asarray(turn @ jacobian)


def test_peer_rtb_kinematics() -> None:
    peer = load("peer_rtb.json")
    arm = robot("panda")
    jacobian = aligned_jacobian(arm, np.array(peer["qr"]))
    expected = peer["panda_qr_measures"]["pin_full_precision"]
    values = resolve(jacobian, np.zeros(6)).singular_values
    for rows, name in ((slice(0, 6), "all"), (slice(0, 3), "trans"), (slice(3, 6), "rot")):
        volume = np.prod(np.linalg.svd(jacobian[rows])[1])
        assert volume == pytest.approx(expected[f"manipulability_{name}"], abs=1e-9)
    assert values[-1] / values[0] == pytest.approx(expected["inverse_condition"], abs=1e-12)
    assert values[-1] == pytest.approx(expected["min_singular"], abs=1e-12)
    case = peer["fkine_jacob0"]
    urdf = catalogue.read_urdf(catalogue.find("panda"))
    hand = Robot(urdf, "panda_link0", "panda_hand")
    shift = np.eye(4)
    shift[2, 3] = 0.103
    pose, body = hand.evaluate(np.array(case["q"]))
    np.testing.assert_allclose(pose @ shift, case["T_pin"], atol=1e-12)
    moved = np.kron(np.eye(2), pose[:3, :3]) @ se3.adjoint(se3.inverse(shift)) @ body
    np.testing.assert_allclose(moved, case["J_pin"], atol=1e-12)


def test_peer_rtb_manipulability_gradient() -> None:
    # Central differences of the volume, per part of the Jacobian: a gradient that `obstacle_gradient` may receive.
    peer = load("peer_rtb.json")["manipulability_gradient"]
    hand = Robot(catalogue.read_urdf(catalogue.find("panda")), "panda_link0", "panda_hand")
    q = np.array(peer["q"])
    for rows, name in ((slice(0, 6), "all"), (slice(0, 3), "trans"), (slice(3, 6), "rot")):

        def volume(step: Array, rows: slice = rows) -> float:
            return float(np.prod(np.linalg.svd(aligned_jacobian(hand, q + step)[rows])[1]))

        gradient = [(volume(step) - volume(-step)) / 2e-6 for step in 1e-6 * np.eye(7)]
        np.testing.assert_allclose(gradient, peer["expected"][name], atol=1e-4)


def test_peer_rtb_ik() -> None:
    # From each of the published starts: solved within limits; two steps to a pose out of reach: not converged.
    case = load("peer_rtb.json")["ik_success"]
    arm = robot("panda")
    solver = PoseSolver(arm)
    starts = [case["q0_sets"]["NR2"], *case["q0_sets"]["NR4"], case["q0_sets"]["QP1"]]
    for start in starts:
        solution = solver.solve(case["T"], start)
        assert solution.converged
        error = se3.log(se3.inverse(arm.pose(solution.q)) @ np.array(case["T"]))
        assert 0.5 * float(error @ error) < 1e-5
    goal = arm.pose(np.array([0.0, -1.3, 0.0, 1.2, 0.0, 2.0, 0.1]))
    assert not PoseSolver(arm, search_iterations=2).solve(goal, restarts=0).converged
    ur5 = robot("ur5")
    assert PoseSolver(ur5).solve(ur5.pose(np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0]))).converged


def test_peer_kdl() -> None:
    # Newton with a truncated SVD (cutoff 0.1) on the seven-joint arm of KDL's own test, errors in base axes.
    peer = load("peer_kdl.json")

    def link(alpha: float, d: float) -> Array:
        turn = np.eye(4)
        turn[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
        turn[:3, 3] = 0.0, -np.sin(alpha) * d, np.cos(alpha) * d
        return turn

    half = np.pi / 2.0
    links = [link(half, 0.0), link(-half, 0.36), link(half, 0.0), link(-half, 0.36), link(half, 0.0), link(-half, 0.0)]
    links.append(link(0.0, 0.155))
    frame, axes = link(0.0, 0.36), []
    for following in links:
        axes.append(se3.adjoint(frame) @ (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        frame = frame @ following
    chain = ScrewChain.from_angular_first(frame, space=angular_first(np.array(axes).T))

    def aligned(q: Array) -> Array:
        pose, jacobian = chain.evaluate(q)
        return np.asarray(np.kron(np.eye(2), pose[:3, :3]) @ jacobian)

    for case in peer["wdls"]:
        jacobian = aligned(np.array(case["q"]))
        np.testing.assert_allclose(jacobian, case["J_base_linear_angular"], atol=1e-12)
        values = resolve(jacobian, np.zeros(6)).singular_values
        np.testing.assert_allclose(values, case["singular_values"][:6], atol=1e-12)
        assert int(np.count_nonzero(values < 0.1)) + 1 == case["count_below_0p1"]
    for case in peer["cases"]:
        goal = np.array(case["T_des"])

        def error(q: Array, goal: Array = goal) -> Array:
            pose = chain.pose(q)
            return -np.concatenate((goal[:3, 3] - pose[:3, 3], se3.log_rotation(goal[:3, :3] @ pose[:3, :3].T)))

        result = find_root(
            error, case["q_init"], aligned, tolerance=1e-6, max_iterations=case["maxiter"], cutoff=case["eps_vel"]
        )
        replica = case["replica"]
        assert result.converged is replica["converged"], case["name"]
        assert result.reason in (
            {TerminationReason.CONVERGED}
            if replica["converged"]
            else {TerminationReason.CAP, TerminationReason.SINGULAR}
        )
        np.testing.assert_allclose(result.theta, replica["q"], atol=1e-6)


def test_peer_pinocchio() -> None:
    # Pinocchio's sample arm (its joints 1-3 intersect in a point): the notes' full steps end at the goal, chaotically.
    peer = load("peer_pinocchio.json")
    axes = [(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1), (1, 0, 0, 2), (0, 1, 0, 2)]
    columns = []
    for x, y, z, height in axes:
        omega = np.array([x, y, z], dtype=np.float64)
        columns.append(np.concatenate((omega, np.cross((0.0, 0.0, height), omega))))
    home = np.eye(4)
    home[2, 3] = 2.0
    chain = ScrewChain.from_angular_first(home, space=np.array(columns).T)
    goal = np.eye(4)
    goal[:3, 3] = peer["target"]["p"]
    case = peer["nonsingular_start"]
    solution: PoseSolution = solve_pose_newton(chain, goal, case["q0"], eps_omega=1e-4, eps_v=1e-4)
    assert solution.converged
    np.testing.assert_allclose(chain.pose(solution.q), goal, atol=1e-3)
    # From the singular neutral position undamped steps remain in a plane; restarts find the solution.
    assert PoseSolver(chain).solve(goal, np.zeros(6)).converged
