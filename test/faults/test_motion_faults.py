"""Faults of joint states, targets, obstacles and requests while an arm moves, over DDS, for each method.

For each: the largest command over the limit in force, commands that are not finite, the largest acceleration over its
limit, the time to zero velocity, the status and the way back. ``--exhaustive`` runs all of them for all methods.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from fault import choose, chosen_methods, spread
from fault_table import failures
from request_faults import REQUEST_FAULTS
from session import session
from state_faults import STATE_FAULTS
from target_faults import OBSTACLE_FAULTS, TARGET_FAULTS

GROUPS = {"states": STATE_FAULTS, "targets": TARGET_FAULTS, "obstacles": OBSTACLE_FAULTS, "requests": REQUEST_FAULTS}
CHOSEN = {"states": 5, "targets": 3, "obstacles": 3, "requests": 4}
"""Faults of each group in one run without ``--exhaustive``."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    metafunc.parametrize("method", chosen_methods(metafunc.config, "motion"))


def test_motion_faults(method: str, tmp_path: Path, pytestconfig: pytest.Config, record_property: object) -> None:
    chosen = [fault for group, faults in GROUPS.items() for fault in choose(pytestconfig, group, faults, CHOSEN[group])]
    with session(tmp_path, method) as node:
        for fault in spread(chosen):
            node.run(fault)
        rows = node.rows()
    record_property("fault_rows", [list(row) for row in rows])  # type: ignore[operator]
    assert not failures(rows), "\n".join(failures(rows))
