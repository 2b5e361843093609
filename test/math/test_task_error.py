"""The error of a task with a tolerance.

It does not depend on what is free, is zero exactly where the task is fulfilled, is the distance to the nearest member
of the family, and has the stated derivative. Members are made by rotation matrices and checked by a numerical
minimiser, both without the functions under test. Half a turn, where the swing has no unique direction, has tests of its
own.
"""

from __future__ import annotations

from math import inf, pi

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ik_node.math import se3
from ik_node.math.task_error import HALF_TURN_CONE, NO_DIRECTION, SWING, TWIST, TaskDeviation, excess, task_deviation
from ik_node.math.task_tolerance import FRAMES, TaskTolerance
from ik_node.math.types import Array

POINTING = (0.0, 0.0, 0.0, 0.0, 0.0, inf)
TOLERANCES = [
    POINTING,
    (0.0, 0.0, 0.0, inf, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, inf, 0.2),
    (0.0, 0.01, 0.0, 0.1, 0.2, inf),
    (0.0, 0.0, inf, 0.0, 0.0, inf),
    (inf, 0.0, 0.02, inf, 0.0, 0.0),
    (0.0, 0.0, 0.0, inf, inf, inf),
    (inf, 0.0, 0.0, inf, inf, inf),
    (0.01, 0.02, 0.03, inf, inf, inf),
    (0.0, 0.0, 0.0, inf, inf, 0.0),
    (0.0, 0.0, inf, 0.3, inf, inf),
    (0.0, 0.0, 0.0, 0.2, 0.2, 0.2),
    (0.01, inf, 0.0, 0.0, 0.1, 0.2),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.5),
    (inf, 0.01, 0.0, 0.0, 0.0, 0.0),
    (inf, inf, inf, 0.0, 0.0, inf),
]
CASES = [pytest.param(TaskTolerance(t, frame), id=f"{frame} {t}") for t in TOLERANCES for frame in FRAMES]
SPINS = (0.3, pi / 2, np.deg2rad(179.0), np.deg2rad(-179.999), pi, -2.0)


def deviation(task: TaskTolerance, pose_sb: Array, pose_sd: Array) -> TaskDeviation:
    return task_deviation(task.form, np.ascontiguousarray(pose_sb), np.ascontiguousarray(pose_sd))


def error(task: TaskTolerance, pose_sb: Array, pose_sd: Array) -> Array:
    return excess(deviation(task, pose_sb, pose_sd).components, task.form.half_widths)


def random_pose(rng: np.random.Generator) -> Array:
    return pose(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1.0, 1.0, 3))


def pose(rotation: Array, position: Array) -> Array:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation, position
    return result


def turn(vector: Array) -> Array:
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def about(axis: int, angle: float) -> Array:
    return turn(angle * np.eye(3)[axis])


def angle_between(a: Array, b: Array) -> float:
    return float(np.linalg.norm(Rotation.from_matrix(a.T @ b).as_rotvec()))


def same_families(task: TaskTolerance, target: Array, rng: np.random.Generator) -> list[Array]:
    """Targets that differ from ``target`` only in what is free."""
    targets = []
    free_turns = np.flatnonzero(task.free[3:])
    base = task.frame == "base"
    for spin in SPINS:
        rotation, position = target[:3, :3], target[:3, 3].copy()
        if len(free_turns) == 1:
            freely = about(int(free_turns[0]), spin)
            rotation = freely @ rotation if base else rotation @ freely
        elif len(free_turns) == 3:
            rotation = Rotation.random(random_state=rng).as_matrix()
        for axis in np.flatnonzero(task.free[:3]):
            # In the frame tool a free direction is part of the family only if the free rotations leave it in place.
            if base or task.free[:3].all() or len(free_turns) == 0 or free_turns.tolist() == [axis]:
                position += rng.uniform(-1.0, 1.0) * (np.eye(3) if base else rotation)[:, axis]
        targets.append(pose(rotation, position))
    return targets


