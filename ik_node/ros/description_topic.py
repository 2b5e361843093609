"""The topic ``robot_description``: the newest description, and whether it is another one than that in use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_msgs.msg import String

from ik_node.errors import InputError
from ik_node.messages.decode import decode_description
from ik_node.robot.robot import Robot
from ik_node.ros import qos
from ik_node.ros.throttled_log import ThrottledLog

DESCRIPTION = "robot_description"
OTHER_DESCRIPTION = "another robot_description was published; it is ignored until the node is configured again"


class DescriptionTopic:
    """Subscribes to ``robot_description``, whose size is checked before it is decoded."""

    def __init__(self, node: Any, log: ThrottledLog, on_description: Callable[[], None]) -> None:
        """``on_description`` is called when :attr:`text` was received."""
        self._log = log
        self._on_description = on_description
        self.text = ""
        """The newest URDF; empty for none."""
        self.warning = ""
        """Text for the status when another description than that in use was published; empty otherwise."""
        self.refusal = ""
        """Text for the status when the last message was refused; empty otherwise."""
        subscription = node.create_subscription(String, DESCRIPTION, self._on_bytes, qos.LATCHED, raw=True)
        self.name: str = subscription.topic_name
        """Full name of the topic."""

    def check(self, robot: Robot, configured_with: str) -> None:
        """Set :attr:`warning`.

        Args:
            robot: The robot in use.
            configured_with: The text that it was made from; empty when it is from a parameter.
        """
        other = self.text not in ("", robot.urdf, configured_with)
        if other and not self.warning:
            self._log.warning(DESCRIPTION, OTHER_DESCRIPTION)
        self.warning = OTHER_DESCRIPTION if other else ""

    def _on_bytes(self, data: bytes) -> None:
        try:
            self.text = decode_description(data)
        except InputError as error:
            self.refusal = f"{DESCRIPTION} refused: {error}"
            self._log.error(DESCRIPTION, self.refusal)
        else:
            self.refusal = ""
        self._on_description()
