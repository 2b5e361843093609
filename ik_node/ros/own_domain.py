"""A ROS domain for the processes of one command; no import of rclpy, which reads the environment when it is loaded."""

from __future__ import annotations

import os

from ik_node import resources


def use_own_domain() -> None:
    """Sets a domain of this process, on this computer only, with quick discovery; what is set already stays."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(resources.config_file("fastdds_quick_discovery.xml")))
