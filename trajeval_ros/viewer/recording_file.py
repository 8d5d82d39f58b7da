"""A file (.rrd) of a run that is over."""

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
    """Return what writes a picture to a path; it raises OSError where the disk takes no more.

    Args:
        title: What the viewer calls the recording.
        blueprint: Its layout.
        draw: Logs everything to a recording.

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
