"""What bits depend on beside the inputs: our code, the libraries, Python, the processor."""

from __future__ import annotations

import ctypes
import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType

import numpy as np

import ik_node

DISTRIBUTIONS = (
    "pin",
    "coal",
    "numpy",
    "numba",
    "llvmlite",
    "daqp",
    "rosbags",
    "mcap",
    "example-robot-data",
    "ros-jazzy-rclpy",
)
SOURCE = "source"
"""Key of the digest of our own code."""
_HARMLESS = ("rosbags", "mcap", "ros-jazzy-rclpy", "example-robot-data")  # carry bytes, do not calculate
_NOT_COMPUTING = ("ros", "cli", "report", "viewer", "recording", "replay", "messages")
"""Folders of this package that compute no command."""


@cache
def source_digest() -> str:
    """Sixteen hexadecimal digits that change with every file of this package that can change a command."""
    folder = Path(ik_node.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        place = path.relative_to(folder)
        if place.parts[0] not in _NOT_COMPUTING:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@cache
def versions() -> Mapping[str, str]:
    """Our version and a digest of our code, versions of the libraries and of Python, the processor, BLAS's kernels."""
    found = {
        "ik_node": ik_node.__version__,
        SOURCE: source_digest(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": _processor(),
        "libc": " ".join(platform.libc_ver()),
        "blas": _blas(),
    }
    for name in DISTRIBUTIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return MappingProxyType(found)


def differences(recorded: Mapping[str, str]) -> tuple[str, ...]:
    """What is different here from where ``recorded`` was true, as far as it can change bits; for people."""
    here = versions()
    names = [name for name in dict.fromkeys((*recorded, *here)) if name not in _HARMLESS]
    return tuple(
        f"{name} {recorded.get(name, 'none')} there, {here.get(name, 'none')} here"
        for name in names
        if recorded.get(name) != here.get(name)
    )


def _processor() -> str:
    """Its name as the kernel has it; functions of the C library choose their code by it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _blas() -> str:
    """Version, and the kernels that NumPy's OpenBLAS has chosen for this processor; empty when it is another BLAS."""
    for path in sorted((Path(np.__file__).parent.parent / "numpy.libs").glob("libscipy_openblas64_*")):
        try:
            config = ctypes.CDLL(str(path)).scipy_openblas_get_config64_
        except (OSError, AttributeError):
            continue
        config.restype = ctypes.c_char_p
        name: bytes = config() or b""
        return name.decode()
    return ""
