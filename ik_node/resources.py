"""Files that are installed with the package: parameter files of robots, scenes, layouts, DDS profiles."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from ik_node.errors import SettingsError


def config_file(name: str) -> Path:
    """Return the path of ``config/name``; raises SettingsError listing the files when there is none of this name."""
    folder = config_folder()
    path = folder / name
    if not path.is_file():
        valid = ", ".join(sorted(entry.name for entry in folder.iterdir()))
        raise SettingsError(f"no configuration '{name}'; valid: {valid}")
    return path


def config_folder() -> Path:
    """Return the folder of the files: below an ament prefix, below ``sys.prefix``, or in the source tree."""
    for folder in _candidates():
        if folder.is_dir():
            return folder
    raise SettingsError("the configuration files of ik_node are not installed")


def _candidates() -> Iterator[Path]:
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        if prefix:
            yield Path(prefix, "share", "ik_node", "config")
    yield Path(__file__).resolve().parent.parent / "config"
