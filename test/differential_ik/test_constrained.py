"""The constrained optimum: the largest s, the least cost, the box to the last bit, and a solution for every input.

The references are the independent solvers of reference_solvers.py (scipy's linear program, an equality-constrained
minimum on the active bounds, the signs of the multipliers, DAQP on the whole problem). Not tested here: the computation
of the box (test_joint_limits.py).
"""

from __future__ import annotations

import numpy as np
import pytest
import reference_solvers
from arms import random_position
from loop import make_robot
from reference_solvers import Check, Problem, check, least_deviation, problem
from scipy.optimize import linprog

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import constrained, quadratic_program
from ik_node.differential_ik.closed_form import resolve
from ik_node.differential_ik.constrained import ConstrainedSolution
from ik_node.differential_ik.exact_program import LinearProgram, NullSpaceCost
from ik_node.errors import InputError
from ik_node.math.types import Array
from ik_node.robot.joint_limits import joint_bounds, motion_limits
from ik_node.settings.groups import LimitSettings


@pytest.mark.parametrize("method", reference_solvers.METHODS)
@pytest.mark.parametrize("name", reference_solvers.ROBOTS)
def test_random_states_against_independent_solvers(name: str, method: str) -> None:
    """A sample with the required tolerances: bounds 1e-9 (here: exactly), s 1e-6, cost 1e-6, closed form 1e-8."""
    robot, rng = make_robot(name), np.random.default_rng(11)
    bound = 0
    for _ in range(40):
        found = check(problem(robot, method, rng))
        assert found.trespass <= 0.0
        assert found.residual < 1e-9
        assert not abs(found.scale_difference) > 1e-6
        assert abs(found.deviation_difference) < 1e-6
        assert abs(found.cost_difference) < 1e-6
        assert found.multiplier_error < 1e-6
        assert found.binds or found.closed_form_difference < 1e-8
        bound += found.binds
    assert bound > 5


@pytest.mark.exhaustive
@pytest.mark.parametrize("method", reference_solvers.METHODS)
@pytest.mark.parametrize("name", reference_solvers.ROBOTS)
def test_many_random_states_against_independent_solvers(name: str, method: str) -> None:
    """The same on 10,000 states: the largest difference includes the errors of the reference solvers."""
    robot, rng = make_robot(name), np.random.default_rng(1)
    checks = [check(problem(robot, method, rng)) for _ in range(10_000)]
    found = Check(*(np.array(column) for column in zip(*checks, strict=True)))  # type: ignore[arg-type]
    assert np.max(found.trespass) <= 1e-9
    assert np.max(found.residual) <= 1e-9
    assert np.nanmax(np.abs(found.scale_difference)) <= 1e-6
    assert np.max(np.abs(found.deviation_difference)) <= 5e-6
    assert np.max(np.abs(found.cost_difference)) <= 1e-6
    assert np.max(found.multiplier_error) <= 1e-6
    free = ~np.asarray(found.binds)
    assert np.max(np.asarray(found.closed_form_difference)[free], initial=0.0) <= 1e-8


