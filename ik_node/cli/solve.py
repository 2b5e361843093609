"""Solve inverse kinematics for one pose and print every iteration."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError, InputError

if TYPE_CHECKING:
    from ik_node.inverse_kinematics.newton_raphson import PoseSolution
    from ik_node.math.task_tolerance import TaskTolerance
    from ik_node.math.types import Array
    from ik_node.robot.robot import Robot
    from ik_node.robot.screw_chain import ScrewChain

FORMS = ("body", "space")
FRAMES = ("tool", "base")
EXAMPLES = ("2r", "plateau")
EPILOG = """\
examples:
  ik_solve --example 2r                                  Example 6.1 of the notes
  ik_solve --example plateau --plot plateau.png          the scalar equation of Fig. 6.7
  ik_solve --robot panda --target "0.4 0.1 0.5 1 0 0 0"  damped search with restarts, within the joint limits
  ik_solve --robot ur5 --target "-0.5 0.1 0.1 0.5 0.5 -0.5 0.5" --seed 2.6 0.6 -1.7 1.1 -0.6 -1.6 --restarts 0
                                                         pure Newton-Raphson from the seed
  ik_solve --robot ur5 --target "0.4 0.2 0.4 1 0 0 0" --tolerance 0 0 0 0 0 inf
                                                         position and direction of the tool axis; it may spin
  ik_solve --robot panda --target "0.4 0.1 0.5 1 0 0 0" --seed 0 -0.8 0 -2.4 0 1.6 0.8 --lock panda_joint3
                                                         with one joint at the seed's position
  ik_solve --robot so101 --target "0.25 0.1 0.1 0 0.8660254 0 0.5" --tolerance 0 0 0 0 0 inf --frame base
                                                         five joints: the yaw about the vertical is free
