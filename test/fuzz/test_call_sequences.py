"""Calls in any order lead to commands within the limits, never to a fault, and replay bit for bit. Not tested here:
that the arm does what was asked (test/control, test/targets)."""

from __future__ import annotations

import time

import pytest
from call_sequences import COUNTS, CallSequence
from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import run_state_machine_as_test


@pytest.mark.parametrize(("sequences", "calls"), [(12, 25), pytest.param(300, 40, marks=pytest.mark.exhaustive)])
def test_any_sequence_of_calls(sequences: int, calls: int, capsys: pytest.CaptureFixture[str]) -> None:
    COUNTS.clear()
    begin = time.monotonic()
    chosen = settings(
        max_examples=sequences,
        stateful_step_count=calls,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        print_blob=False,
        report_multiple_bugs=False,
        phases=(Phase.generate,),  # a sequence is short enough to be read as it is; shrinking one takes minutes
    )
    run_state_machine_as_test(CallSequence, settings=chosen)
    counts = ", ".join(f"{COUNTS[name]} {name}" for name in ("sequences", "calls", "steps", "refused", "replays"))
    with capsys.disabled():
        print(f"\ncall sequences: {counts}, {time.monotonic() - begin:.0f} s")
    assert COUNTS["steps"] > 20 * sequences
    assert COUNTS["replays"] > 0
