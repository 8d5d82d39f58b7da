"""Files (.rrd) of complete runs, and detection of a full disk under them."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from trajeval_ros.viewer.scene_entities import APPLICATION
from trajeval_ros.viewer.sdk import sdk

_LEAST_ROOM, _LITTLE_ROOM = 2**16, 2**20  # bytes


def open_file(recording: Any, path: Path, blueprint: Any, *, write_footer: bool = True) -> None:
    """Write a recording to a file from now on."""
    rerun, _ = sdk()
    _require_room(path)
    sink = rerun.FileSink(str(path), write_footer=write_footer)
    recording.set_sinks(sink, default_blueprint=blueprint)


def flush_to(path: Path, recording: Any) -> None:
    """Flush a recording to its file."""
    try:
        recording.flush()
    except RuntimeError as error:
        if _room(path) < _LITTLE_ROOM:
            raise _no_space() from error
        raise OSError(str(error)) from error
    _require_room(path)  # on a nearly full disk, flush may drop data without an error


def _require_room(path: Path, least: int = _LEAST_ROOM) -> None:
    """Check that the disk has room for a few chunks, or for a number of bytes."""
    if _room(path) < least:
        raise _no_space()


def _room(path: Path) -> int:
    """Return the free bytes of the disk."""
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize


def _no_space() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def recording_writer(
    title: str, blueprint: Any, draw: Callable[[Any], object]
) -> Callable[[Path], None]:
    """Return a function that writes a picture to a path, and raises OSError on a full disk."""
    rerun, _ = sdk()

    def write(path: Path) -> None:
        # Without room for a complete recording, its writer can wait without end.
        _require_room(path, _LITTLE_ROOM)
        recording = rerun.RecordingStream(APPLICATION)
        recording.set_log_time_enabled(False)
        open_file(recording, path, blueprint)
        try:
            recording.send_recording_name(title)
            draw(recording)
            flush_to(path, recording)
        finally:
            recording.disconnect()

    return write
