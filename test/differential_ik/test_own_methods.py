"""Own methods: loaded by import path, entry point or as a callable; checked at the start; a fault never touches the
task.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import own_method_samples as samples
import pytest
from independent_kinematics import Kinematics
from loop import READY, Loop, make_robot
from random_states import cases

from ik_node.control.controller import Controller
from ik_node.control.warm_up import warm_up
from ik_node.differential_ik.own_methods import load_methods, source_digest
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.differential_ik.task_rows import ToleranceRows
from ik_node.errors import SettingsError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Level
from ik_node.math import se3
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

GRAVITY = "own_method_samples:gravity"


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def settings(method: str, *extra: str, **values: Any) -> Settings:
    return Settings().with_values({"method": method, "extra_methods": extra, **values})


def followed(loop: Loop, duration_s: float = 1.0) -> Loop:
    loop.run(0.05)
    loop.follow(figure_of_eight(loop.pose()).pose, duration_s, 100.0)
    return loop


def commands(loop: Loop) -> Array:
    return np.array([step.joint_velocity for step in loop.steps])


# --- the cost of a function is used as that of a built-in method ---


def test_the_function_of_a_built_in_method_gives_its_commands_bit_for_bit(panda: Robot) -> None:
    own = followed(Loop(panda, READY["panda"], settings(GRAVITY)))
    built_in = followed(Loop(panda, READY["panda"], settings("gravity_gradient")))
    assert commands(own).tobytes() == commands(built_in).tobytes()
    assert own.controller.status.level is Level.OK
    assert own.controller.settings.control.extra_methods == (GRAVITY,)


def test_a_callable_of_the_library_is_used_by_its_name(panda: Robot) -> None:
    controller = Controller(panda, settings("mine", "mine"), {"mine": samples.gravity})
    assert controller.method.own["mine"].function is samples.gravity
    loop = Loop(panda, READY["panda"])
    loop.controller = controller
    found = commands(followed(loop))
    assert found.tobytes() == commands(followed(Loop(panda, READY["panda"], settings(GRAVITY)))).tobytes()


def test_an_entry_point_is_used_by_its_name(panda: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "of_a_user-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: of-a-user\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[ik_node.methods]\ndownhill = own_method_samples:gravity\n")
    with pytest.raises(SettingsError, match="method is 'downhill'; valid: plain, "):
        settings("downhill")
    with pytest.raises(SettingsError, match=r"'downhill' is no entry point of the group ik_node.methods; valid: none"):
        Controller(panda, settings("plain", "downhill"))
    monkeypatch.syspath_prepend(str(tmp_path))
    controller = Controller(panda, settings("downhill"))
    assert controller.method.own["downhill"].function is samples.gravity
    assert controller.settings.control.extra_methods == ("downhill",)


def test_the_digest_is_that_of_the_file(panda: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "of_a_user.py").write_text("def cost(robot, q):\n    return None, q\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    first = load_methods(panda, settings("of_a_user:cost").control)["of_a_user:cost"].digest
    assert len(first) == 16
    (tmp_path / "of_a_user.py").write_text("def cost(robot, q):\n    return None, q + 1\n")
    assert load_methods(panda, settings("of_a_user:cost").control)["of_a_user:cost"].digest != first
    assert source_digest(eval("lambda robot, q: (None, q)", {})) != ""


def test_a_function_cannot_change_what_the_controller_uses(panda: Robot) -> None:
    """It has a copy of q and a robot with data of its own."""
    loop = followed(Loop(panda, READY["panda"], settings("own_method_samples:centre")))
    assert loop.controller.status.level is Level.OK
    assert np.linalg.norm(loop.steps[-1].error_b[:3]) < 1e-6


def test_the_warm_up_runs_with_an_own_method(panda: Robot) -> None:
    warm_up(panda, settings(GRAVITY))


# --- bad input ---


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_module:f", r"cannot be imported: No module named 'no_such_module'"),
        ("own_method_samples:no_such_name", r"cannot be imported: module 'own_method_samples' has no attribute"),
        ("own_method_samples:NUMBER", r"is a int; expected a function of \(robot, q\)"),
        ("own_method_samples:one_argument", r"does not take \(robot, q\): too many positional arguments"),
        ("own_method_samples:raises", r"raised ZeroDivisionError: nothing to divide by"),
        ("own_method_samples:ends_the_process", r"raised SystemExit: 3"),
        ("own_method_samples:nothing", r"returned NoneType; expected W, grad_h and optionally h"),
        ("own_method_samples:one_value", r"returned tuple of 1; expected W, grad_h and optionally h"),
        ("own_method_samples:wrong_weight", r"W has the shape \(6, 6\); expected \(7, 7\)"),
        ("own_method_samples:wrong_gradient", r"grad_h has the shape \(8,\); expected \(7,\)"),
        ("own_method_samples:text_gradient", r"grad_h is str of 5; expected numbers \(7,\)"),
        ("own_method_samples:not_symmetric", r"W is not symmetric"),
        ("own_method_samples:indefinite", r"W is not positive definite \(joint 'panda_joint\d'\)"),
        ("own_method_samples:negative", r"W is not positive definite \(joint 'panda_joint\d'\)"),
        ("own_method_samples:singular", r"W is not positive definite \(joint 'panda_joint\d'\)"),
        ("own_method_samples:vast", r"the diagonal of W is \[1e\+12, .*valid: 1e-09 to 1e\+09"),
        ("own_method_samples:steep", r"grad_h is \[1e\+300, .*valid: up to 1e\+09"),
        ("own_method_samples:not_finite", r"grad_h is not finite"),
        ("own_method_samples:infinite_weight", r"W is not finite"),
        ("own_method_samples:other_gradient", r"not that of its h at .* for joint 'panda_joint3', differences of h"),
        ("own_method_samples:potential_alone", r"gradient is not that of its h"),
        ("own_method_samples:vector_potential", r"h has the shape \(7,\); expected \(\)"),
    ],
)
def test_a_method_that_cannot_be_used_is_refused_at_the_start_in_one_line(panda: Robot, name: str, words: str) -> None:
    for one in (settings(name), settings("plain", name)):
        with pytest.raises(SettingsError, match=f"method '{name}'.*{words}") as error:
            Controller(panda, one)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("method", "extra", "words"),
    [
        ("plian", (), r"method is 'plian'; valid: plain, .*joint_weighted, package.module:name, an entry point"),
        ("no module:f", (), r"method is 'no module:f'; valid: plain"),
        ("a:b:c", (), r"method is 'a:b:c'; valid: plain"),
        ("", (), r"method is ''; valid: plain"),
        ("plain", ("plain",), r"extra_methods has 'plain', which is built in; valid: package.module:name"),
        ("plain", ("",), r"extra_methods has '', which is no name; valid: package.module:name"),
    ],
)
def test_names_that_cannot_be_methods_are_refused_by_the_settings(
    method: str, extra: tuple[str, ...], words: str
) -> None:
    with pytest.raises(SettingsError, match=words):
        settings(method, *extra)


def test_a_module_that_fails_is_refused(panda: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_module_of_a_user.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(SettingsError, match="cannot be imported: ZeroDivisionError: division by zero"):
        Controller(panda, settings("broken_module_of_a_user:f"))


def test_only_what_was_loaded_at_the_start_can_be_chosen(panda: Robot) -> None:
    loop = followed(Loop(panda, READY["panda"], settings("plain", GRAVITY)), 0.2)
    other = loop.controller.settings.with_values({"method": "own_method_samples:centre"})
    for change in (loop.controller.check, loop.controller.apply):
        with pytest.raises(
            SettingsError, match=r"was not loaded at the start .*valid: plain, .*own_method_samples:grav"
        ):
            change(other)
    assert loop.controller.settings.control.method == "plain"
    loop.controller.apply(loop.controller.settings.with_values({"method": GRAVITY}))
    loop.run(0.1)
    assert loop.controller.status.level is Level.OK


# --- faults while the arm moves ---


def failing(function: Callable[[Robot, Array], Any], after: float) -> Callable[[Robot, Array], Any]:
    """``gravity`` up to a position of the first joint, then another function: a function of q alone."""

    def cost(robot: Robot, q: Array) -> Any:
        return function(robot, q) if after < q[0] < 0.5 else samples.gravity(robot, q)

    return cost


FAULTS = {
    "raises": "raised ZeroDivisionError: nothing to divide by",
    "ends_the_process": "raised SystemExit: 3",
    "nothing": "returned NoneType",
    "wrong_weight": r"W has the shape \(6, 6\)",
    "not_symmetric": "not symmetric",
    "indefinite": "not positive definite",
    "negative": "not positive definite",
    "vast": "the diagonal of W",
    "steep": "grad_h is",
    "not_finite": "grad_h is not finite",
    "infinite_weight": "W is not finite",
}


class Faulty(Loop):
    """A Panda whose method fails when the first joint has passed a position, on a path along y."""

    def __init__(self, robot: Robot, function: Callable[[Robot, Array], Any] | None) -> None:
        values = {"obstacles.self_collision": False}
        super().__init__(robot, READY["panda"], settings("plain", **values))
        if function is not None:
            cost = failing(function, 0.05)
            own = settings("mine", "mine", **values)
            # Loaded by itself: at the checked positions it would fail.
            methods = load_methods(robot, own.control, {"mine": samples.gravity})
            methods["mine"] = methods["mine"]._replace(function=cost)
            self.controller = Controller(robot, own, methods)

    def along(self, duration_s: float) -> None:
        start = self.pose()
        begin_ns = self.time_ns
        for _ in range(round(duration_s * 50)):
            goal = start.copy()
            goal[1, 3] += 0.06 * (1.0 - np.cos(2.0 * (self.time_ns - begin_ns) / NS))
            self.target(goal)
            self.run(0.02)


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_never_touches_the_task(panda: Robot, name: str) -> None:
    loop = Faulty(panda, getattr(samples, name))
    loop.run(0.05)
    loop.along(1.5)
    assert loop.controller.method.fault
    reason = loop.controller.status.reason
    assert "method 'mine'" in reason
    assert reason.count("continued with plain") == 1
    assert loop.controller.status.level is Level.WARN
    assert re.search(FAULTS[name], loop.controller.method.fault)
    errors = [np.linalg.norm(step.error_b[:3]) for step in loop.steps[100:]]
    assert max(errors) < 1e-4, "as with plain"
    assert min(step.scale for step in loop.steps[100:]) == 1.0
    rates = np.abs(np.diff(commands(loop), axis=0)).max() * 500.0
    assert rates <= 10.0 * (1.0 + 1e-6), "the acceleration limit"


def test_after_a_fault_the_commands_are_those_of_plain(panda: Robot) -> None:
    """From the same state; and reset, or another choice of the method, uses the function again."""
    loop = Faulty(panda, samples.raises)
    loop.run(0.05)
    loop.along(1.5)
    plain = Controller(panda, loop.controller.settings.with_values({"method": "plain"}), loop.controller.method.own)
    plain.restore(loop.controller.capture())
    before = len(loop.steps)
    state = loop.arm.measure(loop.time_ns + loop.period_ns)
    assert state is not None
    loop.time_ns += loop.period_ns
    sample = JointSample(loop.now.ros_ns, panda.joints, state)
    one, two = loop.take(loop.controller.on_joint_state(sample, loop.now)), plain.on_joint_state(sample, loop.now)
    assert one is not None
    assert two is not None
    assert one.joint_velocity.tobytes() == two.joint_velocity.tobytes()
    assert len(loop.steps) == before + 1
    loop.controller.apply(loop.controller.settings.with_values({"gain": (9.0, 9.0)}))
    assert loop.controller.method.fault, "another parameter does not clear it"
    loop.controller.apply(loop.controller.settings.with_values({"method": "plain"}))
    loop.controller.apply(loop.controller.settings.with_values({"method": "mine"}))
    assert not loop.controller.method.fault
    loop.controller.method.fail("too slow")
    loop.run(0.1)
    assert "too slow; continued with plain" in loop.controller.status.reason
    loop.controller.reset()
    assert not loop.controller.method.fault


def any_cost(robot: Robot, q: Array) -> Any:
    """A valid cost that depends on q: W with condition numbers up to 1e16, gradients up to 1e8."""
    rng = np.random.default_rng(crc32(q.tobytes()))
    n = robot.n
    directions = np.linalg.qr(rng.normal(size=(n, n)))[0]
    weight = (directions * 10.0 ** rng.uniform(-rng.choice([0.0, 8.0]), 0.0, n)) @ directions.T
    size = np.sqrt(10.0 ** rng.uniform(-6.0, 3.0, n) / np.diagonal(weight))
    weight *= np.outer(size, size)
    return 0.5 * (weight + weight.T), rng.normal(size=n) * 10.0 ** rng.uniform(-3.0, 8.0)


@pytest.mark.parametrize("widths", [(0.0,) * 6, (0.0, 0.0, 0.0, 0.0, 0.0, inf), (0.0, 0.0, 0.0, inf, inf, inf)])
@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_whatever_the_cost_is_the_task_is_executed_as_with_plain(name: str, widths: tuple[float, ...]) -> None:
    """Random states beside limits and singularities: the same s, and no more motion off the direction."""
    robot, task, rng = make_robot(name), TaskTolerance(widths), np.random.default_rng(0)
    kinematics = Kinematics(robot)
    values = {"obstacles.self_collision": False, "gradient_gain": 1.0}
    solver = DifferentialIkSolver(robot, settings("mine", "mine", **values), {"mine": any_cost})
    source = cases(robot, kinematics, solver, rng)
    case, others = next(source), 0
    for _ in range(200):
        target = np.ascontiguousarray(robot.pose(case.state.q_middle) @ se3.exp(rng.normal(size=6) * 0.05))
        rows = None
        if not task.is_exact:
            rows = ToleranceRows(robot, np.repeat((1.0, 0.3), 3), task.form)
            rows.aim(Motion(target, np.zeros(6)))
        before = solver.capture()
        solver.method.fail("replaced by plain")
        plain = solver.solve_twist(case.state, case.twist, rows)
        solver.restore(before)
        own = solver.solve_twist(case.state, case.twist, rows)
        assert not solver.method.fault
        assert own.task_scale >= plain.task_scale - 1e-9
        off, plain_off = (np.abs(solution.off_direction_b).max() for solution in (own, plain))
        assert off < plain_off + 1e-9
        others += bool(np.abs(own.joint_velocity - plain.joint_velocity).max() > 1e-6)
        case = source.send(own.joint_velocity)
    assert others > 5 or robot.n == np.count_nonzero(task.exact)


def test_a_snapshot_has_the_fault(panda: Robot) -> None:
    loop = Faulty(panda, samples.raises)
    loop.run(0.05)
    loop.along(1.5)
    other = Controller(panda, loop.controller.settings, loop.controller.method.own)
    other.restore(loop.controller.capture())
    assert other.method.fault == loop.controller.method.fault != ""


def test_a_built_in_method_has_no_fault(panda: Robot) -> None:
    controller = Controller(panda, settings("plain"))
    controller.method.fail("too slow")
    assert not controller.method.note
