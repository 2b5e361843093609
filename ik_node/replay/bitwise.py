"""The recorded calls through a controller, and whether the same Steps come of them, bit for bit.

Nothing is simulated: the controller gets the recorded messages at the recorded times, whatever it answers. So what
parts does so for a reason inside the controller, and at the tick where it is first seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Step
from ik_node.messages.step_codec import Call, StepEncoder, words_of
from ik_node.recording.call_log import Checkpoint, Event, RecordedCalls
from ik_node.recording.environment import differences
from ik_node.recording.input_table import INPUTS
from ik_node.recording.json_codec import to_json
from ik_node.replay.call_source import make
from ik_node.replay.gc_pause import seldom_collecting

TOLERANCE = 1e-9
"""Elsewhere, with another processor's kernels, no number of a Step may part by more than this, in its SI unit; fields
larger than 1 by no more than this part of their largest number."""
SINGULAR_TOLERANCE = 1e-2
"""The same where rounding is amplified (5e-3 was seen): with the smallest singular value below ``NEAR`` thresholds."""
NEAR = 4.0
_SAYINGS = ("status", "binding", "closest_pair", "closest_points")
"""What rounding may decide: whether s = 1 - 1e-16 counts as slowed down, and which of two is nearer."""


class Parting(NamedTuple):
    """One number of one Step that is not what was recorded."""

    tick: int
    """Running number of the Step; of the last one before, where there is none."""
    time_s: float
    """From the first call."""
    call: Call
    source: str
    """What was called, with which message."""
    field: str
    """Of the Step."""
    recorded: str
    replayed: str
    size: float
    """Largest difference in that field, in its SI unit; inf where it is no number's."""


@dataclass
class Comparison:
    """What came of a replay."""

    calls: int = 0
    ticks: int = 0
    """Steps that were compared."""
    duration_s: float = 0.0
    """From the first call to the last."""
    first: Parting | None = None
    """Where bits part first."""
    beyond: Parting | None = None
    """Where something parts first by more than rounding does."""
    largest: dict[str, float] = field(default_factory=dict)
    """Field -> largest difference, of the numbers that differ."""
    sayings: int = 0
    """Steps that say something else: about status, limits that bind, or the closest pair."""
    lost_calls: int = 0
    """Calls that the recording does not hold; the replay goes on at the next recorded state."""
    skipped_calls: int = 0
    """Calls between a lost one and the next recorded state."""
    lost_steps: int = 0
    """Steps that the recording does not hold."""
    checkpoints: int = 0
    """Recorded states that were compared with the controller's."""
    elsewhere: tuple[str, ...] = ()
    """What is different here from where the recording was made, as far as bits depend on it."""

    @property
    def identical(self) -> bool:
        """Every Step that the recording holds came out with the same bits."""
        return self.first is None

    @property
    def within_tolerance(self) -> bool:
        """No number parts by more than :data:`TOLERANCE` (:data:`SINGULAR_TOLERANCE`), and no mode is another."""
        return self.beyond is None

    @property
    def holds(self) -> bool:
        """The same bits; on another machine or with other versions, the same but for rounding."""
        return self.ticks > 0 and (self.identical or (bool(self.elsewhere) and self.within_tolerance))


def replay(recorded: RecordedCalls) -> Comparison:
    """All of a recording through a new controller. RecordingError where it is damaged or holds no Step to compare."""
    with seldom_collecting():
        return _Replay(recorded).run()


