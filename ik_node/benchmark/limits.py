"""``ik_benchmark limits``: hostile targets, starts outside, lag and noise, singularities."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ik_node.benchmark import hostile, singularities
from ik_node.benchmark.arms import ROBOTS
from ik_node.benchmark.parts import Part, print_parts
from ik_node.benchmark.singularities import WAYS


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the figures; 1 when one is out of its bounds."""
    parser = argparse.ArgumentParser(prog="ik_benchmark limits", description=__doc__)
    parser.add_argument("--ticks", type=int, default=1_000_000, help="ticks of hostile targets, over all robots")
    parser.add_argument("--seed", type=int, default=1, help="of everything random")
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS), help="for hostile targets [%(default)s]")
    parser.add_argument("--lag-ticks", type=int, default=5000, help="ticks of each lag and noise")
    parser.add_argument("--drives", nargs="+", default=[""], help="singularities: drives whose name holds one of these")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS), help="singularities: ways to pass them")
    names = ("hostile", "outside", "lag", "singularities")
    parser.add_argument("--only", choices=names, nargs="+", default=[], help="these parts instead of all")
    parser.add_argument("--json", action="store_true", help="one JSON object per row instead of the tables")
    options = parser.parse_args(arguments)
    parts: dict[str, Part] = {
        "hostile": lambda: hostile.table(options.ticks, options.seed, options.robots),
        "outside": lambda: hostile.outside(options.seed),
        "lag": lambda: hostile.lag_table(options.lag_ticks),
        "singularities": lambda: singularities.table(options.drives, options.ways),
    }
    return print_parts(parts, options.only, options.json)


if __name__ == "__main__":
    sys.exit(main())
