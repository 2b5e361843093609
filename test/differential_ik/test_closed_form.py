"""Inverse velocity kinematics. Optimality is tested directly (stationarity, constraint, minimality against random
neighbours), against an independent 50-digit KKT solution where digits are lost, the fade at singularities by its
specified properties (bounds, continuity, bit-equality away from them), and with the reference cases beside the
checkout."""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pinocchio as pin
import pytest
from support import shared_path

from ik_node.differential_ik.closed_form import ClosedFormSolution, resolve
from ik_node.errors import InputError
from ik_node.math.numerics import smoothstep
from ik_node.math.pseudoinverse import decompose, pseudoinverse
from ik_node.math.se3 import adjoint
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot

SHAPES = [(6, 7), (6, 6), (6, 4), (3, 7), (2, 3), (6, 9), (1, 4)]


def problem(seed: int, m: int, n: int, sigma_min: float = 0.2) -> tuple[Array, Array, Array, Array]:
    """Draw J, V, W, grad_h with a given smallest singular value."""
    rng = np.random.default_rng(seed)
    size = min(m, n)
    u, y = np.linalg.qr(rng.normal(size=(m, m)))[0], np.linalg.qr(rng.normal(size=(n, n)))[0]
    values = np.geomspace(2.0, sigma_min, size) if size > 1 else np.array([sigma_min])
    root = np.linalg.qr(rng.normal(size=(n, n)))[0] * np.geomspace(0.03, 2.0, n)
    return u[:, :size] * values @ y[:, :size].T, rng.normal(size=m), root @ root.T, rng.normal(size=n)


def robot(name: str) -> Robot:
    arm = catalogue.find(name)
    return Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)


def kkt(j: Array, v: Array, w: Array, c: Array) -> tuple[Array, Array]:
    """Solve the KKT system [W -J'; J 0] (qd, lambda) = (-c, V) with 50 digits; no pseudoinverse is used."""
    m, n = j.shape
    with mpmath.workdps(50):
        matrix = mpmath.matrix(np.block([[w, -j.T], [j, np.zeros((m, m))]]).tolist())
        answer = mpmath.lu_solve(matrix, mpmath.matrix([*(-c).tolist(), *v.tolist()]))
        numbers = np.array([float(answer[i]) for i in range(m + n)])
    return numbers[:n], numbers[n:]


def close(actual: Array, reference: Array, tolerance: float) -> None:
    assert np.linalg.norm(actual - reference) <= tolerance * np.linalg.norm(reference)


@pytest.mark.parametrize("shape", SHAPES)
def test_stationarity_and_constraint(shape: tuple[int, int]) -> None:
    # W qd + k grad_h = J' lambda, and the least squares conditions: together they are the optimum.
    m, n = shape
    for seed in range(20):
        j, v, w, g = problem(seed, m, n)
        for weight, gradient, gain in [(None, None, 0.0), (w, None, 0.0), (w, g, 0.7), (None, g, 0.7)]:
            result = resolve(j, v, weight, gradient, gain)
            metric = np.eye(n) if weight is None else weight
            pull = np.zeros(n) if gradient is None else gain * gradient
            np.testing.assert_allclose(metric @ result.joint_velocity + pull, j.T @ result.multiplier, atol=1e-12)
            np.testing.assert_allclose(j.T @ result.residual, 0.0, atol=1e-12)
            np.testing.assert_allclose(result.residual, v - j @ result.joint_velocity, atol=1e-13)
            if m <= n:
                np.testing.assert_allclose(result.residual, 0.0, atol=1e-13)
                assert np.array_equal(result.attained, v)
            else:
                np.testing.assert_allclose(result.attained, j @ result.joint_velocity, atol=1e-13)
            assert result.rank == min(m, n)


@pytest.mark.parametrize("shape", [(6, 7), (3, 7), (6, 6)])
@pytest.mark.parametrize("sigma_min", [0.1, 1e-4, 1e-7])
def test_digits_against_a_50_digit_kkt_solution(shape: tuple[int, int], sigma_min: float) -> None:
    # The error grows with cond(J), not with its square as with the printed formula.
    for seed in range(3):
        j, v, w, g = problem(seed, *shape, sigma_min=sigma_min)
        v = j @ np.random.default_rng(seed).normal(size=shape[1])
        tolerance = 1e-13 * 2.0 / sigma_min
        for weight, gradient, gain in [(None, None, 0.0), (w, None, 0.0), (w, g, 1.0)]:
            metric = np.eye(shape[1]) if weight is None else weight
            qd, multiplier = kkt(j, v, metric, np.zeros(shape[1]) if gradient is None else gain * gradient)
            result = resolve(j, v, weight, gradient, gain)
            close(result.joint_velocity, qd, tolerance)
            close(result.multiplier, multiplier, tolerance * 10.0)


