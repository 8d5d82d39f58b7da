"""Detection of a full disk under Rerun's file, which Rerun reports without a reason."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

from trajeval_ros.viewer.sdk import sdk

_LEAST_ROOM, _LITTLE_ROOM = 2**16, 2**20  # bytes


def open_file(recording: Any, path: Path, blueprint: Any, *, write_footer: bool = True) -> None:
    """Write a recording to a file from now on.

    Raises:
        OSError: The disk is full. Rerun may then not return from opening the file.
    """
    rerun, _ = sdk()
    _require_room(path)
    sink = rerun.FileSink(str(path), write_footer=write_footer)
    recording.set_sinks(sink, default_blueprint=blueprint)


def flush_to(path: Path, recording: Any) -> None:
    """Flush a recording to its file.

    Raises:
        OSError: The disk is full.
    """
    try:
        recording.flush()
    except RuntimeError as error:
        if _room(path) < _LITTLE_ROOM:
            raise _no_space() from error
        raise OSError(str(error)) from error
    _require_room(path)  # on a nearly full disk, flush may drop data without an error


def _require_room(path: Path) -> None:
    """Check that the disk has room for a few chunks.

    Raises:
        OSError: It has not.
    """
    if _room(path) < _LEAST_ROOM:
        raise _no_space()


def _room(path: Path) -> int:
    """Return the free bytes of the disk."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize


def _no_space() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
