"""Content of ``metadata.yaml``, as rosbag2 writes it (version 9)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fringedic import __version__
from fringedic.recording.mcap_output import WrittenFile
from fringedic.recording.topics import Topic
from fringedic.wording.yaml_text import load_foreign_yaml


def bag_metadata(files: Sequence[WrittenFile], topics: Iterable[Topic], counts: Mapping[str, int]) -> dict[str, Any]:
    """Return the metadata of a recording.

    Parameters
    ----------
    files
        Its files in their order.
    topics
        Its topics.
    counts
        Messages of each topic by its name.
    """
    filled = [file for file in files if file.messages]
    start = min((file.start_time for file in filled), default=0)
    end = max((file.end_time for file in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [_topic(topic, counts.get(topic.name, 0)) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [_file(file) for file in files],
        "custom_data": {"fringedic_version": __version__},
        "ros_distro": os.environ.get("ROS_DISTRO", "unknown"),
    }


def _topic(topic: Topic, messages: int) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": offered_profiles(topic.qos),
            "type_description_hash": topic.hash,
        },
        "message_count": messages,
    }


def _file(file: WrittenFile) -> dict[str, Any]:
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": file.start_time},
        "duration": {"nanoseconds": file.end_time - file.start_time},
        "message_count": file.messages,
    }


def offered_profiles(qos: str) -> list[dict[str, Any]]:
    """Return the QoS profiles in the YAML text of a topic; an empty list if it is not a list of mappings.

    Examples
    --------
    >>> offered_profiles("- {depth: 10, durability: volatile}")
    [{'depth': 10, 'durability': 'volatile'}]
    >>> offered_profiles("- 5"), offered_profiles("{")
    ([], [])
    """
    try:
        profiles = load_foreign_yaml(qos)
    except Exception:
        return []
    if isinstance(profiles, list) and all(isinstance(each, dict) for each in profiles):
        return profiles
    return []
