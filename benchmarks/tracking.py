"""``ik_benchmark tracking``: how well a moving target is tracked by the node's controller on a simulated arm.

The arm is a Panda with the settings of config/panda.yaml. Simulator "ideal" does what it is told; "lagged" answers with
a first-order lag of 20 ms after one sample of delay, and its encoders have noise. The node is told both by its
parameters ``arm_lag_s`` and ``arm_delay_s``; beside it stands what it does without. Targets are (a) known as a
whole: a trajectory with twists or a timed path, or (b) streams: made ones, and real ones where their files are. The
error is that of the tool where it truly is against the truth at the same time; the first 0.5 s are left out, and so is
the time about a step of a stream.

The rivals are P control through the pseudoinverse, without feed-forward and without acceleration limits: at 10 1/s, at
its best gain, and "the whole error in one period, clipped" to 1 m/s and 2.5 rad/s at its best part of the error per
period. Best is what leaves the least RMS position error plus 0.3 m times the RMS orientation error; an unstable gain
cannot. Accelerations are of the commanded joint velocities as a vector: peak and RMS of the change per tick, and over
20 ms; jerk is the change of the first. The exit code is 1 when a demand is missed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import streams, tracking_dds
from benchmarks.streams import CLEAN, STAMPED, Dirt, Stream
from benchmarks.tracking_arm import Simulator
from benchmarks.tracking_rows import Bench, Demand, Row, known_demands, order_demand, stream_demands
from benchmarks.tracking_targets import READY, known, laid_at, panda, start_of_streams
from ik_node.errors import IkNodeError
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

NOISE_RAD = 2e-5
"""About what 17 bits a turn leave."""
KNOWN_RATES_HZ = (250.0, 500.0, 1000.0)
STREAM_RATE_HZ = 500.0
DECIMATED_HZ = 30.0
ASKED = ("task board", "camera", "letter h", "letter e", "co-manipulation")
PARTS = ("known", "made", "real", "dds")


class Options(NamedTuple):
    """What the command line says."""

    data: Path
    seconds: float
    seed: int
    name: str
    as_json: bool


def simulators(seed: int) -> tuple[Simulator, Simulator]:
    """The ideal and the lagged one."""
    return Simulator("ideal"), Simulator("lagged", 0.02, True, NOISE_RAD, seed)


def resting_at(robot: Robot, pose: Array) -> Array:
    """Joint positions (n,) near the ready posture for a tool pose; IkNodeError when there are none."""
    found = PoseSolver(robot).solve(pose, READY)
    if not found.converged:
        raise IkNodeError(f"the arm does not reach {pose[:3, 3].round(3).tolist()} m, where the stream begins")
    return found.q


def known_part(options: Options) -> Iterator[tuple[str, list[Row], list[Demand]]]:
    """Targets that are known as a whole, at all rates; the order of the error in the tick at last."""
    robot, _ = panda(STREAM_RATE_HZ)
    for target in known(robot, robot.pose(READY)):
        if options.name not in target.name:
            continue
        ideal: list[Row] = []
        for rate_hz in KNOWN_RATES_HZ:
            stream = target.stream(rate_hz)
            for simulator in simulators(options.seed):
                bench = Bench(robot, READY, simulator, stream, streams.sent(stream, PROMPT, 0), panda(rate_hz)[1])
                rows = [bench.node(target.message), *bench.rivals()]
                if simulator.lag_s:
                    rows.insert(1, bench.untold_node(target.message))
                else:
                    ideal.append(rows[0])
                title = f"{target.name}, {rate_hz:g} Hz, {simulator.name}"
                yield title, rows, known_demands(title, simulator, rate_hz, rows)
        yield f"{target.name}, ideal: error over tick", [], order_demand(target.name, KNOWN_RATES_HZ, ideal)


PROMPT = Dirt("at every tick", stamped=False)


def streams_of(part: str, options: Options, start_pose: Array) -> Iterator[tuple[Stream, Dirt]]:
    """The made or the real ones."""
    if part == "made":
        for stream, dirt in (
            (streams.wander(20.0), CLEAN),
            (streams.wander(30.0), CLEAN),
            (streams.wander(30.0), STAMPED),
            (streams.eight(20.0), STAMPED),
        ):
            yield laid_at(start_pose, stream), dirt
        return
    for name in streams.absent(options.data):
        if name in ASKED:
            print(f"{name}: skipped, {options.data} does not hold it; a made stream covers the same", file=sys.stderr)
    for stream, dirts in streams.real(options.data, (DECIMATED_HZ,), start_pose):
        if stream.name.startswith(ASKED):
            yield stream, dirts[0]


def stream_part(part: str, options: Options) -> Iterator[tuple[str, list[Row], list[Demand]]]:
    """Streams as the node gets them."""
    robot, settings = panda(STREAM_RATE_HZ)
    for whole, dirt in streams_of(part, options, start_of_streams(robot)):
        if options.name not in whole.name:
            continue
        stream = streams.first_seconds(whole, options.seconds)
        samples = streams.sent(stream, dirt, options.seed)
        for simulator in simulators(options.seed):
            start = resting_at(robot, stream.poses[0])
            bench = Bench(robot, start, simulator, stream, samples, settings)
            node, rivals = bench.node(), bench.rivals()
            title = f"{stream.name}, {dirt.name}, {simulator.name}"
            other = bench.untold_node() if simulator.lag_s else bench.unlimited_node()
            yield title, [node, other, *rivals], stream_demands(title, stream, node, rivals[0])


def parser() -> argparse.ArgumentParser:
    """The command line of this part."""
    result = argparse.ArgumentParser(
        prog="ik_benchmark tracking", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of real recordings")
    result.add_argument("--only", choices=PARTS, help="one part instead of all")
    result.add_argument("--name", default="", help="targets whose name holds this")
    result.add_argument("--seconds", type=float, default=120.0, help="of each stream; 0: all of it [%(default)s]")
    result.add_argument("--seed", type=int, default=0, help="of noise and of what happens to samples [%(default)s]")
    result.add_argument("--dds", action="store_true", help="the streams over DDS too, to the node as ik_demo runs it")
    result.add_argument("--json", action="store_true", help="one object per line instead of the tables")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the figures; 1 when a demand is missed."""
    given = parser().parse_args(arguments)
    options = Options(given.data, given.seconds, given.seed, given.name, given.json)
    parts = [given.only] if given.only else [part for part in PARTS if part != "dds" or given.dds]
    demands: list[Demand] = []
    if not options.as_json:
        print(HEAD)
    for part in parts:
        if part == "known":
            found = known_part(options)
        elif part == "dds":
            found = tracking_dds.part(options.data, options.name, options.seconds)
        else:
            found = stream_part(part, options)
        for title, rows, asked in found:
            demands += asked
            _show(part, title, rows, asked, options.as_json)
    missed = [demand for demand in demands if not demand.met]
    if not options.as_json:
        print(f"\n{len(demands)} demands, {len(missed)} missed")
        print("\n".join(f"  {demand.of}: {demand.text()}" for demand in missed))
    return 1 if missed else 0


HEAD = """of position (mm) and orientation (mrad): RMS and largest error, lag in ms, RMS error with the lag taken off;
of the joints (rad/s2, rad/s3): acceleration per tick, peak and RMS, over 20 ms, peak and RMS, jerk, peak and RMS
the circle is 0.24 m in diameter, at 0.15 m/s, the tool leaning by up to 0.3 rad"""


def _show(part: str, title: str, rows: list[Row], demands: list[Demand], as_json: bool) -> None:
    if as_json:
        for row in rows:
            figures = {"position": row.linear._asdict(), "orientation": row.angular._asdict()}
            line = {"part": part, "title": title, "follower": row.name, "search": row.search, **figures}
            print(json.dumps({**line, "joints": row.joints._asdict()}), flush=True)
        for demand in demands:
            print(json.dumps({"part": part, "title": title, "demand": demand._asdict(), "met": demand.met}), flush=True)
        return
    print(f"\n{title}")
    for row in rows:
        print(f"  {row.line()}")
    for row in rows:
        if row.search:
            print(f"  search {row.name}: " + ", ".join(f"{gain:.4g}: {score:.3g}" for gain, score in row.search))
    for demand in demands:
        print(f"  {demand.text()}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
