"""The files of a rosbag2's directory, and its metadata.yaml."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import natural_key
from trajeval_ros.io.yaml_file import read_mapping

_METADATA = "metadata.yaml"
_COMPRESSED = ".zstd"
# Of a file that metadata.yaml does not list.
_READ = "a file of the same recording, which is read, too"
_UNREAD = "which is not read; give it alone, or remove it"
_ENDINGS = (".mcap", ".db3", f".mcap{_COMPRESSED}", f".db3{_COMPRESSED}")


@dataclass(frozen=True)
class FilePath:
    """A file of a bag, as written in its metadata.yaml.

    Up to version 3 the path starts with the former name of the folder. Paths can be of another
    machine or operating system.
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
    """The contents of a metadata.yaml, of versions 1 (Foxy) to 9 (Rolling)."""

    files: tuple[FilePath, ...]
    counts: dict[tuple[str, str], int]  # number of messages by topic and type


def read_metadata(path: Path) -> Metadata:
    """Return the contents of a metadata.yaml."""
    information = read_mapping(path, "information about a bag", is_generated=True)
    try:
        content = information["rosbag2_bagfile_information"]
        paths = content["relative_file_paths"]
        if not isinstance(paths, list) or not all(isinstance(item, str) for item in paths):
            raise TypeError("no paths")
        files = tuple(FilePath(item) for item in paths)
        counts: dict[tuple[str, str], int] = {}
        for topic in content["topics_with_message_count"]:
            key = topic["topic_metadata"]["name"], topic["topic_metadata"]["type"]
            count = int(topic["message_count"])
            if not 0 <= count < 1 << 63:
                raise ValueError("no number of messages")
            counts[key] = counts.get(key, 0) + count
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path} has no bag information") from error
    return Metadata(files, counts)


def holds_bag(folder: Path) -> bool:
    """Return whether a directory is a bag: it has a description, or files of one."""
    return any(path.name == _METADATA or path.name.endswith(_ENDINGS) for path in folder.iterdir())


@dataclass(frozen=True)
class BagFolder:
    """The contents of a bag's directory, compared with its metadata."""

    files: tuple[Path, ...]  # of the bag, in order
    metadata: Metadata | None  # None where there is none that can be read
    notes: tuple[str, ...]  # problems that were worked around
    damage: tuple[str, ...]  # missing files, one sentence per file

    @classmethod
    def of(cls, path: Path) -> BagFolder:
        """Look at a directory."""
        candidates = [file for ending in _ENDINGS for file in path.glob(f"*{ending}")]
        files = sorted(
            filter(Path.is_file, candidates),  # a pipe blocks
            key=lambda file: natural_key(file.name),
        )
        described, metadata = path / _METADATA, None
        notes = tuple(f"{item} skipped: not a file" for item in candidates if item not in files)
        damage: tuple[str, ...] = ()
        if described.is_file():
            try:
                metadata = read_metadata(described)
            except InputError as error:
                notes += (f"{error}; {described.name} ignored",)
        listed: set[str] = set()
        if metadata is not None:
            notices, damage = _judged(path, metadata)
            notes += notices
            listed = {item.name for item in metadata.files}
            listed_names = set(map(_plain, listed))
            others = [file for file in files if _plain(file.name) not in listed_names]
            if len(others) < len(files):
                series = set(map(_series, listed_names))
                files = [file for file in files if _series(file.name) in series]
                notes += tuple(
                    f"{described} does not list {file.name}, {_READ if file in files else _UNREAD}"
                    for file in others
                )
                # The counts of the metadata are those of the files that it lists.
                metadata = None if set(others) & set(files) else metadata
        kept = _without_copies(files, listed)
        if metadata is None:
            notes += tuple(
                f"{file} skipped, since {file.name}{_COMPRESSED} has the same data"
                for file in files
                if file not in kept
            )
        if not kept:
            why = "; ".join(damage) or "it has no *.mcap or *.db3"
            raise InputError(f"{path} is a directory without a bag: {why}")
        return cls(tuple(kept), metadata, notes, damage)


def _plain(name: str) -> str:
    """Return a file's name without compression. Players leave a decompressed copy next to it."""
    return name.removesuffix(_COMPRESSED)


def _series(name: str) -> str:
    """Return the part of a file's name that all files of a split bag share."""
    return re.sub(r"_\d+(\.\w+)$", r"\1", _plain(name))


def _without_copies(files: list[Path], listed: set[str]) -> list[Path]:
    """Return the files without duplicates: as listed, otherwise as recorded."""
    by_plain = {
        _plain(file.name): file for file in sorted(files, key=lambda path: path.name in listed)
    }
    return [file for file in files if by_plain[_plain(file.name)] is file]


def _judged(folder: Path, metadata: Metadata) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notes and damage: files that the metadata lists and the folder does not have."""
    there = {_plain(path.name) for path in folder.iterdir() if path.is_file()}
    missing = [file.written for file in metadata.files if _plain(file.name) not in there]
    outside = [file.written for file in metadata.files if file.leads_out]
    notes = [
        f"{folder / _METADATA} lists {item}, which is outside the bag's folder; move it into the "
        "folder"
        for item in outside[:1]
    ]
    return tuple(notes), tuple(
        f"{folder / _METADATA} lists {item}, which is missing" for item in missing
    )
