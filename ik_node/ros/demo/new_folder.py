"""A new folder that is removed when what was to fill it fails."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from ik_node.errors import SettingsError

RECORDING = "bag"
"""Folder of the recording."""


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Create a folder with its missing parents; remove them again after an exception.

    After a BrokenPipeError (``ik_demo | head``) a folder with a recording stays: the run is complete, and only its
    report has no reader.

    Args:
        path: The folder; must not exist.

    Yields:
        The folder.

    Raises:
        SettingsError: The folder cannot be created.
    """
    created: list[Path] = []
    try:
        try:
            created = [folder for folder in (path, *path.parents) if not folder.exists()]
            path.mkdir(parents=True)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            reason = getattr(error, "strerror", None) or str(error)
            raise SettingsError(f"folder '{path}' cannot be created: {reason}") from error
        yield path
    except BaseException as error:
        if isinstance(error, BrokenPipeError) and (path / RECORDING).is_dir():
            raise
        shutil.rmtree(path, ignore_errors=True)
        for parent in created[1:]:
            with contextlib.suppress(OSError):  # something else is in it now
                parent.rmdir()
        raise
