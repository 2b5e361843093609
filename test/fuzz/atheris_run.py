"""Fuzzes one target, coverage-guided: ``python atheris_run.py TARGET [options of libFuzzer]``.

A process of its own, so that a crash of compiled code is found like any other fault. The target ``all`` chooses by the
first byte of the input; it is the short version.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import atheris

PACKAGE = Path(__file__).resolve().parent.parent.parent / "ik_node"


def compiled_modules() -> list[str]:
    """Modules with functions that numba compiles; those cannot be instrumented."""
    found = [path for path in PACKAGE.rglob("*.py") if "ik_node.jit import" in path.read_text()]
    return [".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in found]


with atheris.instrument_imports(include=["ik_node", "mcap", "fuzz_targets"], exclude=compiled_modules()):
    from fuzz_targets import TARGETS, check_input, remove_sandbox

LONGEST_S = 120
"""Time for one input, also on a machine that pauses, after which libFuzzer reports it."""
MOST_MB = 1500
"""Memory of the process."""


def main() -> None:
    """Write the seeds and the words of the target, and let libFuzzer run; it ends the process."""
    name, *options = sys.argv[1:]
    names = sorted(TARGETS) if name == "all" else [name]
    folder = Path(tempfile.mkdtemp(prefix="ik_node_fuzz_corpus_"))
    corpus, words = folder / "corpus", folder / "words"
    corpus.mkdir()
    for number, one in enumerate(names):
        for index, seed in enumerate(TARGETS[one].seeds()):
            (corpus / f"{one}_{index}").write_bytes((bytes((number,)) if name == "all" else b"") + seed)
    listed = dict.fromkeys(word for one in names for word in TARGETS[one].words)
    escaped = ["".join(f"{chr(92)}x{byte:02x}" for byte in word) for word in listed]
    if escaped:
        words.write_text("".join(f'"{word}"\n' for word in escaped))
        options.append(f"-dict={words}")

    def run(data: bytes) -> None:
        number, rest = (data[0], data[1:]) if name == "all" and data else (0, data)
        check_input(TARGETS[names[number % len(names)]], rest)

    limits = [f"-timeout={LONGEST_S}", f"-rss_limit_mb={MOST_MB}", f"-max_len={TARGETS[names[0]].max_bytes}"]
    if name == "all":
        limits[-1] = "-max_len=16384"
    atheris.Setup([sys.argv[0], *limits, "-seed=1", *options, str(corpus)], run)
    try:
        atheris.Fuzz()
    finally:
        remove_sandbox()


if __name__ == "__main__":
    main()
