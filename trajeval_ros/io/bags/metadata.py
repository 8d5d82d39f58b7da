"""metadata.yaml of a rosbag2: what its directory should hold."""

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
    """A file of a bag, as its metadata.yaml writes it.

    Up to version 3 the path begins with the folder's name, which may have changed since. Any
    recorder's may be of another machine, or of another system.

    Attributes:
        written: The path.
    """

    written: str

    @property
    def name(self) -> str:
        """The file's name: all that tells where it is in the folder."""
        return self._parts[-1]

    @property
    def leads_out(self) -> bool:
        """Whether the path would leave the bag's folder."""
        return ".." in self._parts or not self._parts[0] or self._parts[0].endswith(":")

    @property
    def _parts(self) -> list[str]:
        return re.split(r"[/\\]", self.written)


@dataclass(frozen=True)
class Metadata:
    """What a metadata.yaml says, of versions 1 (Foxy) to 9 (Rolling).

    Attributes:
        files: Of the bag.
        counts: Number of messages by topic and type.
    """

    files: tuple[FilePath, ...]
    counts: dict[tuple[str, str], int]


def read_metadata(path: Path) -> Metadata:
    """Return what a metadata.yaml says.

    Raises:
        InputError: It is none; the message says why.
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
    """Return the quality of service that was offered, nothing where it can't be understood."""
    if not profiles:
        return []
    from rosbags.rosbag2.metadata import parse_qos

    try:
        return parse_qos(profiles)
    except Exception:  # what a damaged profile raises is up to chance
        return []
