"""``ik_benchmark limits``: the bounded optimum, hostile targets, starts outside, lag and noise, singularities."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from benchmarks import limit_stress, reference_solvers, singularities
from benchmarks.sections import Part, print_parts


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the figures; 1 when one is out of its bounds."""
    parser = argparse.ArgumentParser(prog="ik_benchmark limits", description=__doc__)
    parser.add_argument("--states", type=int, default=10_000, help="random states for each robot and method")
    parser.add_argument("--ticks", type=int, default=1_000_000, help="ticks of hostile targets, over all robots")
    parser.add_argument("--seed", type=int, default=1, help="of everything random")
    parser.add_argument(
        "--only", choices=("optimum", "hostile", "outside", "lag", "singularities"), help="one part instead of all"
    )
    options = parser.parse_args(arguments)
    parts: dict[str, Part] = {
        "optimum": lambda: reference_solvers.table(options.states, options.seed),
        "hostile": lambda: limit_stress.table(options.ticks, options.seed),
        "outside": lambda: limit_stress.outside(options.seed),
        "lag": limit_stress.lag_table,
        "singularities": singularities.table,
    }
    return print_parts(parts, options.only)


if __name__ == "__main__":
    sys.exit(main())
