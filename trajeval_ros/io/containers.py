"""The files that bags are made of: opened by what they begin with, refused if unfinished."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError

_MCAP, _SQLITE, _ROS1, _ZSTD = b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V", b"(\xb5/\xfd"


def open_file(path: Path) -> Any:
    """Return the open reader of a single file, chosen by its first bytes."""
    with path.open("rb") as file:
        beginning = file.read(16)
    if not beginning:
        raise InputError(f"{path} is empty; was the recording stopped before it was written?")
    if beginning.startswith(_ZSTD):
        raise InputError(
            f"{path} is compressed as a whole; name its directory if that has a metadata.yaml, or "
            "decompress it with `zstd -d`"
        )
    if beginning.startswith(_ROS1):
        from rosbags.rosbag1 import Reader as Ros1Reader

        reader: Any = Ros1Reader(path)
    elif beginning.startswith(_SQLITE):
        from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

        refuse_unfinished(path)
        refuse_truncated(path)
        reader = Sqlite3Reader(path)
    elif beginning.startswith(_MCAP):
        from rosbags.rosbag2.storage_mcap import McapReader

        reader = McapReader(path)
    else:
        raise InputError(f"{path} is no bag: it begins as neither MCAP, sqlite3 nor ROS 1")
    reader.open()
    return reader


def refuse_unfinished(path: Path) -> None:
    """Raise InputError if messages wait in a write-ahead log, which readers pass over silently."""
    log = path.with_name(f"{path.name}-wal")
    if log.exists() and log.stat().st_size:
        raise InputError(
            f"{path} was not closed: messages wait in {log.name}; merge them with "
            f"`sqlite3 {path} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
        )


def refuse_truncated(path: Path) -> None:
    """Raise InputError if sqlite's header counts more pages than the file has.

    What sqlite makes of missing pages depends on which they are: often fewer messages, silently.
    """
    with path.open("rb") as file:
        header = file.read(100).ljust(100, b"\0")
    page_size, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    page_size = 65536 if page_size == 1 else page_size
    is_valid = header[24:28] == header[92:96]  # older versions of sqlite don't keep the count
    size = path.stat().st_size
    if is_valid and size < pages * page_size:
        raise InputError(
            f"{path} was cut short: it has {size} of {pages * page_size} bytes; copy it again, or "
            f"save what is left with `sqlite3 {path} .recover`"
        )


def storages(reader: Any) -> list[Any]:
    """Return the readers of the files, whose times are those of the messages themselves."""
    return list(getattr(reader, "storages", [reader]))


def first_and_last(storage: Any) -> tuple[int, int]:
    """Return the first and the last log time of a file; the last is before the first if empty."""
    times = getattr(storage, "metadata", storage)  # the reader of ROS 1 has them itself
    return times.start_time, times.end_time - 1
