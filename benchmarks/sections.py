"""Parts of a benchmark: each gives lines to print and whether its figures are within their bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Part = Callable[[], tuple[list[str], bool]]


def print_parts(parts: Mapping[str, Part], only: str | None) -> int:
    """Prints ``only`` that part, or all; returns the exit code: 1 when a figure is out of its bounds."""
    good = True
    for name, part in parts.items():
        if only in (None, name):
            lines, within = part()
            print(f"\n{name}: {'within its bounds' if within else 'OUT OF ITS BOUNDS'}")
            print("\n".join(lines), flush=True)
            good &= within
    return 0 if good else 1