exit code: 0 converged, 1 not converged, 2 invalid arguments
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_solve", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    problem = result.add_argument_group("problem")
    problem.add_argument("--robot", help="name in example-robot-data")
    problem.add_argument("--urdf", type=Path, help="URDF file, instead of --robot")
    problem.add_argument("--base", default="", help="frame {s} of the target [the robot's usual base]")
    problem.add_argument("--tip", default="", help="tool frame {b} [the robot's usual tool]")
    problem.add_argument("--target", metavar='"X Y Z QX QY QZ QW"', help="pose of the tip in the base, m")
    problem.add_argument("--example", choices=EXAMPLES, help="a worked example of docs/notes.md instead of a robot")
    problem.add_argument(
        "--tolerance",
        nargs="+",
        metavar="T",
        help="half-widths x y z rx ry rz about the target, m and rad: 0 is exact, inf free [0 0 0 0 0 0]",
    )
    problem.add_argument("--frame", choices=FRAMES, help="axes of --tolerance: those of the target or of --base [tool]")
    method = result.add_argument_group("method")
    method.add_argument("--seed", nargs="+", metavar="Q", help="joint positions to start from [middle of the range]")
    method.add_argument(
        "--restarts", type=int, help="further starts at most; 0: pure Newton-Raphson, no limits in the steps [many]"
    )
    method.add_argument("--form", choices=FORMS, default="body", help="frame of twist and Jacobian, with --restarts 0")
    method.add_argument("--eps-omega", type=float, help="accuracy of the rotation, rad [1e-6; --example 2r: 1e-3]")
    method.add_argument("--eps-v", type=float, help="accuracy of the position, m [1e-6; --example 2r: 1e-4]")
    method.add_argument("--max-iterations", type=int, help="cap on all iterations together [3000; pure: 100]")
    method.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints that stay where --seed has them")
    output = result.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print JSON instead of the table")
    output.add_argument(
        "--digits", type=int, choices=range(1, 16), metavar="N", help="decimals of the table [4; --example 2r: 3]"
    )
    output.add_argument("--plot", type=Path, metavar="FILE", help="picture of the iterates and the screw axis")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Solve and print; return 0 when the search converged, 1 when not, 2 for invalid arguments."""
    given = sys.argv[1:] if arguments is None else arguments
    options = parser().parse_args([_shield(argument) for argument in given])
    try:
        if options.example is not None and (options.tolerance is not None or options.frame is not None):
            raise InputError("--tolerance and --frame need a robot; --example has neither")
        if options.example is not None and options.lock:
            raise InputError("--lock needs a robot; --example has none")
        if options.example == "plateau":
            return _plateau(options)
        if options.example == "2r":
            return _example_2r(options)
        return _robot(options)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _shield(argument: str) -> str:
    """Put a blank before numbers such as -1e-3, which argparse would read as an option."""
    try:
        float(argument)
    except ValueError:
        return argument
    return f" {argument}" if argument.startswith("-") else argument


def _numbers(text: str | Sequence[str], name: str) -> list[float]:
    words = (text if isinstance(text, str) else " ".join(text)).replace(",", " ").split()
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{name} is '{' '.join(words)}'; expected numbers") from error


def _target(text: str | None) -> Array:
    from ik_node.math import se3

    if text is None:
        raise InputError('--target is missing; expected "x y z qx qy qz qw"')
    numbers = _numbers(text, "--target")
    if len(numbers) != 7:
        raise InputError(f"--target has {len(numbers)} numbers; expected 7: x y z qx qy qz qw")
    return se3.pose_from(numbers[:3], numbers[3:], "--target")


def _task_tolerance(options: argparse.Namespace) -> TaskTolerance:
    from ik_node.math.task_tolerance import TaskTolerance

    if options.tolerance is None:
        if options.frame is not None:
            raise InputError("--frame has no effect without --tolerance")
        return TaskTolerance()
    if options.restarts == 0:
        raise InputError("--tolerance cannot be used with --restarts 0, which is Newton-Raphson on the whole pose")
    return TaskTolerance(_numbers(options.tolerance, "--tolerance"), options.frame or "tool")


def _load(options: argparse.Namespace) -> Robot:
    from ik_node.robot import catalogue
    from ik_node.robot.robot import Robot

    if options.urdf is not None:
        if options.robot is not None:
            raise InputError("--robot and --urdf exclude each other; expected one of them")
        return Robot(catalogue.read_file(options.urdf), options.base, options.tip)
    if options.robot is None:
        raise InputError(f"--robot is missing; or give --urdf, or --example {' or '.join(EXAMPLES)}")
    arm = catalogue.find(options.robot)
    return Robot(catalogue.read_urdf(arm), options.base or arm.base_frame, options.tip or arm.tip_frame)


def _robot(options: argparse.Namespace) -> int:
    from ik_node.inverse_kinematics.newton_raphson import solve_pose_newton
    from ik_node.inverse_kinematics.pose_solver import PoseSolver
    from ik_node.math.numerics import checked_vector
    from ik_node.robot.locked_chain import free_joints
    from ik_node.robot.task_rank import task_rank

    tolerance = _task_tolerance(options)
    robot = _load(options)
    for fault in robot.limit_faults:
        print(f"warning: {fault.text}; taken as none", file=sys.stderr)
    if options.urdf is not None and not options.tip:
        print(f"warning: --tip is missing: {robot.default_tip_text}", file=sys.stderr)
    pose_sd = _target(options.target)
    seed = None if options.seed is None else checked_vector(_numbers(options.seed, "--seed"), robot.n, "--seed")
    eps_omega, eps_v = _accuracies(options, 1e-6, 1e-6)
    pure = options.restarts == 0
    if options.lock and (pure or seed is None):
        raise InputError("--lock needs --seed, and cannot be used with --restarts 0")
    solver = PoseSolver(
        robot, eps_omega=eps_omega, eps_v=eps_v, max_iterations=_given(options.max_iterations, 100 if pure else 3000),
        tolerance=tolerance, locked=options.lock,
    )  # fmt: skip
    if pure:
        start = solver.start(0) if seed is None else seed
        solution = solve_pose_newton(
            robot, pose_sd, start, eps_omega=eps_omega, eps_v=eps_v, form=options.form,
            max_iterations=solver.max_iterations,
        )  # fmt: skip
    else:
        solution = solver.solve(pose_sd, seed, restarts=options.restarts)
    about: dict[str, Any] = {
        "robot": options.robot or robot.name,
        "base_frame": robot.base_frame,
        "tip_frame": robot.tip_frame,
        "joints": list(robot.joints),
    }
    title = f"{about['robot']}: {robot.tip_frame} seen from {robot.base_frame}, {'pure' if pure else 'damped'} steps"
    about["twist_frame"] = options.form if pure else "body" if tolerance.is_exact else tolerance.frame
    if options.tolerance is not None:
        title += f", tolerance {tolerance.text()} in the frame {tolerance.frame}"
        about["tolerance"] = [
            None if free else width for width, free in zip(tolerance.half_widths, tolerance.free, strict=True)
        ]
        about["frame"] = tolerance.frame
    if options.lock:
        title += f", locked: {', '.join(options.lock)}"
        about["locked"] = options.lock
    if not solution.converged:
        free = free_joints(robot.joints, options.lock) if options.lock else None
        hint = task_rank(robot, tolerance, free=free).text(tolerance)
        if hint:
            print(f"hint: {hint}", file=sys.stderr)
    return _finish(options, title, about, robot, pose_sd, solution)


def _example_2r(options: argparse.Namespace) -> int:
    from ik_node.inverse_kinematics.newton_raphson import solve_pose_newton
    from ik_node.inverse_kinematics.worked_examples import planar_2r
    from ik_node.math.numerics import checked_vector

    example = planar_2r()
    start = example.start
    if options.seed is not None:
        start = checked_vector(_numbers(options.seed, "--seed"), 2, "--seed")
    eps_omega, eps_v = _accuracies(options, 1e-3, 1e-4)
    solution = solve_pose_newton(
        example.chain, example.pose_sd, start, eps_omega=eps_omega, eps_v=eps_v, form=options.form,
        max_iterations=_given(options.max_iterations, 100),
    )  # fmt: skip
    title = "Example 6.1: planar 2R arm, links of 1 m"
    return _finish(
        options, title, {"example": "2r", "twist_frame": options.form}, example.chain, example.pose_sd, solution
    )


def _finish(
    options: argparse.Namespace,
    title: str,
    about: dict[str, Any],
    chain: Robot | ScrewChain,
    pose_sd: Array,
    solution: PoseSolution,
) -> int:
    from ik_node.inverse_kinematics.iteration_table import outcome_text, pose_document, pose_table, pose_target_document
    from ik_node.robot.screw_chain import ScrewChain

    if options.json:
        document = about | {"target": pose_target_document(pose_sd)} | pose_document(solution)
        print(json.dumps(document, indent=1))
    else:
        print(title)
        planar = options.example == "2r"
        digits = _given(options.digits, 3 if planar else 4)
        revolute = chain.turning if isinstance(chain, ScrewChain) else chain.revolute
        partial = options.tolerance is not None
        print(pose_table(solution, revolute.tolist(), planar=planar, digits=digits, partial=partial))
        counts = _count(solution.iterations, "iteration", "iterations")
        if solution.searches > 1:
            counts += f" in {solution.searches} searches"
        print(f"{outcome_text(solution.converged, solution.reason)}; {counts}")
        print("q = " + " ".join(f"{value:.{max(9, digits)}g}" for value in solution.q))
    if options.plot is not None:
        from ik_node.inverse_kinematics.iteration_figure import draw_pose_iterations

        draw_pose_iterations(options.plot, title, chain, pose_sd, solution)
        print(f"wrote {options.plot}", file=sys.stderr)
    return 0 if solution.converged else 1


def _plateau(options: argparse.Namespace) -> int:
    from ik_node.inverse_kinematics.iteration_table import outcome_text, root_document, root_table
    from ik_node.inverse_kinematics.worked_examples import PLATEAU_ROOTS, PLATEAU_STARTS, plateau

    starts = PLATEAU_STARTS if options.seed is None else tuple(_numbers(options.seed, "--seed"))
    tolerance = _given(options.eps_v, 1e-10)
    runs = [plateau(start, tolerance=tolerance, max_iterations=_given(options.max_iterations, 50)) for start in starts]
    if options.json:
        entries = [{"start": start} | root_document(run) for start, run in zip(starts, runs, strict=True)]
        print(json.dumps({"example": "plateau", "roots": list(PLATEAU_ROOTS), "runs": entries}, indent=1))
    else:
        print("x_d - f(theta) = 1 / (1 + (theta - 2)^4) - 1/2: roots 1 and 3, plateau at 2")
        for start, run in zip(starts, runs, strict=True):
            print(f"\nfrom theta^0 = {start:g}: {outcome_text(run.converged, run.reason)}")
            print(root_table(run))
    if options.plot is not None:
        from ik_node.inverse_kinematics.iteration_figure import draw_plateau

        draw_plateau(options.plot, starts, runs)
        print(f"wrote {options.plot}", file=sys.stderr)
    return 0


def _count(number: int, singular: str, plural: str) -> str:
    return f"{number} {singular if number == 1 else plural}"


def _accuracies(options: argparse.Namespace, eps_omega: float, eps_v: float) -> tuple[float, float]:
    return _given(options.eps_omega, eps_omega), _given(options.eps_v, eps_v)


def _given(value: Any, default: Any) -> Any:
    return default if value is None else value


if __name__ == "__main__":
    sys.exit(main())
