"""What has to be settled before rclpy is loaded: tests talk to nobody but themselves."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROJECT / "config" / "fastdds_quick_discovery.xml")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp(prefix="ik_node_test_log_"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("RMW_IMPLEMENTATION", None)


def pytest_configure(config: pytest.Config) -> None:
    """Compiles once what the test processes would else all compile at the same time."""
    from ik_node.jit import is_cold

    if is_cold() and not hasattr(config, "workerinput"):
        from loop import make_robot

        from ik_node.control.warm_up import rehearse
        from ik_node.settings.groups import Settings

        rehearse(make_robot("panda"), Settings())
