"""Rerun's file on a disk that takes no more, of which Rerun says only that it doesn't."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

_LEAST_ROOM, _LITTLE_ROOM = 2**16, 2**20  # bytes


def flush_to(path: Path, recording: Any) -> None:
    """Have everything of a recording in its file.

    Raises:
        OSError: The disk takes no more.
    """
    try:
        recording.flush()
    except RuntimeError as error:
        if _room(path) < _LITTLE_ROOM:
            raise _no_space() from error
        raise OSError(str(error)) from error
    if _room(path) < _LEAST_ROOM:  # then a flush may pass over what did not fit
        raise _no_space()


def _room(path: Path) -> int:
    """Return how many bytes the disk still takes."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize


def _no_space() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