def test_terms_add_up_and_belong_together() -> None:
    # The gradient does not move the tool; the task term is independent of the gradient; k enters linearly.
    j, v, w, g = problem(3, 6, 9)
    with_task, with_both, twice = resolve(j, v, w), resolve(j, v, w, g, 0.5), resolve(j, v, w, g, 1.0)
    np.testing.assert_array_equal(with_both.task_velocity, with_task.joint_velocity)
    np.testing.assert_array_equal(with_both.multiplier_task, with_task.multiplier)
    np.testing.assert_allclose(2.0 * with_both.null_velocity, twice.null_velocity, rtol=1e-13)
    np.testing.assert_allclose(2.0 * with_both.multiplier_potential, twice.multiplier_potential, rtol=1e-12)
    np.testing.assert_array_equal(with_both.joint_velocity, with_both.task_velocity + with_both.null_velocity)
    np.testing.assert_array_equal(with_both.multiplier, with_both.multiplier_task + with_both.multiplier_potential)
    assert with_task.gain == 0.0


def test_the_formulas_of_the_notes() -> None:
    # J_M^+ V + (I - J_M^+ J) M^-1 (-k grad h) and both terms of lambda, written as printed.
    j, v, w, g = problem(4, 6, 7)
    wi = np.linalg.inv(w)
    core = np.linalg.inv(j @ wi @ j.T)
    plus = wi @ j.T @ core
    result = resolve(j, v, w, g, 0.3)
    np.testing.assert_allclose(result.task_velocity, plus @ v, atol=1e-11)
    np.testing.assert_allclose(result.null_velocity, (np.eye(7) - plus @ j) @ wi @ (-0.3 * g), atol=1e-11)
    np.testing.assert_allclose(result.multiplier_task, core @ v, atol=1e-11)
    np.testing.assert_allclose(result.multiplier_potential, core @ j @ wi @ (0.3 * g), atol=1e-11)
    np.testing.assert_allclose(result.task_velocity, weighted_pseudoinverse(j, w) @ v, atol=1e-13)


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova"])
def test_kinetic_energy_of_inertia_weighted_is_least(name: str) -> None:
    # At the same q and V, against `plain` and against the solution plus any null-space motion.
    arm = robot(name)
    rng = np.random.default_rng(11)
    for _ in range(50):
        q = rng.uniform(-2.0, 2.0, arm.n)
        j, mass = arm.evaluate(q).jacobian_b, arm.dynamics(q).mass_matrix
        v = rng.normal(size=6)
        plain, inertia = resolve(j, v), resolve(j, v, mass)
        if inertia.singular_values[-1] < 1e-3:
            continue
        energy = 0.5 * inertia.joint_velocity @ mass @ inertia.joint_velocity
        assert energy <= 0.5 * plain.joint_velocity @ mass @ plain.joint_velocity * (1.0 + 1e-12)
        null = np.linalg.svd(j)[2][6:].T
        for _ in range(5):
            other = inertia.joint_velocity + null @ rng.normal(size=null.shape[1])
            assert energy <= 0.5 * other @ mass @ other * (1.0 + 1e-12)


WEIGHTED_SHAPES = [(6, 7), (6, 6), (6, 3), (3, 7), (2, 3), (1, 1), (1, 5), (5, 1)]


def random_weight(seed: int, n: int) -> Array:
    rng = np.random.default_rng(seed)
    v = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return np.asarray(v * np.geomspace(1e-3, 3.0, n) @ v.T)


def weighted_pseudoinverse(j: Array, w: Array, rcond: float | None = None) -> Array:
    """J_W^+: its columns are the velocities for unit twists."""
    svd = decompose(j, rcond=rcond)
    return np.stack([resolve(j, twist, w, svd=svd).joint_velocity for twist in np.eye(len(j))], axis=1)


