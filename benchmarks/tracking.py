"""``ik_benchmark tracking``: tracking of moving targets by the controller of the node on a simulated arm.

The arm is a Panda with the settings of config/panda.yaml. The "ideal" arm follows commands exactly; the "lagged" one
has one sample of delay, a first-order lag of 20 ms and encoder noise. The parameters ``arm_lag_s`` and ``arm_delay_s``
describe it to the node, which also runs without them. Targets are (a) known as a whole: a trajectory with twists or a
timed path, or (b) streams: generated ones, and real ones where their files exist. The error is that of the true tool
pose with respect to the truth at the same time; the first 0.5 s and steps of a stream do not count.

The baselines are P control through the pseudoinverse, without feed-forward and without acceleration limits: at 10 1/s,
at its best gain, and "the whole error in one period, clipped" to 1 m/s and 2.5 rad/s at its best fraction of the error
per period. The best gain has the least sum of RMS position error and 0.3 m times RMS orientation error. Accelerations
are those of the vector of commanded joint velocities: peak and RMS of the change per control step, and over 20 ms; jerk
is the change of the change per control step. The exit code is 1 when a requirement is not met.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import stream_data, tracking_dds
from benchmarks.stream_data import CLEAN, STAMPED, Stream, StreamNoise
from benchmarks.tracking_arm import ArmVariant
from benchmarks.tracking_rows import (
    FollowerResult,
    Requirement,
    TrackingCase,
    known_requirements,
    order_requirements,
    stream_requirements,
)
from benchmarks.tracking_targets import READY, known, laid_at, panda, start_of_streams
from ik_node.errors import IkNodeError, InputError
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.math.types import Array
from ik_node.report import as_plain
from ik_node.robot.robot import Robot

NOISE_RAD = 2e-5
"""Resolution of an encoder with 17 bits per turn, about."""
KNOWN_RATES_HZ = (250.0, 500.0, 1000.0)
STREAM_RATE_HZ = 500.0
DECIMATED_HZ = 30.0
MIN_DURATION_S = 0.75
"""Shortest target: half a second does not count, and figures over 20 ms need a minimum duration."""
ASKED = ("task board", "camera", "letter h", "letter e", "co-manipulation")
ARMS = ("ideal", "lagged")
PARTS = ("known", "made", "real", "dds")


class Options(NamedTuple):
    """Options of the command line."""

    data: Path
    seconds: float
    seed: int
    name: str
    as_json: bool
    rates_hz: tuple[float, ...] = KNOWN_RATES_HZ
    arms: tuple[str, ...] = ARMS
    searched: bool = True


def simulators(options: Options) -> list[ArmVariant]:
    """Return the selected arms."""
    both = ArmVariant("ideal"), ArmVariant("lagged", 0.02, True, NOISE_RAD, options.seed)
    return [simulator for simulator in both if simulator.name in options.arms]


def resting_at(robot: Robot, pose: Array) -> Array:
    """Return joint positions (n,) near the ready posture for a tool pose; raises IkNodeError when there are none."""
    found = PoseSolver(robot).solve(pose, READY)
    if not found.converged:
        raise IkNodeError(f"the arm does not reach {pose[:3, 3].round(3).tolist()} m, where the stream begins")
    return found.q


def known_part(options: Options) -> Iterator[tuple[str, list[FollowerResult], list[Requirement]]]:
    """Run targets that are known as a whole at all rates; check the order of the error in the control period."""
    robot, _ = panda(STREAM_RATE_HZ)
    for target in known(robot, robot.pose(READY)):
        if options.name not in target.name:
            continue
        ideal: list[FollowerResult] = []
        for rate_hz in options.rates_hz:
            stream = stream_data.first_seconds(target.stream(rate_hz), options.seconds)
            for simulator in simulators(options):
                bench = TrackingCase(
                    robot, READY, simulator, stream, stream_data.transported(stream, PROMPT, 0), panda(rate_hz)[1]
                )
                rows = [bench.node(target.message), *bench.baselines(options.searched)]
                if simulator.lag_s:
                    rows.insert(1, bench.uncompensated_node(target.message))
                else:
                    ideal.append(rows[0])
                title = f"{target.name}, {rate_hz:g} Hz, {simulator.name}"
                yield title, rows, known_requirements(title, simulator, rate_hz, rows)
        yield f"{target.name}, ideal: error over tick", [], order_requirements(target.name, options.rates_hz, ideal)


PROMPT = StreamNoise("at every tick", stamped=False)


def streams_of(part: str, options: Options, start_pose: Array) -> Iterator[tuple[Stream, StreamNoise]]:
    """Yield generated or real streams with their noise."""
    if part == "made":
        for stream, noise in (
            (stream_data.random_walk(20.0), CLEAN),
            (stream_data.random_walk(30.0), CLEAN),
            (stream_data.random_walk(30.0), STAMPED),
            (stream_data.eight(20.0), STAMPED),
        ):
            yield laid_at(start_pose, stream), noise
        return
    for name in stream_data.absent(options.data):
        if name in ASKED:
            print(
                f"{name}: skipped, {options.data} does not hold it; a generated stream covers the same", file=sys.stderr
            )
    for stream, noises in stream_data.real(options.data, (DECIMATED_HZ,), start_pose):
        if stream.name.startswith(ASKED):
            yield stream, noises[0]


def stream_part(part: str, options: Options) -> Iterator[tuple[str, list[FollowerResult], list[Requirement]]]:
    """Run streams as the node receives them."""
    robot, settings = panda(STREAM_RATE_HZ)
    for whole, noise in streams_of(part, options, start_of_streams(robot)):
        if options.name not in whole.name:
            continue
        stream = stream_data.first_seconds(whole, options.seconds)
        samples = stream_data.transported(stream, noise, options.seed)
        for simulator in simulators(options):
            start = resting_at(robot, stream.poses[0])
            bench = TrackingCase(robot, start, simulator, stream, samples, settings)
            node, baselines = bench.node(), bench.baselines(options.searched)
            title = f"{stream.name}, {noise.name}, {simulator.name}"
            other = bench.uncompensated_node() if simulator.lag_s else bench.unlimited_node()
            yield title, [node, other, *baselines], stream_requirements(title, stream, node, baselines[0])


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_benchmark tracking", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of real recordings")
    result.add_argument("--only", choices=PARTS, help="one part [all]")
    result.add_argument("--name", default="", help="only targets whose name contains this")
    result.add_argument(
        "--seconds", type=float, default=120.0, help="duration of each target, s; 0: all of it [%(default)s]"
    )
    result.add_argument(
        "--rates",
        type=float,
        nargs="+",
        default=KNOWN_RATES_HZ,
        help="control rates for known targets, Hz [%(default)s]",
    )
    result.add_argument("--arms", nargs="+", choices=ARMS, default=ARMS, help="[%(default)s]")
    result.add_argument("--no-search", action="store_true", help="do not search the best gains of the baselines")
    result.add_argument("--seed", type=int, default=0, help="seed of all noise [%(default)s]")
    result.add_argument(
        "--dds", action="store_true", help="also run the streams over DDS with the node, as ik_demo does"
    )
    result.add_argument(
        "--load", action="store_true", help="over DDS: also with one busy process per core, without requirements"
    )
    result.add_argument("--json", action="store_true", help="one object per line instead of the tables")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; return 1 when a requirement is not met."""
    given = parser().parse_args(arguments)
    if 0.0 < given.seconds < MIN_DURATION_S:
        raise InputError(
            f"--seconds is {given.seconds:g}; expected 0 or at least {MIN_DURATION_S:g}: the start does not count"
        )
    options = Options(
        given.data,
        given.seconds,
        given.seed,
        given.name,
        given.json,
        tuple(given.rates),
        tuple(given.arms),
        not given.no_search,
    )
    parts = [given.only] if given.only else [part for part in PARTS if part != "dds" or given.dds]
    if given.load and "dds" not in parts:
        raise InputError("--load has no effect without --dds or --only dds")
    requirements: list[Requirement] = []
    if not options.as_json:
        print(HEAD)
    for part in parts:
        if part == "known":
            found = known_part(options)
        elif part == "dds":
            found = tracking_dds.part(options.data, options.name, options.seconds, given.load)
        else:
            found = stream_part(part, options)
        for title, rows, required in found:
            requirements += required
            _print(part, title, rows, required, options.as_json)
    missed = [requirement for requirement in requirements if not requirement.met]
    if not options.as_json:
        print(f"\n{len(requirements)} requirements, {len(missed)} missed")
        print("\n".join(f"  {requirement.of}: {requirement.text()}" for requirement in missed))
    return 1 if missed else 0


