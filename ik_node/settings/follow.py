"""The parameters of the detection of a robot that does not follow its commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ik_node.settings.schema import Group, setting


@dataclass(frozen=True)
class FollowSettings(Group):
    """Detection of a robot that does not follow its commands."""

    prefix: ClassVar[str] = "follow"
    enabled: bool = setting(True, "Detect a robot that does not follow its commands.")
    min_ratio: float = setting(
        0.5, "Minimum ratio of measured to commanded motion of a robot that follows.", "", 0.0, 1.0
    )
