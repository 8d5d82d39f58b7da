"""metadata.yaml of a rosbag2: what its directory should hold."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.yaml_file import read_mapping

if TYPE_CHECKING:
    from rosbags.interfaces import Qos


@dataclass(frozen=True)
class Metadata:
    """What a metadata.yaml says.

    Attributes:
        files: Names of the bag's files.
        counts: Number of messages by topic and type.
    """

    files: tuple[str, ...]
    counts: dict[tuple[str, str], int]


def read_metadata(path: Path) -> Metadata:
    """Return what a metadata.yaml says.

    Raises:
        InputError: It is none; the message says why.
    """
    found = read_mapping(path, "information about a bag", is_generated=True)
    try:
        content = found["rosbag2_bagfile_information"]
        files = tuple(PurePath(name).name for name in content["relative_file_paths"])
        counts: dict[tuple[str, str], int] = {}
        for topic in content["topics_with_message_count"]:
            key = topic["topic_metadata"]["name"], topic["topic_metadata"]["type"]
            counts[key] = counts.get(key, 0) + int(topic["message_count"])
    except (TypeError, KeyError, ValueError, AttributeError) as error:  # a wrong structure
        raise InputError(f"{path} holds no information about a bag") from error
    return Metadata(files, counts)


def qos_of(profiles: Any) -> list[Qos]:
    """Return the quality of service that was offered, nothing where it can't be understood."""
    if not profiles:
        return []
    from rosbags.rosbag2.metadata import parse_qos

    try:
        return parse_qos(profiles)
    except Exception:  # what a damaged profile raises is up to chance
        return []