HEAD = """of position (mm) and orientation (mrad): RMS and largest error, lag in ms, RMS error without the lag;
of the joints (rad/s2, rad/s3): acceleration per step, peak and RMS, over 20 ms, peak and RMS, jerk, peak and RMS
the circle is 0.24 m in diameter, at 0.15 m/s, the tool leaning by up to 0.3 rad"""


def _print(part: str, title: str, rows: list[FollowerResult], requirements: list[Requirement], as_json: bool) -> None:
    if as_json:
        for row in rows:
            figures = {"position": row.linear._asdict(), "orientation": row.angular._asdict()}
            line = {"part": part, "title": title, "follower": row.name, "search": row.search, **figures}
            late = {} if row.late is None else {"late": as_plain(row.late)}
            print(json.dumps({**line, "joints": row.joints._asdict(), **late}), flush=True)
        for requirement in requirements:
            judged = {"requirement": requirement._asdict(), "met": requirement.met}
            print(json.dumps({"part": part, "title": title, **judged}), flush=True)
        return
    print(f"\n{title}")
    for row in rows:
        print(f"  {row.line()}")
        if row.late is not None:
            print(f"  {row.late.line()}")
    for row in rows:
        if row.search:
            print(f"  search {row.name}: " + ", ".join(f"{gain:.4g}: {score:.3g}" for gain, score in row.search))
    for requirement in requirements:
        print(f"  {requirement.text()}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
