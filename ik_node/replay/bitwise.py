"""Bitwise replay: makes the recorded calls on a new controller and compares every Step with the recorded one.

Nothing is simulated: the controller receives the recorded messages at the recorded times, whatever it commands. A
difference therefore has its cause inside the controller, at the control step where it appears first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ik_node.control.controller_state import ControllerSnapshot
from ik_node.differential_ik.task_problem import MULTIPLIER_FADE_M
from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import TEXT_FIELDS, Step, smallest_singular_value
from ik_node.messages.step_codec import Call, StepEncoder, text_fields
from ik_node.recording.call_log import RecordedCall, RecordedSnapshot, decode_snapshot
from ik_node.recording.environment import differences
from ik_node.recording.input_table import INPUTS
from ik_node.recording.json_codec import to_json
from ik_node.replay.call_source import RecordingSource, make_recorded_call
from ik_node.replay.gc_pause import infrequent_gc
from ik_node.replay.recorded_methods import method_differences

TOLERANCE = 1e-9
"""Largest difference of a number on another platform, in its SI unit; relative to the largest number of a field when
that exceeds 1."""
SINGULAR_TOLERANCE = 1e-2
"""The same where rounding is amplified (5e-3 was measured): smallest singular value below ``NEAR_SINGULAR_M``."""
NEAR_SINGULAR_M = 4.0 * MULTIPLIER_FADE_M
_DECIDED_BY_ROUNDING = (*(entry.name for entry in TEXT_FIELDS), "closest_points")
"""Fields that rounding may change: whether s = 1 - 1e-16 counts as limited, and which of two pairs is closer."""


class Mismatch(NamedTuple):
    """A field of a Step that differs from the recorded one."""

    tick: int
    """Number of the Step; of the previous one when there is none."""
    time_s: float
    """Time since the first call."""
    call: Call
    source: str
    """The call and its message."""
    field: str
    """Of the Step."""
    recorded: str
    replayed: str
    size: float
    """Largest difference in that field, in its SI unit; inf for texts and non-finite numbers."""


@dataclass
class Comparison:
    """Result of a bitwise replay."""

    calls: int = 0
    steps: int = 0
    """Compared Steps."""
    duration_s: float = 0.0
    """From the first call to the last."""
    first: Mismatch | None = None
    """First field whose bits differ."""
    first_beyond_tolerance: Mismatch | None = None
    """First field that differs by more than rounding."""
    max_difference: dict[str, float] = field(default_factory=dict)
    """Field -> largest difference, for numeric fields that differ."""
    text_mismatches: int = 0
    """Steps with other text fields or another closest pair."""
    missing_calls: int = 0
    """Calls that the recording lacks; the replay resumes at the next recorded snapshot."""
    skipped_calls: int = 0
    """Calls between a missing one and the next snapshot."""
    missing_steps: int = 0
    """Steps that the recording lacks."""
    snapshots: int = 0
    """Recorded snapshots that were compared with the state of the controller."""
    environment_differences: tuple[str, ...] = ()
    """Differences of versions and platform that can change bits."""
    method_differences: tuple[str, ...] = ()
    """Own methods that are absent or have another source; part of ``environment_differences``."""

    @property
    def identical(self) -> bool:
        """True when every recorded Step was reproduced bit for bit."""
        return self.first is None

    @property
    def within_tolerance(self) -> bool:
        """True when all differences are within the tolerances and no mode differs."""
        return self.first_beyond_tolerance is None

    @property
    def passed(self) -> bool:
        """True for identical Steps; on another platform or with other versions also for equality within tolerance."""
        equal_elsewhere = bool(self.environment_differences) and self.within_tolerance
        return self.steps > 0 and (self.identical or equal_elsewhere)


def replay(recorded: RecordingSource) -> Comparison:
    """Replays a recording and compares every Step.

    Args:
        recorded: The recording.

    Returns:
        What was compared and what differs.

    Raises:
        RecordingError: The recording is damaged or contains no Step.
    """
    with infrequent_gc():
        return _Replay(recorded).run()


class _Replay:
    def __init__(self, recorded: RecordingSource) -> None:
        self._recorded = recorded
        self._controller = recorded.controller()
        self._encoder = StepEncoder(recorded.head.node, self._controller.robot.n)
        self._result = Comparison(environment_differences=differences(recorded.head.setup["versions"]))
        there, here = recorded.head.setup["geometry"], self._controller.collision_monitor.digest
        if there != here:
            self._result.environment_differences += (f"collision geometry: recorded {there}, here {here}",)
        methods = method_differences(recorded.head.setup["methods"], self._controller)
        self._result.method_differences = methods
        self._result.environment_differences += methods
        self._next_number = 0
        self._last: RecordedCall | None = None
        self._tick = 0
        self._start_ns = 0
        self._desynchronised = False

    def run(self) -> Comparison:
        for entry in self._recorded.entries():
            if isinstance(entry, RecordedSnapshot):
                self._compare_snapshot(entry)
                continue
            if self._last is None:
                self._start_ns, self._next_number = entry.call.now.monotonic_ns, entry.number
            self._replay_call(entry)
            self._last = entry
        if self._last is None or not self._result.steps:
            raise RecordingError(f"'{self._recorded.path}' contains no Step to compare")
        self._result.duration_s = (self._last.call.now.monotonic_ns - self._start_ns) / NS
        return self._result

    def _compare_snapshot(self, recorded: RecordedSnapshot) -> None:
        if self._last is None:  # the initial one, with which the controller was created
            return
        if self._desynchronised:
            self._controller.restore(decode_snapshot(recorded.text, ControllerSnapshot))
            self._desynchronised = False
        elif self._result.identical:
            self._result.snapshots += 1
            replayed = to_json(self._controller.capture())
            if recorded.text != replayed and not self._result.environment_differences:
                self._add(Mismatch(*self._position(self._last), "snapshot", recorded.text, replayed, math.inf), 0.0)

    def _replay_call(self, recorded: RecordedCall) -> None:
        if recorded.number != self._next_number:
            self._result.missing_calls += recorded.number - self._next_number
            self._desynchronised = True
        self._next_number = recorded.number + 1
        if self._desynchronised:
            self._result.skipped_calls += 1
            return
        self._result.calls += 1
        step = make_recorded_call(self._controller, self._recorded, recorded)
        if step is None and recorded.step is None:
            return
        self._tick = self._tick if step is None else step.tick
        if recorded.step is None or step is None:
            self._compare_presence(recorded)
            return
        self._result.steps += 1
        texts = self._recorded.steps.texts_of(recorded.step)
        same_texts = texts.fields == text_fields(step)
        if not same_texts or recorded.step != self._encoder.numbers(step, texts.number):
            self._compare_fields(recorded, self._recorded.steps.step(recorded.step), step)

    def _compare_presence(self, recorded: RecordedCall) -> None:
        """Only the recording or only the replay has a Step."""
        if recorded.step is None and self._recorded.lossy:
            self._result.missing_steps += 1
            return
        there, here = ("none", "a Step") if recorded.step is None else ("a Step", "none")
        self._add(Mismatch(*self._position(recorded), "step", there, here, math.inf), 0.0)

    def _compare_fields(self, call: RecordedCall, recorded: Step, replayed: Step) -> None:
        near_singular = smallest_singular_value(recorded.singular_values) < NEAR_SINGULAR_M
        tolerance = SINGULAR_TOLERANCE if near_singular else TOLERANCE
        same_mode = recorded.status.mode is replayed.status.mode
        texts_differ = False
        for name in Step._fields:
            one, two = getattr(recorded, name), getattr(replayed, name)
            size = _difference(one, two)
            if size is not None:
                decided_by_rounding = name in _DECIDED_BY_ROUNDING
                texts_differ |= decided_by_rounding
                mismatch = Mismatch(*self._position(call), name, _shown(one), _shown(two), size)
                self._add(mismatch, math.inf if decided_by_rounding and same_mode else tolerance * _magnitude(one))
        self._result.text_mismatches += texts_differ

    def _add(self, mismatch: Mismatch, tolerance: float) -> None:
        result = self._result
        result.first = result.first or mismatch
        if mismatch.size > tolerance:
            result.first_beyond_tolerance = result.first_beyond_tolerance or mismatch
        if mismatch.field not in _DECIDED_BY_ROUNDING:
            largest = result.max_difference.get(mismatch.field, 0.0)
            result.max_difference[mismatch.field] = max(largest, mismatch.size)

    def _position(self, recorded: RecordedCall) -> tuple[int, float, Call, str]:
        """The first entries of a :class:`Mismatch`."""
        call = recorded.call
        source = f", message {call.sequence} of {INPUTS[call.kind].name}" if call.kind in INPUTS else ""
        time_s = (call.now.monotonic_ns - self._start_ns) / NS
        return self._tick, time_s, call, call.kind.name.lower() + source


def _difference(one: Any, two: Any) -> float | None:
    """Largest difference; None for equal bits. NaN equals NaN, and differs from other values by inf."""
    if isinstance(one, np.ndarray):
        if one.tobytes() == two.tobytes():
            return None
        with np.errstate(invalid="ignore"):  # inf - inf
            apart = np.where((one == two) | (np.isnan(one) & np.isnan(two)), 0.0, np.abs(one - two))
        return float(np.where(np.isnan(apart), np.inf, apart).max())
    if isinstance(one, float):
        return _difference(np.array(one), np.array(two))
    return None if one == two else math.inf


def _magnitude(value: Any) -> float:
    """The largest finite absolute value in a field, at least 1."""
    numbers = np.abs(np.asarray(value, dtype=np.float64)) if isinstance(value, (np.ndarray, float)) else np.zeros(0)
    return float(np.max(numbers, initial=1.0, where=np.isfinite(numbers)))


def _shown(value: Any) -> str:
    return str(value.tolist()) if isinstance(value, np.ndarray) else str(value)