def solve_on(name: str, seed: int) -> tuple[Problem, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return problem(make_robot(name), "obstacle_gradient", rng), rng


def test_the_constrained_problem_gives_the_closed_form_where_limits_hardly_bind() -> None:
    """A box that is narrower by rounding requires the constrained problem; its solution is that of the closed form."""
    for seed in range(30):
        for name in ("panda", "ur5"):
            task, _ = solve_on(name, seed)
            free = resolve(task.jacobian, task.twist, task.weight, task.gradient, task.gain)
            if free.singular_values[-1] < 1e-3:
                continue
            qd = free.joint_velocity
            lo, hi = np.minimum(qd, 0.0) - 1e-7, np.maximum(qd, 0.0) + 1e-7
            fastest = int(np.argmax(np.abs(qd)))
            (hi if qd[fastest] > 0.0 else lo)[fastest] = (1.0 - 1e-12) * qd[fastest]
            long_way = constrained.solve(task.jacobian, task.twist, lo, hi, task.weight, task.gradient, task.gain)
            assert long_way.binds
            assert np.count_nonzero(long_way.sides) == 1
            assert long_way.task_scale == pytest.approx(1.0, abs=1e-9)
            assert long_way.joint_velocity == pytest.approx(qd, rel=1e-8, abs=1e-8)


def test_the_direction_of_the_twist_is_kept_and_clipping_would_change_it() -> None:
    """From rest, the tool moves along V for any box; with the clipped closed form it does not."""
    bent = 0.0
    for seed in range(20):
        task, rng = solve_on("panda", seed)
        hi = rng.uniform(0.05, 0.5, 7)
        twist = rng.normal(size=6) * 3.0
        answer = constrained.solve(task.jacobian, twist, -hi, hi, task.weight, task.gradient, task.gain)
        assert 0.0 < answer.task_scale < 1.0
        assert answer.attained == pytest.approx(answer.task_scale * twist, abs=1e-12)
        clipped = task.jacobian @ np.clip(answer.unconstrained.joint_velocity, -hi, hi)
        bent = max(bent, float(np.linalg.norm(clipped - (clipped @ twist) / (twist @ twist) * twist)))
    assert bent > 0.05


def test_a_box_without_zero_is_answered_as_nearly_along_the_twist_as_it_allows() -> None:
    """A moving arm that has to stop, reverse or turn: J qd = s V is infeasible. While slowing down it keeps its
    direction."""
    robot, rng = make_robot("panda"), np.random.default_rng(5)
    limits = motion_limits(robot, LimitSettings(), 500.0)
    for _ in range(100):
        q = random_position(robot, rng)
        moving = rng.uniform(-0.5, 0.5, 7)
        bounds = joint_bounds(limits, q, moving, 0.002)
        jacobian = robot.evaluate(q).jacobian_b
        now = jacobian @ moving
        for twist in (np.zeros(6), -now, rng.normal(size=6), now):
            answer = constrained.solve(jacobian, twist, bounds.lo, bounds.hi)
            goal = jacobian @ answer.base_velocity + (answer.task_scale - answer.base_scale) * twist
            assert answer.attained == pytest.approx(goal, abs=1e-10)
            assert not answer.fallback
            task = Problem(jacobian, twist, bounds.lo, bounds.hi, None, None, 0.0)
            astray = float(np.linalg.norm(answer.attained - answer.task_scale * twist))
            assert astray <= least_deviation(task) + 1e-7
        slowed = constrained.solve(jacobian, 3.0 * now, bounds.lo, bounds.hi)
        assert 0.25 < slowed.task_scale < 1.0
        assert slowed.attained == pytest.approx(3.0 * slowed.task_scale * now, abs=1e-9)


def reference_scale(
    jacobian: Array, twist: Array, answer: ConstrainedSolution, lo: Array, hi: Array, dampers: VelocityDampers
) -> float:
    """s by scipy with the dampers, relaxed by the slack of our solution."""
    n, base = len(lo), answer.base_velocity
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_ub=np.column_stack((-dampers.rows, np.zeros(len(dampers.least)))),
        b_ub=-(dampers.least - answer.damper_slack),
        A_eq=np.column_stack((jacobian, -twist)),
        b_eq=jacobian @ base - answer.base_scale * twist,
        bounds=[*zip(lo.tolist(), hi.tolist(), strict=True), (0.0, 1.0)],
        options={"primal_feasibility_tolerance": 1e-9},
    )
    return float(found.x[n]) if found.status == 0 else float("nan")


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_dampers_are_obeyed_or_relaxed_by_the_least_amount(name: str) -> None:
    """Rows that forbid motion, rows that require motion, rows that contradict the box; s is still the largest."""
    rng, given_way, compared = np.random.default_rng(6), 0, 0
    robot = make_robot(name)
    for _ in range(150):
        task = problem(robot, "obstacle_gradient", rng)
        lo, hi = -robot.limits.velocity, 0.1 * robot.limits.velocity
        count = int(rng.integers(1, 4))
        rows = rng.normal(size=(count, robot.n)) * rng.choice([1e-3, 0.3])
        dampers = VelocityDampers(rows, rng.uniform(-0.3, 0.1, count), tuple("abc"[:count]))
        answer = constrained.solve(
            task.jacobian, task.twist, lo, hi, task.weight, task.gradient, task.gain, dampers=dampers
        )
        qd = answer.joint_velocity
        assert (qd >= lo).all()
        assert (qd <= hi).all()
        assert (rows @ qd >= dampers.least - answer.damper_slack - 1e-9).all()
        if answer.damper_slack.any():
            given_way += 1
            # The largest value that the box permits for the worst row: the reference minimises the largest slack.
            least = linprog(
                np.append(np.zeros(robot.n), 1.0),
                A_ub=np.column_stack((-rows, -np.ones(count))),
                b_ub=-dampers.least,
                bounds=[*zip(lo.tolist(), hi.tolist(), strict=True), (0.0, None)],
            )
            assert answer.damper_slack.max() == pytest.approx(least.fun, abs=1e-7)
        else:
            reference = reference_scale(task.jacobian, task.twist, answer, lo, hi, dampers)
            compared += np.isfinite(reference)
            assert not abs(answer.task_scale - reference) > 1e-6
    assert given_way > 5
    assert compared > 50


