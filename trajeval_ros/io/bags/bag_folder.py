"""The files of a rosbag2's directory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.metadata import Metadata, read_metadata

_ENDINGS = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


@dataclass(frozen=True)
class BagFolder:
    """What a directory holds, and what it should hold.

    Attributes:
        files: Of the bag, in order.
        metadata: None where there is none that can be read.
        notes: What had to be worked around.
        damage: What is missing, one sentence each.
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
        described, metadata = path / "metadata.yaml", None
        notes: tuple[str, ...] = ()
        damage: tuple[str, ...] = ()
        if described.exists():
            try:
                metadata = read_metadata(described)
            except InputError as error:
                notes = (f"{error}; {described.name} was not used",)
        if metadata is not None:
            missing = [each for each in metadata.files if not (path / each).exists()]
            damage = tuple(f"{described} names {each}, which is missing" for each in missing)
            files = [file for file in files if file.name in metadata.files] or files
        if not files:
            why = "; ".join(damage) or "it holds no *.mcap or *.db3"
            raise InputError(f"{path} is a directory without a bag: {why}")
        return cls(tuple(files), metadata, notes, damage)


def _split(name: str) -> list[str]:
    """Return a name in parts that sort as people count: `bag_2` before `bag_10`."""
    return re.split(r"(\d+)", name)
