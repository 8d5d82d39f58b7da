"""Detection of a full disk under Rerun's file, which Rerun reports without a reason."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

from trajeval_ros.viewer.sdk import sdk

_LEAST_ROOM, _LITTLE_ROOM = 2**16, 2**20  # bytes


def open_file(recording: Any, path: Path, blueprint: Any, *, write_footer: bool = True) -> None:
    """Have a recording written to a file.

    Raises:
        OSError: The disk has no room; then Rerun's file may never open.
    """
    rerun, _ = sdk()
    _require_room(path)
    sink = rerun.FileSink(str(path), write_footer=write_footer)
    recording.set_sinks(sink, default_blueprint=blueprint)


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
    _require_room(path)  # with less a flush may pass over what did not fit


def _require_room(path: Path) -> None:
    """Do nothing while the disk has room for a few chunks.

    Raises:
        OSError: It has less.
    """
    if _room(path) < _LEAST_ROOM:
        raise _no_space()


def _room(path: Path) -> int:
    """Return how many bytes the disk still takes."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize


def _no_space() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
