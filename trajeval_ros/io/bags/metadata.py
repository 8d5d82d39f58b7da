"""metadata.yaml of a rosbag2: what its directory should hold."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.interfaces import Qos

_LARGEST = 16 << 20  # bytes; real ones have some kB


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
        ValueError: It is none; the message says why.
    """
    from ruamel.yaml import YAML

    if path.stat().st_size > _LARGEST:
        raise ValueError(f"it is larger than {_LARGEST} bytes")
    try:
        content = YAML(typ="safe").load(path.read_bytes())["rosbag2_bagfile_information"]
        files = tuple(PurePath(name).name for name in content["relative_file_paths"])
        counts: dict[tuple[str, str], int] = {}
        for topic in content["topics_with_message_count"]:
            key = topic["topic_metadata"]["name"], topic["topic_metadata"]["type"]
            counts[key] = counts.get(key, 0) + int(topic["message_count"])
    except OSError:
        raise
    except Exception as error:  # of YAML's a dozen kinds, and what a wrong structure raises
        raise ValueError("it holds no information about a bag") from error
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
