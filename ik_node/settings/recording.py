"""The parameters of the recording of runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ik_node.settings.schema import Group, setting


@dataclass(frozen=True)
class RecordingSettings(Group):
    """Recording of runs."""

    prefix: ClassVar[str] = "recording"
    enabled: bool = setting(False, "Record from configuration on.", read_only=True)
    directory: str = setting(
        "", "Folder of the recording; must not exist; default: ik_node_ and the time, here.", read_only=True
    )
    compression: str = setting(
        "zstd", "Compression of the chunks of a recording.", choices=("none", "lz4", "zstd"), read_only=True
    )
    max_part_mb: float = setting(0.0, "Size at which a new file is begun; 0: never.", "MB", 0.0, 1e6, read_only=True)
    max_part_s: float = setting(0.0, "Duration at which a new file is begun; 0: never.", "s", 0.0, 1e6, read_only=True)