def member(task: TaskTolerance, target: Array, rng: np.random.Generator) -> Array:
    """A pose within the tolerance: up to the border of bands, anywhere in what is free."""
    widths = np.array(task.half_widths)
    inside = rng.uniform(-1.0, 1.0, 6) * np.where(np.isinf(widths), np.where(np.arange(6) < 3, 1.0, 3.1), widths)
    free = np.flatnonzero(task.free[3:])
    loose = np.flatnonzero(widths[3:] > 0.0)
    turns = inside[3:]
    twist = np.eye(3)
    if len(free) == 1 or (len(free) == 0 and len(loose) == 1):
        axis = int(free[0] if len(free) == 1 else loose[0])
        twist = about(axis, turns[axis])
        swing = turn(np.where(np.arange(3) == axis, 0.0, turns))
    elif len(free) == 2:
        held = int(3 - free.sum())
        # The components of a rotation with a least distance c to those without twist: quaternion part sin(c / 2).
        part = np.sin(0.5 * turns[held])
        others = rng.normal(size=3)
        others *= np.sqrt(1.0 - part**2) / np.linalg.norm(others)
        quaternion = np.insert(others[:2], held, part)
        swing = Rotation.from_quat([*quaternion, others[2]]).as_matrix()
    else:
        swing = turn(turns if len(free) == 0 else rng.normal(size=3))
    rotation_d = target[:3, :3]
    if task.frame == "base":
        # R_d R_b' is the inverse of swing twist
        return pose((swing @ twist) @ rotation_d, target[:3, 3] - inside[:3])
    rotation_b = rotation_d @ (swing @ twist).T
    axes = {0: rotation_d, 1: rotation_b @ swing, 2: rotation_d, 3: rotation_b}[len(free)]
    return pose(rotation_b, target[:3, 3] - axes @ inside[:3])


@pytest.mark.parametrize("task", CASES)
def test_the_error_does_not_depend_on_what_is_free(task: TaskTolerance) -> None:
    rng = np.random.default_rng(1)
    followed = ~task.free
    for _ in range(20):
        tool, target = random_pose(rng), random_pose(rng)
        first = deviation(task, tool, target)
        wanted = excess(first.components, task.form.half_widths)
        assert (wanted[task.free] == 0.0).all()
        for other in same_families(task, target, rng):
            second = deviation(task, tool, other)
            np.testing.assert_allclose(excess(second.components, task.form.half_widths), wanted, atol=1e-9)
            np.testing.assert_allclose(second.rows_b[followed], first.rows_b[followed], atol=1e-9)


@pytest.mark.parametrize("task", CASES)
def test_the_feed_forward_does_not_contain_a_motion_in_the_free_directions(task: TaskTolerance) -> None:
    rng = np.random.default_rng(2)
    free_turns = np.flatnonzero(task.free[3:])
    for _ in range(20):
        tool, target = random_pose(rng), random_pose(rng)
        rotation = target[:3, :3]
        twist = np.zeros(6)
        if len(free_turns) in (1, 3):
            for axis in free_turns:
                spin = 20.0 * np.eye(3)[axis]
                twist[3:] += rotation.T @ spin if task.frame == "base" else spin
        rates = deviation(task, tool, target).rows_d @ twist
        np.testing.assert_allclose(rates[~task.free], 0.0, atol=1e-9)


@pytest.mark.parametrize("task", CASES)
def test_the_error_is_zero_exactly_where_the_task_is_fulfilled(task: TaskTolerance) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        target = random_pose(rng)
        tool = member(task, target, rng)
        np.testing.assert_allclose(error(task, tool, target), 0.0, atol=1e-9)
    # A motion out of the family in any component that is followed gives an error.
    target = random_pose(rng)
    for index in np.flatnonzero(~task.free):
        step = np.linalg.lstsq(deviation(task, target, target).rows_b, np.eye(6)[index], rcond=None)[0]
        away = target @ se3.exp(0.6 * step)
        assert np.linalg.norm(error(task, away, target)) > 1e-3


