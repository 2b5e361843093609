"""Recordings side by side: each with its name, its colour and its place on a common axis of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.errors import IkNodeError, RecordingError
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.report.ground_truth import FILE_NAME, Truth, read_truth
from ik_node.report.metrics import Report, figures
from ik_node.report.style import SUBJECT_COLOURS
from ik_node.report.text import title

USUAL_NAME = "bag"
"""What ``ik_demo`` calls every recording: its folder's name says more."""


class Subject(NamedTuple):
    """One of the recordings that are reported together."""

    name: str
    run: Run
    report: Report
    colour: str
    zero_s: float = 0.0
    """Moment on the axis of ``Run.times_s`` that is 0 in the pictures."""

    @property
    def times_s(self) -> Array:
        """Of every tick, (k,), on the pictures' axis."""
        result: Array = self.run.times_s - self.zero_s
        return result

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last tick on the pictures' axis."""
        times = self.times_s
        return (float(times[0]), float(times[-1])) if len(times) else (0.0, 0.0)


def subject_of(run: Run, report: Report) -> Subject:
    """One run alone."""
    return Subject(title(report), run, report, SUBJECT_COLOURS[0])


def read_subjects(bags: Sequence[Path], truth: Path | None = None) -> tuple[Subject, ...]:
    """Reads and measures recordings: against ``truth``, else what lies beside each, else the targets in it.

    Several share an axis of time that begins at the first target of each; with one that has no target, at the first
    tick. Raises RecordingError that names the recording when one cannot be read, and our other errors where a robot
    or a truth cannot.
    """
    read = []
    for bag in bags:
        try:
            run = load_run(bag)
            read.append((run, figures(run, _truth(bag, truth))))
        except IkNodeError as error:
            raise error if str(bag) in str(error) else RecordingError(f"'{bag}': {error}") from error
    aligned = len(read) > 1 and all(len(run.targets.times_s) for run, _ in read)
    return tuple(
        Subject(
            name,
            run,
            report,
            SUBJECT_COLOURS[index % len(SUBJECT_COLOURS)],
            float(run.targets.times_s[0]) if aligned else 0.0,
        )
        for index, (name, (run, report)) in enumerate(zip(names_of(bags), read, strict=True))
    )


def names_of(bags: Sequence[Path]) -> tuple[str, ...]:
    """The shortest ends of the paths that tell them apart; the same recording twice is numbered."""
    places = [bag.resolve() for bag in bags]
    parts = [(place.with_suffix("") if place.suffix == ".mcap" else place).parts for place in places]
    lengths = [2 if path[-1] == USUAL_NAME and len(path) > 1 else 1 for path in parts]
    paths = Counter(map(tuple, parts))

    def name(index: int) -> str:
        end = parts[index][-lengths[index] :]
        return "/".join(end[:-1] if end[-1] == USUAL_NAME and len(end) > 1 else end)

    while True:
        names = [name(index) for index in range(len(parts))]
        alike = Counter(names)
        short = [
            index
            for index, path in enumerate(parts)
            if alike[names[index]] > paths[tuple(path)] and lengths[index] < len(path)
        ]
        if not short:
            break
        for index in short:
            lengths[index] += 1
    seen: Counter[str] = Counter()
    for index, given in enumerate(names):
        seen[given] += 1
        names[index] = f"{given} ({seen[given]})" if seen[given] > 1 else given
    return tuple(names)


def span_of(subjects: Sequence[Subject]) -> tuple[float, float]:
    """From the first tick of any to the last of any, on the pictures' axis."""
    spans = [subject.span_s for subject in subjects]
    return min(begin for begin, _ in spans), max(end for _, end in spans)


def time_label(subjects: Sequence[Subject]) -> str:
    """What the axis of time counts from."""
    aligned = any(subject.zero_s for subject in subjects)
    return "time since the first target [s]" if aligned else "time [s]"


def all_joints(subjects: Sequence[Subject]) -> tuple[str, ...]:
    """Every joint's name once, in the order of the first robot that has it."""
    return tuple(dict.fromkeys(joint for subject in subjects for joint in subject.run.joints))


def methods_of(subject: Subject) -> tuple[str, ...]:
    """The method at the start and those that were changed to."""
    changes = (changed["method"] for _, changed in subject.run.setting_changes if "method" in changed)
    return tuple(dict.fromkeys((subject.report.method, *map(str, changes))))


def potential_wrench(subject: Subject) -> Array:
    """The potential's term of the multiplier times 1/k, (k, 6): a wrench, N and N m.

    k is ``gradient_gain`` as it stood at each tick. Where ``null_space_speed`` had lowered k, this is the wrench times
    that part: the k that was used is not in the recording. NaN where k is 0 or not recorded.
    """
    run = subject.run
    gain = np.full(len(run.times_s), _number(run.settings.get("gradient_gain")))
    for time_s, changed in run.setting_changes:
        if "gradient_gain" in changed:
            gain[run.times_s >= time_s] = _number(changed["gradient_gain"])
    with np.errstate(divide="ignore", invalid="ignore"):
        result: Array = run.multiplier_potential / np.where(gain > 0.0, gain, np.nan)[:, None]
    return result


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else np.nan


def _truth(bag: Path, given: Path | None) -> Truth | None:
    """The truth that was given, or that lies beside the recording's folder; None where there is none."""
    if given is not None:
        return read_truth(given)
    place = bag.resolve()
    beside = (place if place.is_dir() else place.parent).parent / FILE_NAME
    return read_truth(beside) if beside.is_file() else None