def test_a_damper_limits_approach_and_never_retreat() -> None:
    """Motion away from the obstacle is unchanged, bit for bit; motion towards it is slowed along its direction."""
    robot = make_robot("ur5")
    jacobian = robot.evaluate(np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.2])).jacobian_b
    towards = np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    dampers = VelocityDampers(
        -jacobian[:1], np.array([-0.05]), ("forearm - box",)
    )  # n along +x: at most 0.05 m/s in this direction.
    box = 3.0 * np.ones(6)
    away = constrained.solve(jacobian, -towards, -box, box, dampers=dampers)
    assert (away.joint_velocity == resolve(jacobian, -towards, checked=True).joint_velocity).all()
    slowed = constrained.solve(jacobian, towards, -box, box, dampers=dampers)
    assert slowed.attained == pytest.approx(0.25 * towards, abs=1e-12)
    assert slowed.sides.tolist() == [0] * 6 + [1]


@pytest.mark.parametrize("rows", [1, 2, 3, 4])
def test_null_spaces_of_many_dimensions(rows: int) -> None:
    """Position tasks and planar tasks: z has up to six entries there. Checked like the pose tasks."""
    rng = np.random.default_rng(8)
    for _ in range(25):
        task = problem(make_robot("panda"), "obstacle_gradient", rng)
        smaller = task._replace(jacobian=task.jacobian[:rows], twist=task.twist[:rows])
        found = check(smaller)
        assert found.trespass <= 0.0
        assert found.residual < 1e-9
        assert not abs(found.scale_difference) > 1e-6
        assert abs(found.cost_difference) < 1e-6
        assert found.multiplier_error < 1e-6


def test_daqp_on_random_programs() -> None:
    """s against scipy's linear program; z by stationarity with multipliers of the right sign."""
    rng, slowed = np.random.default_rng(9), 0
    for _ in range(200):
        size, count = int(rng.integers(1, 6)), int(rng.integers(8, 20))
        zeta = np.concatenate((rng.normal(size=(count, size)), np.eye(size), -np.eye(size)))
        beta = np.concatenate((rng.uniform(0.0, 1.0, count) * rng.choice([0.0, 1.0], count), np.full(2 * size, 5.0)))
        alpha = np.concatenate((rng.normal(size=count) * 10.0 ** rng.uniform(-6.0, 1.0), np.zeros(2 * size)))
        root, slope = rng.normal(size=(size, size)), rng.normal(size=size)
        cost = NullSpaceCost(root @ root.T + 0.1 * np.eye(size), slope, rng.normal(size=size))
        found = quadratic_program.largest_scale(LinearProgram(alpha, zeta, beta), cost)
        assert found is not None
        s, z = found
        goal = np.append(-1.0, np.zeros(size))
        free = [(None, None)] * size
        reference = linprog(goal, A_ub=np.column_stack((alpha, zeta)), b_ub=beta, bounds=[(0.0, 1.0), *free])
        assert s == pytest.approx(reference.x[0], abs=1e-7)
        assert (alpha * s + zeta @ z <= beta + 1e-10).all()
        slowed += s < 1.0
        task = Problem(
            np.zeros((0, size)), np.zeros(0), -beta[:size], beta[:size], cost.hessian, slope + s * cost.change, 1.0
        )
        assert multiplier_error_of_rows(task, z, zeta, beta - s * alpha) < 1e-8
    assert slowed > 50


