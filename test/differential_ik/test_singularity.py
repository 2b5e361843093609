"""Singularities: which components are retained or truncated and at which scale, and that the arm always leaves them.

Closed loops with an ideal arm for the behaviour (a sample of `ik_benchmark limits`), single calls for the properties:
away from singularities V is unchanged; solutions are continuous, bounded and deterministic, and report what they
truncate.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from arms import random_position
from benchmark_runs import benchmark
from loop import READY, Loop, make_robot

from ik_node.differential_ik import constrained
from ik_node.differential_ik.singularity import START, RegulatedTask, SingularityState, regulate_singularities
from ik_node.differential_ik.singularity_branch import Branch, track_branch
from ik_node.math import pseudoinverse
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, joint_bounds, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings, SingularitySettings

SETTINGS = SingularitySettings()
PERIOD_S = 0.002
ROW_SCALE = np.repeat((1.0, 0.3), 3)
SINGULAR = {
    "ur5 wrist": (0.3, -1.2, 1.6, -1.2, 0.0, 0.4),
    "ur5 elbow": (0.3, -1.0, 0.0, -0.9, -1.2, 0.4),
    "ur5 shoulder": (0.3, 0.29279801863138033, 2.2, -1.0, 1.2, 0.4),
    "panda wrist": (0.7940000000418319, -0.771322402285052, -2.005230681426768, -2.0129621820115142,
                    1.5707963267954028, 3.363637425960939, 0.6179999999686188),
    "panda shoulder": (-1.099999999993753, 0.0, 1.5428911686078752, -1.3972210514851395,
                       -0.8324607100873602, 2.1385076057545707, -1.0320000000044764),
}  # fmt: skip
"""Positions at which the Jacobian loses a direction, rad."""


def decompose(robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Return u, sigma and the rows of y' of the body Jacobian with scaled rows."""
    u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b, full_matrices=False)
    return u, sigma, rows


def limits_of(robot: Robot) -> MotionLimits:
    return motion_limits(robot, LimitSettings(acceleration=(10.0,)), 500.0)


def regulate(
    robot: Robot,
    q: Array,
    twist: Array,
    previous: Array | None = None,
    state: SingularityState = START,
    scale: float = 1.0,
) -> RegulatedTask:
    limits = limits_of(robot)
    now = np.zeros(robot.n) if previous is None else previous
    return regulate_singularities(
        lambda p: robot.evaluate(p).jacobian_b,
        q,
        robot.evaluate(q).jacobian_b,
        twist,
        now,
        joint_bounds(limits, q, now, PERIOD_S),
        limits,
        ROW_SCALE,
        pseudoinverse.decompose(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b),
        SETTINGS,
        state,
        PERIOD_S,
        scale,
    )


def test_the_twist_is_unchanged_away_from_singularities() -> None:
    """V and J themselves, bit for bit; only the stalled time is reset."""
    robot, rng = make_robot("panda"), np.random.default_rng(1)
    tried = 0
    while tried < 20:
        q, twist = random_position(robot, rng), rng.normal(size=6)
        found = regulate(robot, q, twist, state=SingularityState(1.0, "pass", 0.0, 0.1))
        if found.singular_values[-1] < SETTINGS.threshold:
            continue
        tried += 1
        assert (found.twist == twist).all()
        assert (found.jacobian == robot.evaluate(q).jacobian_b).all()
        assert found.singularity_scale == found.retention == 1.0
        assert not found.truncated.any()
        assert found.state == SingularityState(1.0 - PERIOD_S, "free", 1.0, 0.0)


def test_gentle_twists_are_done_exactly_however_near() -> None:
    """A feasible twist is not truncated: at sigma = 0.01 m and 1 mm/s it is executed completely."""
    robot = make_robot("ur5")
    q = np.array([0.3, -1.2, 1.6, -1.2, 0.057, 0.4])
    rng = np.random.default_rng(2)
    for _ in range(20):
        twist = 1e-3 * rng.normal(size=6)
        found = regulate(robot, q, twist)
        assert 0.008 < found.singular_values[-1] < 0.012
        assert found.twist == pytest.approx(twist, abs=1e-12)
        assert found.singularity_scale == pytest.approx(1.0)


