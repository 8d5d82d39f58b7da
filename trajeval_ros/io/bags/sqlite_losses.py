"""Data of a sqlite3 file that sqlite ignores without an error."""

from __future__ import annotations

import sys
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.sqlite_pages import page_size_of

_LOG_MAGICS = (0x377F0682, 0x377F0683)
_LOG_HEADER, _FRAME_HEADER = 32, 24  # bytes


def lost_of_log(log: Path) -> str:
    """Return a sentence on pages of the log that sqlite did not use, which it does not report.

    See sqlite's file format, 4.1 and 4.4. The log is a header and frames of one page. The index
    next to it has the number of committed frames.
    """
    with log.open("rb") as file:
        header = file.read(_LOG_HEADER)
        if int.from_bytes(header[:4], "big") not in _LOG_MAGICS or len(header) < _LOG_HEADER:
            return "none of its pages is readable"
        frame = _FRAME_HEADER + int.from_bytes(header[8:12], "big")
        size = log.stat().st_size
        count = 0
        while _LOG_HEADER + (count + 1) * frame <= size:
            file.seek(_LOG_HEADER + count * frame + 8)
            if file.read(8) != header[16:24]:  # a frame of an older log
                break
            count += 1
    index, used = log.with_name(f"{log.name.removesuffix('-wal')}-shm"), 0
    if index.exists():  # it does not, if the database is not in the mode WAL
        with index.open("rb") as file:
            used = int.from_bytes(file.read(20)[16:], sys.byteorder)
    return f"{count - used} of its {count} pages are unreadable" if used < count else ""


def refuse_truncated(path: Path, name: str) -> None:
    """Raise InputError if sqlite's header counts more pages than the file has.

    With missing pages, sqlite often returns fewer messages without an error.
    """
    with path.open("rb") as file:
        header = file.read(100).ljust(100, b"\0")
    page_size, pages = page_size_of(header), int.from_bytes(header[28:32], "big")
    is_valid = header[24:28] == header[92:96]  # older versions of sqlite do not update the count
    size = path.stat().st_size
    if is_valid and size < pages * page_size:
        raise InputError(
            f"{name} is truncated: it has {size} of {pages * page_size} bytes; copy it again, or "
            "recover the data with the sqlite3 command `.recover`"
        )