class _Replay:
    def __init__(self, recorded: RecordedCalls) -> None:
        self._recorded = recorded
        self._controller = recorded.controller()
        self._encoder = StepEncoder(recorded.head.node, self._controller.robot.n)
        self._found = Comparison(elsewhere=differences(recorded.head.setup["versions"]))
        there, here = recorded.head.setup["geometry"], self._controller.geometry
        if there != here:
            self._found.elsewhere += (f"collision geometry {there} there, {here} here",)
        self._next = 0
        self._last: Event | None = None
        self._tick = 0
        self._start_ns = 0
        self._astray = False

    def run(self) -> Comparison:
        for entry in self._recorded.events():
            if isinstance(entry, Checkpoint):
                self._at_checkpoint(entry)
                continue
            if self._last is None:
                self._start_ns, self._next = entry.call.now.monotonic_ns, entry.number
            self._take(entry)
            self._last = entry
        if self._last is None or not self._found.ticks:
            raise RecordingError(f"'{self._recorded.path}' holds no tick to compare")
        self._found.duration_s = (self._last.call.now.monotonic_ns - self._start_ns) / NS
        return self._found

    def _at_checkpoint(self, checkpoint: Checkpoint) -> None:
        if self._last is None:  # the one at the beginning, which the controller started with
            return
        if self._astray:
            self._controller.restore(checkpoint.state)
            self._astray = False
        elif self._found.identical:
            self._found.checkpoints += 1
            there, here = to_json(checkpoint.state), to_json(self._controller.capture())
            if there != here and not self._found.elsewhere:
                self._note(Parting(*self._where(self._last), "state", there, here, math.inf), 0.0)

    def _take(self, event: Event) -> None:
        if event.number != self._next:
            self._found.lost_calls += event.number - self._next
            self._astray = True
        self._next = event.number + 1
        if self._astray:
            self._found.skipped_calls += 1
            return
        self._found.calls += 1
        step = make(self._controller, self._recorded, event)
        if step is None and event.step is None:
            return
        self._tick = self._tick if step is None else step.tick
        if event.step is None or step is None:
            self._only_one(event, step)
            return
        self._found.ticks += 1
        texts = self._recorded.steps.texts_of(event.step)
        same_texts = texts.words == words_of(step)
        if not same_texts or event.step != self._encoder.numbers(step, texts.number):
            self._part(event, self._recorded.steps.step(event.step), step)

    def _only_one(self, event: Event, step: Step | None) -> None:
        """A Step that only the recording, or only the replay has."""
        if event.step is None and self._recorded.lossy:
            self._found.lost_steps += 1
            return
        there, here = ("none", "a Step") if event.step is None else ("a Step", "none")
        self._note(Parting(*self._where(event), "step", there, here, math.inf), 0.0)

    def _part(self, event: Event, recorded: Step, replayed: Step) -> None:
        """Every field in which both differ."""
        smallest = recorded.singular_values[-1]
        singular = smallest < NEAR * self._controller.settings.control.singularity_threshold
        tolerance = SINGULAR_TOLERANCE if singular else TOLERANCE
        same_mode = recorded.status.mode is replayed.status.mode
        other_sayings = False
        for name in Step._fields:
            one, two = getattr(recorded, name), getattr(replayed, name)
            size = _difference(one, two)
            if size is not None:
                saying = name in _SAYINGS
                other_sayings |= saying
                parting = Parting(*self._where(event), name, _shown(one), _shown(two), size)
                self._note(parting, math.inf if saying and same_mode else tolerance * _scale(one))
        self._found.sayings += other_sayings

    def _note(self, parting: Parting, tolerance: float) -> None:
        found = self._found
        found.first = found.first or parting
        if parting.size > tolerance:
            found.beyond = found.beyond or parting
        if parting.field not in _SAYINGS:
            found.largest[parting.field] = max(found.largest.get(parting.field, 0.0), parting.size)

    def _where(self, event: Event) -> tuple[int, float, Call, str]:
        call = event.call
        source = f", message {call.sequence} of {INPUTS[call.kind].name}" if call.kind in INPUTS else ""
        time_s = (call.now.monotonic_ns - self._start_ns) / NS
        return self._tick, time_s, call, call.kind.name.lower() + source


def _difference(one: Any, two: Any) -> float | None:
    """How far apart; None when the same to the last bit. NaN is the same as NaN, and infinitely far from the rest."""
    if isinstance(one, np.ndarray):
        if one.tobytes() == two.tobytes():
            return None
        with np.errstate(invalid="ignore"):  # inf - inf
            apart = np.where((one == two) | (np.isnan(one) & np.isnan(two)), 0.0, np.abs(one - two))
        return float(np.where(np.isnan(apart), np.inf, apart).max())
    if isinstance(one, float):
        return _difference(np.array(one), np.array(two))
    return None if one == two else math.inf


def _scale(value: Any) -> float:
    """The largest finite number in a field, at least 1."""
    numbers = np.abs(np.asarray(value, dtype=np.float64)) if isinstance(value, (np.ndarray, float)) else np.zeros(0)
    return float(np.max(numbers, initial=1.0, where=np.isfinite(numbers)))


def _shown(value: Any) -> str:
    return str(value.tolist()) if isinstance(value, np.ndarray) else str(value)
