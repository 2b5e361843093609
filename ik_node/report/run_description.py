"""What a recording says about its robot and date."""

from __future__ import annotations

import re
from datetime import datetime, timezone

from ik_node.interfaces.clock import NS
from ik_node.recording.run import Run

MIN_DATE_NS = 1_000_000_000 * NS
"""ROS times before 2001 are those of a simulation."""


def recording_date(ros_ns: int) -> str:
    """Date and time in UTC; empty for a time that is not one since 1970, as in a simulation."""
    if ros_ns < MIN_DATE_NS:
        return ""
    return datetime.fromtimestamp(ros_ns // NS, tz=timezone.utc).strftime("%Y-%m-%d %H:%M UTC")


def joint_units(run: Run) -> tuple[str, ...]:
    """``m`` for prismatic joints of the URDF, ``rad`` for all others."""
    tags = re.findall(r"<joint\b[^>]*>", run.urdf)
    prismatic = {_attribute(tag, "name") for tag in tags if _attribute(tag, "type") == "prismatic"}
    prefix = str(run.settings.get("joint_prefix", ""))
    return tuple(
        "m" if joint in prismatic or joint.removeprefix(prefix) in prismatic else "rad" for joint in run.joints
    )


def _attribute(tag: str, name: str) -> str:
    found = re.search(rf"\b{name}\s*=\s*[\"']([^\"']*)", tag)
    return found.group(1) if found else ""
