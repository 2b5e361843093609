"""Replays an archive: distributes the recordings, keeps finished rows, and writes the tables."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TextIO

from ik_node.errors import MissingPackageError, RecordingError
from ik_node.recording.environment import source_digest
from ik_node.replay.archive import table
from ik_node.replay.archive.bags import FoundBag
from ik_node.replay.archive.page import as_page
from ik_node.replay.archive.row import BagResult, BagRow, ReplayTask

Distribute = Callable[[Sequence[FoundBag], ReplayTask], Iterator[tuple[FoundBag, BagResult]]]
"""Replays recordings and yields the results as they finish."""
ROWS, REPORTS, PAGE = "rows", "reports", "index.html"
ROW_FORMAT = 1
"""Incremented when the fields of a row change, so that kept rows are not read as other ones."""
LINE_PERIOD_S = 5.0
"""Of the progress where it is not a terminal."""
TABLE_PERIOD_S = 10.0
"""Of the tables, so that a call that is killed leaves those of what it had done."""


class ArchiveResult(NamedTuple):
    """The table of an archive."""

    rows: tuple[BagRow, ...]
    """In the order of the recordings."""
    kept: int
    """Rows of an earlier call, which were not computed again."""
    files: tuple[Path, ...]
    """Written tables and the page."""
    notes: tuple[str, ...]
    """What could not be written, and why."""


def replay_archive(
    bags: Sequence[FoundBag],
    task: ReplayTask,
    distribute: Distribute,
    folder: Path,
    output: TextIO | None = None,
    clock_s: Callable[[], float] | None = None,
) -> ArchiveResult:
    """Replays recordings and writes their table.

    Every finished row is kept in the folder. A call that was ended continues where it was; rows are computed again only
    when the recording, the task or this package changed. The tables are written at times and at the end, also at that
    of an interrupted call.

    Args:
        bags: The recordings.
        task: What to do with each.
        distribute: Where they are replayed.
        folder: Of the tables, reports and kept rows; created when it does not exist.
        output: Where the progress is printed; default: stderr.
        clock_s: Steady clock for the recordings per minute in the progress and the times of the tables; default: the
            former are not printed, and the tables are written at the end only.

    Raises:
        RecordingError: The folder cannot be written.
    """
    keys = {bag: _key(bag, task) for bag in bags}
    try:
        for name in (ROWS, REPORTS):
            (folder / name).mkdir(parents=True, exist_ok=True)
        rows = {bag: row for bag in bags if (row := _kept(folder, keys[bag])) is not None}
        kept = len(rows)
        missing = [bag for bag in bags if bag not in rows]
        written_s = clock_s() if clock_s else 0.0
        try:
            with ArchiveProgress(len(bags), kept, output or sys.stderr, clock_s) as progress:
                for bag, result in distribute(missing, task) if missing else ():
                    _keep(folder, keys[bag], result)
                    rows[bag] = result.row
                    progress.advance(bool(result.row.error))
                    if clock_s and clock_s() - written_s >= TABLE_PERIOD_S:
                        _write_tables(rows, keys, folder)
                        written_s = clock_s()
        except KeyboardInterrupt:
            _write_tables(rows, keys, folder)
            done = f"{len(rows)} of {len(bags)} recordings are in {folder / PAGE}; the same command continues"
            print(done, file=output or sys.stderr, flush=True)
            raise
        files, notes = _write_tables(rows, keys, folder)
    except OSError as error:
        raise RecordingError(f"'{folder}' cannot be written: {error.strerror or error}") from error
    return ArchiveResult(tuple(rows[bag] for bag in bags), kept, files, notes)


def _key(bag: FoundBag, task: ReplayTask) -> str:
    """Name of the kept row and report of a recording."""
    known = (ROW_FORMAT, bag, task.methods, sorted(task.changes.items()), task.report, source_digest())
    readable = "".join(character if character.isalnum() else "_" for character in bag.name)[-40:].strip("_")
    return f"{readable}_{hashlib.sha256(repr(known).encode()).hexdigest()[:12]}"


def _kept(folder: Path, key: str) -> BagRow | None:
    try:
        return BagRow(**json.loads((folder / ROWS / f"{key}.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):  # not there, or not written to its end
        return None


def _keep(folder: Path, key: str, result: BagResult) -> None:
    """Writes report and row; the row last and at once, because it says that both are there."""
    if result.html:
        (folder / REPORTS / f"{key}.html").write_text(result.html, encoding="utf-8")
    _replace(folder / ROWS / f"{key}.json", json.dumps(result.row._asdict(), allow_nan=False))


def _write_tables(
    found: Mapping[FoundBag, BagRow], keys: Mapping[FoundBag, str], folder: Path
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Writes the rows that there are, in the order of the recordings; each file is replaced when it is complete."""
    known = [bag for bag in keys if bag in found]
    rows = [found[bag] for bag in known]
    addresses = [f"{REPORTS}/{keys[bag]}.html" for bag in known]
    reports = [address if (folder / address).is_file() else "" for address in addresses]
    texts = {
        "table.csv": table.as_csv(rows),
        "table.json": table.as_json(rows),
        PAGE: as_page(rows, reports, len(keys)),
    }
    for name, text in texts.items():
        _replace(folder / name, text)
    files, notes = [folder / name for name in texts], []
    try:
        partial = folder / "table.parquet.partial"
        table.write_parquet(rows, partial)
        partial.replace(folder / "table.parquet")
        files.append(folder / "table.parquet")
    except MissingPackageError as error:
        notes.append(f"table.parquet was not written: {error}")
    return tuple(files), tuple(notes)


def _replace(path: Path, text: str) -> None:
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


class ArchiveProgress:
    """A line with the number of finished recordings: rewritten on a terminal, printed at times elsewhere."""

    def __init__(self, total: int, kept: int, output: TextIO, clock_s: Callable[[], float] | None) -> None:
        self._total, self._done, self._kept = total, kept, kept
        self._errors = 0
        self._output, self._on_terminal = output, output.isatty()
        self._clock_s = clock_s or (lambda: 0.0)
        self._begin_s = self._clock_s()
        self._next_s = 0.0

    def __enter__(self) -> ArchiveProgress:
        self._show()
        return self

    def __exit__(self, *error: object) -> None:
        self._show(last=True)
        if self._on_terminal:
            print(file=self._output, flush=True)

    def advance(self, failed: bool) -> None:
        """Counts a finished recording."""
        self._done += 1
        self._errors += failed
        self._show()

    def _show(self, last: bool = False) -> None:
        elapsed_s = self._clock_s() - self._begin_s
        if not (last or self._on_terminal or elapsed_s >= self._next_s):
            return
        self._next_s = elapsed_s + LINE_PERIOD_S
        per_s = (self._done - self._kept) / elapsed_s if elapsed_s > 0.0 else 0.0
        line = f"{self._done} of {self._total} recordings"
        line += f", {self._kept} of them done before" if self._kept else ""
        line += f", {self._errors} with an error" if self._errors else ""
        if per_s > 0.0:
            line += f", {60.0 * per_s:.0f} a minute"
            if self._done < self._total:
                line += f", {(self._total - self._done) / per_s:.0f} s left"
        print(f"\r{line:<100}" if self._on_terminal else line, end="" if self._on_terminal else "\n", file=self._output)
        self._output.flush()
