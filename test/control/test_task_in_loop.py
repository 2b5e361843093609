"""A task with a tolerance in the control loop, from the topic on.

Targets that differ only in what is free give the same commands, from streams, paths and jogging, whatever they do
there; the error is zero exactly where the task is fulfilled.
"""

from __future__ import annotations

from math import inf
from pathlib import Path

import numpy as np
import pytest
from loop import READY, Loop
from recorded_loop import finish, recorded_loop
from scipy.spatial.transform import Rotation
from task_loops import (
    BAND,
    POINTING,
    POSITION,
    Free,
    commands,
    jog,
    nothing,
    send_path,
    send_trajectory,
    target_of,
    task_loop,
)

from ik_node.errors import SettingsError
from ik_node.interfaces.samples import ObstacleSample
from ik_node.interfaces.step import Mode
from ik_node.math.task_error import excess, task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.robot.catalogue import robot_from_settings
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import read_settings

SAME = 1e-9
"""Largest difference of two commands, rad/s."""


def spin(rate: float, axis: int = 2) -> Free:
    return lambda time_s: np.asarray(rate * time_s * np.eye(6)[3 + axis])


def turned_over(time_s: float) -> Array:
    """Half a turn about z between two samples, 20 ms apart, and back."""
    return np.asarray(np.eye(6)[5] * np.pi * (round(time_s / 0.02) % 2))


def tumbling(time_s: float) -> Array:
    return np.array((0.0, 0.0, 0.0, 20.0 * time_s, 3.0 * np.sin(9.0 * time_s), 7.0))


def spinning_and_sliding(time_s: float) -> Array:
    return np.array((0.0, 0.0, 0.5 * np.sin(8.0 * time_s), 0.0, 0.0, 20.0 * time_s))


TASKS = [
    pytest.param(POINTING, "tool", spin(20.0), id="pointing, spinning target"),
    pytest.param(POINTING, "tool", turned_over, id="pointing, target turned over"),
    pytest.param((0.0, 0.0, 0.0, inf, 0.0, 0.0), "tool", spin(20.0, 0), id="x axis, spinning target"),
    pytest.param(POINTING, "base", spin(20.0), id="yaw of the base free"),
    pytest.param(POSITION, "tool", tumbling, id="position, tumbling target"),
    pytest.param((0.0, 0.0, inf, 0.0, 0.0, inf), "tool", spinning_and_sliding, id="drill that may slide"),
    pytest.param((0.0, 0.0, inf, 0.0, 0.0, inf), "base", spinning_and_sliding, id="height of the base free"),
    pytest.param((0.0, 0.02, 0.0, 0.1, 0.1, inf), "base", spin(20.0), id="bands beside a free yaw"),
]


def stream_of(loop: Loop, frame: str, free: Free, rate_hz: float = 50.0) -> Array:
    loop.follow(target_of(loop.pose(), frame, free), 0.5, rate_hz)
    assert loop.mode() is Mode.TRACKING
    return commands(loop)


@pytest.mark.parametrize(("tolerance", "frame", "free"), TASKS)
def test_streams_that_differ_in_what_is_free_give_the_same_commands(
    tolerance: tuple[float, ...], frame: str, free: Free
) -> None:
    still = stream_of(task_loop("ur5", tolerance, frame), frame, nothing)
    assert np.abs(still).max() > 0.1
    assert np.abs(stream_of(task_loop("ur5", tolerance, frame), frame, free) - still).max() < SAME


@pytest.mark.parametrize("law", ["twist_feedback", "ik_difference"])
@pytest.mark.parametrize("lag_s", [0.0, 0.02])
def test_the_laws_and_the_predictor_do_not_see_what_is_free(law: str, lag_s: float) -> None:
    runs = []
    for free in (nothing, spin(20.0)):
        loop = task_loop(
            "panda",
            POINTING,
            control_law=law,
            arm_lag_s=lag_s,
            method="obstacle_gradient",
            integral_gain=(1.0, 1.0),
        )
        runs.append(stream_of(loop, "tool", free))
    assert np.abs(runs[1] - runs[0]).max() < SAME


