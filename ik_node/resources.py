"""Files that come with the package: configurations of robots, layouts, profiles."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from ik_node.errors import SettingsError


def config_file(name: str) -> Path:
    """The file ``config/name``; SettingsError with the names that there are."""
    folder = config_folder()
    path = folder / name
    if not path.is_file():
        valid = ", ".join(sorted(entry.name for entry in folder.iterdir()))
        raise SettingsError(f"no configuration '{name}'; valid: {valid}")
    return path


def config_folder() -> Path:
    """Where the configurations lie: an ament prefix, the environment's prefix, or the source tree."""
    for place in _places():
        if place.is_dir():
            return place
    raise SettingsError("the configurations of ik_node are not installed")


def _places() -> Iterator[Path]:
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        if prefix:
            yield Path(prefix, "share", "ik_node", "config")
    yield Path(__file__).resolve().parent.parent / "config"
