"""Newton-Raphson: iterates against exact rational arithmetic and against an independent multiple-precision iteration of
the planar 2R arm; the screw kinematics against matrix exponentials of 30 digits and against the URDF models; every
termination reason (converged, cap, stalled, diverged, singular, limits) by a problem that must end that way.
Convergence from distant starts is not guaranteed and not tested."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest

from ik_node.errors import IkNodeError, InputError, UnknownNameError
from ik_node.inverse_kinematics.newton_raphson import (
    PoseSolution,
    TerminationReason,
    find_root,
    solve_coordinates,
    solve_pose_newton,
)
from ik_node.inverse_kinematics.worked_examples import PLATEAU_ROOTS, planar_2r, plateau
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.robot.screw_chain import ScrewChain, wrap_angle, wrap_into_limits


def robot(name: str) -> Robot:
    arm = catalogue.find(name)
    return Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)


def squares(theta: Array) -> Array:
    return np.asarray(theta**2 - (4.0, 9.0))


def test_iterates_are_exact_newton_steps() -> None:
    # x <- (x^2 + 4) / 2x, y <- (y^2 + 9) / 2y from (1, 1) in rational arithmetic; J given or differenced.
    x, y = Fraction(1), Fraction(1)
    exact = [(x, y)]
    for _ in range(4):
        x, y = (x * x + 4) / (2 * x), (y * y + 9) / (2 * y)
        exact.append((x, y))
    for jacobian, tolerance in ((lambda theta: np.diag(2.0 * theta), 1e-15), (None, 1e-9)):
        result = find_root(squares, [1.0, 1.0], jacobian, max_iterations=4)
        assert result.reason is TerminationReason.CAP
        assert not result.converged
        for iterate, reference in zip(result.iterates, exact, strict=True):
            np.testing.assert_allclose(iterate.theta, [float(value) for value in reference], rtol=tolerance)
            np.testing.assert_array_equal(iterate.value, squares(iterate.theta))
            assert iterate.norm == np.linalg.norm(iterate.value)
    np.testing.assert_array_equal(result.theta, result.iterates[-1].theta)


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_every_root_is_found_from_its_quadrant(signs: tuple[int, int]) -> None:
    result = find_root(squares, signs, tolerance=1e-12)
    assert result.converged
    assert result.reason is TerminationReason.CONVERGED
    np.testing.assert_allclose(result.theta, np.array(signs) * (2.0, 3.0), rtol=1e-14)


def test_plateau_has_two_roots_and_two_failures() -> None:
    # Fig. 6.7 of the notes: from the right, from the left, near the plateau, on it.
    right, left, near, on = plateau(3.4), plateau(0.6), plateau(2.1), plateau(2.0)
    assert (left.theta[0], right.theta[0]) == pytest.approx(PLATEAU_ROOTS, abs=1e-9)
    assert (near.reason, near.converged) == (TerminationReason.DIVERGED, False)
    assert abs(near.iterates[1].theta[0] - near.iterates[0].theta[0]) > 50.0
    assert (on.reason, on.converged, len(on.iterates)) == (TerminationReason.SINGULAR, False, 1)


def test_stalled_at_the_nearest_point() -> None:
    # Two equations, one unknown, no common root: the iteration ends at the least squares point, which is no root.
    result = find_root(lambda theta: np.array([theta[0] - 1.0, theta[0] + 1.0]), [5.0])
    assert result.reason is TerminationReason.STALLED
    assert result.theta[0] == pytest.approx(0.0, abs=1e-9)


def test_least_norm_step_of_an_underdetermined_equation() -> None:
    # One equation in three unknowns: the step of J^+ is the shortest one, along the normal.
    result = find_root(lambda theta: np.array([theta @ theta - 4.0]), [1.0, 2.0, 2.0])
    assert result.converged
    np.testing.assert_allclose(result.theta, np.array([1.0, 2.0, 2.0]) * 2.0 / 3.0, rtol=1e-9)


def test_values_that_are_not_finite_are_reported_and_not_raised() -> None:
    with np.errstate(invalid="ignore"):
        result = find_root(np.log, [4.0], lambda theta: 1.0 / theta, max_iterations=50)
    assert result.reason is TerminationReason.DIVERGED
    assert np.isnan(result.iterates[-1].norm)


def test_truncated_and_damped_steps() -> None:
    # With a cutoff above the smallest singular value its direction is not moved; damping shortens every step.
    def diagonal(theta: Array) -> Array:
        return np.diag([1.0, 1e-3])

    def shift(theta: Array) -> Array:
        return np.asarray(diagonal(theta) @ (theta - 1.0))

    truncated = find_root(shift, [0.0, 0.0], diagonal, cutoff=1e-2)
    assert truncated.reason is TerminationReason.SINGULAR
    np.testing.assert_allclose(truncated.theta, [1.0, 0.0], atol=1e-15)
    damped = find_root(shift, [0.0, 0.0], diagonal, damping=1.0, max_iterations=1)
    np.testing.assert_allclose(damped.theta, [0.5, 1e-6 / (1.0 + 1e-6)], rtol=1e-9)


def tip_2r(theta: Array) -> Array:
    """Tip position of the planar arm with two links of 1 m."""
    a, b = theta[0], theta[0] + theta[1]
    return np.array([np.cos(a) + np.cos(b), np.sin(a) + np.sin(b)])


def test_coordinate_form_of_the_planar_arm() -> None:
    # The solution reaches x_d; the wrapped result differs from the last iterate by whole turns only.
    x_d = tip_2r(np.array([0.5, 1.5]))
    for start in ([0.2, 0.5], [0.2 + 6.0 * np.pi, 0.5 - 4.0 * np.pi]):
        result = solve_coordinates(x_d, tip_2r, start, wrapped=[True, True])
        assert result.converged
        np.testing.assert_allclose(result.theta, [0.5, 1.5], atol=1e-9)
        np.testing.assert_allclose(result.iterates[0].value, x_d - tip_2r(np.array(start)))
    assert np.abs(result.iterates[-1].theta - result.theta).max() > 6.0
    assert not solve_coordinates([3.0, 0.0], tip_2r, [0.2, 0.5], max_iterations=200).converged


def test_singular_start_without_a_step() -> None:
    # A stretched arm that has to move straight inwards: J has lost that direction and the step is zero. For the whole
    # pose (6 rows, 2 joints) J keeps its rank; the start is then the nearest point to first order.
    result = solve_coordinates([1.5, 0.0], tip_2r, [0.0, 0.0], lambda theta: np.array([[0.0, 0.0], [2.0, 1.0]]))
    assert (result.reason, len(result.iterates)) == (TerminationReason.SINGULAR, 1)
    goal = np.eye(4)
    goal[0, 3] = 1.5
    assert solve_pose_newton(planar_2r().chain, goal, [0.0, 0.0]).reason is TerminationReason.STALLED


def reference_2r(start: tuple[str, str], goal_angle: Any, goal: tuple[Any, Any], steps: int) -> list[tuple[Any, ...]]:
    """Return rows (theta, (wz, vx, vy)) of the body-twist iteration of the planar arm, implemented for the plane with
    40 digits: V = log of a planar motion in closed form, left inverse by 2x2 normal equations."""
    rows = []
    theta = mpmath.matrix([mpmath.mpf(start[0]), mpmath.mpf(start[1])])
    for _ in range(steps):
        a, b = theta[0], theta[0] + theta[1]
        x, y = mpmath.cos(a) + mpmath.cos(b), mpmath.sin(a) + mpmath.sin(b)
        turn = goal_angle - b
        dx, dy = goal[0] - x, goal[1] - y
        px, py = mpmath.cos(b) * dx + mpmath.sin(b) * dy, -mpmath.sin(b) * dx + mpmath.cos(b) * dy
        half = turn / 2 * mpmath.cot(turn / 2)
        v = (half * px + turn / 2 * py, -turn / 2 * px + half * py)
        twist = mpmath.matrix([turn, *v])
        jacobian = mpmath.matrix([[1, 1], [mpmath.sin(theta[1]), 0], [mpmath.cos(theta[1]) + 1, 1]])
        rows.append((theta.copy(), twist))
        theta = theta + (jacobian.T * jacobian) ** -1 * jacobian.T * twist
    return rows


def test_example_6_1_to_full_precision() -> None:
    # Every number of the table against an independent iteration; row 2 of the notes prints -0.004 where the value is
    # -0.0035.
    with mpmath.workdps(40):
        root = mpmath.sqrt(3)
        goal = ((root - 1) / 2, (root + 1) / 2)
        rows = reference_2r(("0", str(mpmath.pi / 6)), 2 * mpmath.pi / 3, goal, 4)
    example = planar_2r()
    solution = solve_pose_newton(example.chain, example.pose_sd, example.start, eps_omega=1e-3, eps_v=1e-4)
    assert (solution.converged, solution.iterations) == (True, 3)
    for iterate, (theta, twist) in zip(solution.iterates, rows, strict=True):
        np.testing.assert_allclose(iterate.theta, np.array(theta.tolist(), float).ravel(), atol=2e-15)
        planar = iterate.twist[[5, 0, 1]]
        np.testing.assert_allclose(planar, np.array(twist.tolist(), float).ravel(), atol=2e-15)
        assert iterate.norm_omega == pytest.approx(float(abs(twist[0])), abs=1e-15)
        assert iterate.norm_v == pytest.approx(float(mpmath.hypot(twist[1], twist[2])), abs=1e-15)
        np.testing.assert_allclose(iterate.pose_sb, example.chain.pose(iterate.theta), atol=1e-15)
    assert solution.iterates[2].twist[5] == pytest.approx(-0.0034857, abs=5e-8)
    np.testing.assert_allclose(np.rad2deg(solution.q), [30.0, 90.0], atol=1e-4)


def test_printed_goal_is_accepted_and_put_right() -> None:
    # The notes print T_sd with three decimals: determinant 0.99996. It is projected, not rejected.
    example = planar_2r()
    solution = solve_pose_newton(example.chain, np.round(example.pose_sd, 3), example.start)
    assert (solution.converged, solution.iterations) == (True, 3)
    np.testing.assert_allclose(np.rad2deg(solution.q), [30.0, 90.0], atol=5e-3)


def test_half_turn_goal() -> None:
    # 30 to 210 degrees: the log has two values there, and the textbook formula divides by zero. Either sign is valid.
    example = planar_2r()
    goal = example.chain.pose(np.deg2rad([90.0, 120.0]))
    solution = solve_pose_newton(example.chain, goal, example.start)
    assert solution.converged
    assert solution.iterates[0].norm_omega == pytest.approx(np.pi, abs=1e-12)
    assert solution.iterates[0].norm_v == pytest.approx(4.2914953731462235, abs=1e-9)
    np.testing.assert_allclose(example.chain.pose(solution.q), goal, atol=1e-3)


def random_chain(seed: int, n: int) -> ScrewChain:
    """Draw revolute joints about random lines, and one prismatic joint if n > 2."""
    rng = np.random.default_rng(seed)
    columns = []
    for index in range(n):
        omega = rng.normal(size=3)
        omega /= np.linalg.norm(omega)
        moment = np.cross(rng.uniform(-0.6, 0.6, 3), omega)
        columns.append(np.concatenate((moment, omega)) if index != 2 else np.concatenate((omega, np.zeros(3))))
    return ScrewChain(se3.exp(rng.normal(size=6) * 0.5), np.array(columns).T)


def test_screw_chain_against_matrix_exponentials() -> None:
    # T_sb = M e^[B1]q1 ... with 30-digit matrix exponentials; J_b by differencing the pose.
    chain = random_chain(1, 5)
    q = np.array([0.3, -1.2, 0.4, 2.0, -0.7])
    with mpmath.workdps(30):
        pose = mpmath.matrix(chain.home.tolist())
        for screw, angle in zip(chain.screws_b.T, q, strict=True):
            v, (x, y, z) = screw[:3], screw[3:]
            hat = [[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]]
            pose = pose * mpmath.expm(mpmath.matrix(hat) * mpmath.mpf(angle))
        reference = np.array(pose.tolist(), dtype=np.float64)
    pose_sb, jacobian = chain.evaluate(q)
    np.testing.assert_allclose(pose_sb, reference, atol=1e-14)
    for index in range(chain.n):
        step = np.zeros(chain.n)
        step[index] = 1e-6
        moved = se3.log(se3.inverse(chain.pose(q - step)) @ chain.pose(q + step)) / 2e-6
        np.testing.assert_allclose(jacobian[:, index], moved, atol=1e-9)
    np.testing.assert_array_equal(chain.turning, [True, True, False, True, True])


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_screws_and_urdf_are_the_same_arm(name: str) -> None:
    # Body and space screws taken from the model at q = 0 give its poses, Jacobians and Newton iterates.
    arm = robot(name)
    home, screws_b = arm.evaluate(np.zeros(arm.n))
    space = se3.angular_first(se3.adjoint(home) @ screws_b)
    limits = (arm.limits.lower, arm.limits.upper)
    rng = np.random.default_rng(2)
    for chain in (ScrewChain(home, screws_b, *limits), ScrewChain.from_angular_first(home, space=space)):
        q = rng.uniform(-1.5, 1.5, arm.n)
        for ours, theirs in zip(chain.evaluate(q), arm.evaluate(q), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-13)
        goal, start = arm.pose(q), q + rng.uniform(-0.2, 0.2, arm.n)
        pairs = zip(
            solve_pose_newton(chain, goal, start).iterates, solve_pose_newton(arm, goal, start).iterates, strict=True
        )
        for ours_row, theirs_row in pairs:
            np.testing.assert_allclose(ours_row.theta, theirs_row.theta, atol=1e-11)


def test_body_and_space_form_take_the_same_steps_unless_tall() -> None:
    # J_s = Ad J_b, V_s = Ad V_b: the same least-norm step for n >= 6, another least squares step for n < 6.
    arm = robot("panda")
    q = np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.6, 0.5])
    goal, start = arm.pose(q), q + 0.25
    body = solve_pose_newton(arm, goal, start)
    space = solve_pose_newton(arm, goal, start, form="space")
    for b, s in zip(body.iterates, space.iterates, strict=True):
        np.testing.assert_allclose(b.theta, s.theta, atol=1e-11)
        np.testing.assert_allclose(s.twist, se3.adjoint(b.pose_sb) @ b.twist, atol=1e-10)
    example = planar_2r()
    tall = [solve_pose_newton(*example, form=form).iterates[1].theta for form in ("body", "space")]
    assert np.abs(tall[0] - tall[1]).max() > 1e-2


def test_translation_target() -> None:
    # Same orientation, 0.1 m along the tool's z: V_b = 0.1 along z, errors decrease strictly, few steps.
    arm = robot("ur5")
    start = np.array([-0.5, -0.5, 0.5, -0.5, -0.5, 0.0]) * np.pi
    goal = arm.pose(start) @ se3.exp(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    solution = solve_pose_newton(arm, goal, start, eps_omega=1e-12, eps_v=1e-12)
    np.testing.assert_allclose(solution.iterates[0].twist, [0, 0, 0.1, 0, 0, 0], atol=1e-12)
    lengths = [iterate.norm_v + iterate.norm_omega for iterate in solution.iterates]
    assert lengths == sorted(lengths, reverse=True)
    assert solution.iterations <= 4


def test_no_steps_when_already_there() -> None:
    arm = robot("panda")
    q = np.array([0.2, -0.4, 0.1, -1.9, 0.3, 1.6, 0.5])
    solution = solve_pose_newton(arm, arm.pose(q), q)
    assert (solution.converged, solution.iterations) == (True, 0)
    np.testing.assert_array_equal(solution.q, q)


def test_out_of_reach_ends_at_the_cap_or_states_the_reason() -> None:
    # The loop as printed would not terminate.
    arm = robot("ur5")
    goal = np.eye(4)
    goal[0, 3] = 5.0
    solution = solve_pose_newton(arm, goal, np.full(6, 0.7), max_iterations=40)
    assert not solution.converged
    assert solution.reason in {TerminationReason.CAP, TerminationReason.DIVERGED}
    assert solution.iterations <= 40
    assert len(solution.iterates) == solution.iterations + 1


def test_a_pose_reached_only_outside_the_limits_is_not_converged() -> None:
    example = planar_2r()
    limited = ScrewChain(example.chain.home, example.chain.screws_b, [-1.0, -1.0], [1.0, 1.0])
    solution = solve_pose_newton(limited, example.pose_sd, example.start)
    assert (solution.converged, solution.reason) == (False, TerminationReason.LIMITS)
    wide = ScrewChain(example.chain.home, example.chain.screws_b, [6.0, -6.5], [7.5, 0.0])
    turned: PoseSolution = solve_pose_newton(wide, example.pose_sd, example.start)
    assert turned.converged
    np.testing.assert_allclose(turned.q, np.deg2rad([390.0, -270.0]), atol=1e-4)


def test_fold_takes_the_fewest_turns() -> None:
    turn = 2.0 * np.pi
    chain = ScrewChain(
        np.eye(4), np.tile([[0], [0], [0], [0], [0], [1.0]], 4), [-7, -1, 0, -np.inf], [7, 1, 20, np.inf]
    )
    folded, inside = wrap_into_limits(np.array([7.5, 0.5 + 3 * turn, 21.0, 3.0 + 5 * turn]), chain)
    np.testing.assert_allclose(folded, [7.5 - turn, 0.5, 21.0 - turn, 3.0], atol=1e-13)
    assert inside
    folded, inside = wrap_into_limits(np.array([6.9, 2.0, -30.0, 0.0]), chain)
    np.testing.assert_allclose(folded, [6.9, 2.0, -30.0 + 5 * turn, 0.0], atol=1e-13)
    assert not inside
    slide = ScrewChain(np.eye(4), [[0.0], [0.0], [1.0], [0.0], [0.0], [0.0]], [0.0], [1.0])
    assert wrap_into_limits(np.array([turn]), slide)[1] is False
    np.testing.assert_allclose(wrap_angle(np.array([4.0, -4.0, 1.0])), [4.0 - turn, turn - 4.0, 1.0])


def _bad_pose_calls() -> list[tuple[str, dict[str, Any]]]:
    nan = float("nan")
    skew = np.eye(4)
    skew[0, 1] = 0.01
    return [
        ("pose_sd", {"pose_sd": np.full((4, 4), nan)}),
        ("pose_sd", {"pose_sd": skew}),
        ("pose_sd", {"pose_sd": np.eye(3)}),
        ("start", {"start": [0.0]}),
        ("start", {"start": [0.0, nan]}),
        ("eps_omega", {"eps_omega": 0.0}),
        ("eps_v", {"eps_v": nan}),
        ("max_iterations", {"max_iterations": -1}),
        ("form", {"form": "tool"}),
    ]


@pytest.mark.parametrize(("name", "change"), _bad_pose_calls())
def test_bad_input_to_solve_pose_is_named(name: str, change: dict[str, Any]) -> None:
    example = planar_2r()
    with pytest.raises(IkNodeError, match=name):
        solve_pose_newton(example.chain, **({"pose_sd": example.pose_sd, "start": example.start} | change))


def test_bad_input_elsewhere_is_named() -> None:
    nan = float("nan")
    with pytest.raises(InputError, match="start"):
        find_root(squares, [1.0, nan])
    with pytest.raises(InputError, match="tolerance"):
        find_root(squares, [1.0, 1.0], tolerance=-1.0)
    with pytest.raises(InputError, match="jacobian has shape"):
        find_root(squares, [1.0, 1.0], lambda theta: np.eye(3))
    with pytest.raises(InputError, match=r"g\(theta\) has shape"):
        find_root(lambda theta: np.eye(2), [1.0, 1.0])
    with pytest.raises(InputError, match="x_d"):
        solve_coordinates([nan], lambda theta: theta, [1.0])
    with pytest.raises(InputError, match=r"f\(theta\) has shape"):
        solve_coordinates([1.0, 2.0], lambda theta: theta, [1.0])
    with pytest.raises(InputError, match="screws_b"):
        ScrewChain(np.eye(4), np.eye(3))
    with pytest.raises(InputError, match="home"):
        ScrewChain(2.0 * np.eye(4), np.ones((6, 1)))
    with pytest.raises(InputError, match="lower"):
        ScrewChain(np.eye(4), np.ones((6, 1)), lower=[nan])
    with pytest.raises(InputError, match="exceeds upper"):
        ScrewChain(np.eye(4), np.ones((6, 1)), lower=[1.0], upper=[0.0])
    with pytest.raises(InputError, match="either body or space"):
        ScrewChain.from_angular_first(np.eye(4))
    with pytest.raises(UnknownNameError, match="valid: body, space"):
        solve_pose_newton(planar_2r().chain, np.eye(4), [0.0, 0.0], form="base")
