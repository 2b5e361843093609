"""Sections of a benchmark: each returns lines to print and whether its figures are within their bounds."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple


class SectionResult(NamedTuple):
    """The result of one section."""

    lines: list[str]
    """Text to print."""
    within: bool
    """True when all figures are within their bounds."""
    rows: Sequence[Mapping[str, Any]] = ()
    """The figures, for JSON."""


Section = Callable[[], SectionResult]


def print_sections(sections: Mapping[str, Section], only: Sequence[str], as_json: bool) -> int:
    """Run and print sections.

    Args:
        sections: Name -> section.
        only: Names of the sections to run; all when empty.
        as_json: Print one object per row instead of the lines.

    Returns:
        Exit code: 1 when a figure is out of its bounds.
    """
    within = True
    for name, section in sections.items():
        if only and name not in only:
            continue
        result = section()
        within &= result.within
        if as_json:
            for row in result.rows:
                print(json.dumps({"section": name, **row}), flush=True)
        else:
            print(f"\n{name}: {'within its bounds' if result.within else 'OUT OF ITS BOUNDS'}")
            print("\n".join(result.lines), flush=True)
    return 0 if within else 1
