"""Poses of a topic while they are read, in columns that grow in place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.io.bags.blocks import ROWS
from trajeval_ros.io.bags.pose_messages import PoseColumns

_RESERVED = 1 << 26  # bytes of a column, at most: counts of messages are not trusted
_COLUMNS = ("stamps", "positions", "quaternions", "body_velocities", "covariances", "fix_quality")


class GrowingPoses:
    """The poses of a topic, added part by part."""

    def __init__(self, expected: int) -> None:
        """Prepare to add.

        Args:
            expected: Number of poses to reserve memory for. The kernel provides memory only when
                it is written to, so an excessive number costs nothing.
        """
        self._expected = expected
        self._columns: dict[str, _Column] = {}
        self._frames: list[tuple[int, str, str]] = []
        self._undecodable = self._count = self._messages = 0

    def add(self, part: PoseColumns, log_times: NDArray[np.int64]) -> None:
        """Add poses, and the log times of all messages that they were decoded from."""
        columns = {name: getattr(part, name) for name in _COLUMNS} | {
            "rows": part.rows + self._messages,
            "log": log_times[part.rows],
        }
        for name, rows in columns.items():
            if rows is not None:
                if name not in self._columns:
                    self._columns[name] = _Column(rows, self._expected)
                self._columns[name].extend(rows)
        self._frames += [(self._count + row, frame, child) for row, frame, child in part.frames]
        self._undecodable += part.undecodable
        self._count += len(part.stamps)
        self._messages += len(log_times)

    def done(self) -> PoseColumns:
        """Return all poses in order of their log times."""
        columns = {name: column.done() for name, column in self._columns.items()}
        frames, log_times = self._frames, columns.pop("log")
        if (np.diff(log_times) < 0).any():
            order = np.argsort(log_times, kind="stable")
            columns = {name: column[order] for name, column in columns.items()}
            firsts = np.array([row for row, *_ in frames])
            which = (np.searchsorted(firsts, order, side="right") - 1).tolist()
            frames = [(row, *frames[change][1:]) for row, change in enumerate(which)]
        changes = [
            change
            for before, change in zip([None, *frames], frames, strict=False)
            if before is None or before[1:] != change[1:]
        ]
        return PoseColumns(
            columns["stamps"],
            columns["positions"],
            columns.get("quaternions"),
            columns.get("body_velocities"),
            columns.get("covariances"),
            columns.get("fix_quality"),
            changes,
            columns["rows"],
            self._undecodable,
        )


class _Column:
    """Rows that grow in place. Concatenating small arrays at the end takes twice the memory."""

    def __init__(self, like: NDArray[Any], expected: int) -> None:
        shape = like.shape[1:]
        most = _RESERVED // (like.dtype.itemsize * math.prod(shape))
        self._rows = np.empty((max(ROWS, min(expected, most)), *shape), like.dtype)
        self._count = 0

    def extend(self, rows: NDArray[Any]) -> None:
        end = self._count + len(rows)
        if end > len(self._rows):
            self._resize(max(end, len(self._rows) * 9 // 8))
        self._rows[self._count : end] = rows
        self._count = end

    def done(self) -> NDArray[Any]:
        self._resize(self._count)
        return self._rows

    def _resize(self, count: int) -> None:
        # Large arrays are not copied, only the page table changes. No other view exists.
        self._rows.resize((count, *self._rows.shape[1:]), refcheck=False)
