"""Differential inverse kinematics of robot arms: velocity control with limits, singularities, obstacles, recordings.

The package is a ROS 2 node and a library. The library in five lines::

    import ik_node

    robot = ik_node.load_robot("panda")
    solution = ik_node.solve_pose(robot, pose_sd)
    kinematics = robot.evaluate(solution.q)
    resolution = ik_node.resolve(kinematics.jacobian_b, twist_b)

Conventions: SI units; joint vectors in the order of ``robot.joints``; poses are homogeneous matrices ``T_sb`` of frame
{b} (tool) seen from frame {s} (base); twists and Jacobian rows have their linear part first; quaternions are x y z w.

Importing the package loads none of its modules: each name below is imported when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ik_node.control.controller import Controller
    from ik_node.differential_ik.closed_form import resolve
    from ik_node.differential_ik.constrained import solve
    from ik_node.differential_ik.methods import METHODS
    from ik_node.errors import (
        CollisionUnavailableError,
        IkNodeError,
        InputError,
        MethodFault,
        MissingPackageError,
        PackagesError,
        RecordingError,
        RobotError,
        SceneError,
        SettingsError,
        StateRefused,
        TargetRefused,
        TrajectoryFileError,
        UnknownNameError,
    )
    from ik_node.interfaces.clock import Instant
    from ik_node.interfaces.samples import JointSample, PoseSample
    from ik_node.interfaces.step import Step
    from ik_node.inverse_kinematics.pose_solver import solve_pose
    from ik_node.math.task_tolerance import TaskTolerance
    from ik_node.recording.run_reader import load_run
    from ik_node.robot.catalogue import load_robot
    from ik_node.robot.robot import Robot
    from ik_node.robot.simulated_arm import SimulatedArm
    from ik_node.robot.task_rank import task_rank
    from ik_node.settings.groups import Settings

__version__ = "0.2.0"
__all__ = [
    "METHODS",
    "CollisionUnavailableError",
    "Controller",
    "IkNodeError",
    "InputError",
    "Instant",
    "JointSample",
    "MethodFault",
    "MissingPackageError",
    "PackagesError",
    "PoseSample",
    "RecordingError",
    "Robot",
    "RobotError",
    "SceneError",
    "Settings",
    "SettingsError",
    "SimulatedArm",
    "StateRefused",
    "Step",
    "TargetRefused",
    "TaskTolerance",
    "TrajectoryFileError",
    "UnknownNameError",
    "load_robot",
    "load_run",
    "resolve",
    "solve",
    "solve_pose",
    "task_rank",
]

if not TYPE_CHECKING:  # a type checker reads the imports above and reports unknown names
    _MODULES = {
        "METHODS": "differential_ik.methods",
        "Controller": "control.controller",
        "Instant": "interfaces.clock",
        "JointSample": "interfaces.samples",
        "PoseSample": "interfaces.samples",
        "Robot": "robot.robot",
        "Settings": "settings.groups",
        "SimulatedArm": "robot.simulated_arm",
        "Step": "interfaces.step",
        "TaskTolerance": "math.task_tolerance",
        "load_robot": "robot.catalogue",
        "load_run": "recording.run_reader",
        "resolve": "differential_ik.closed_form",
        "solve": "differential_ik.constrained",
        "solve_pose": "inverse_kinematics.pose_solver",
        "task_rank": "robot.task_rank",
    }
    """Exported name -> module below ``ik_node``; the other exported names are in ``errors``."""

    def __getattr__(name):
        """Import the exported ``name`` at its first use (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        from ik_node.errors import EXTRAS, MissingPackageError

        try:
            module = import_module(f"{__name__}.{_MODULES.get(name, 'errors')}")
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] in EXTRAS:
                raise MissingPackageError(error) from error
            raise
        value = getattr(module, name)
        globals()[name] = value
        return value

    def __dir__():
        """Include the names that are not imported yet."""
        return sorted({*globals(), *__all__})