@pytest.mark.parametrize("task", CASES)
def test_the_error_is_continuous_and_zero_inside_a_band(task: TaskTolerance) -> None:
    rng = np.random.default_rng(4)
    widths = np.array(task.half_widths)
    for index in np.flatnonzero((widths > 0.0) & np.isfinite(widths)):
        target = random_pose(rng)
        linear = index < 3
        for value in widths[index] * np.array([-1.0 - 1e-9, -1.0 + 1e-9, -0.5, 0.0, 0.5, 1.0 - 1e-9, 1.0 + 1e-9, 1.5]):
            component = np.eye(3)[index % 3] * value
            rotation = target[:3, :3]
            if task.frame == "base":
                tool = pose(turn(np.zeros(3) if linear else -component) @ rotation, target[:3, 3])
                tool[:3, 3] -= component if linear else 0.0
            else:
                tool = pose(rotation @ turn(np.zeros(3) if linear else -component), target[:3, 3])
                tool[:3, 3] -= rotation @ component if linear else 0.0
            wanted = np.zeros(6)
            wanted[index] = value - np.clip(value, -widths[index], widths[index])
            np.testing.assert_allclose(error(task, tool, target), wanted, atol=1e-12)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("free", [1, 2])
def test_the_rotation_error_is_the_angle_to_the_nearest_member(frame: str, axis: int, free: int) -> None:
    # One free rotation: the members turn about one axis. Two: they have no twist about the third.
    loose = [index == axis if free == 1 else index != axis for index in range(3)]
    task = TaskTolerance([0.0, 0.0, 0.0, *np.where(loose, inf, 0.0)], frame)
    rng = np.random.default_rng(5)
    for _ in range(20):
        tool, target = random_pose(rng), random_pose(rng)

        def rotation_of(parameters: Array, target: Array = target) -> Array:
            vector = np.zeros(3)
            vector[loose] = parameters
            member = turn(vector)
            return np.asarray(member @ target[:3, :3] if frame == "base" else target[:3, :3] @ member)

        def distance(parameters: Array, tool: Array = tool) -> float:
            return angle_between(tool[:3, :3], rotation_of(parameters))

        starts = np.linspace(-3.0, 3.0, 5)
        grid = np.stack(np.meshgrid(*[starts] * free), axis=-1).reshape(-1, free)
        start = min(grid, key=distance)
        options = {"xatol": 1e-10, "fatol": 1e-13, "maxiter": 4000}
        best = minimize(distance, start, method="Nelder-Mead", options=options).fun
        np.testing.assert_allclose(np.linalg.norm(error(task, tool, target)[3:]), best, atol=1e-6)


@pytest.mark.parametrize("frame", FRAMES)
def test_the_linear_error_is_the_distance_to_the_nearest_member(frame: str) -> None:
    rng = np.random.default_rng(6)
    task = TaskTolerance([0.3, inf, 0.0, 0.0, 0.0, 0.0], frame)
    for _ in range(20):
        tool, target = random_pose(rng), random_pose(rng)
        axes = np.eye(3) if frame == "base" else target[:3, :3]

        def distance(part: Array, axes: Array = axes, tool: Array = tool, target: Array = target) -> float:
            return float(np.sum((tool[:3, 3] - target[:3, 3] - axes[:, :2] @ part) ** 2))

        best = minimize(distance, np.zeros(2), bounds=[(-0.3, 0.3), (None, None)], tol=1e-15).fun
        np.testing.assert_allclose(np.linalg.norm(error(task, tool, target)[:3]), np.sqrt(best), atol=1e-6)