def test_the_whole_pose_is_followed_without_a_tolerance() -> None:
    """The same targets give other commands then."""
    still = stream_of(task_loop("ur5", (0.0,) * 6), "tool", nothing)
    assert np.abs(stream_of(task_loop("ur5", (0.0,) * 6), "tool", spin(1.0)) - still).max() > 0.1


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize(("tolerance", "frame", "free"), TASKS)
def test_paths_that_differ_in_what_is_free_give_the_same_commands(
    tolerance: tuple[float, ...], frame: str, free: Free, timed: bool
) -> None:
    runs = []
    for beside in (nothing, free):
        loop = task_loop("ur5", tolerance, frame)
        send_path(loop, target_of(loop.pose(), frame, beside), timed)
        loop.run(0.6)
        runs.append(commands(loop))
    assert np.abs(runs[0]).max() > 0.1
    assert np.abs(runs[1] - runs[0]).max() < SAME


SMOOTH = [case for case in TASKS if case.values[2] not in (turned_over, tumbling)]


@pytest.mark.parametrize(("tolerance", "frame", "free"), SMOOTH)
def test_trajectories_with_twists_that_differ_in_what_is_free_give_the_same_commands(
    tolerance: tuple[float, ...], frame: str, free: Free
) -> None:
    """The twists of the test are differences of poses, accurate to 1e-8 only."""
    runs = []
    for beside in (nothing, free):
        loop = task_loop("ur5", tolerance, frame)
        send_trajectory(loop, target_of(loop.pose(), frame, beside))
        loop.run(0.6)
        runs.append(commands(loop))
    assert np.abs(runs[0]).max() > 0.1
    assert np.abs(runs[1] - runs[0]).max() < 1e-5


@pytest.mark.parametrize("axes", ["tool0", "base_link"])
@pytest.mark.parametrize(
    ("tolerance", "frame", "free"),
    [
        (POINTING, "tool", (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)),
        (POINTING, "base", (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)),
        ((0.0, 0.0, inf, 0.0, 0.0, inf), "tool", (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)),
        (POSITION, "tool", (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)),
    ],
)
def test_jogging_that_differs_in_what_is_free_gives_the_same_commands(
    tolerance: tuple[float, ...], frame: str, free: tuple[float, ...], axes: str
) -> None:
    runs = []
    for rate in (0.0, 9.0):
        loop = task_loop("ur5", tolerance, frame)

        def twist(time_s: float, loop: Loop = loop, rate: float = rate) -> Array:
            """The free part in the axes of the present reference, which the step states."""
            wanted = np.array((0.1, -0.05, 0.02, 0.2, 0.1, 0.0))
            turn = np.eye(3) if axes == "base_link" else loop.steps[-1].pose_sd[:3, :3]
            beside = rate * np.reshape(free, (2, 3))
            if frame == "tool":
                beside = beside @ loop.steps[-1].pose_sd[:3, :3].T
            return np.asarray(wanted + (beside @ turn).ravel())

        jog(loop, 0.5, twist, axes)
        assert loop.mode() is Mode.TRACKING
        runs.append(commands(loop))
    assert np.abs(runs[0]).max() > 0.1
    assert np.abs(runs[1] - runs[0]).max() < SAME


def test_the_lead_of_jogging_does_not_count_what_is_free() -> None:
    """The null space turns the tool about its free axis by more than the lead limit; jogging goes on at full speed."""
    loop = task_loop(
        "ur5", POINTING, obstacles__posture=(0.0, -1.2, 1.6, -1.97, -1.57, 1.5), obstacles__posture_weight=2000.0
    )
    jog(loop, 2.0, lambda time_s: np.array((0.0, 0.05, 0.0, 0.0, 0.0, 0.0)), "base_link")
    last = loop.steps[-1]
    turned = Rotation.from_matrix(last.pose_sd[:3, :3].T @ last.pose_sb[:3, :3]).magnitude()
    assert turned > 0.4
    assert np.abs(last.error_b).max() < 1e-3
    assert last.pose_sb[1, 3] - loop.steps[0].pose_sb[1, 3] == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(("tolerance", "frame", "free"), TASKS)
def test_a_target_within_the_tolerance_moves_nothing(tolerance: tuple[float, ...], frame: str, free: Free) -> None:
    loop = task_loop("ur5", tolerance, frame)
    start = loop.pose()

    def target(time_s: float) -> Array:
        beside = free(time_s)
        moved: Array = start.copy()
        turn = Rotation.from_rotvec(beside[3:]).as_matrix()
        moved[:3, :3] = turn @ start[:3, :3] if frame == "base" else start[:3, :3] @ turn
        moved[:3, 3] += beside[:3] if frame == "base" else start[:3, :3] @ beside[:3]
        return moved

    loop.follow(target, 0.5, 50.0)
    assert np.abs(commands(loop)).max() < SAME
    assert max(float(np.abs(step.error_b).max()) for step in loop.steps[10:]) < 1e-9