@pytest.mark.parametrize("shape", WEIGHTED_SHAPES)
@pytest.mark.parametrize("rank", [1, 2, 9])
def test_weighted_penrose_conditions(shape: tuple[int, int], rank: int) -> None:
    # J P J = J, P J P = P, J P symmetric, W P J symmetric define J_W^+, also where the notes' formula has no inverse.
    m, n = shape
    rank = min(rank, m, n)
    j = problem(8, m, rank)[0] @ problem(9, rank, n)[0]
    w = random_weight(10, n)
    assert resolve(j, np.zeros(m), w, svd=decompose(j, rcond=1e-10)).rank == rank
    p = weighted_pseudoinverse(j, w, rcond=1e-10)
    np.testing.assert_allclose(j @ p @ j, j, atol=1e-12)
    np.testing.assert_allclose(p @ j @ p, p, atol=1e-10)
    np.testing.assert_allclose(j @ p, (j @ p).T, atol=1e-12)
    np.testing.assert_allclose(w @ p @ j, (w @ p @ j).T, atol=1e-12)


def test_weighted_is_the_notes_formula_at_full_row_rank() -> None:
    # W^-1 J' (J W^-1 J')^-1 with rational numbers, evaluated with 40 digits.
    j, w = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, -1.0]]), np.diag([1.0, 2.0, 5.0])
    with mpmath.workdps(40):
        jm, wi = mpmath.matrix(j.tolist()), mpmath.diag([1, mpmath.mpf(1) / 2, mpmath.mpf(1) / 5])
        exact = np.array((wi * jm.T * (jm * wi * jm.T) ** -1).tolist(), dtype=np.float64)
    np.testing.assert_allclose(weighted_pseudoinverse(j, w), exact, atol=1e-15)
    np.testing.assert_allclose(weighted_pseudoinverse(j, np.eye(3)), pseudoinverse(j).matrix, atol=1e-15)


