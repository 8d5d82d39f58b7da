"""The files of one segment of an estimate, in the folder of the run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.io.live.pair_file import SUFFIX, PairWriter
from trajeval_ros.io.live.revised_file import REVISED_SUFFIX, write_revised
from trajeval_ros.io.writing import write_whole
from trajeval_ros.online.revised import RevisedPath
from trajeval_ros.online.state_rows import POSITION, QUATERNION


class SegmentFiles:
    """Writes the pairs of a segment, the state of the run, and the newest path.

    Attributes:
        folder: Their folder.
        pairs: The pair file.
    """

    def __init__(
        self, folder: Path, name: str, segment: int, description: Mapping[str, Any]
    ) -> None:
        """Create an empty pair file.

        Args:
            folder: Existing folder.
            name: Name of the estimate.
            segment: Number of the segment, from 1.
            description: Description of the run, for the pair file.

        Raises:
            InputError: The file can't be made.
        """
        self.folder = folder
        self._stem = name if segment == 1 else f"{name}.{segment}"
        self.pairs = PairWriter(
            folder / f"{self._stem}{SUFFIX}", {**description, "segment": segment}
        )
        self._state: Mapping[str, Any] = {}

    def write_state(self, state: Mapping[str, Any]) -> None:
        """Write what `trajeval finish` needs besides pairs (`recorded_state`), if it changed."""
        if state == self._state:
            self.pairs.write()
            return
        self._state = state
        none = np.empty((0, 10))
        self.pairs.append(np.empty(0, dtype=np.int64), none, none, state)

    def write_path(self, path: RevisedPath, offset_ns: int) -> None:
        """Write a path with an offset of its timestamps, if it has poses.

        Raises:
            InputError: It can't be written.
        """
        if not len(path.stamps):
            return
        stamps, positions = path.stamps + offset_ns, path.states[:, POSITION]
        write_whole(
            self.folder / f"{self._stem}{REVISED_SUFFIX}",
            lambda file: write_revised(file, stamps, positions, path.states[:, QUATERNION]),
        )
