"""What has to be settled before rclpy is loaded: tests talk to nobody but themselves."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROJECT / "config" / "fastdds_quick_discovery.xml")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp(prefix="ik_node_test_log_"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("RMW_IMPLEMENTATION", None)