@pytest.mark.parametrize(("tolerance", "frame", "free"), TASKS)
def test_the_error_of_a_step_is_zero_exactly_where_the_task_is_fulfilled(
    tolerance: tuple[float, ...], frame: str, free: Free
) -> None:
    """Linear and angular part of ``error_b`` have the lengths of what exceeds the tolerance."""
    loop = task_loop("ur5", tolerance, frame)
    stream_of(loop, frame, free)
    form, seen = TaskTolerance(tolerance, frame).form, 0
    for step in loop.steps[20:]:
        over = excess(task_deviation(form, step.pose_sb, step.pose_sd).components, form.half_widths)
        for half in (slice(0, 3), slice(3, 6)):
            assert np.linalg.norm(step.error_b[half]) == pytest.approx(np.linalg.norm(over[half]), abs=1e-12)
        seen += bool(np.abs(over).max() > 1e-7)
    assert seen > 50


def test_the_tool_settles_on_a_target_that_is_turned_over() -> None:
    """The pointing axis starts opposite to that of the target but for a degree."""
    loop = task_loop("panda", POINTING)
    start = loop.pose()
    goal = start.copy()
    goal[:3, :3] = start[:3, :3] @ Rotation.from_rotvec((0.6, 0.0, 0.0)).as_matrix()
    loop.follow(lambda time_s: goal, 2.0, 20.0)
    assert np.abs(loop.steps[-1].error_b).max() < 1e-4


def test_nothing_is_corrected_inside_a_band_and_nothing_chatters_at_its_border() -> None:
    """A target turns to and fro by 0.3 rad: the tool rests while it is inside, and else is at the border, without a
    change of direction more than the target's."""
    loop = task_loop("ur5", BAND)
    start = loop.pose()

    def target(time_s: float) -> Array:
        moved: Array = start.copy()
        moved[:3, :3] = start[:3, :3] @ Rotation.from_rotvec((0.3 * np.sin(time_s), 0.0, 0.0)).as_matrix()
        return moved

    loop.follow(target, 4.0, 100.0)
    form = TaskTolerance(BAND).form
    c = np.array([task_deviation(form, step.pose_sb, step.pose_sd).components[3] for step in loop.steps])
    moving = np.linalg.norm(commands(loop), axis=1) > 1e-4
    assert np.abs(c[300:]).max() < 0.2 + 1e-3
    assert np.abs(c[moving]).min() > 0.2 - 0.48 / 10.0, "from the border less than the target's speed over the gain"
    assert 0.05 < np.mean(~moving) < 0.9
    turns = commands(loop) @ commands(loop)[np.argmax(np.abs(commands(loop)).sum(axis=1))]
    turns = np.sign(turns[np.abs(turns) > 1e-4])
    assert np.count_nonzero(np.diff(turns)) <= 4
    binding = [name for step in loop.steps for name in step.binding]
    assert "band rx" in binding


def test_a_band_is_dragged_along_with_the_feed_forward_of_its_target() -> None:
    """A target at constant speed: after the border is reached, the tool is on it without a lag."""
    loop = task_loop("panda", (0.02, 0.0, 0.0, 0.0, 0.0, 0.0), "base")
    start = loop.pose()

    def target(time_s: float) -> Array:
        moved: Array = start.copy()
        moved[0, 3] -= 0.1 * time_s
        return moved

    loop.follow(target, 1.5, 100.0)
    behind = np.array([step.pose_sd[0, 3] - step.pose_sb[0, 3] for step in loop.steps])
    assert behind.min() > -0.0201
    assert behind[-1] == pytest.approx(-0.02, abs=1e-4)
    first = next(index for index, step in enumerate(loop.steps) if np.abs(step.joint_velocity).max() > 1e-3)
    assert behind[first] < 0.0


def changed(loop: Loop, tolerance: tuple[float, ...], frame: str = "tool") -> None:
    loop.settings = loop.settings.with_values({"task.tolerance": tolerance, "task.frame": frame})
    loop.controller.check(loop.settings)
    loop.controller.apply(loop.settings)


