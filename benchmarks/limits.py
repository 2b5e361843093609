"""``ik_benchmark limits``: stress targets, starts outside limits, lag and noise, singularities."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from benchmarks import limit_stress, singularities
from benchmarks.arms import ROBOTS
from benchmarks.sections import Section, print_sections
from benchmarks.singularities import WAYS


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; return 1 when one is out of its bounds."""
    parser = argparse.ArgumentParser(prog="ik_benchmark limits", description=__doc__)
    parser.add_argument("--ticks", type=int, default=1_000_000, help="control steps with stress targets, in total")
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers")
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS), help="robots of the stress targets [%(default)s]")
    parser.add_argument("--lag-ticks", type=int, default=5000, help="control steps per lag and noise")
    parser.add_argument("--drives", nargs="+", default=[""], help="singularities: only runs with such a name")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS), help="singularities: solvers to compare")
    names = ("stress", "outside", "lag", "singularities")
    parser.add_argument("--only", choices=names, nargs="+", default=[], help="sections to run [all]")
    parser.add_argument("--json", action="store_true", help="one JSON object per row instead of the tables")
    options = parser.parse_args(arguments)
    sections: dict[str, Section] = {
        "stress": lambda: limit_stress.table(options.ticks, options.seed, options.robots),
        "outside": lambda: limit_stress.outside(options.seed),
        "lag": lambda: limit_stress.lag_table(options.lag_ticks),
        "singularities": lambda: singularities.table(options.drives, options.ways),
    }
    return print_sections(sections, options.only, options.json)


if __name__ == "__main__":
    sys.exit(main())
