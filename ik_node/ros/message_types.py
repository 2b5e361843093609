"""rclpy's classes of messages by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def message_class(type_name: str) -> Any:
    """The class of ``package/msg/Name``."""
    package, folder, name = type_name.split("/")
    return getattr(import_module(f"{package}.{folder}"), name)