def multiplier_error_of_rows(task: Problem, x: Array, rows: Array, limits: Array) -> float:
    from scipy.optimize import nnls

    active = rows[rows @ x >= limits - 1e-10]
    assert task.weight is not None
    assert task.gradient is not None
    slope = task.weight @ x + task.gradient
    return float(np.linalg.norm(slope) if len(active) == 0 else nnls(active.T, -slope)[1])


def test_degenerate_boxes_and_extreme_input_have_solutions() -> None:
    """A box of one point, infinite bounds, a singular Jacobian, a huge twist: a solution in the box, no exception."""
    robot = make_robot("panda")
    jacobian = robot.evaluate(np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.5, 0.3])).jacobian_b
    twist = np.array([0.1, 0.0, 0.2, 0.0, 0.3, 0.0])
    point = np.linspace(-0.2, 0.2, 7)
    assert (constrained.solve(jacobian, twist, point, point).joint_velocity == point).all()
    free = constrained.solve(jacobian, twist, np.full(7, -np.inf), np.full(7, np.inf))
    assert free.task_scale == 1.0
    assert free.attained == pytest.approx(twist, abs=1e-12)
    half = constrained.solve(jacobian, 100.0 * twist, np.full(7, -np.inf), np.full(7, 0.1))
    assert (half.joint_velocity <= 0.1).all()
    for broken in (
        np.zeros((6, 7)),
        np.outer(np.ones(6), np.ones(7)),
        jacobian * np.array([[1], [1], [1], [0], [1], [1]]),
    ):
        for size in (1e-12, 1.0, 1e12):
            answer = constrained.solve(
                broken, size * twist, np.full(7, -1.0), np.full(7, 1.0), np.eye(7), np.ones(7), 0.1
            )
            assert (np.abs(answer.joint_velocity) <= 1.0).all()
            assert 0.0 <= answer.task_scale <= 1.0
    with pytest.raises(InputError, match="empty"):
        constrained.solve(jacobian, twist, point + 1.0, point)
    with pytest.raises(InputError):
        constrained.solve(jacobian, np.full(6, np.nan), -np.ones(7), np.ones(7))


def test_the_same_input_gives_the_same_bits() -> None:
    """Replays depend on it: no state is carried from one call to the next."""
    tasks = [solve_on("panda", seed)[0] for seed in range(5)]
    runs = [
        [constrained.solve(t.jacobian, t.twist, t.lo, t.hi, t.weight, t.gradient, t.gain).joint_velocity for t in order]
        for order in (tasks, tasks[::-1])
    ]
    assert all((a == b).all() for a, b in zip(runs[0], runs[1][::-1], strict=True))


def test_what_bound_is_named() -> None:
    """The status names the limit that slowed the arm."""
    robot = make_robot("panda")
    limits = motion_limits(robot, LimitSettings(), 500.0)
    q = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.5, 0.3])
    jacobian = robot.evaluate(q).jacobian_b
    bounds = joint_bounds(limits, q, np.zeros(7), 0.002)
    answer = constrained.solve(jacobian, np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0]), bounds.lo, bounds.hi)
    names = answer.binding(bounds, robot.joints)
    assert names
    assert all(name.startswith("acceleration panda_joint") for name in names)
    assert constrained.solve(jacobian, np.full(6, 1e-6), bounds.lo, bounds.hi).binding(bounds, robot.joints) == ()
