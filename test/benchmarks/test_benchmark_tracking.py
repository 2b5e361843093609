"""Samples of `ik_benchmark tracking`: the demands on the whole loop, on short targets of our own.

The real streams are in `test_stream_tracking.py` and in the benchmark; here made ones cover the same behaviour. The
loop that measures is tested first: a rival with an arm must do what the same rival does with an ideal tool.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from support import PROJECT

from benchmarks import streams, tracking
from benchmarks.stream_baselines import Proportional
from benchmarks.streams import CLEAN, STAMPED, figures, first_seconds, follow, sent
from benchmarks.tracking import PROMPT, resting_at, simulators
from benchmarks.tracking_arm import ArmFollower, Rival, Simulator
from benchmarks.tracking_dds import measured
from benchmarks.tracking_rows import Bench, Demand, known_demands, order_demand, stream_demands
from benchmarks.tracking_targets import READY, Known, known, laid_at, panda
from ik_node.recording.run_reader import load_run
from ik_node.report import truth_from_targets

IDEAL, LAGGED = simulators(0)
PANDA, SETTINGS = panda(500.0)
START = PANDA.pose(READY)
CIRCLE, EIGHT, WAYPOINTS = known(PANDA, START)


def test_an_arm_leads_a_rival_as_an_ideal_tool_does() -> None:
    """P control through the pseudoinverse of an ideal arm moves the tool as P control of the tool itself does."""
    stream = first_seconds(laid_at(START, streams.eight(20.0)), 2.0)
    samples = sent(stream, CLEAN, 0)
    follower = ArmFollower(PANDA, resting_at(PANDA, stream.poses[0]), IDEAL, Rival(PANDA, Proportional(10.0)), 500.0)
    with_arm, without = follow(follower, stream, samples), follow(Proportional(10.0), stream, samples)
    assert np.abs(with_arm.poses - without.poses)[:, :3, 3].max() < 3e-4
    for ours, other in zip(figures(with_arm, stream), figures(without, stream), strict=True):
        assert ours.rms == pytest.approx(other.rms, rel=0.01)
        assert ours.lag_ms == pytest.approx(other.lag_ms, abs=2.0)
        assert ours.acceleration_peak == pytest.approx(other.acceleration_peak, rel=0.01)
    assert len(follower.velocities) == len(with_arm.poses)


@pytest.mark.parametrize("target", [CIRCLE, WAYPOINTS], ids=["trajectory with twists", "timed path"])
def test_a_known_target_is_tracked_to_the_square_of_the_tick(target: Known) -> None:
    """Default gains: under 0.1 um and 0.1 urad at 500 Hz, four times that at 250 Hz."""
    rows = []
    for rate_hz in (250.0, 500.0):
        stream = first_seconds(target.stream(rate_hz), 3.5)
        rows.append(Bench(PANDA, READY, IDEAL, stream, sent(stream, PROMPT, 0), panda(rate_hz)[1]).node(target.message))
    demands = order_demand("", (250.0, 500.0), rows) + known_demands("", IDEAL, 500.0, [rows[1]])
    assert len(demands) == 4
    assert not [demand.text() for demand in demands if not demand.met]


def test_a_late_arm_is_tracked_better_than_any_rival_can() -> None:
    """At default gains, told of the lag: a third of the error of either rival at its best gain, at most; the search
    finds the gain at which rivals become unstable."""
    stream = first_seconds(EIGHT.stream(250.0), 2.5)
    bench = Bench(PANDA, READY, LAGGED, stream, sent(stream, PROMPT, 0), panda(250.0)[1])
    rivals = bench.rivals()
    demands = known_demands("", LAGGED, 250.0, [bench.node(EIGHT.message), *rivals])
    assert len(demands) == 2
    assert not [demand.text() for demand in demands if not demand.met]
    scores = dict(rivals[1].search)
    assert 20.0 < min(scores, key=lambda gain: scores[gain]) < 300.0, "beyond it the arm oscillates"


@pytest.mark.parametrize("simulator", [IDEAL, LAGGED], ids=lambda simulator: simulator.name)
@pytest.mark.parametrize("stream", [streams.wander(30.0), streams.eight(20.0)], ids=lambda stream: stream.name)
def test_made_streams_are_tracked_as_asked(stream: streams.Stream, simulator: Simulator) -> None:
    """The whole loop on a hand that cannot be foretold and on a smooth one, with jitter, losses and reordering."""
    short = first_seconds(laid_at(START, stream), 4.0)
    bench = Bench(PANDA, resting_at(PANDA, short.poses[0]), simulator, short, sent(short, STAMPED, 0), SETTINGS)
    rival = bench.row("P", Rival(PANDA, Proportional(10.0)))
    demands = stream_demands("", short, bench.node(), rival)
    assert len(demands) == 5
    assert not [demand.text() for demand in demands if not demand.met]


def test_a_recording_is_measured_with_the_same_code() -> None:
    """A recorded run of the node, measured as runs over DDS are: streamed targets are followed within millimetres."""
    run = load_run(PROJECT / "bags" / "plain")
    truth = truth_from_targets(run.targets, run.base_frame)
    assert truth is not None
    row, period_s = measured(run, truth)
    assert 0.0 < row.linear.rms < 5.0
    assert 0.001 < period_s < 0.2
    assert 0.0 < row.joints.acceleration_peak < 100.0


def test_a_demand_that_is_not_a_number_is_missed() -> None:
    """Figures over nothing must not pass."""
    assert not Demand("", "", float("nan"), 1.0).met
    assert Demand("", "", 1.0, 1.0).met
    assert not Demand("", "", 4.0, np.inf, 5.0).met


def test_the_part_prints_its_figures_and_says_what_is_absent(capsys: pytest.CaptureFixture[str]) -> None:
    """What a person calls: exit code 1 exactly when a demand was missed; JSON for machines."""
    code = tracking.main(["--only", "made", "--name", "eight", "--seconds", "0.8", "--json"])
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    missed = [line for line in lines if "met" in line and not line["met"]]
    assert code == (1 if missed else 0)
    assert {"ik_node", "P, 10 1/s"} < {line["follower"] for line in lines if "follower" in line}
    assert tracking.main(["--only", "real", "--data", "nowhere"]) == 0
    assert "camera: skipped" in capsys.readouterr().err