def test_the_same_input_gives_the_same_bits_and_the_state_is_explicit() -> None:
    """A replay that starts from a recorded state continues as the run did."""
    robot, rng = make_robot("ur5"), np.random.default_rng(3)
    q = np.array([0.3, -1.2, 1.6, -1.2, 0.02, 0.4])
    for _ in range(10):
        twist, previous = 0.2 * rng.normal(size=6), 0.1 * rng.normal(size=6)
        state = SingularityState(float(rng.uniform(0, 3)), "keep", float(rng.uniform()), 0.0)
        first = regulate(robot, q, twist, previous, state)
        regulate(robot, q + 0.1, -twist)
        again = regulate(robot, q, twist, previous, state)
        assert (first.twist == again.twist).all()
        assert first.state == again.state


def test_the_twist_is_continuous_in_position_and_target() -> None:
    """No switching threshold: small changes of q and V, with the state held, change V_f little."""
    robot, rng = make_robot("ur5"), np.random.default_rng(4)
    worst = 0.0
    for _ in range(30):
        q = np.array([0.3, -1.2, 1.6, -1.2, rng.uniform(0.01, 0.8), 0.4])
        twist = 0.15 * rng.normal(size=6)
        state = SingularityState(0.0, "keep", 1.0, 0.0)
        one = regulate(robot, q, twist, state=state)
        other = regulate(robot, q + 1e-6 * rng.normal(size=6), twist + 1e-6 * rng.normal(size=6), state=state)
        worst = max(worst, float(np.abs(ROW_SCALE * (one.twist - other.twist)).max()))
    assert worst < 1e-3


def test_the_regulated_task_is_never_singular_and_always_bounded() -> None:
    """At and beside every singularity, for any twist: finite, feasible, within the limits, with bounded speeds."""
    rng = np.random.default_rng(5)
    for name, singular in SINGULAR.items():
        robot = make_robot(name.split()[0])
        limits, motion = limits_of(robot), decompose(robot, np.array(singular))[2][-1]
        assert decompose(robot, np.array(singular))[1][-1] < 1e-12
        for beside in (0.0, 1e-15, 1e-12, 1e-6, 1e-3):
            q = np.array(singular) + beside * motion
            for size in (1e-9, 1e-3, 1.0, 100.0):
                found = regulate(robot, q, size * rng.normal(size=6))
                assert np.isfinite(found.twist).all()
                sigma = np.linalg.svd(ROW_SCALE[:, None] * found.jacobian, compute_uv=False)
                assert sigma[-1] > 0.9e-6
                bounds = joint_bounds(limits, q, np.zeros(robot.n), PERIOD_S)
                answer = constrained.solve(found.jacobian, found.twist, bounds.lo, bounds.hi, row_scale=ROW_SCALE)
                assert (np.abs(answer.joint_velocity) <= limits.velocity).all()


def drive(name: str, *ways: str) -> list[dict[str, Any]]:
    """Return the figures of a closed loop with an ideal arm, by `ik_benchmark limits`; one motion per strategy."""
    ran = benchmark("limits", "--only", "singularities", "--drives", name, "--ways", *(ways or ("ours",)), "--json")
    rows = ran.rows()
    assert [(row["drive"], row["way"]) for row in rows] == [(name, way) for way in ways or ("ours",)]
    return rows


def test_a_wrist_is_passed_on_the_path_where_a_filter_leaves_it() -> None:
    """Reachable, 20 mm beside the singularity: slowing down early costs 1 mm, the filter 20 mm, clipping 10 mm."""
    mine, slow, fade = drive("ur5 wrist: past at +20 mm, direction 0", "ours", "slow", "fade")
    assert mine["path_m"] < 1e-3
    assert mine["path_rad"] < 3e-3
    assert slow["path_rad"] > 10.0 * mine["path_rad"]
    assert fade["path_m"] > 10.0 * mine["path_m"]
    assert mine["changes"] <= 3


