"""Published figures, for comparison.

TRAC-IK: the table of its README (v1.5.1): 10,000 random reachable joint positions per chain, pose within 1e-5, 5 ms
allowed, start at the middle of the joint limits, limits kept, times include failures.

Haviland and Corke, Manipulator Differential Kinematics, parts 1 and 2 (arXiv 2207.01796, 2207.01794), as computed by
their notebooks (github.com/jhavl/dkt); :mod:`benchmarks.haviland_corke` describes the protocol.
"""

from __future__ import annotations

from typing import NamedTuple


class PublishedReach(NamedTuple):
    """Solved poses in percent and mean time in ms, of three solvers."""

    kdl: tuple[float, float]
    kdl_restarts: tuple[float, float]
    trac_ik: tuple[float, float]


TRAC_IK = {
    "panda": PublishedReach((62.02, 2.11), (93.21, 0.79), (99.88, 0.37)),
    "ur3": PublishedReach((17.11, 4.18), (89.08, 0.77), (98.60, 0.45)),
    "ur5": PublishedReach((16.52, 4.21), (88.58, 0.74), (99.17, 0.37)),
    "ur10": PublishedReach((14.90, 4.29), (88.63, 0.74), (99.33, 0.36)),
}


class PublishedRow(NamedTuple):
    """A row of Haviland and Corke, with the row of their C++ solver for the same method if there is one."""

    method: str
    mean_iterations: float
    median_iterations: float
    infeasible_percent: float
    mean_searches: float
    max_searches: int
    outside_percent: float
    mean_iterations_cpp: float | None = None


class PublishedTable(NamedTuple):
    """A table of Haviland and Corke: settings and rows."""

    title: str
    robot: str
    seed: int
    steps: int
    searches: int
    refuse_outside: bool
    rows: tuple[PublishedRow, ...]


HAVILAND_CORKE = (
    PublishedTable(
        "Part 1, UR5, one search of up to 500 steps", "ur5", 0, 500, 1, False,
        (
            PublishedRow("NR", 21.06, 16, 11.02, 1.0, 1, 0.00),
            PublishedRow("GN", 21.41, 16, 11.00, 1.0, 1, 0.00),
            PublishedRow("NR pinv", 21.15, 16, 11.10, 1.0, 1, 0.00),
            PublishedRow("GN pinv", 21.91, 16, 10.73, 1.0, 1, 0.00),
            PublishedRow("LM Wampler 0.0001", 20.41, 14, 9.21, 1.0, 1, 0.00),
            PublishedRow("LM Wampler 1e-06", 30.42, 17, 5.35, 1.0, 1, 0.00),
            PublishedRow("LM Chan 1", 16.58, 14, 10.11, 1.0, 1, 0.00),
            PublishedRow("LM Chan 0.1", 9.43, 9, 9.61, 1.0, 1, 0.00),
            PublishedRow("LM Sugihara 0.001", 20.54, 15, 10.24, 1.0, 1, 0.00),
            PublishedRow("LM Sugihara 0.0001", 17.01, 14, 10.11, 1.0, 1, 0.00),
        ),
    ),
    PublishedTable(
        "Part 1, UR5, up to 100 searches of 30 steps", "ur5", 0, 30, 100, False,
        (
            PublishedRow("NR", 29.94, 18, 0.00, 1.46, 19, 0.00, 28.85),
            PublishedRow("GN", 30.51, 18, 0.00, 1.48, 31, 0.00, 29.37),
            PublishedRow("NR pinv", 30.17, 18, 0.00, 1.47, 17, 0.00, 29.30),
            PublishedRow("GN pinv", 30.07, 18, 0.00, 1.47, 18, 0.00, 29.32),
            PublishedRow("LM Wampler 0.0001", 25.16, 15, 0.00, 1.35, 21, 0.00, 23.92),
            PublishedRow("LM Wampler 1e-06", 29.13, 18, 0.00, 1.44, 27, 0.00, 28.86),
            PublishedRow("LM Chan 1", 22.60, 15, 0.00, 1.25, 18, 0.00, 21.47),
            PublishedRow("LM Chan 0.1", 15.33, 9, 0.00, 1.20, 18, 0.00, 15.12),
            PublishedRow("LM Sugihara 0.001", 26.49, 16, 0.00, 1.35, 18, 0.00, 25.95),
            PublishedRow("LM Sugihara 0.0001", 23.04, 15, 0.00, 1.26, 18, 0.00, 22.38),
        ),
    ),
    PublishedTable(
        "Part 2, UR5, up to 100 searches of 30 steps, joint limits refused", "ur5", 10, 30, 100, True,
        (
            PublishedRow("NR pinv", 28.63, 16, 0.00, 1.46, 29, 0.00),
            PublishedRow("LM Chan 0.1", 15.52, 8, 0.00, 1.21, 14, 0.00),
            PublishedRow("LM Wampler 0.0001", 23.75, 13, 0.00, 1.35, 20, 0.00),
            PublishedRow("LM Sugihara 0.0001", 21.89, 13, 0.00, 1.27, 19, 0.00),
        ),
    ),
    PublishedTable(
        "Part 2, Panda, up to 100 searches of 30 steps, joint limits only counted", "panda", 10, 30, 100, False,
        (
            PublishedRow("NR pinv", 27.60, 16, 0.00, 1.41, 13, 66.97),
            PublishedRow("LM Chan 0.1", 11.91, 8, 0.00, 1.12, 7, 53.94),
        ),
    ),
    PublishedTable(
        "Part 2, Panda, up to 100 searches of 30 steps, joint limits refused", "panda", 10, 30, 100, True,
        (
            PublishedRow("NR pinv", 137.67, 80, 1.03, 7.39, 100, 0.00),
            PublishedRow("LM Wampler 0.0001", 127.83, 76, 1.01, 7.13, 99, 0.00),
            PublishedRow("LM Chan 0.1", 37.55, 18, 0.91, 3.81, 86, 0.00),
            PublishedRow("LM Sugihara 0.0001", 50.13, 26, 0.89, 3.64, 76, 0.00),
        ),
    ),
)  # fmt: skip