@pytest.mark.parametrize("task", CASES)
def test_the_rows_are_the_derivative(task: TaskTolerance) -> None:
    # Rows that stand for the rate in axes that move with the error have the derivative of its length.
    rng = np.random.default_rng(7)
    h = 1e-6
    followed = ~task.free
    for _ in range(30):
        tool, target = random_pose(rng), random_pose(rng)
        here = deviation(task, tool, target)
        if here.components[3:] @ here.components[3:] > 2.9**2:
            continue
        twist_b, twist_d = rng.normal(size=6), rng.normal(size=6)
        rate = here.rows_d @ twist_d - here.rows_b @ twist_b
        after = deviation(task, tool @ se3.exp(h * twist_b), target @ se3.exp(h * twist_d)).components
        before = deviation(task, tool @ se3.exp(-h * twist_b), target @ se3.exp(-h * twist_d)).components
        difference = (after - before) / (2.0 * h)
        form = task.form
        parts = [(slice(0, 3), form.axes_turn or form.in_base), (slice(3, 6), not form.shortest)]
        for part, is_derivative in parts:
            chosen = np.zeros(6, dtype=bool)
            chosen[part] = True
            chosen &= followed & (task.exact | is_derivative)
            if is_derivative and not (part.start == 0 and form.linear_axes == 1 and not form.axes_spin):
                np.testing.assert_allclose(rate[chosen], difference[chosen], rtol=1e-5, atol=1e-5)
            else:
                value = here.components[chosen]
                np.testing.assert_allclose(value @ rate[chosen], value @ difference[chosen], rtol=1e-5, atol=1e-5)
            band = followed & ~task.exact & (np.arange(6) >= 3) & (part.start == 3)
            np.testing.assert_allclose(rate[band], difference[band], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("spin_deg", [0.0, 90.0, 150.0, 179.0])
@pytest.mark.parametrize("frame", FRAMES)
def test_the_tilt_decays_exponentially_whatever_the_spin_does(frame: str, spin_deg: float) -> None:
    """Feedback of 1/s on 30 deg of tilt, a target that tilts and spins at 20 rad/s, a tool that spins too.

    The tilt falls to 0.1 deg in ln(300) = 5.7 s. A masked logarithm takes 7.1 s with 90 deg of spin, 17.9 s with 179.
    """
    task = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf), frame)
    target = random_pose(np.random.default_rng(8))
    tilt, spin = turn(np.deg2rad([30.0, 0.0, 0.0])), about(2, np.deg2rad(spin_deg))
    tool = target.copy()
    tool[:3, :3] = spin @ tilt @ target[:3, :3] if frame == "base" else target[:3, :3] @ tilt @ spin

    def twists(tool: Array, target: Array, time: float) -> tuple[Array, Array]:
        def spinning(pose_s: Array, speed: float) -> Array:
            spin = np.array([0.0, 0.0, speed])
            return pose_s[:3, :3].T @ spin if frame == "base" else spin

        twist_d = np.array([0.0, 0.0, 0.0, 0.5 * np.cos(time), 0.3, 0.0])
        twist_d[3:] += spinning(target, 20.0)
        now = deviation(task, tool, target)
        wanted = now.rows_d @ twist_d + now.components
        twist_b = np.linalg.lstsq(now.rows_b[:5], wanted[:5], rcond=None)[0]
        twist_b[3:] += spinning(tool, 3.0)
        return twist_b, twist_d

    h, time = 0.001, 0.0
    while (length := float(np.linalg.norm(error(task, tool, target)[3:]))) > np.deg2rad(0.1):
        np.testing.assert_allclose(length, np.deg2rad(30.0) * np.exp(-time), rtol=2e-3, atol=3e-5)
        twist_b, twist_d = twists(tool, target, time)
        middle = tool @ se3.exp(0.5 * h * twist_b), target @ se3.exp(0.5 * h * twist_d)
        twist_b, twist_d = twists(*middle, time + 0.5 * h)
        tool, target = tool @ se3.exp(h * twist_b), target @ se3.exp(h * twist_d)
        time += h
        assert time < 7.0
    assert time == pytest.approx(np.log(300.0), abs=0.01)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_swing_of_half_a_turn_has_a_direction_that_is_kept(frame: str, axis: int) -> None:
    task = TaskTolerance([0.0, 0.0, 0.0, *np.where(np.arange(3) == axis, inf, 0.0)], frame)
    form = task.form
    target = random_pose(np.random.default_rng(9))
    across = np.eye(3)[(axis + 1) % 3]
    rotation = target[:3, :3]
    half = turn(pi * across)
    tool = target.copy()
    tool[:3, :3] = half @ rotation if frame == "base" else rotation @ half
    first = task_deviation(form, tool, target)
    assert np.linalg.norm(excess(first.components, form.half_widths)[3:]) == pytest.approx(pi, abs=1e-9)
    assert np.isfinite(first.rows_b).all()
    assert np.isfinite(first.rows_d).all()
    direction = first.swing_direction
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    # Noise about half a turn reverses the swing without a direction to keep, and never with one.
    rng = np.random.default_rng(10)
    reversed_without = []
    for _ in range(100):
        noisy = tool @ se3.exp(np.array([0.0, 0.0, 0.0, *(rng.normal(size=3) * 0.2 * HALF_TURN_CONE)]))
        kept = task_deviation(form, noisy, target, direction)
        assert kept.swing_direction == direction
        swing = excess(first.components, form.half_widths)[3:]
        assert swing @ excess(kept.components, form.half_widths)[3:] > 0.9 * pi**2
        without = task_deviation(form, noisy, target, NO_DIRECTION)
        reversed_without.append(swing @ excess(without.components, form.half_widths)[3:] < 0.0)
    assert sum(reversed_without) > 10
    # Feedback leads away from half a turn to the target, in the direction that was chosen.
    kept_direction = direction
    for _ in range(400):
        now = task_deviation(form, tool, target, kept_direction)
        kept_direction = now.swing_direction
        twist = np.linalg.lstsq(now.rows_b, excess(now.components, form.half_widths), rcond=None)[0]
        tool = tool @ se3.exp(np.array(0.05 * twist))
    assert np.linalg.norm(error(task, tool, target)) < 1e-6
    assert np.dot(kept_direction, direction) > 0.99


