"""Set-up before rclpy is loaded: test processes do not communicate with other processes on the computer."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path

import pytest
from domains import own_domain
from support import Run

PROJECT = Path(__file__).resolve().parent.parent

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROJECT / "config" / "fastdds_quick_discovery.xml")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp(prefix="ik_node_test_log_"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("RMW_IMPLEMENTATION", None)
# Tests send these signals to their children; background jobs of a shell and nohup leave them ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


_while_this_runs = ExitStack()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--exhaustive`` (also the tests that are required before a release only) and those of test/faults."""
    parser.addoption("--exhaustive", action="store_true", help="also run the tests that repeat others with more cases")
    parser.addoption("--fault-seed", type=int, default=18, help="chooses the faults of test/faults [18]")
    parser.addoption("--fault-table", type=Path, help="file for the table of test/faults")


def pytest_configure(config: pytest.Config) -> None:
    """Compile once what all test processes would otherwise compile at the same time; reserve a ROS domain for each."""
    config.addinivalue_line("markers", "exhaustive: more cases of quicker tests; run with --exhaustive")
    if not hasattr(config, "workerinput"):
        from ik_node.jit import is_cold

        if is_cold():
            from loop import make_robot

            from ik_node.control.compilation import compile_and_warm_up
            from ik_node.settings.groups import Settings

            compile_and_warm_up(make_robot("panda"), Settings(), print)
    # Default for every process that a test starts without a domain of its own.
    os.environ["ROS_DOMAIN_ID"] = str(_while_this_runs.enter_context(own_domain()))


def pytest_unconfigure() -> None:
    """Release the domain."""
    _while_this_runs.close()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip the exhaustive tests unless ``--exhaustive`` is given."""
    if config.getoption("--exhaustive"):
        return
    for item in items:
        if item.get_closest_marker("exhaustive") is not None:
            item.add_marker(pytest.mark.skip(reason="more cases of quicker tests: run with --exhaustive"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the table of test/faults, also of tests that ran in other processes; ``--fault-table`` writes it."""
    reports = [report for found in terminalreporter.stats.values() for report in found]
    calls = [report for report in reports if getattr(report, "when", "") == "call"]
    rows = [row for call in calls for name, found in call.user_properties if name == "fault_rows" for row in found]
    if rows and not hasattr(config, "workerinput"):
        from fault_table import table

        text = f"seed {config.getoption('--fault-seed')}, {len(rows)} rows\n{table(rows)}\n"
        terminalreporter.section("fault x method")
        terminalreporter.write(text)
        if (file := config.getoption("--fault-table")) is not None:
            file.write_text(text)


@pytest.fixture(scope="module")
def in_own_process() -> Iterator[Run]:
    """Runs functions in one process per module of tests."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        yield lambda check, *arguments: pool.submit(check, *arguments).result()
