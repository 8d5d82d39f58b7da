"""A file (.rrd) of a complete run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from trajeval_ros.viewer.flushing import flush_to, open_file
from trajeval_ros.viewer.scene_entities import APPLICATION
from trajeval_ros.viewer.sdk import sdk


def recording_writer(
    title: str, blueprint: Any, draw: Callable[[Any], object]
) -> Callable[[Path], None]:
    """Return a function that writes a picture to a path, and raises OSError on a full disk.

    Args:
        title: Title of the recording in the viewer.
        blueprint: Its layout.
        draw: Logs all data to a recording.

    Raises:
        InputError: rerun-sdk is not installed.
    """
    rerun, _ = sdk()

    def write(path: Path) -> None:
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