def test_a_wrist_missed_by_less_than_the_tolerance_is_passed_without_delay() -> None:
    """Half a turn for 2 mm is not required: little time is lost, and the error stays at that size."""
    (mine,) = drive("ur5 wrist: past at +0 mm, direction 0")
    assert mine["slowed_s"] < 0.05
    assert mine["path_m"] < 1e-3
    (mine,) = drive("ur5 wrist: past at +3 mm, direction 0")
    assert mine["path_m"] < 4e-3
    assert mine["slowed_s"] < 0.5


@pytest.mark.parametrize("name", ["ur5 elbow: into it, -1u", "ur5 shoulder: into it, +1u"])
def test_a_target_out_of_reach_neither_stops_nor_shakes_the_arm(name: str) -> None:
    """The boundary is approached like a joint limit, and left at once: full tracking within 1 s after reach is
    regained."""
    (mine,) = drive(name)
    assert mine["untracked_s"] < 1.0
    assert mine["changes"] <= 8
    assert mine["speed"] <= 1.0


@pytest.mark.exhaustive
def test_every_drive_is_within_its_bounds() -> None:
    """Past, from and into each singularity, both ways: the exit code states that this package is within its bounds."""
    ran = benchmark("limits", "--only", "singularities", "--json")
    assert ran.code == 0
    assert len(ran.rows()) > 3 * 50


def test_the_rest_of_the_twist_goes_on_at_a_boundary() -> None:
    """Elbow stretched, target outward and sideways: sideways continues at full speed, outward is truncated."""
    robot, rng = make_robot("ur5"), np.random.default_rng(6)
    singular = np.array(SINGULAR["ur5 elbow"])
    q = singular + 0.02 * decompose(robot, singular)[2][-1]
    u, sigma, rows = decompose(robot, q)
    growth = decompose(robot, q + 1e-3 * rows[-1])[1][-1] - sigma[-1]
    sideways = rng.normal(size=6)
    sideways -= u[:, -1] * (u[:, -1] @ sideways)
    sideways *= 0.1 / np.linalg.norm(sideways)
    outward = -np.sign(growth) * 0.2 * u[:, -1]
    found = regulate(robot, q, (sideways + outward) / ROW_SCALE)
    assert found.singularity_scale > 0.999
    done = ROW_SCALE * found.twist
    assert done - u[:, -1] * (u[:, -1] @ done) == pytest.approx(sideways, abs=1e-9)
    assert abs(u[:, -1] @ done) < 0.02
    assert ROW_SCALE * found.truncated == pytest.approx(outward - u[:, -1] * (u[:, -1] @ done), abs=1e-3)


EXHAUSTIVE = pytest.mark.exhaustive


@pytest.mark.parametrize(
    ("name", "beside"),
    [
        ("ur5 wrist", "0"),
        pytest.param("ur5 wrist", "1e-12", marks=EXHAUSTIVE),
        ("ur5 elbow", "0"),
        pytest.param("ur5 elbow", "1e-12", marks=EXHAUSTIVE),
        pytest.param("ur5 shoulder", "0", marks=EXHAUSTIVE),
        ("ur5 shoulder", "1e-12"),
        ("panda wrist", "0"),
        pytest.param("panda wrist", "1e-12", marks=EXHAUSTIVE),
        pytest.param("panda shoulder", "0", marks=EXHAUSTIVE),
        ("panda shoulder", "1e-12"),
    ],
)
def test_an_exactly_singular_start_is_left(name: str, beside: str) -> None:
    """V only in the lost direction, both ways: bounded, no chatter, and the arm reaches the target in the end."""
    for sign in ("+1u", "-1u"):
        (mine,) = drive(f"{name}: from {beside} rad, {sign}")
        assert mine["speed"] <= 1.0
        assert mine["changes"] <= 8
        assert mine["left_m"] < 1e-3
        assert mine["left_rad"] < 3e-3


