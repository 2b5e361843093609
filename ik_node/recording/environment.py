"""Versions and platform on which the bits of a result depend besides the inputs."""

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
"""Key of the digest of this package."""
_IRRELEVANT = ("rosbags", "mcap", "ros-jazzy-rclpy", "example-robot-data")  # transport data, do not compute
_NOT_COMPUTING = ("ros", "cli", "report", "viewer", "recording", "replay", "messages")
"""Folders of this package that cannot change a command."""


@cache
def source_digest() -> str:
    """Digest, 16 hexadecimal digits, of all files of this package that can change a command."""
    folder = Path(ik_node.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        place = path.relative_to(folder)
        if place.parts[0] not in _NOT_COMPUTING:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@cache
def versions() -> Mapping[str, str]:
    """Version and digest of this package, versions of libraries and Python, processor, and kernels of BLAS."""
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
    """Differences between recorded and present versions that can change bits, as texts.

    Args:
        recorded: Result of :func:`versions` in the recorded process.
    """
    here = versions()
    names = [name for name in dict.fromkeys((*recorded, *here)) if name not in _IRRELEVANT]
    return tuple(
        f"{name}: recorded {recorded.get(name, 'none')}, here {here.get(name, 'none')}"
        for name in names
        if recorded.get(name) != here.get(name)
    )


def _processor() -> str:
    """Model name; functions of the C library select their code by processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _blas() -> str:
    """Version and selected kernels of NumPy's OpenBLAS; empty for another BLAS."""
    for path in sorted((Path(np.__file__).parent.parent / "numpy.libs").glob("libscipy_openblas64_*")):
        try:
            config = ctypes.CDLL(str(path)).scipy_openblas_get_config64_
        except (OSError, AttributeError):
            continue
        config.restype = ctypes.c_char_p
        name: bytes = config() or b""
        return name.decode()
    return ""
