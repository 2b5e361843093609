"""Helpers that several tests share."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parent.parent
Run = Callable[..., Any]
"""Calls a function of a test module with arguments, and returns or raises what it does."""


def loaded_program(path: Path) -> ModuleType:
    """Import a program of the checkout that is in no package."""
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def skip_unless_others_can_read() -> None:
    """Skip a test in which root becomes another user where only root may enter the folders of checkout and Python."""
    places = (PROJECT, Path(sys.prefix).resolve())
    closed = [folder for place in places for folder in (place, *place.parents) if not folder.stat().st_mode & 0o001]
    if os.getuid() == 0 and closed:
        pytest.skip(f"other users than root may not enter {closed[0]}")


def shared_path(*parts: str) -> Path:
    """Return a file of the folder `shared` beside the project; skip the test with a reason where it is absent."""
    path = PROJECT.parent.joinpath("shared", *parts)
    if not path.exists():
        pytest.skip(f"needs shared/{'/'.join(parts)}, which is not beside this checkout")
    return path
