"""Singularities: what is kept, what is let go, at what pace, and that the arm always gets away.

Closed loops with an ideal arm for the behaviour (a sample of `ik_benchmark limits`), single calls for the properties:
nothing happens away from singularities, answers are continuous, bounded, deterministic, and say what they gave up.
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from benchmarks.loop import PERIOD_S, ROW_SCALE, exact, faded, follow, ours, sign_changes
from benchmarks.reference_solvers import arm, random_position
from benchmarks.singularities import SETTINGS as TICK
from benchmarks.singularities import Drive, Figures, drives, measure, singularities
from ik_node.differential_ik import constrained
from ik_node.differential_ik.singularity import START, Passage, PassageState, pass_singularities
from ik_node.differential_ik.singularity_branch import Branch, follow_branch
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, joint_bounds, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings, SingularitySettings

SETTINGS = SingularitySettings()
DRIVES = {f"{drive.place.name}: {drive.label}": drive for drive in drives()}


def limits_of(robot: Robot) -> MotionLimits:
    return motion_limits(robot, LimitSettings(acceleration=(10.0,)), 500.0)


def passage(
    robot: Robot, q: Array, twist: Array, previous: Array | None = None, state: PassageState = START, scale: float = 1.0
) -> Passage:
    limits = limits_of(robot)
    now = np.zeros(robot.n) if previous is None else previous
    return pass_singularities(
        lambda p: robot.evaluate(p).jacobian_b,
        q,
        robot.evaluate(q).jacobian_b,
        twist,
        now,
        joint_bounds(limits, q, now, PERIOD_S),
        limits,
        ROW_SCALE,
        SETTINGS,
        state,
        PERIOD_S,
        scale,
    )


def test_nothing_happens_away_from_singularities() -> None:
    """V itself, bit for bit, and J itself; only lost time is forgotten."""
    robot, rng = arm("panda"), np.random.default_rng(1)
    tried = 0
    while tried < 20:
        q, twist = random_position(robot, rng), rng.normal(size=6)
        found = passage(robot, q, twist, state=PassageState(1.0, "pass", 0.0, 0.1))
        if found.singular_values[-1] < SETTINGS.threshold:
            continue
        tried += 1
        assert (found.twist == twist).all()
        assert (found.jacobian == robot.evaluate(q).jacobian_b).all()
        assert found.pace == found.keep == 1.0
        assert not found.lost.any()
        assert found.state == PassageState(1.0 - PERIOD_S, "free", 1.0, 0.0)


def test_gentle_twists_are_done_exactly_however_near() -> None:
    """What the joints can do is not filtered: at sigma = 0.01 m and 1 mm/s nothing is lost."""
    robot = arm("ur5")
    q = np.array([0.3, -1.2, 1.6, -1.2, 0.057, 0.4])
    rng = np.random.default_rng(2)
    for _ in range(20):
        twist = 1e-3 * rng.normal(size=6)
        found = passage(robot, q, twist)
        assert 0.008 < found.singular_values[-1] < 0.012
        assert found.twist == pytest.approx(twist, abs=1e-12)
        assert found.pace == pytest.approx(1.0)


def test_the_same_input_gives_the_same_bits_and_the_state_is_explicit() -> None:
    """A replay that starts from a recorded state must go on as the run did."""
    robot, rng = arm("ur5"), np.random.default_rng(3)
    q = np.array([0.3, -1.2, 1.6, -1.2, 0.02, 0.4])
    for _ in range(10):
        twist, previous = 0.2 * rng.normal(size=6), 0.1 * rng.normal(size=6)
        state = PassageState(float(rng.uniform(0, 3)), "keep", float(rng.uniform()), 0.0)
        first = passage(robot, q, twist, previous, state)
        passage(robot, q + 0.1, -twist)
        again = passage(robot, q, twist, previous, state)
        assert (first.twist == again.twist).all()
        assert first.state == again.state


def test_the_twist_is_continuous_in_position_and_target() -> None:
    """No threshold at which something switches: small steps of q and V, with the state held, move V_f little."""
    robot, rng = arm("ur5"), np.random.default_rng(4)
    worst = 0.0
    for _ in range(30):
        q = np.array([0.3, -1.2, 1.6, -1.2, rng.uniform(0.01, 0.8), 0.4])
        twist = 0.15 * rng.normal(size=6)
        state = PassageState(0.0, "keep", 1.0, 0.0)
        one = passage(robot, q, twist, state=state)
        other = passage(robot, q + 1e-6 * rng.normal(size=6), twist + 1e-6 * rng.normal(size=6), state=state)
        worst = max(worst, float(np.abs(ROW_SCALE * (one.twist - other.twist)).max()))
    assert worst < 1e-3


def test_the_problem_handed_on_is_never_singular_and_always_bounded() -> None:
    """At and beside every singularity, for any twist: finite, answerable, within the limits; speeds do not blow up."""
    rng = np.random.default_rng(5)
    for place in singularities():
        limits = limits_of(place.robot)
        for beside in (0.0, 1e-15, 1e-12, 1e-6, 1e-3):
            q = place.q + beside * place.motion
            for size in (1e-9, 1e-3, 1.0, 100.0):
                found = passage(place.robot, q, size * rng.normal(size=6))
                assert np.isfinite(found.twist).all()
                sigma = np.linalg.svd(ROW_SCALE[:, None] * found.jacobian, compute_uv=False)
                assert sigma[-1] > 0.9e-6
                bounds = joint_bounds(limits, q, np.zeros(place.robot.n), PERIOD_S)
                answer = constrained.solve(found.jacobian, found.twist, bounds.lo, bounds.hi, row_scale=ROW_SCALE)
                assert (np.abs(answer.joint_velocity) <= limits.velocity).all()


def run(name: str, passing: str = "ours") -> Figures:
    drive: Drive = DRIVES[name]
    return measure(drive, {"ours": ours, "slow": exact, "fade": faded}[passing])[0]


def test_a_wrist_is_passed_on_the_path_where_a_filter_leaves_it() -> None:
    """Reachable, 20 mm beside the singularity: slowing down early costs a millimetre, the filter 20, clipping 10."""
    mine, slow, fade = (run("ur5 wrist: past at +20 mm, direction 0", way) for way in ("ours", "slow", "fade"))
    assert mine.path_m < 1e-3
    assert mine.path_rad < 3e-3
    assert slow.path_rad > 10.0 * mine.path_rad
    assert fade.path_m > 10.0 * mine.path_m
    assert mine.changes <= 3


def test_a_wrist_missed_by_less_than_the_tolerance_is_passed_without_delay() -> None:
    """Half a turn for 2 mm is not worth it: little time is lost, and the error stays of that size."""
    mine = run("ur5 wrist: past at +0 mm, direction 0")
    assert mine.slowed_s < 0.05
    assert mine.path_m < 1e-3
    mine = run("ur5 wrist: past at +3 mm, direction 0")
    assert mine.path_m < 4e-3
    assert mine.slowed_s < 0.5


@pytest.mark.parametrize("name", ["ur5 elbow: into it, -1u", "ur5 shoulder: into it, +1u"])
def test_a_target_out_of_reach_neither_stops_nor_shakes_the_arm(name: str) -> None:
    """The boundary is approached like a joint limit, and left at once: full tracking within 1 s of reach."""
    mine = run(name)
    assert mine.untracked_s < 1.0
    assert mine.changes <= 8
    assert mine.speed <= 1.0


def test_the_rest_of_the_twist_goes_on_at_a_boundary() -> None:
    """Elbow stretched, target outward and sideways: sideways goes on at full pace, outward is lost."""
    place = next(place for place in singularities() if place.name == "ur5 elbow")
    rng, q = np.random.default_rng(6), place.q + 0.02 * place.motion
    u, _, rows = np.linalg.svd(ROW_SCALE[:, None] * place.robot.evaluate(q).jacobian_b)
    growth = float(place.slope @ rows[-1])
    sideways = rng.normal(size=6)
    sideways -= u[:, -1] * (u[:, -1] @ sideways)
    sideways *= 0.1 / np.linalg.norm(sideways)
    outward = -np.sign(growth) * 0.2 * u[:, -1]
    found = passage(place.robot, q, (sideways + outward) / ROW_SCALE)
    assert found.pace > 0.999
    done = ROW_SCALE * found.twist
    assert done - u[:, -1] * (u[:, -1] @ done) == pytest.approx(sideways, abs=1e-9)
    assert abs(u[:, -1] @ done) < 0.02
    assert ROW_SCALE * found.lost == pytest.approx(outward - u[:, -1] * (u[:, -1] @ done), abs=1e-3)


@pytest.mark.parametrize("beside", ["0", "1e-12"])
@pytest.mark.parametrize("name", ["ur5 wrist", "ur5 elbow", "ur5 shoulder", "panda wrist", "panda shoulder"])
def test_an_exactly_singular_start_is_left(name: str, beside: str) -> None:
    """V only in the lost direction, both ways: bounded, no chatter, and at the end the arm is where it should be."""
    for sign in ("+1u", "-1u"):
        drive = DRIVES[f"{name}: from {beside} rad, {sign}"]
        limits = limits_of(drive.place.robot)
        way = ours(drive.place.robot, TICK)
        found = follow(drive.place.robot, drive.target, drive.q, way, drive.target.duration_s + 1.0)
        assert (np.abs(found.qd) <= limits.velocity).all()
        assert sign_changes(found.qd) <= 8
        assert found.error_m[-1] < 1e-3
        assert found.error_rad[-1] < 3e-3


def test_who_is_blocked_by_a_limit_lets_go_after_its_patience() -> None:
    """The turn that an exact pass needs may not fit between the joint's limits: time counts, then the rest goes on."""
    robot = arm("ur5")
    q = np.array([0.3, -1.2, 1.6, -1.2, 0.03, 0.4])
    u = np.linalg.svd(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b)[0]
    twist = 0.1 * (u[:, -1] + u[:, 0]) / ROW_SCALE
    state, waited = START, 0
    while passage(robot, q, twist, state=state, scale=0.0).keep > 0.0:
        state = passage(robot, q, twist, state=state, scale=0.0).state
        waited += 1
        assert waited < 2000
    assert 0.5 < waited * PERIOD_S < SETTINGS.patience_s + 1.0
    found = passage(robot, q, twist, state=state, scale=0.0)
    assert found.pace == pytest.approx(1.0)
    assert u[:, 0] @ (ROW_SCALE * found.twist) == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize(("name", "radius_m", "elbow"), [("panda", 0.75, 3), ("ur5", 0.9, 2)])
