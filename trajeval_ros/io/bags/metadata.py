"""metadata.yaml of a rosbag2: the files and messages of its directory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.yaml_file import read_mapping

if TYPE_CHECKING:
    from rosbags.interfaces import Qos


@dataclass(frozen=True)
class FilePath:
    """A file of a bag, as written in its metadata.yaml.

    Up to version 3 the path starts with the former name of the folder. Paths can be of another
    machine or operating system.

    Attributes:
        written: The path.
    """

    written: str

    @property
    def name(self) -> str:
        """The file's name in the folder."""
        return self._parts[-1]

    @property
    def leads_out(self) -> bool:
        """Whether the path is outside of the bag's folder."""
        return ".." in self._parts or not self._parts[0] or self._parts[0].endswith(":")

    @property
    def _parts(self) -> list[str]:
        return re.split(r"[/\\]", self.written)


@dataclass(frozen=True)
class Metadata:
    """The contents of a metadata.yaml, of versions 1 (Foxy) to 9 (Rolling).

    Attributes:
        files: Of the bag.
        counts: Number of messages by topic and type.
    """

    files: tuple[FilePath, ...]
    counts: dict[tuple[str, str], int]


def read_metadata(path: Path) -> Metadata:
    """Return the contents of a metadata.yaml.

    Raises:
        InputError: The file is invalid.
    """
    found = read_mapping(path, "information about a bag", is_generated=True)
    try:
        content = found["rosbag2_bagfile_information"]
        paths = content["relative_file_paths"]
        if not isinstance(paths, list) or not all(isinstance(each, str) for each in paths):
            raise TypeError("no paths")
        files = tuple(FilePath(each) for each in paths)
        counts: dict[tuple[str, str], int] = {}
        for topic in content["topics_with_message_count"]:
            key = topic["topic_metadata"]["name"], topic["topic_metadata"]["type"]
            counts[key] = counts.get(key, 0) + int(topic["message_count"])
    except (
        TypeError,
        KeyError,
        ValueError,
        AttributeError,
        OverflowError,
    ) as error:  # a wrong structure
        raise InputError(f"{path} has no bag information") from error
    return Metadata(files, counts)


def qos_of(profiles: Any) -> list[Qos]:
    """Return the offered quality of service, an empty list if it is invalid."""
    if not profiles:
        return []
    from rosbags.rosbag2.metadata import parse_qos

    try:
        return parse_qos(profiles)
    except Exception:  # of many types, depending on the damage
        return []
