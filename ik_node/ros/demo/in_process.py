"""The demonstration without ROS: the recorded controller and the simulated arm in one process, in simulated time.

The loop is that of what-if simulations (:mod:`ik_node.replay.closed_loop`), and recording and report are those of the
demonstration over DDS.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from ik_node.errors import SettingsError
from ik_node.interfaces.clock import NS, Instant
from ik_node.replay.rerecord import record_simulation
from ik_node.replay.side_by_side import record_variants, report_side_by_side
from ik_node.replay.streamed_targets import LEAD_S, SimulatedStart, StreamedTargets
from ik_node.replay.what_if import Variant
from ik_node.report import GROUND_TRUTH_FILE, GroundTruth, ground_truth_from_trajectory, write_ground_truth
from ik_node.robot.simulated_arm import ArmModel
from ik_node.robot.simulator_parameters import arm_model
from ik_node.ros.demo.new_folder import new_folder
from ik_node.ros.demo.options import CheckedRun, DemoOptions
from ik_node.ros.demo.plan import HOLD_S, PlannedMotion, compile_functions, show_picture, write_report
from ik_node.settings.method_names import METHOD_NAMES

START_NS = NS
"""Monotonic time of the start: the same in each simulation, so that the same options give the same bits."""


def run_in_process(options: DemoOptions) -> int:
    """Simulate, record and report; return 0.

    Raises:
        IkNodeError: An option or file cannot be used, or the folder cannot be written; nothing is left behind.
    """
    run = CheckedRun(options)
    model = arm_model(run.simulator)
    if model.encoder_noise or model.dropout:
        raise SettingsError("encoder_noise and dropout of ik_simulator have no effect with --no-ros; expected 0")
    with new_folder(run.out) as out:
        if run.config is not None and run.config.text:
            (out / run.config.path.name).write_text(run.config.text)
        compile_functions(run.robot)
        print(f"starting {run.robot_name}: controller and simulated arm in this process, simulated time", flush=True)
        joints = run.simulated_robot.joints
        if run.start is not None:
            print(run.start.describe(joints), flush=True)
        simulated = dict(zip(joints, run.simulator["initial_position"], strict=True))
        position = np.array([simulated[name] for name in run.robot.joints])
        motion = PlannedMotion(run, options, run.robot.pose(position))
        start = SimulatedStart(position, Instant(START_NS, time.time_ns()))
        targets = list(motion.targets())
        source = StreamedTargets(run.robot, run.settings, start, targets, run.simulator["rate_hz"], HOLD_S)
        begin_ros_ns = start.now.ros_ns + round((LEAD_S + motion.approach.duration_s) * NS)
        truth = ground_truth_from_trajectory(motion.trajectory, begin_ros_ns)
        if options.compares_methods:
            _compare_methods(source, model, out, truth, options)
            return 0
        begin_s = time.monotonic()
        steps = len(record_simulation(source, {}, out / "bag", model, time.perf_counter_ns).steps)
        took_s = time.monotonic() - begin_s
        print(f"{steps} control steps, {motion.whole.duration_s:.1f} s of motion, in {took_s:.1f} s", flush=True)
        write_report(out, truth, options)
    return 0


def _compare_methods(
    source: StreamedTargets, model: ArmModel, out: Path, truth: GroundTruth, options: DemoOptions
) -> None:
    """Record a run of each method, and print and draw them side by side."""
    write_ground_truth(out / GROUND_TRUTH_FILE, truth)
    variants = [Variant(name, {"method": name}) for name in METHOD_NAMES]
    bags = record_variants(lambda: source, variants, out, time.perf_counter_ns, model)
    picture = out / "methods.png"
    print(report_side_by_side(bags, None, picture))
    for bag in bags:
        print(f"recording {bag}")
    print(f"picture   {picture}", flush=True)
    show_picture(picture, options)
