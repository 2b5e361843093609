"""A digest of our own code, as far as it takes part in calculating a command."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

_NOT_CALCULATING = ("ros", "cli", "report", "viewer", "recording", "replay", "messages")


@cache
def source_digest() -> str:
    """Sixteen hexadecimal digits that change with any file that can change a command."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        place = path.relative_to(folder)
        if place.parts[0] not in _NOT_CALCULATING:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
