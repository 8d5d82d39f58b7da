"""The folder of recorded clips of several runs, limited in number and size."""

from __future__ import annotations

import re
import shutil
from datetime import datetime, timezone
from pathlib import Path

from trajeval_ros.formatting.topic_names import part_of_topic
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.temporary import collect_leftovers
from trajeval_ros.io.writing import refused_by_disk

_NAME = re.compile(r"\d{8}T\d{6}\.\d{3}Z_\w+")


class ClipFolder:
    """Names clips by time, and removes the oldest ones.

    Attributes:
        path: The folder.
    """

    def __init__(self, path: Path, most_clips: int, most_bytes: int) -> None:
        """Create the folder, and remove unfinished clips of killed processes.

        Raises:
            InputError: The folder cannot be created.
        """
        self.path = path
        self._most_clips, self._most_bytes = most_clips, most_bytes
        with refused_by_disk(str(path)):
            path.mkdir(parents=True, exist_ok=True)
        collect_leftovers(path)

    def new_clip(self, time_ns: int, subject: str) -> Path:
        """Return a path for a clip about a subject at a time, nanoseconds; it does not exist."""
        seconds, rest = divmod(time_ns, NANOSECONDS)
        time = datetime.fromtimestamp(seconds, timezone.utc)
        name = f"{time:%Y%m%dT%H%M%S}.{rest // 1_000_000:03d}Z_{part_of_topic(subject)}"
        return self.path / name

    def make_room(self) -> list[str]:
        """Remove the oldest clips beyond the limits, except the newest; return their names."""
        clips = sorted(path for path in self.path.iterdir() if _NAME.fullmatch(path.name))
        sizes = [sum(file.stat().st_size for file in clip.iterdir()) for clip in clips]
        removed = []
        while len(clips) > 1 and (len(clips) > self._most_clips or sum(sizes) > self._most_bytes):
            shutil.rmtree(clips[0], ignore_errors=True)
            removed.append(clips.pop(0).name)
            del sizes[0]
        return removed