@pytest.mark.parametrize(
    ("weight", "complaint"),
    [
        (-np.eye(3), "weight is not positive definite"),
        (np.diag([1.0, 1.0, 0.0]), "weight is not positive definite"),
        (np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]), "weight is not symmetric"),
        (np.eye(4), "weight has shape"),
        (np.full((3, 3), np.nan), "weight is not finite"),
    ],
)
def test_bad_weight_is_named(weight: Array, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        resolve(np.ones((2, 3)), np.zeros(2), weight)


def test_null_velocity_does_not_move_the_tool() -> None:
    # |J qd_null| <= 1e-13 cond(J)^2 of its scale, also close to a singularity.
    for seed in range(30):
        j, v, w, g = problem(seed, 6, 7, sigma_min=10.0 ** -(seed % 7))
        result = resolve(j, v, w, g, 1.0)
        cond = float(result.singular_values[0] / result.singular_values[-1])
        scale = np.linalg.norm(j, 2) * np.linalg.norm(result.null_velocity)
        assert np.linalg.norm(j @ result.null_velocity) <= 1e-13 * cond**2 * scale
        assert np.linalg.norm(j @ result.null_velocity) <= 1e-14 * scale * 10


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_body_and_space_forms_agree(name: str) -> None:
    # J_s = Ad(T_sb) J_b, V_s = Ad(T_sb) V_b: the same qd; lambda_s = Ad(T_bs)' lambda_b.
    arm = robot(name)
    rng = np.random.default_rng(12)
    for _ in range(50):
        q = rng.uniform(-2.0, 2.0, arm.n)
        pose, j = arm.evaluate(q)
        mass, gravity = arm.dynamics(q)
        v = rng.normal(size=6)
        to_space = adjoint(pose)
        body = resolve(j, v, mass, gravity, 0.05)
        space = resolve(to_space @ j, to_space @ v, mass, gravity, 0.05)
        cond = float(body.singular_values[0] / body.singular_values[-1])
        close(space.joint_velocity, body.joint_velocity, 1e-13 * cond)
        close(to_space.T @ space.multiplier, body.multiplier, 1e-12 * cond)


def test_invariances_of_weight_and_gradient() -> None:
    # W -> a W: qd is unchanged, lambda times a. grad + J'w: qd is unchanged, lambda + w. Square J: W and gradient do
    # not influence qd.
    j, v, w, g = problem(6, 6, 7)
    base = resolve(j, v, w, g, 1.0)
    scaled = resolve(j, v, 3.0 * w)
    np.testing.assert_allclose(scaled.joint_velocity, base.task_velocity, atol=1e-12)
    np.testing.assert_allclose(scaled.multiplier, 3.0 * base.multiplier_task, atol=1e-11)
    push = np.arange(1.0, 7.0)
    shifted = resolve(j, v, w, g + j.T @ push, 1.0)
    np.testing.assert_allclose(shifted.joint_velocity, base.joint_velocity, atol=1e-11)
    np.testing.assert_allclose(shifted.multiplier, base.multiplier + push, atol=1e-11)
    j, v, w, g = problem(7, 6, 6)
    np.testing.assert_array_equal(resolve(j, v, w, g, 1.0).joint_velocity, resolve(j, v).joint_velocity)


def test_second_term_balances_gravity_only_without_redundancy() -> None:
    # J' lambda_2 = grad h on a six-joint arm; on seven joints the remainder drives the null-space motion.
    for name, balanced in (("ur5", True), ("panda", False)):
        arm = robot(name)
        q = np.array([0.3, -0.8, 0.9, -1.1, 0.7, 0.9, 0.4])[: arm.n]
        mass, gravity = arm.dynamics(q)
        j = arm.evaluate(q).jacobian_b
        result = resolve(j, np.zeros(6), mass, gravity, 1.0)
        gap = np.linalg.norm(j.T @ result.multiplier_potential - gravity) / np.linalg.norm(gravity)
        assert bool(gap < 1e-12) is balanced
        np.testing.assert_allclose(j.T @ result.multiplier - gravity, mass @ result.joint_velocity, atol=1e-10)


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_constrained_dynamics_of_pinocchio_agree(name: str) -> None:
    # An arm at rest without torques, one instant after a constraint J qdd = V: the same equations in another program.
    arm = robot(name)
    q = np.array([0.3, -0.6, -1.1, -2.7, 0.8, 1.0, 0.3])[: arm.n]
    j, v = arm.evaluate(q).jacobian_b, np.array([0.1, 0.2, -0.1, 0.3, -0.2, 0.1])
    mass, gravity = arm.dynamics(q)
    still = np.zeros(arm.n)
    acceleration = pin.forwardDynamics(arm.model, arm.data, q, still, still, j, -v)
    result = resolve(j, v, mass, gravity, 1.0)
    close(result.joint_velocity, acceleration, 1e-11)
    close(result.multiplier, np.array(arm.data.lambda_c), 1e-11)


def test_no_target_no_motion() -> None:
    # V = 0 and no gradient: qd = 0 exactly.
    for shape in SHAPES:
        j, _, w, _ = problem(8, *shape)
        assert not resolve(j, np.zeros(shape[0]), w).joint_velocity.any()
        assert not resolve(j, np.zeros(shape[0]), w).multiplier.any()


def test_row_scale_matters_only_where_something_is_lost() -> None:
    j, v, w, g = problem(9, 6, 7)
    scale = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    plain, scaled = resolve(j, v, w, g, 1.0), resolve(j, v, w, g, 1.0, row_scale=scale)
    np.testing.assert_allclose(scaled.joint_velocity, plain.joint_velocity, atol=1e-12)
    np.testing.assert_allclose(scaled.multiplier, plain.multiplier, atol=1e-11)
    np.testing.assert_allclose(scaled.singular_values, np.linalg.svd(scale[:, None] * j)[1], atol=1e-14)
    tall = problem(9, 6, 4)
    weighted = resolve(tall[0], tall[1], row_scale=scale)
    np.testing.assert_allclose((scale[:, None] * tall[0]).T @ (scale * weighted.residual), 0.0, atol=1e-13)


def test_truncation_at_an_exact_singularity() -> None:
    # Rank 5 of 6: least |V - J qd| first, least cost among those second, checked by perturbing along the null space.
    rng = np.random.default_rng(13)
    base, _, w, g = problem(10, 6, 6)
    u, sigma, vt = np.linalg.svd(base)
    j = u[:, :5] * sigma[:5] @ vt[:5]
    v = rng.normal(size=6)
    result = resolve(j, v, w, g, 1.0)
    assert result.rank == 5
    np.testing.assert_allclose(j.T @ result.residual, 0.0, atol=1e-12)
    np.testing.assert_allclose(result.attained, v - result.residual, atol=1e-12)
    assert abs(u[:, 5] @ result.multiplier) < 1e-11

    def cost(qd: Array) -> float:
        return float(0.5 * qd @ w @ qd + g @ qd)

    for step in (-0.1, 0.1):
        assert cost(result.joint_velocity) < cost(result.joint_velocity + step * vt[5])


def test_zero_jacobian() -> None:
    # No twist is feasible and every motion is a null-space motion: only the potential moves the joints. All finite.
    _, v, w, g = problem(14, 6, 7)
    for threshold in (0.0, 0.02):
        free = resolve(np.zeros((6, 7)), v, w, g, 1.0, threshold=threshold)
        np.testing.assert_allclose(w @ free.joint_velocity, -g, atol=1e-11)
        assert free.rank == 0
        assert not free.multiplier.any()
        still = resolve(np.zeros((6, 7)), v, threshold=threshold)
        assert not still.joint_velocity.any()
        np.testing.assert_array_equal(still.residual, v)
        assert not still.attained.any()


@pytest.mark.parametrize("sigma_min", [0.0, 1e-300, 1e-17, 1e-9, 1e-3, 0.015, 0.0199])
def test_faded_solution_is_bounded_and_states_the_twist_attained(sigma_min: float) -> None:
    # |qd| <= 9/8 |V| / threshold; V_f as defined; the multiplier finite and below 3 |V| / threshold^2 for `plain`.
    threshold = 0.02
    scale = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    base, v, w, g = problem(15, 6, 7)
    u, sigma, vt = np.linalg.svd(base)
    sigma[5] = sigma_min
    j = u * sigma @ vt[:6] / scale[:, None]
    plain = resolve(j, v, threshold=threshold, row_scale=scale)
    size = float(np.linalg.norm(scale * v))
    assert np.linalg.norm(plain.joint_velocity) <= 9.0 / 8.0 * size / threshold
    assert np.linalg.norm(plain.multiplier / scale) <= 3.0 * size / threshold**2
    fade = np.array([smoothstep(x) for x in (sigma / threshold).tolist()])
    expected = (u * fade @ u.T @ (scale * v)) / scale
    np.testing.assert_allclose(plain.attained, expected, atol=1e-13)
    for result in (plain, resolve(j, v, w, g, 1.0, threshold=threshold, row_scale=scale)):
        np.testing.assert_allclose(j @ result.joint_velocity, result.attained, atol=1e-12)
        assert np.abs(j @ result.null_velocity).max() < 1e-13
        assert all(np.isfinite(array).all() for array in result)


def test_fade_is_continuous_through_the_singularity() -> None:
    # From rank 6 to the other side of a singularity: steps a quarter as long make changes a quarter as large. The
    # singularity itself, where the null space has one dimension more, is tested above and excluded here.
    base, v, w, g = problem(16, 6, 7)
    u, sigma, vt = np.linalg.svd(base)

    def largest_changes(steps: int) -> Array:
        results = []
        for value in np.linspace(0.03, -0.03, steps + 1):
            values = np.append(sigma[:5], value)
            results.append(resolve(u * values @ vt[:6], v, w, g, 0.1, threshold=0.02))
        names = ("joint_velocity", "multiplier_task", "multiplier_potential", "attained")
        tracks = [np.array([getattr(result, name) for result in results]) for name in names]
        return np.array([np.abs(np.diff(track, axis=0)).max() for track in tracks])

    ratio = largest_changes(1601) / largest_changes(401)
    assert (ratio > 0.2).all()
    assert (ratio < 0.3).all()


def test_above_the_threshold_the_solution_is_the_undamped_one_bit_for_bit() -> None:
    for shape in SHAPES:
        j, v, w, g = problem(17, *shape)
        undamped = resolve(j, v, w, g, 0.2)
        for other in (resolve(j, v, w, g, 0.2, threshold=0.1), resolve(j, v, w, g, 0.2, checked=True)):
            for name in ClosedFormSolution._fields:
                assert np.array_equal(getattr(undamped, name), getattr(other, name)), name


def test_null_space_cap_lowers_the_gain_and_keeps_the_optimum() -> None:
    # No joint's null-space speed exceeds its limit, and the result equals resolve() with the lower gain that it
    # reports.
    j, v, w, g = problem(18, 6, 9)
    cap = np.linspace(0.05, 0.2, 9)
    free, capped = resolve(j, v, w, g, 1.0), resolve(j, v, w, g, 1.0, null_space_cap=cap)
    assert (np.abs(free.null_velocity) > cap).any()
    assert (np.abs(capped.null_velocity) <= cap * (1.0 + 1e-14)).all()
    assert np.isclose(np.abs(capped.null_velocity / cap).max(), 1.0)
    again = resolve(j, v, w, g, capped.gain)
    np.testing.assert_allclose(capped.joint_velocity, again.joint_velocity, atol=1e-14)
    np.testing.assert_allclose(capped.multiplier, again.multiplier, atol=1e-12)
    assert resolve(j, v, w, g, 1.0, null_space_cap=1e9).gain == 1.0


def test_without_null_space_the_gain_is_unchanged_and_the_wrench_is_returned() -> None:
    # Six joints, six rows: grad_h cannot move any joint, but its wrench is still reported.
    j, v, w, g = problem(19, 6, 6)
    result = resolve(j, v, w, g, 0.4, null_space_cap=1e-3)
    assert not result.null_velocity.any()
    assert result.gain == 0.4
    np.testing.assert_allclose(j.T @ result.multiplier_potential, 0.4 * g, atol=1e-12)


def _bad() -> list[tuple[str, dict[str, Any]]]:
    j, v, w, g = problem(20, 6, 7)
    nan = float("nan")
    return [
        ("jacobian", {"jacobian": j * nan}),
        ("jacobian", {"jacobian": j[0]}),
        ("twist", {"twist": v[:5]}),
        ("twist", {"twist": v * np.inf}),
        ("weight has shape", {"weight": np.eye(6)}),
        ("weight is not positive definite", {"weight": -w}),
        ("weight is not symmetric", {"weight": w + np.eye(7, k=1)}),
        ("weight is not finite", {"weight": w * nan}),
        ("gradient", {"gradient": g[:6]}),
        ("gradient", {"gradient": g * nan}),
        ("gain", {"gain": -1.0}),
        ("gain", {"gain": nan}),
        ("gradient", {"gradient": None, "gain": 1.0}),
        ("threshold", {"threshold": -0.1}),
        ("threshold", {"threshold": nan}),
        ("row_scale", {"row_scale": np.ones(5)}),
        ("row_scale", {"row_scale": np.zeros(6)}),
        ("null_space_cap", {"null_space_cap": 0.0}),
        ("null_space_cap", {"null_space_cap": np.ones(3)}),
    ]


@pytest.mark.parametrize(("name", "change"), _bad())
def test_bad_input_is_named(name: str, change: dict[str, Any]) -> None:
    j, v, w, g = problem(20, 6, 7)
    arguments: dict[str, Any] = {"jacobian": j, "twist": v, "weight": w, "gradient": g} | change
    with pytest.raises(InputError, match=name):
        resolve(**arguments)


def test_unchecked_nan_never_becomes_a_number() -> None:
    # The control loop skips the checks and tests the result instead.
    j, v, w, g = problem(21, 6, 7)
    nan = float("nan")
    assert np.isnan(resolve(j, v * nan, w, g, 1.0, threshold=0.02, checked=True).joint_velocity).all()
    assert np.isnan(resolve(j, v, w * nan, g, 1.0, threshold=0.02, checked=True).joint_velocity).any()
    assert np.isnan(resolve(j, v, w, g * nan, 1.0, threshold=0.02, checked=True).joint_velocity).any()
    with pytest.raises(InputError, match="jacobian"):
        resolve(j * nan, v, w, g, 1.0, threshold=0.02, checked=True)


SHARED = [
    ("kkt_panda.json", 1e-9),
    ("kkt_ur5.json", 1e-9),
    ("kkt_panda_position_only.json", 1e-9),
    ("kkt_planar3R_exact.json", 1e-12),
    ("kkt_exactly_singular.json", 1e-7),
    ("kkt_near_singular.json", 0.0),
]


@pytest.mark.parametrize(("file", "tolerance"), SHARED)
def test_shared_cases(file: str, tolerance: float) -> None:
    # Independent 50-digit references, qd and lambda; the tolerance near singularities follows cond(J).
    cases = json.loads(shared_path("cases", file).read_text())["cases"]
    assert cases
    for case in cases:
        allowed = tolerance or 1000.0 * case["cond_J"] * 2.2e-16
        for method, solution in case["solutions"].items():
            weight = None if method.startswith("plain") else case["M"]
            gradient = case["grad_h_artificial"] if "artificial" in method else None
            gradient = case["grad_h_gravity"] if "gravity" in method else gradient
            result = resolve(case["J"], case["V"], weight, gradient, 0.0 if gradient is None else 1.0)
            close(result.joint_velocity, _reference(solution, "qd"), allowed)
            close(result.multiplier, _reference(solution, "lambda"), allowed)
            if "rank" in case:
                assert result.rank == case["rank"]


def _reference(solution: dict[str, Any], what: str) -> Array:
    if f"{what}_exact" in solution:
        return np.array([float(Fraction(text)) for text in solution[f"{what}_exact"]])
    return np.array(solution.get(f"{what}_ref", solution.get(f"{what}_ref_min_norm")), dtype=np.float64)
