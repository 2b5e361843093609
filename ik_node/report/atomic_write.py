"""Writing a report as PNG, PDF, SVG or HTML, by the ending of its name."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ik_node.errors import InputError
from ik_node.report.canvas import convert_write_errors
from ik_node.report.document import write_pdf, write_png, write_svg
from ik_node.report.html import write_html
from ik_node.report.reported_run import ReportedRun

ReportWriter = Callable[[Sequence[ReportedRun], Path], None]
WRITERS: Mapping[str, ReportWriter] = {".png": write_png, ".pdf": write_pdf, ".html": write_html, ".svg": write_svg}
"""Suffix of a file -> function that writes it."""


def check_suffix(path: Path) -> None:
    """Raises InputError, which lists the valid suffixes, when no report can be written as ``path``."""
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"'{path}' ends in '{path.suffix}'; valid: {', '.join(WRITERS)}")


def write_report(reported_runs: Sequence[ReportedRun], path: Path) -> None:
    """Writes a report; an existing file is replaced only when the new one is complete.

    Args:
        reported_runs: One recording, or several that are compared.
        path: The file; its suffix selects the format.

    Raises:
        InputError: The suffix is none of ``WRITERS``.
        RecordingError: The file cannot be written.
        MissingPackageError: matplotlib is not installed.
    """
    check_suffix(path)
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        WRITERS[path.suffix.lower()](reported_runs, partial)
        with convert_write_errors():
            partial.replace(path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
