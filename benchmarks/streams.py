"""``ik_benchmark streams``: tracking of streamed poses by this package, P control and other baselines.

The tool is ideal, everything runs in one process. :mod:`benchmarks.stream_metrics` defines the figures.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import stream_frontier, stream_pictures
from benchmarks.stream_baselines import Follower, LastSlope, Proportional
from benchmarks.stream_data import (
    CLEAN,
    STAMPED,
    UNSTAMPED,
    Stream,
    StreamNoise,
    eight,
    first_seconds,
    random_walk,
    real,
    screw,
    transported,
)
from benchmarks.stream_metrics import TICK_S, StreamMetrics, follow, stream_metrics
from ik_node.settings.groups import TargetSettings
from ik_node.targets.stream.stream import StreamedPoses

FRONTIER_S = 20.0
"""Part of each recording that the frontier uses."""
GAIN = 10.0
"""Gain of the P control that figures are compared with, 1/s."""


def followers() -> dict[str, Callable[[], Follower]]:
    """Return the followers by name; the first two are this package and P control."""
    settings = TargetSettings()
    return {
        "ours": lambda: StreamedPoses(settings),
        f"P, {GAIN:g}/s": lambda: Proportional(GAIN),
        "last slope": lambda: LastSlope(settings),
        "whole error": lambda: Proportional(1.0 / TICK_S, *settings.max_speed),
    }


class StreamRatings(NamedTuple):
    """Figures of this package relative to requirements; each has to be below 1 for streams at 20 to 33 Hz."""

    position_lag: float
    """Relative to 30 ms or one sample period, whichever is larger."""
    rotation_lag: float
    """Relative to 45 ms or 1.5 sample periods, whichever is larger."""
    position_after_lag: float
    """Relative to P control."""
    rotation_after_lag: float
    position_peak: float
    """Five times the peak acceleration per control step, relative to P control."""
    rotation_peak: float


def stream_ratings(
    ours: tuple[StreamMetrics, StreamMetrics], baseline: tuple[StreamMetrics, StreamMetrics], period_s: float
) -> StreamRatings:
    """Rate ``ours`` against P control; a constant orientation meets its requirements."""
    turns = baseline[1].acceleration_peak > 1e-6
    return StreamRatings(
        ours[0].lag_ms / max(30.0, 1e3 * period_s),
        ours[1].lag_ms / max(45.0, 1.5e3 * period_s) if turns else 0.0,
        ours[0].after_lag / baseline[0].after_lag,
        ours[1].after_lag / baseline[1].after_lag if turns else 0.0,
        5.0 * ours[0].acceleration_peak / baseline[0].acceleration_peak,
        5.0 * ours[1].acceleration_peak / baseline[1].acceleration_peak if turns else 0.0,
    )


def main(arguments: Sequence[str]) -> int:
    """Print the table; with ``--json`` one object per stream, noise and follower."""
    parser = argparse.ArgumentParser(prog="ik_benchmark streams", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of real recordings")
    parser.add_argument(
        "--rates", type=float, nargs="+", default=[20.0, 33.0], help="rates of decimated recordings, Hz"
    )
    parser.add_argument("--seeds", type=int, default=1, help="number of random draws of the noise")
    parser.add_argument(
        "--made-rates", type=float, nargs="+", default=[20.0, 50.0, 500.0], help="rates of generated streams, Hz"
    )
    parser.add_argument("--only", nargs="+", default=[""], help="only streams whose name starts with one of these")
    parser.add_argument("--followers", nargs="+", default=[], help="besides this package and P control [all]")
    parser.add_argument("--json", action="store_true", help="one JSON object per line instead of the table")
    parser.add_argument(
        "--frontier",
        action="store_true",
        help="all recordings: lag, error after lag and acceleration of this package and families of rivals",
    )
    parser.add_argument(
        "--pictures", type=Path, help="folder for pictures (PNG) of the frontier, of each stream and of all"
    )
    options = parser.parse_args(arguments)
    if options.frontier:
        return _frontier(options)
    if options.pictures:
        parser.error("--pictures draws the frontier; add --frontier")
    generated = (
        (make(rate), (CLEAN, STAMPED, UNSTAMPED)) for make in (screw, eight, random_walk) for rate in options.made_rates
    )
    noisy = ((eight(rate, 2e-4, 1e-3), (CLEAN,)) for rate in options.made_rates)
    every = followers()
    names = [*list(every)[:2], *(options.followers or list(every)[2:])]
    if unknown := [name for name in names if name not in every]:
        parser.error(f"unknown follower '{unknown[0]}'; valid: {', '.join(every)}")
    chosen = {name: every[name] for name in names}
    if not options.json:
        print(_HEAD)
    for stream, noises in (*generated, *noisy, *real(options.data, options.rates)):
        for noise in noises if stream.name.startswith(tuple(options.only)) else ():
            for seed in range(options.seeds if noise.lost else 1):
                _compare(stream, noise, seed, chosen, options.json)
    return 0


def _frontier(options: argparse.Namespace) -> int:
    others = stream_frontier.rivals()
    if not any(rival.family == "Ruckig" for rival in others):
        print("Ruckig: skipped, the package ruckig is not installed (benchmarks/requirements.txt)", file=sys.stderr)
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    if not options.json:
        print(stream_frontier.HEAD)
    every = []
    for whole, noises in real(options.data, options.rates, more=True):
        for noise in noises if whole.name.startswith(tuple(options.only)) else ():
            rows = stream_frontier.frontier_rows(first_seconds(whole, FRONTIER_S), noise, 0, others)
            every += rows
            for row in rows:
                text = json.dumps(stream_frontier.as_json(row)) if options.json else stream_frontier.line(row)
                print(text, flush=True)
            if options.pictures:
                name = f"{whole.name}, {noise.name}".replace(",", "").replace(" ", "_")
                stream_pictures.draw_stream(rows, options.pictures / f"{name}.png")
    if options.pictures and every:
        stream_pictures.draw_all(every, options.pictures / "all.png")
    if not options.json:
        print("\n".join(stream_frontier.summary(every)))
    return 0


_HEAD = """lag ms, RMS error at the same time, RMS error after removing the lag, peak and RMS acceleration per tick,
peak acceleration over 20 ms, of position (mm, m/s2) and of orientation (mrad, rad/s2)
"""


def _compare(
    stream: Stream, noise: StreamNoise, seed: int, chosen: Mapping[str, Callable[[], Follower]], as_json: bool
) -> None:
    samples = transported(stream, noise, seed)
    results = {name: stream_metrics(follow(make(), stream, samples), stream) for name, make in chosen.items()}
    ours, baseline = list(results.values())[:2]
    ratings = stream_ratings(ours, baseline, float(np.median(np.diff(stream.times_s))))
    if as_json:
        for name, (linear, angular) in results.items():
            row = {"stream": stream.name, "noise": noise.name, "seed": seed, "follower": name}
            print(json.dumps({**row, "position": linear._asdict(), "orientation": angular._asdict()}), flush=True)
        about = {"stream": stream.name, "noise": noise.name, "seed": seed}
        print(json.dumps({**about, "ratings": ratings._asdict()}), flush=True)
        return
    missed = [f"{name} {value:.2f}" for name, value in ratings._asdict().items() if value > 1.0]
    print(f"{stream.name}, {noise.name}, draw {seed}: {'above 1: ' + ', '.join(missed) if missed else 'all met'}")
    for name, both in results.items():
        cells = " | ".join(
            f"{f.lag_ms:4.0f}{f.rms:9.3f}{f.after_lag:9.3f}{f.acceleration_peak:10.2f}{f.acceleration_rms:8.2f}"
            f"{f.acceleration_20ms_peak:8.2f}"
            for f in both
        )
        print(f"  {name:<12}{cells}", flush=True)
