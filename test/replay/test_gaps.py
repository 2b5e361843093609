"""A long gap in the bag of another recorder: leaving most of its clock calls out changes no Step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop import READY, make_robot
from mcap.writer import Writer

from ik_node.interfaces.clock import NS
from ik_node.interfaces.delivery import CLOCK_PERIOD_S
from ik_node.interfaces.step import Step
from ik_node.messages.cdr import STORE
from ik_node.messages.encode import encode_joint_state, encode_pose
from ik_node.messages.step_codec import CallKind, StepEncoder
from ik_node.recording.json_codec import to_json
from ik_node.replay import external_bag
from ik_node.replay.call_source import calls, make_recorded_call
from ik_node.replay.external_bag import ExternalBag
from ik_node.settings.groups import Settings

START_NS = 1_700_000_000 * NS
GAP_S = 90.0
ROBOT = make_robot("panda")
Q = np.array(READY["panda"])
X, Y, Z, W = 0.9238795, -0.3826834, 0.0, 0.0
TOPICS = {"/joint_states": "sensor_msgs/msg/JointState", "/ik_node/target_pose": "geometry_msgs/msg/PoseStamped"}


def write_bag(path: Path) -> Path:
    """Joint states at 100 Hz and targets at 20 Hz for 2 s, a gap in which an arm would move, the same again."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channels = {}
        for topic, kind in TOPICS.items():
            definition, _ = STORE.generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, "ros2msg", definition.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        states, targets = channels.values()
        goal = ROBOT.pose(Q)[:3, 3] + np.array([0.0, 0.02, 0.05])
        for begin_ns in (START_NS, START_NS + round(GAP_S * NS)):
            for number in range(200):
                now_ns = begin_ns + number * 10_000_000
                data = encode_joint_state(ROBOT.joints, now_ns, Q + 1e-4 * np.sin(0.1 * number))
                writer.add_message(states, now_ns, data, now_ns)
                if number % 5 == 0:
                    data = encode_pose("panda_link0", now_ns, goal, np.array([X, Y, Z, W]))
                    writer.add_message(targets, now_ns + 1000, data, now_ns + 1000)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def run(path: Path) -> tuple[list[Step], dict[str, Any], int]:
    """The Steps, the final state of the controller, and the number of clock calls."""
    settings = Settings().with_values({"robot": "panda", "obstacles.geometry": "none", "follow.enabled": False})
    source = ExternalBag(path, settings)
    controller = source.controller()
    made = [(recorded.call.kind, make_recorded_call(controller, source, recorded)) for recorded in calls(source)]
    clocks = sum(kind is CallKind.ON_CLOCK for kind, _ in made)
    return [step for _, step in made if step is not None], json.loads(to_json(controller.capture())), clocks


def test_a_skipped_gap_gives_the_numbers_of_one_that_is_not_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / "bag_0.mcap")
    steps, state, clocks = run(path)
    monkeypatch.setattr(external_bag, "LONGEST_GAP_NS", round(1e6 * NS))
    all_steps, same_state, all_clocks = run(path)
    assert all_clocks > clocks + 2000
    assert len(steps) == len(all_steps) > 300
    encoders = [StepEncoder("ik_node", ROBOT.n) for _ in range(2)]
    for step, other in zip(steps, all_steps, strict=True):
        assert encoders[0].encode(step) == encoders[1].encode(other)
    for found in (state, same_state):
        timer, clock = found["timer"], found["timer"]["clock"]
        assert clock.pop("hz") == pytest.approx(1.0 / CLOCK_PERIOD_S, rel=0.01)
        assert timer.pop("clock_calls") > 0
        for name in ("hold_ups", "hold_ups_ns", "held_up_ns"):  # a skipped gap has no calls
            timer.pop(name)
    assert state == same_state
    assert any(step.joint_velocity.any() for step in steps)
