"""The poses of a topic, by column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Floats, at_rows
from trajeval_ros.geometry.source_info import ReceiveTimes
from trajeval_ros.geometry.valid_poses import add_counts

Frames = tuple[int, str, str]  # first row, frame and child frame
# Columns with a row per pose.
COLUMNS = (
    *("stamps", "positions", "quaternions", "body_velocities", "velocities", "covariances"),
    *("fix_quality", "flags", "rows", "body_rates"),
)


@dataclass(frozen=True, eq=False)
class PoseColumns:
    """The poses of a topic."""

    stamps: NDArray[np.int64]  # (N,) int64, nanoseconds, of the headers
    # (N, 3), metres; of fixes latitude and longitude, degrees, and height, metres.
    positions: Floats
    quaternions: Floats | None  # (N, 4), xyzw, or None if the type has none
    body_velocities: Floats | None  # (N, 3), m/s, in the body, or None
    covariances: Floats | None  # (N, 6, 6), position first, or None
    # (N, 11) of fixes: status, type of covariance, and the covariance about east, north and up,
    # m^2, row by row; else None.
    fix_quality: Floats | None
    # First row, frame and child frame at every change of the frames.
    frames: list[Frames]
    rows: NDArray[np.int64]  # (N,) int64, number of the message of a pose
    undecodable: int  # number of messages that can't be decoded
    velocities: Floats | None = None  # (N, 3), m/s, in the frame, of types without those of bodies
    flags: NDArray[np.int64] | None = None  # (N, 2) of PX4: reset counters and quality, or None
    dropped: Mapping[str, int] = field(default_factory=dict)  # messages without a pose, by reason
    body_rates: Floats | None = None  # (N, 3), rad/s, in the body, or None
    receive_times: ReceiveTimes | None = None  # of the N poses of a bag
    as_received: PoseColumns | None = None  # of paths, the last pose of every message

    def picked(self, usable: Booleans, reason: str) -> PoseColumns:
        """Return the poses of a mask (N,); the others are counted as dropped for a reason."""
        number = int(np.count_nonzero(~usable))
        if not number:
            return self
        ends = np.cumsum(usable)
        frames = [
            (int(ends[row] - usable[row]), frame, child)
            for (row, frame, child), end in zip(
                self.frames, [*(row for row, *_ in self.frames[1:]), len(usable)], strict=True
            )
            if usable[row:end].any()
        ]
        dropped = add_counts(self.dropped, {reason: number})
        return self.rows_of(usable).replaced(frames=frames_changes(frames), dropped=dropped)

    def rows_of(self, usable: NDArray[Any]) -> PoseColumns:
        """Return the columns of the poses of a mask or of indices, with unchanged frames."""
        return at_rows(self, (*COLUMNS, "receive_times"), usable)

    def joined(self, other: PoseColumns) -> PoseColumns:
        """Return these poses followed by others with the same columns; frames are not joined."""
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in COLUMNS}
        return self.replaced(
            **{name: np.concatenate(pair) for name, pair in pairs.items() if pair[0] is not None}
        )

    def replaced(self, **columns: Any) -> PoseColumns:
        """Return the poses with other columns."""
        return replace(self, **columns)


def frames_changes(frames: list[Frames]) -> list[Frames]:
    """Return the entries whose frames differ from those of the entry before."""
    return [*frames[:1], *(after for before, after in pairwise(frames) if before[1:] != after[1:])]
