"""``metadata.yaml`` of a rosbag2 recording (version 9) and QoS profiles as text.

QoS and type hash are stored twice, in the channel and in ``metadata.yaml``. They must be equal, otherwise readers skip
the topic without an error, so both are generated here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.records import Channel

from ik_node.errors import InputError
from ik_node.messages.cdr import STORE
from ik_node.recording.mcap.file import ChannelInfo, Content
from ik_node.settings.yaml_text import load_yaml

VERSION = 9
STORAGE = "mcap"
DISTRO = "jazzy"
METADATA_FILE = "metadata.yaml"
RECORD_NAME = "rosbag2"
"""Name of the metadata record in each file that repeats ``metadata.yaml``."""
ROOT = "rosbag2_bagfile_information"
DROPPED, REPAIRED = "dropped", "repaired"
"""Keys of ``custom_data``: number of messages left out, and what a repair removed."""
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


class Qos(NamedTuple):
    """Offered QoS of a publisher, as far as a bag stores it."""

    depth: int = 10
    reliable: bool = True
    latched: bool = False
    """Transient local: a late subscriber receives the last message."""


class PartInfo(NamedTuple):
    """One finished file of a bag."""

    name: str
    content: Content


def qos_profile(qos: Qos) -> dict[str, Any]:
    """The profile in the YAML of rosbag2."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": "reliable" if qos.reliable else "best_effort",
        "durability": "transient_local" if qos.latched else "volatile",
        "deadline": dict(_INFINITE),
        "lifespan": dict(_INFINITE),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }


def describe_topic(name: str, type_name: str, qos: Qos) -> ChannelInfo:
    """Describes a topic; raises TypesysError when the type is not in ROS 2 Jazzy's common interfaces."""
    definition, _ = STORE.generate_msgdef(type_name, ros_version=2)
    metadata = {
        "offered_qos_profiles": _qos_text(qos),
        "topic_type_hash": STORE.hash_rihs01(type_name),
    }
    return ChannelInfo(name, type_name, definition, metadata)


@lru_cache
def _qos_text(qos: Qos) -> str:
    return _yaml([qos_profile(qos)])


@lru_cache
def _profiles(text: str) -> list[Any]:
    """QoS profiles of a channel; empty when they cannot be parsed."""
    try:
        profiles = load_yaml(text)
    except InputError:
        return []
    return profiles if isinstance(profiles, list) else []


def bag_metadata(parts: Sequence[PartInfo], custom: Mapping[str, str]) -> dict[str, Any]:
    """The content of ``metadata.yaml`` below its root key.

    Args:
        parts: Files in their order.
        custom: ``custom_data``.
    """
    filled = [part.content for part in parts if part.content.message_count]
    start_ns = min((content.start_ns for content in filled), default=0)
    end_ns = max((content.end_ns for content in filled), default=0)
    topics: dict[str, dict[str, Any]] = {}
    counts: dict[str, int] = {}
    for part in parts:
        for channel in part.content.channels:
            topics.setdefault(channel.topic, _topic(channel, part.content.schema_of(channel)))
            counts[channel.topic] = counts.get(channel.topic, 0) + part.content.counts[channel.id]
    return {
        "version": VERSION,
        "storage_identifier": STORAGE,
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(counts.values()),
        "topics_with_message_count": [
            {"topic_metadata": about, "message_count": counts[topic]} for topic, about in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [_file(part) for part in parts],
        "custom_data": dict(custom) or None,
        "ros_distro": DISTRO,
    }


def write_metadata(directory: Path, metadata: Mapping[str, Any]) -> None:
    """Writes ``metadata.yaml`` atomically; raises OSError when it cannot be written."""
    path = directory / METADATA_FILE
    temporary = path.with_suffix(".tmp")
    temporary.write_text(_yaml({ROOT: metadata}))
    temporary.replace(path)


def metadata_record(metadata: Mapping[str, Any]) -> dict[str, str]:
    """The values of the metadata record in each file."""
    return {"serialized_metadata": _yaml(metadata)}


def _topic(channel: Channel, type_name: str) -> dict[str, Any]:
    return {
        "name": channel.topic,
        "type": type_name,
        "serialization_format": channel.message_encoding,
        "offered_qos_profiles": _profiles(channel.metadata.get("offered_qos_profiles", "")),
        "type_description_hash": channel.metadata.get("topic_type_hash", ""),
    }


def _file(part: PartInfo) -> dict[str, Any]:
    content = part.content
    start_ns = content.start_ns if content.message_count else 0
    return {
        "path": part.name,
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": content.end_ns - start_ns},
        "message_count": content.message_count,
    }


class _Plain(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes repeated values in full: some readers do not support YAML anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        del data
        return True


def _yaml(value: Any) -> str:
    return str(yaml.dump(value, Dumper=_Plain, sort_keys=False, default_flow_style=False, allow_unicode=True))
