"""Whether an ``ik_watchdog`` monitors this node, for the diagnostics."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from ik_node.ros import qos

LEVEL = slice(4, 5)
"""The level in the bytes of a diagnostic_msgs/DiagnosticStatus: its first field, behind the head of CDR."""


class WatchdogStatus:
    """Subscribes to the latched status of ``ik_watchdog`` on ``~/watchdog``."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._level = DiagnosticStatus.STALE
        self._subscription = node.create_subscription(
            DiagnosticStatus, "~/watchdog", self._on_status, qos.LATCHED, raw=True
        )

    @property
    def state(self) -> str:
        """``ready``; ``not ready`` while it lacks its topics; ``absent`` without a watchdog."""
        if not self._node.count_publishers(self._subscription.topic_name):
            return "absent"
        return "ready" if self._level in (DiagnosticStatus.OK, DiagnosticStatus.ERROR) else "not ready"

    def _on_status(self, data: bytes) -> None:
        self._level = data[LEVEL]  # the rest, of any length, is not needed
