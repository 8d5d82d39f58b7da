"""Options of the input that have no effect on any source."""

from __future__ import annotations

from collections.abc import Iterable

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.text.hints import TextHints
from trajeval_ros.io.text.layouts import AS_NAMED
from trajeval_ros.io.text.reader import COUNTED


def require_used(hints: TextHints, notes: Iterable[str]) -> None:
    """Refuse column names and a frame rate that no source needed.

    Args:
        hints: Of the command line.
        notes: What the readers of all sources noted.

    Raises:
        SettingsError: No source is a text file with named columns, or all have timestamps.
    """
    noted = [note.removeprefix("format: ") for note in notes]
    if hints.columns and AS_NAMED not in noted:
        raise SettingsError("--columns is for text files, and no text file was read; remove it")
    if hints.frame_rate_hz is not None and not any(each.startswith(COUNTED) for each in noted):
        raise SettingsError(
            "--frame-rate is for text files without timestamps, and no such file was read; remove "
            "it"
        )