def test_a_change_at_run_time_does_not_jump() -> None:
    """While the target moves: the command changes within the acceleration limit, and the tool turns to the target
    within the bounds of the reference, also from a quarter turn away."""
    loop = task_loop("ur5", POINTING)
    start = loop.pose()

    def target(time_s: float) -> Array:
        moved: Array = start.copy()
        moved[:3, 3] += (0.0, 0.05 * np.sin(2.0 * time_s), 0.0)
        moved[:3, :3] = start[:3, :3] @ Rotation.from_rotvec((0.0, 0.0, 1.5)).as_matrix()
        return moved

    loop.follow(target, 0.5, 50.0)
    assert np.abs(loop.steps[-1].error_b).max() < 1e-3
    begun = len(loop.steps)
    for tolerance, frame in (((0.0,) * 6, "tool"), (BAND, "tool"), (POSITION, "base"), ((0.0,) * 6, "tool")):
        changed(loop, tolerance, frame)
        loop.follow(target, 1.5, 50.0)
        assert loop.mode() is Mode.TRACKING
        assert np.abs(loop.steps[-1].error_b).max() < 5e-3, tolerance
    steps = np.abs(np.diff(commands(loop)[begun - 1 :], axis=0))
    assert steps.max() <= 10.0 * 0.002 + 1e-9
    assert max(float(np.linalg.norm(step.error_b[3:])) for step in loop.steps[begun:]) < 0.3
    last = loop.steps[-1]
    assert Rotation.from_matrix(last.pose_sb[:3, :3].T @ target(0.0)[:3, :3]).magnitude() < 0.01


def test_a_single_target_is_turned_to_when_its_orientation_begins_to_matter() -> None:
    """The stream sent one pose, long ago, and the tool took any orientation."""
    loop = task_loop("ur5", POSITION)
    goal = loop.pose()
    goal[:3, :3] = goal[:3, :3] @ Rotation.from_rotvec((0.5, 0.3, 1.0)).as_matrix()
    loop.target(goal)
    loop.run(1.0)
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-6
    changed(loop, (0.0,) * 6)
    loop.run(3.0)
    assert np.abs(loop.pose() - goal).max() < 1e-3


def test_an_arm_without_a_target_stays_when_the_tolerance_changes() -> None:
    loop = task_loop("ur5", POSITION, obstacles__posture=(0.3,) * 6, obstacles__posture_weight=300.0)
    loop.run(1.0)
    turned = Rotation.from_matrix(loop.steps[-1].pose_sd[:3, :3].T @ loop.pose()[:3, :3]).magnitude()
    assert turned > 0.05
    here = loop.pose()
    changed(loop, (0.0,) * 6)
    loop.run(0.5)
    assert Rotation.from_matrix(here[:3, :3].T @ loop.pose()[:3, :3]).magnitude() < 0.05
    assert np.abs(loop.steps[-1].error_b).max() < 1e-4