def test_a_direction_blocked_by_a_limit_is_truncated_after_the_timeout() -> None:
    """Exact tracking may require a rotation that joint limits forbid: the direction is truncated after the timeout."""
    robot = make_robot("ur5")
    q = np.array([0.3, -1.2, 1.6, -1.2, 0.03, 0.4])
    u = np.linalg.svd(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b)[0]
    twist = 0.1 * (u[:, -1] + u[:, 0]) / ROW_SCALE
    state, waited = START, 0
    while regulate(robot, q, twist, state=state, scale=0.0).retention > 0.0:
        state = regulate(robot, q, twist, state=state, scale=0.0).state
        waited += 1
        assert waited < 2000
    assert 0.5 < waited * PERIOD_S < SETTINGS.timeout_s + 1.0
    found = regulate(robot, q, twist, state=state, scale=0.0)
    assert found.singularity_scale == pytest.approx(1.0)
    assert u[:, 0] @ (ROW_SCALE * found.twist) == pytest.approx(0.1, rel=1e-6)


def sign_changes(qd: Array, least: float = 0.02) -> int:
    """Return the largest number of sign changes of a joint velocity; speeds below ``least`` rad/s do not count."""
    moving = [np.sign(column[np.abs(column) > least]) for column in qd.T]
    return max(int(np.count_nonzero(signs[1:] != signs[:-1])) for signs in moving)


@pytest.mark.parametrize(("name", "radius_m", "elbow"), [("panda", 0.75, 3), ("ur5", 0.9, 2)])
def test_an_elbow_returns_from_out_of_reach_on_the_same_branch(name: str, radius_m: float, elbow: int) -> None:
    """A stream moves beyond the reach and back: the arm is calm meanwhile, and the elbow does not cross the stretched
    position.

    Before this was handled, rounding decided the branch: a Panda then moved into the limit of joint 4 and stayed there.
    """
    loop = Loop(make_robot(name), READY[name])
    loop.run(0.05)
    home = loop.pose()
    away = home.copy()
    away[:2, 3] *= radius_m / np.linalg.norm(home[:2, 3])

    def between(part: float) -> Array:
        pose: Array = home.copy()
        pose[:3, 3] += min(max(part, 0.0), 1.0) * (away[:3, 3] - home[:3, 3])
        return pose

    loop.follow(lambda time_s: between(time_s / 2.5), 3.5, 50.0)
    begin = len(loop.steps)
    loop.follow(lambda time_s: between(1.0), 1.0, 50.0)
    waiting = np.array([step.joint_velocity for step in loop.steps[begin:]])
    assert sign_changes(waiting) <= 2
    assert np.abs(waiting).max() < 0.6
    begin = len(loop.steps)
    loop.follow(lambda time_s: between(1.0 - time_s / 2.5), 3.5, 50.0)
    error_m = np.array([np.linalg.norm(step.error_b[:3]) for step in loop.steps[begin:]])
    assert error_m[round(1.8 / PERIOD_S) : round(2.3 / PERIOD_S)].max() < 1e-3
    assert error_m[-1] < 1e-4
    assert loop.position[elbow] == pytest.approx(READY[name][elbow], abs=0.05)


def test_branches_of_a_singularity_are_distinguished_for_any_signs_of_its_decomposition() -> None:
    """The wrist of a UR5 is turned through zero in small steps: it counts as crossed after zero, not before."""
    robot = make_robot("ur5")
    state: Branch | None = None
    chance = np.random.default_rng(7)
    for sweep, crossed in ((np.linspace(0.3, 0.02, 40), False), (np.linspace(-0.02, -0.3, 40), True)):
        for angle in sweep:
            q = np.array([0.3, -1.2, 1.6, -1.2, angle, 0.4])
            u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b)
            signs = chance.choice([-1.0, 1.0], 2)
            state = track_branch(state, signs[0] * u[:, -1], signs[0] * rows[-1], sigma[-1] / SETTINGS.threshold)
            assert state is not None
            assert state.crossed == crossed
    assert track_branch(None, u[:, -1], rows[-1], 0.2) is None
