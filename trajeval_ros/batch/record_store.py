"""The records of a comparison on disk: one file of entries, and one per shard that was merged.

Every entry is appended by one system call, so a kill loses only the entry in progress. The next
writer removes everything after the last complete entry.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from trajeval_ros.batch.records import HEAD_BYTES, EntryHead, Record, decode, entry_head
from trajeval_ros.io.writing import refused_by_disk

RECORDS = "runs"  # their folder in that of a comparison
SUFFIX = ".records"
OWN = f"all{SUFFIX}"


class RecordStore:
    """All records in a folder, by key; of several with the same key, the last one counts."""

    def __init__(self, folder: Path) -> None:
        """Index all entries of a folder with files of records; it may not exist yet."""
        self._own = folder / OWN  # records are added to this file
        self._end = 0  # of the last complete entry in that file
        self._places: dict[str, tuple[Path, int]] = {}
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            for key, begin, end in _entries(path):
                self._places[key] = (path, begin)
                if path == self._own:
                    self._end = end

    def __contains__(self, key: str) -> bool:
        return key in self._places

    def __len__(self) -> int:
        return len(self._places)

    def add(self, entry: bytes) -> None:
        """Append an encoded record.

        Raises:
            InputError: It can't be written; the file is unchanged.
        """
        head = entry_head(entry)
        assert head is not None
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        with refused_by_disk(str(self._own)):
            file = os.open(self._own, flags, 0o666)
            try:
                os.ftruncate(file, self._end)
                _write_all(file, entry, self._end)
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(file, self._end)
                raise
            finally:
                os.close(file)
        self._places[head.key] = (self._own, self._end)
        self._end += len(entry)

    def read(self, key: str, *, with_pooled: bool = True) -> Record | None:
        """Return a record; None if there is none or it is damaged.

        Args:
            key: Its key.
            with_pooled: Whether to read the errors of its sub-trajectories, which are large.
        """
        if key not in self._places:
            return None
        path, begin = self._places[key]
        try:
            with path.open("rb", buffering=0) as file:
                file.seek(begin)
                head = entry_head(file.read(HEAD_BYTES))
                if head is None or head.key != key:
                    return None
                drawn = file.read(head.drawn_bytes)
                pooled = file.read(head.pooled_bytes) if with_pooled else None
        except OSError:
            return None
        return decode(head, drawn, pooled)

    def forget(self, key: str) -> None:
        """Remove a damaged record from the index."""
        self._places.pop(key, None)


def _entries(path: Path) -> Iterator[tuple[str, int, int]]:
    """Yield key, start and end of the entries of a file, up to the first incomplete one."""
    try:
        with path.open("rb", buffering=0) as file:
            size, begin = os.fstat(file.fileno()).st_size, 0
            while (head := _head_at(file.fileno(), begin)) and begin + head.size <= size:
                yield head.key, begin, begin + head.size
                begin += head.size
    except OSError:
        return


def _head_at(file: int, begin: int) -> EntryHead | None:
    return entry_head(os.pread(file, HEAD_BYTES, begin))


def _write_all(file: int, data: bytes, begin: int) -> None:
    rest = memoryview(data)
    while rest:
        written = os.pwrite(file, rest, begin)
        rest, begin = rest[written:], begin + written
