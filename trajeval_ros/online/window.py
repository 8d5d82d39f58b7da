"""How much of the run the live numbers are about, and the pairs that they need."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.errors import lengths
from trajeval_ros.online.state_rows import (
    POSITION,
    WIDTH,
    WIDTH_WITH_COVARIANCE,
    Pairs,
    as_wide,
)

_LARGEST = 1e9  # s, m or pairs; in nanoseconds it still fits stamps


@dataclass(frozen=True)
class Window:
    """The newest part of a run: a time, a distance or a number of pairs; or all of it.

    Attributes:
        size: How much; 0 is the whole run.
        unit: `s`, `m`, or `pairs`.
    """

    size: float = 0.0
    unit: str = "pairs"

    @classmethod
    def parse(cls, text: str) -> Window:
        """Read "0" (the whole run), "30s", "50m" or "500" (pairs).

        Raises:
            SettingsError: It is none of these, or longer than any run.
        """
        match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(s|m)?\s*", text)
        if match is None:
            raise SettingsError(
                f"the window {text!r} is not valid; give 0 (whole run), 30s, 50m or 500 (pairs)"
            )
        size = float(match[1])
        if size > _LARGEST:
            raise SettingsError(
                f"the window {text.strip()} is above the limit of {_LARGEST:g}; use 0 for the "
                "whole run"
            )
        return cls(size, match[2] or "pairs")

    def __str__(self) -> str:
        """Write it as `parse` reads it."""
        return f"{self.size:.15g}{'' if self.unit == 'pairs' else self.unit}"

    @property
    def is_whole_run(self) -> bool:
        """Whether nothing ever leaves it."""
        return self.size == 0.0


class PairStore:
    """The newest pairs as columns, in order of arrival, each with the path up to it.

    Pairs are numbered from the beginning of the run; `begin` is the oldest that is held. A pair
    takes `BYTES_PER_PAIR`. Room for as many again is made when it runs out: allocated is up to
    twice what the pairs take, resident what they take, and while they move the double of it.
    """

    BYTES_PER_PAIR = 8 * (1 + 2 * WIDTH + 1)  # and 288 with covariances

    def __init__(self, *, covariances: bool = False) -> None:
        """Create it empty.

        Args:
            covariances: Keep those of the estimate, too.
        """
        self.begin = self.end = 0
        self._offset = 0  # number of the pair in row 0
        # Groundtruth, estimate, and the path behind them.
        self._own_width = WIDTH_WITH_COVARIANCE if covariances else WIDTH
        self._stamps: Stamps = np.empty(1024, dtype=np.int64)
        self._rows: Floats = np.empty((1024, WIDTH + self._own_width + 1))

    def __len__(self) -> int:
        """Return the number of pairs held."""
        return self.end - self.begin

    def append(self, pairs: Pairs) -> None:
        """Add pairs; the path goes on from the last groundtruth position."""
        count = len(pairs.stamps)
        self._make_room(count)
        first = self.end - self._offset
        rows = self._rows[first : first + count]
        self._stamps[first : first + count] = pairs.stamps
        rows[:, :WIDTH] = pairs.groundtruth
        rows[:, WIDTH:-1] = as_wide(pairs.estimate, self._own_width)
        if not first:
            self._rows[0, -1] = 0.0
        path = self._rows[max(first - 1, 0) : first + count]
        steps = lengths(path[1:, POSITION] - path[:-1, POSITION])
        path[1:, -1] = path[:1, -1] + np.cumsum(steps)
        self.end += count

    def drop_before(self, number: int) -> None:
        """Forget the pairs before this one."""
        self.begin = min(max(self.begin, number), self.end)

    def _view(self, begin: int | None) -> slice:
        first = self.begin if begin is None else max(begin, self.begin)
        return slice(first - self._offset, self.end - self._offset)

    def stamps(self, begin: int | None = None) -> Stamps:
        """Stamps of the pairs from a number on, (N,), nanoseconds."""
        return self._stamps[self._view(begin)]

    def groundtruth(self, begin: int | None = None) -> Floats:
        """Groundtruth states of the pairs from a number on, (N, 10)."""
        return self._rows[self._view(begin), :WIDTH]

    def estimate(self, begin: int | None = None) -> Floats:
        """Estimated states of the pairs from a number on, (N, 10), or (N, 46) with covariances."""
        return self._rows[self._view(begin), WIDTH:-1]

    def along(self, begin: int | None = None) -> Floats:
        """Groundtruth path up to the pairs from a number on, (N,), metres."""
        return self._rows[self._view(begin), -1]

    def window_begin(self, window: Window) -> int:
        """Return the number of the first pair in a window."""
        if window.is_whole_run or not len(self):
            return self.begin
        if window.unit == "pairs":
            return max(self.begin, self.end - int(window.size))
        if window.unit == "m":
            along = self.along()
            return self.begin + int(along.searchsorted(along[-1] - window.size))
        stamps = self.stamps()
        oldest = stamps[-1] - round(window.size * NANOSECONDS)
        return self.begin + int(stamps.searchsorted(oldest))

    def _make_room(self, count: int) -> None:
        if self.end - self._offset + count <= len(self._stamps):
            return
        # The pair before the oldest stays: the path goes on from it.
        keep = max(self.begin - 1, self._offset) - self._offset
        stamps, rows = self._stamps[keep : self.end - self._offset], self._rows[keep:]
        rows = rows[: len(stamps)]
        size = max(1024, 2 * (len(stamps) + count))
        self._offset += keep
        self._stamps, self._rows = np.empty(size, np.int64), np.empty((size, self._rows.shape[1]))
        self._stamps[: len(stamps)], self._rows[: len(stamps)] = stamps, rows
