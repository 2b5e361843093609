"""What rosbag2 wants to know of a bag beside its messages: ``metadata.yaml`` (version 9 of the format) and QoS as text.

QoS and type hash stand in two places, the file's channel and ``metadata.yaml``. They must agree to the letter, or
readers skip the topic without a word, so both are made here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import yaml

from ik_node.messages.cdr import STORE
from ik_node.recording.mcap_file import ChannelInfo, Content

VERSION = 9
STORAGE = "mcap"
DISTRO = "jazzy"
METADATA_FILE = "metadata.yaml"
RECORD_NAME = "rosbag2"
"""Name of the metadata record inside each file that repeats ``metadata.yaml``."""
ROOT = "rosbag2_bagfile_information"
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


class Qos(NamedTuple):
    """What a publisher offers, as far as the bag says it."""

    depth: int = 10
    reliable: bool = True
    latched: bool = False
    """Transient local: a late subscriber still gets the last message."""


class Topic(NamedTuple):
    """A recorded topic."""

    channel: ChannelInfo
    qos: Qos


class PartInfo(NamedTuple):
    """One finished file of a bag."""

    name: str
    content: Content


def qos_profile(qos: Qos) -> dict[str, Any]:
    """The profile as rosbag2's YAML spells it."""
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


def describe_topic(name: str, type_name: str, qos: Qos) -> Topic:
    """What a bag says of a topic; TypesysError when the type is not one of ROS 2 Jazzy's."""
    definition, _ = STORE.generate_msgdef(type_name, ros_version=2)
    metadata = {
        "offered_qos_profiles": _qos_text(qos),
        "topic_type_hash": STORE.hash_rihs01(type_name),
    }
    return Topic(ChannelInfo(name, type_name, definition, metadata), qos)


@lru_cache
def _qos_text(qos: Qos) -> str:
    return _yaml([qos_profile(qos)])


def bag_metadata(parts: Sequence[PartInfo], topics: Sequence[Topic], custom: Mapping[str, str]) -> dict[str, Any]:
    """The content of ``metadata.yaml`` below its root key, for these files and ``topics`` in channel order."""
    filled = [part.content for part in parts if part.content.message_count]
    start_ns = min((content.start_ns for content in filled), default=0)
    end_ns = max((content.end_ns for content in filled), default=0)
    counts = dict.fromkeys(range(1, len(topics) + 1), 0)
    for part in parts:
        for channel, count in part.content.counts.items():
            counts[channel] += count
    return {
        "version": VERSION,
        "storage_identifier": STORAGE,
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(counts.values()),
        "topics_with_message_count": [
            {"topic_metadata": _topic(topic), "message_count": counts[number]}
            for number, topic in enumerate(topics, start=1)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [_file(part) for part in parts],
        "custom_data": dict(custom) or None,
        "ros_distro": DISTRO,
    }


def metadata_yaml(metadata: Mapping[str, Any]) -> str:
    """The text of ``metadata.yaml``."""
    return _yaml({ROOT: metadata})


def metadata_record(metadata: Mapping[str, Any]) -> dict[str, str]:
    """The values of the metadata record that rosbag2 puts into each file."""
    return {"serialized_metadata": _yaml(metadata)}


def _topic(topic: Topic) -> dict[str, Any]:
    return {
        "name": topic.channel.topic,
        "type": topic.channel.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": [qos_profile(topic.qos)],
        "type_description_hash": topic.channel.metadata["topic_type_hash"],
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
    """Writes equal parts out instead of referring to them: YAML anchors are lost on some readers."""

    def ignore_aliases(self, data: Any) -> bool:
        del data
        return True


def _yaml(value: Any) -> str:
    return str(yaml.dump(value, Dumper=_Plain, sort_keys=False, default_flow_style=False, allow_unicode=True))