def test_an_elbow_comes_back_from_out_of_reach_bent_the_way_it_was(name: str, radius_m: float, elbow: int) -> None:
    """Led beyond its reach and back by a stream: calm while it waits, and not on the other side of the stretched elbow.

    The other side was taken by chance before: a Panda then ran into the limit of joint 4 and stayed there.
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


def test_the_sides_of_a_singularity_are_told_apart_whatever_the_signs_of_its_decomposition() -> None:
    """The wrist of a UR5 turned through zero in small steps: wrong from there on, not before, and back again."""
    robot = arm("ur5")
    state: Branch | None = None
    chance = np.random.default_rng(7)
    for sweep, wrong in ((np.linspace(0.3, 0.02, 40), False), (np.linspace(-0.02, -0.3, 40), True)):
        for angle in sweep:
            q = np.array([0.3, -1.2, 1.6, -1.2, angle, 0.4])
            u, sigma, rows = np.linalg.svd(ROW_SCALE[:, None] * robot.evaluate(q).jacobian_b)
            signs = chance.choice([-1.0, 1.0], 2)
            state = follow_branch(state, signs[0] * u[:, -1], signs[0] * rows[-1], sigma[-1] / SETTINGS.threshold)
            assert state is not None
            assert state.wrong == wrong
    assert follow_branch(None, u[:, -1], rows[-1], 0.2) is None
