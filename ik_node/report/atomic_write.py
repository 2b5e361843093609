"""Which function writes a report of which kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ik_node.errors import InputError
from ik_node.report.document import write_pdf, write_png, write_svg
from ik_node.report.html import write_html
from ik_node.report.reported_run import Subject

Writer = Callable[[Sequence[Subject], Path], None]
WRITERS: Mapping[str, Writer] = {".png": write_png, ".pdf": write_pdf, ".html": write_html, ".svg": write_svg}
"""Ending of a file -> what writes it; an existing file is replaced."""


def writer_for(path: Path) -> Writer:
    """What writes a file of this ending; InputError that lists the endings when nothing does."""
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"'{path}' ends in '{path.suffix}'; valid: {', '.join(WRITERS)}")
    return WRITERS[path.suffix.lower()]
