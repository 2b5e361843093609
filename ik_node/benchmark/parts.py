"""Parts of a benchmark: each gives lines to print and whether its figures are within their bounds."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple


class Found(NamedTuple):
    """What a part gives."""

    lines: list[str]
    """To print."""
    within: bool
    """Whether all figures are within their bounds."""
    rows: Sequence[Mapping[str, Any]] = ()
    """The figures, for machines."""


Part = Callable[[], Found]


def print_parts(parts: Mapping[str, Part], only: Sequence[str], as_json: bool) -> int:
    """Prints the parts named in ``only``, or all; returns the exit code: 1 when a figure is out of its bounds.

    ``as_json``: one object per row instead of the lines.
    """
    good = True
    for name, part in parts.items():
        if only and name not in only:
            continue
        found = part()
        good &= found.within
        if as_json:
            for row in found.rows:
                print(json.dumps({"part": name, **row}), flush=True)
        else:
            print(f"\n{name}: {'within its bounds' if found.within else 'OUT OF ITS BOUNDS'}")
            print("\n".join(found.lines), flush=True)
    return 0 if good else 1