def test_a_recording_with_changes_of_the_tolerance_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    """Also from a snapshot beside half a turn, where the direction of the swing is kept."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0, "task.tolerance": POINTING})
    start = loop.pose()
    over = start.copy()
    over[:3, :3] = start[:3, :3] @ Rotation.from_rotvec((np.pi - 1e-3, 0.0, 0.0)).as_matrix()
    loop.follow(target_of(start, "tool", spin(20.0)), 1.5, 50.0)
    loop.follow(lambda time_s: over, 0.5, 50.0)
    loop.settings = loop.settings.with_values({"task.tolerance": BAND, "task.frame": "base"})
    loop.controller.apply(loop.settings, loop.now)  # type: ignore[call-arg]
    loop.follow(target_of(start, "tool", nothing), 1.0, 50.0)
    finish(loop)
    result = replay(RecordingSource(str(tmp_path / "bag")))
    assert result.identical, result.first
    assert result.steps == len(loop.steps)


def test_a_loop_that_is_restored_continues_bit_for_bit() -> None:
    loop = task_loop("panda", (0.0, 0.0, 0.0, 0.0, 0.1, inf))
    pose = target_of(loop.pose(), "tool", spin(20.0))
    loop.follow(pose, 0.3, 50.0)
    other = task_loop("panda", (0.0, 0.0, 0.0, 0.0, 0.1, inf))
    other.controller.restore(loop.controller.capture())
    other.time_ns, other.arm = loop.time_ns, loop.arm
    sample = pose(0.4)
    for one in (loop, other):
        one.target(sample)
    loop.tick()
    step = loop.steps[-1]
    other.tick()
    assert other.steps[-1].joint_velocity.tobytes() == step.joint_velocity.tobytes()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"task.tolerance": (0.0, 0.0, -0.1, 0.0, 0.0, 0.0)}, r"^task.tolerance\[2\] is -0.1; valid: 0 to inf"),
        ({"task.tolerance": (0.0, 0.0, float("nan"), 0.0, 0.0, 0.0)}, r"^task.tolerance is .*nan.*; valid: numbers$"),
        ({"task.tolerance": (0.0, 0.0)}, r"^task.tolerance has 2 elements; valid: a list of 6 doubles"),
        ({"task.tolerance": (inf,) * 6}, r"^task.tolerance leaves all six components free"),
        ({"task.tolerance": (inf, inf, inf, 3.2, 4.0, inf)}, r"^task.tolerance leaves all six components free"),
        ({"task.tolerance": ("x",) * 6}, r"^task.tolerance is .*; valid: a list of 6 doubles"),
        ({"task.frame": "world"}, r"^task.frame is 'world'; valid: tool, base$"),
        ({"gain": (inf, 1.0)}, r"^gain is .*; valid: finite numbers$"),
    ],
)
def test_a_tolerance_that_is_not_defined_is_refused_in_one_line(values: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message) as refused:
        Settings().with_values(values)
    assert "\n" not in str(refused.value)


def test_a_parameter_file_states_a_free_component_by_inf(tmp_path: Path) -> None:
    file = tmp_path / "task.yaml"
    file.write_text(
        "/**:\n  ik_node:\n    ros__parameters:\n      task:\n"
        "        tolerance: [0.0, 0.0, 0.0, 0.0, 0.0, .inf]\n        frame: base\n"
    )
    task = read_settings(file).task
    assert task.tolerance == POINTING
    assert task.frame == "base"


def test_a_rotation_of_half_a_turn_or_more_is_free() -> None:
    loop = task_loop("ur5", (0.0, 0.0, 0.0, 0.0, 0.0, 3.2))
    start = loop.pose()
    goal = start.copy()
    goal[:3, :3] = start[:3, :3] @ Rotation.from_rotvec((0.0, 0.0, 2.0)).as_matrix()
    loop.follow(lambda time_s: goal, 0.3, 50.0)
    assert np.abs(commands(loop)).max() < SAME


def test_bands_alone_are_a_task() -> None:
    """No component is exact: the arm moves only as far as the bands require."""
    loop = task_loop("ur5", (0.02, 0.02, 0.02, 0.1, 0.1, 0.1), target__max_acceleration=(0.5, 5.0))
    start = loop.pose()
    goal = start.copy()
    goal[:3, 3] += (0.05, 0.0, 0.0)
    loop.follow(lambda time_s: goal, 2.0, 50.0)
    assert np.abs(loop.steps[-1].error_b).max() < 1e-4
    moved = loop.pose()[:3, 3] - start[:3, 3]
    assert 0.0299 < moved[0] < 0.033
    assert np.linalg.norm(moved) < 0.04
    assert np.isnan(loop.steps[-1].singular_values).all()


def clearance_beside_a_ball(tolerance: tuple[float, ...]) -> float:
    """Clearance of a UR5 that holds a torch at 45 deg, beside a ball at its forearm, m."""
    half = float(np.sin(np.pi / 8)), float(np.cos(np.pi / 8))
    values = {
        "robot": "ur5",
        "tool_offset": (0.1, 0.0, 0.1, 0.0, half[0], 0.0, half[1]),
        "task.tolerance": tolerance,
        "method": "obstacle_gradient",
        "obstacles.self_collision": False,
    }
    settings = Settings().with_values(values)
    robot = robot_from_settings(settings.arm)
    loop = Loop(robot, READY["ur5"], settings)
    loop.run(0.02)
    start = loop.pose()
    ball = ObstacleSample(
        0, robot.base_frame, "ball", "add", "sphere", (0.05,), np.array((0.3, 0.1, 0.3)), np.array((0, 0, 0, 1.0)), 0
    )
    loop.controller.on_obstacles((ball,), loop.now)
    loop.follow(lambda time_s: start, 2.5, 20.0)
    assert np.abs(loop.steps[-1].error_b).max() < 1e-6
    assert np.linalg.norm(loop.pose()[:3, 3] - start[:3, 3]) < 1e-6
    assert ("no null space" in loop.controller.status.reason) == (tolerance == (0.0,) * 6)
    return loop.steps[-1].clearance


def test_an_obstacle_pushes_a_pointing_ur5_in_its_null_space() -> None:
    """The whole pose leaves it none; pointing gains clearance while the tool point and its axis stay."""
    held, pointing = clearance_beside_a_ball((0.0,) * 6), clearance_beside_a_ball(POINTING)
    print(f"clearance {1e3 * held:.1f} mm with the whole pose, {1e3 * pointing:.1f} mm pointing")
    assert pointing > held + 0.01
