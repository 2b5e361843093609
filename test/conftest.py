"""What has to be settled before rclpy is loaded: tests talk to nobody but themselves."""

from __future__ import annotations

import os
import tempfile
from contextlib import ExitStack
from pathlib import Path

import pytest
from domains import own_domain

PROJECT = Path(__file__).resolve().parent.parent

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROJECT / "config" / "fastdds_quick_discovery.xml")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp(prefix="ik_node_test_log_"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("RMW_IMPLEMENTATION", None)


_while_this_runs = ExitStack()


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--exhaustive``: what is run before a release."""
    parser.addoption("--exhaustive", action="store_true", help="also run what only repeats on more cases")


def pytest_configure(config: pytest.Config) -> None:
    """Compiles once what the test processes would else all compile at the same time; gives each a ROS domain."""
    config.addinivalue_line("markers", "exhaustive: more cases of what quicker tests cover; run with --exhaustive")
    if not hasattr(config, "workerinput"):
        from ik_node.jit import is_cold

        if is_cold():
            from loop import make_robot

            from ik_node.control.warm_up import warm_up
            from ik_node.settings.groups import Settings

            warm_up(make_robot("panda"), Settings())
    # For every process that a test starts without saying where.
    os.environ["ROS_DOMAIN_ID"] = str(_while_this_runs.enter_context(own_domain()))


def pytest_unconfigure() -> None:
    """Gives the domain back."""
    _while_this_runs.close()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves the exhaustive tests out unless they are asked for."""
    if config.getoption("--exhaustive"):
        return
    for item in items:
        if item.get_closest_marker("exhaustive") is not None:
            item.add_marker(pytest.mark.skip(reason="more of the same: --exhaustive runs it"))
