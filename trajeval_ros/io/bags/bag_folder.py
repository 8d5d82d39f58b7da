"""The files of a rosbag2's directory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.metadata import Metadata, read_metadata

_METADATA = "metadata.yaml"
_COMPRESSED = ".zstd"
_ENDINGS = (".mcap", ".db3", f".mcap{_COMPRESSED}", f".db3{_COMPRESSED}")


def holds_bag(folder: Path) -> bool:
    """Return whether a directory is a bag: it has a description, or files of one."""
    return any(each.name == _METADATA or each.name.endswith(_ENDINGS) for each in folder.iterdir())


@dataclass(frozen=True)
class BagFolder:
    """The contents of a bag's directory, compared with its metadata.

    Attributes:
        files: Of the bag, in order.
        metadata: None where there is none that can be read.
        notes: Problems that were worked around.
        damage: Missing files, one sentence per file.
    """

    files: tuple[Path, ...]
    metadata: Metadata | None
    notes: tuple[str, ...]
    damage: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> BagFolder:
        """Look at a directory.

        Raises:
            InputError: There is no bag in it.
        """
        files = sorted(
            (file for ending in _ENDINGS for file in path.glob(f"*{ending}")),
            key=lambda file: [int(part) if part.isdigit() else part for part in _split(file.name)],
        )
        described, metadata = path / _METADATA, None
        notes: tuple[str, ...] = ()
        damage: tuple[str, ...] = ()
        if described.exists():
            try:
                metadata = read_metadata(described)
            except InputError as error:
                notes = (f"{error}; {described.name} ignored",)
        listed: set[str] = set()
        if metadata is not None:
            said, damage = _judged(path, metadata)
            notes += said
            listed = {each.name for each in metadata.files}
            wanted = set(map(_plain, listed))
            files = [file for file in files if _plain(file.name) in wanted] or files
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


def _without_copies(files: list[Path], listed: set[str]) -> list[Path]:
    """Return the files without duplicates: as listed, otherwise as recorded."""
    by_plain = {
        _plain(each.name): each for each in sorted(files, key=lambda each: each.name in listed)
    }
    return [file for file in files if by_plain[_plain(file.name)] is file]


def _judged(folder: Path, metadata: Metadata) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notes and damage: files that the metadata lists and the folder does not have."""
    there = {_plain(each.name) for each in folder.iterdir()}
    missing = [each.written for each in metadata.files if _plain(each.name) not in there]
    outside = [each.written for each in metadata.files if each.leads_out]
    notes = [
        f"{folder / _METADATA} lists {each}, which is outside the bag's folder; move it into the "
        "folder"
        for each in outside[:1]
    ]
    return tuple(notes), tuple(
        f"{folder / _METADATA} lists {each}, which is missing" for each in missing
    )


def _split(name: str) -> list[str]:
    """Return a name in parts that sort by number: `bag_2` before `bag_10`."""
    return re.split(r"(\d+)", name)