@pytest.mark.parametrize("task", CASES)
def test_half_turns_give_finite_numbers(task: TaskTolerance) -> None:
    for vector in (*np.eye(3), *-np.eye(3), np.array([0.6, 0.8, 0.0]), np.zeros(3)):
        target = random_pose(np.random.default_rng(11))
        tool = target @ pose(turn(pi * vector), np.array([0.1, 0.2, 0.3]))
        result = deviation(task, tool, target)
        for numbers in (result.components, result.rows_b, result.rows_d):
            assert np.isfinite(numbers).all()
        assert np.abs(result.components[3:]).max() <= 2.0 * pi


def test_translation_and_rotation_are_separate() -> None:
    # log6 turns a position error of 1 m by 45 deg for 90 deg of spin; masked y leaks into z for 10 deg of tilt.
    target = np.eye(4)
    spun = pose(about(2, pi / 2), np.array([-1.0, 0.0, 0.0]))
    np.testing.assert_allclose(error(TaskTolerance(POINTING, "base"), spun, target), [1, 0, 0, 0, 0, 0], atol=1e-12)
    tilted = pose(about(0, np.deg2rad(10.0)), np.array([0.0, -1.0, 0.0]))
    seam = TaskTolerance((0.0, inf, 0.0, 0.0, 0.0, inf))
    assert error(seam, tilted, target)[2] == pytest.approx(0.0, abs=1e-12)


def test_one_wide_band_is_the_swing_and_a_limited_twist() -> None:
    # The tilt is that of a free twist, not distorted by a large twist within the band.
    rng = np.random.default_rng(12)
    band, free = TaskTolerance((0, 0, 0, 0, 0, 2.5)), TaskTolerance(POINTING)
    assert (band.form.rotation, TaskTolerance((0, 0, 0, inf, inf, 0)).form.rotation) == (SWING, TWIST)
    for _ in range(20):
        target = random_pose(rng)
        tool = target.copy()
        tool[:3, :3] = target[:3, :3] @ about(2, 2.4 * rng.uniform(-1, 1)) @ turn(np.array([*rng.normal(size=2), 0.0]))
        np.testing.assert_allclose(error(band, tool, target)[3:5], error(free, tool, target)[3:5], atol=1e-12)
