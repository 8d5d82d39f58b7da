"""What is learned from good pairs: the usual differences over all lags, and the body."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.metrics.discontinuities.relative_motion import (
    CELL_S,
    PAIR_WIDTH,
    Difference,
    RelativeMotion,
)
from trajeval_ros.metrics.discontinuities.usual_differences import KEPT, LAGS, UsualDifferences

_FIT_LAG = 2  # cells between the pairs that determine rotation, scale and lever arm
# Motions over one period. The first ones are all learned, and again with a known rotation; later
# ones are learned three times per cell.
_ALL_LEARNED = 60
_MOST_MARKS = 40  # earlier pairs that a correction agrees with: more cost time at a step


class MotionHistory:
    """Good pairs, one per cell of time, and what is learned from their differences.

    Nothing is learned before `learn`, so that limits are equal for batches of any size.
    """

    def __init__(self, motion: RelativeMotion, begin_s: float, period_s: float) -> None:
        self.usual = UsualDifferences(period_s)
        self.marks: list[Floats] = []  # good pairs, evenly over the present part
        self._mark_cells = 1  # between two marks
        self._motion, self._begin_s, self._period_s = motion, begin_s, period_s
        self._cell = 0
        self._rows: Floats = np.empty((0, PAIR_WIDTH))  # good pairs, one per cell
        self._cells: Indices = np.empty(0, dtype=np.int64)
        self._new = 0  # how many of them are not learned yet
        # How many of them, the newest ones, wait to be compared over lags, and how many did.
        self.waiting = self._known = 0
        self._calm: list[tuple[Floats, Floats]] = []  # begin and end of motions over one period
        self._steps: list[Difference] = []  # over one period, not learned yet
        self._calm_count = 0

    def add_calm(self, begin: Floats, end: Floats, difference: Difference) -> None:
        """Take N differences over one period, and the pairs (N, 15) between which they are."""
        if self._motion.rotation is None:
            both = zip(*self._calm, (begin, end), strict=True)
            first, last = (np.concatenate(pairs)[-_ALL_LEARNED:] for pairs in both)
            self._calm = [(first, last)]
        numbers = self._calm_count + 1 + np.arange(len(end))
        every = max(1, int(CELL_S / self._period_s) // 3)
        rows = np.flatnonzero((numbers % every == 0) | (numbers <= _ALL_LEARNED))
        if len(rows):
            self._steps.append(Difference(*(values[rows] for values in difference)))
        self._calm_count += len(end)

    def add(self, pairs: Floats) -> None:
        """Take good pairs (N, 15)."""
        cells = self._cells_of(pairs)
        first = np.flatnonzero(np.diff(cells, prepend=self._cell))
        if not len(first):
            return
        self._cell = int(cells[-1])
        self._rows = np.concatenate([self._rows, pairs[first]])
        self._cells = np.concatenate([self._cells, cells[first]])
        self._new += len(first)

    def learn(self, *, of_lags: bool = True) -> bool:
        """Learn from what was taken since the last call; return whether there was any.

        Differences over `LAGS` may wait until they are as many as the known ones: only limits in
        gaps and after unusual motions depend on the newest ones.
        """
        is_new = bool(self._steps or self._new)
        for difference in self._steps:
            self.usual.add(0, difference.m, difference.deg)
        self._steps.clear()
        new, self._new = self._new, 0
        if new:
            self.waiting += new
            self._mark(self._rows[-new:], self._cells[-new:])
            lags = self.usual.lags
            begins, ends, _ = self._compared(len(self._rows) - new, lags[lags == _FIT_LAG])
            if len(ends) and self._motion.learn(self._rows[begins], self._rows[ends]):
                self._learn_again()
        if self.waiting and (of_lags or self.waiting >= min(self._known, KEPT)):
            self._learn_lags(len(self._rows) - self.waiting)
            self._known, self.waiting, is_new = self._known + self.waiting, 0, True
        if len(self._rows):
            oldest = self._cells[-max(self.waiting, 1)]
            kept = self._cells > oldest - LAGS[-1]
            self._rows, self._cells = self._rows[kept], self._cells[kept]
        return is_new

    def _mark(self, rows: Floats, cells: Indices) -> None:
        for cell, row in zip(cells.tolist(), rows, strict=True):
            if cell % self._mark_cells == 0:
                self.marks.append(row)
            if len(self.marks) > _MOST_MARKS:
                self.marks, self._mark_cells = self.marks[::2], 2 * self._mark_cells

    def begin_at(self, pair: Floats, *, is_learned: bool = True) -> None:
        """Compare no pairs before and after this one; it is not learned itself if it is not."""
        self.learn()
        self._rows, self._cells = self._rows[:0], self._cells[:0]
        self._cell = int(self._cells_of(pair)) - is_learned

    def begin_part(self) -> None:
        """Forget the marks, after a step that is no correction."""
        self.marks, self._mark_cells = [], 1

    def _cells_of(self, pairs: Floats) -> Indices:
        return ((pairs[..., 0] - self._begin_s) / CELL_S).astype(np.int64)

    def _compared(self, first: int, lags: Indices) -> tuple[Indices, Indices, Indices]:
        """Return the rows that are compared with those from one on, and the numbers of lags."""
        earlier = (self._cells[first:, None] - lags).ravel()
        ends = np.repeat(np.arange(first, len(self._cells)), len(lags))
        numbers = np.tile(np.arange(len(lags)), len(self._cells) - first)
        begins = np.minimum(np.searchsorted(self._cells, earlier), len(self._cells) - 1)
        seconds = self._rows[:, 0]
        apart_s = np.abs(seconds[ends] - seconds[begins] - CELL_S * lags[numbers])
        known = (self._cells[begins] == earlier) & (apart_s <= 0.5 * CELL_S + self._period_s)
        return begins[known], ends[known], numbers[known]

    def _learn_lags(self, first: int) -> None:
        """Learn the differences over all lags that end at rows from one on."""
        begins, ends, numbers = self._compared(first, self.usual.lags)
        difference = self._motion.among(self._rows, begins, ends)
        self.usual.add(1 + numbers, difference.m, difference.deg)

    def _learn_again(self) -> None:
        """Replace differences of lengths by those of vectors, once the rotation is known."""
        self.usual.clear()
        self._known, self.waiting = 0, len(self._rows)
        for begin, end in self._calm:
            difference = self._motion.between(begin, end)
            self.usual.add(0, difference.m, difference.deg)
        self._calm.clear()
