"""Messages and files of any content are read or refused with an error of this package, in one line. Not tested here:
what valid ones mean (the tests of their folders).

Hypothesis mutates valid inputs in this process; atheris, guided by coverage, in processes of its own.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pytest
from fuzz_targets import TARGETS, check_input, remove_sandbox
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

IN_THIS_PROCESS = sorted(set(TARGETS) - {"robot"})
"""Pinocchio reads descriptions in processes of their own only."""
NEEDS_ATHERIS = pytest.mark.skipif(
    importlib.util.find_spec("atheris") is None, reason="atheris has no wheel for this Python or platform"
)
LONGEST_RUN_S = 1800.0
"""After this time a process of atheris is ended."""


class AtherisRun(NamedTuple):
    """Result of one process."""

    target: str
    inputs: int
    elapsed_s: float
    fault: str
    """End of its output when it found one; empty for none."""


@pytest.fixture(scope="module", autouse=True)
def _sandbox() -> Iterator[None]:
    yield
    remove_sandbox()


@st.composite
def mutations(draw: st.DrawFn, seeds: list[bytes], words: tuple[bytes, ...]) -> bytes:
    """A valid input with some bytes replaced, inserted, removed or repeated; or any bytes."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.binary(max_size=200))
    data = bytearray(draw(st.sampled_from(seeds)))
    pieces = st.binary(max_size=8)
    if words:
        pieces |= st.sampled_from(words)
    for _ in range(draw(st.integers(1, 4))):
        begin = draw(st.integers(0, len(data)))
        end = min(len(data), begin + draw(st.sampled_from((0, 1, 4, 8, 8, 64))))
        kind = draw(st.sampled_from(("replace", "insert", "remove", "repeat", "cut")))
        if kind == "replace":
            data[begin:end] = draw(pieces)
        elif kind == "insert":
            data[begin:begin] = draw(pieces)
        elif kind == "remove":
            del data[begin:end]
        elif kind == "repeat":
            data[begin:begin] = data[begin:end] * draw(st.integers(1, 3))
        else:
            del data[begin:]
    return bytes(data)


@pytest.mark.parametrize("name", IN_THIS_PROCESS)
def test_mutated_inputs_are_read_or_refused(name: str) -> None:
    target = TARGETS[name]
    seeds = target.seeds()
    for seed in seeds:
        assert check_input(target, seed), "a valid input is refused"

    @settings(max_examples=40, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @given(mutations(seeds, target.words))
    def run(data: bytes) -> None:
        check_input(target, data)

    run()


def atheris_run(target: str, runs: int, folder: Path) -> AtherisRun:
    """Fuzzes a target with atheris in a process of its own."""
    folder.mkdir()
    command = [sys.executable, str(Path(__file__).with_name("atheris_run.py")), target, f"-runs={runs}"]
    begin = time.monotonic()
    with (folder / "output").open("w+b") as output:
        code = subprocess.run(
            [*command, f"-artifact_prefix={folder}/"],
            stdout=output,
            stderr=subprocess.STDOUT,
            timeout=LONGEST_RUN_S,
            check=False,
            env={**os.environ, "TMPDIR": str(folder)},
        ).returncode
        output.seek(0)
        text = output.read().decode(errors="replace")
    done = re.findall(r"^Done (\d+) runs|^#(\d+)\s", text, re.MULTILINE)
    inputs = max((int(one or other) for one, other in done), default=0)
    fault = "" if code == 0 else f"{target}: exit code {code}\n{text[-3000:]}"
    return AtherisRun(target, inputs, time.monotonic() - begin, fault)


@NEEDS_ATHERIS
def test_coverage_guided_inputs_are_read_or_refused(tmp_path: Path) -> None:
    """The short, seeded run: all targets in one process."""
    result = atheris_run("all", 4000, tmp_path / "run")
    assert result.fault == ""
    assert result.inputs >= 4000


@NEEDS_ATHERIS
@pytest.mark.exhaustive
def test_a_million_coverage_guided_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = sorted(TARGETS, key=lambda name: -TARGETS[name].runs)
    begin = time.monotonic()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(pool.map(lambda name: atheris_run(name, TARGETS[name].runs, tmp_path / name), names))
    lines = [f"{'target':24} {'inputs':>9} {'s':>7} {'1/s':>7}"]
    for result in results:
        rate = result.inputs / result.elapsed_s
        lines.append(f"{result.target:24} {result.inputs:9d} {result.elapsed_s:7.0f} {rate:7.0f}")
    total = sum(result.inputs for result in results)
    lines.append(f"{'together':24} {total:9d} {time.monotonic() - begin:7.0f}")
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert [result.fault for result in results if result.fault] == []
    assert total >= 1_000_000
