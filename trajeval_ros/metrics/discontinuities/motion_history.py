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
from trajeval_ros.metrics.discontinuities.usual_differences import LAGS, UsualDifferences

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

    def learn(self) -> bool:
        """Learn from what was taken since the last call; return whether there was any."""
        is_new = bool(self._steps or self._new)
        for difference in self._steps:
            self.usual.add(0, difference.m, difference.deg)
        self._steps.clear()
        new, self._new = self._new, 0
        if not new:
            return is_new
        begin, end, numbers = self._compared(len(self._rows) - new)
        self._learn_usual(begin, end, numbers)
        fits = LAGS[numbers - 1] == _FIT_LAG
        if fits.any() and self._motion.learn(begin[fits], end[fits]):
            self._learn_again()
        for cell, row in zip(self._cells[-new:].tolist(), self._rows[-new:], strict=True):
            if cell % self._mark_cells == 0:
                self.marks.append(row)
            if len(self.marks) > _MOST_MARKS:
                self.marks, self._mark_cells = self.marks[::2], 2 * self._mark_cells
        kept = self._cells > self._cells[-1] - LAGS[-1]
        self._rows, self._cells = self._rows[kept], self._cells[kept]
        return is_new

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

    def _compared(self, first: int) -> tuple[Floats, Floats, Indices]:
        """Return the pairs that are compared with those from a row on, and numbers of lags."""
        earlier = (self._cells[first:, None] - LAGS).ravel()
        ends = np.repeat(np.arange(first, len(self._cells)), len(LAGS))
        numbers = np.tile(np.arange(1, len(LAGS) + 1), len(self._cells) - first)
        begins = np.minimum(np.searchsorted(self._cells, earlier), len(self._cells) - 1)
        begin, end = self._rows[begins], self._rows[ends]
        apart_s = np.abs(end[:, 0] - begin[:, 0] - CELL_S * LAGS[numbers - 1])
        known = self.usual.is_learned[numbers] & (self._cells[begins] == earlier)
        known &= apart_s <= 0.5 * CELL_S + self._period_s
        return begin[known], end[known], numbers[known]

    def _learn_usual(self, begin: Floats, end: Floats, numbers: Indices) -> None:
        difference = self._motion.between(begin, end)
        self.usual.add(numbers, difference.m, difference.deg)

    def _learn_again(self) -> None:
        """Replace differences of lengths by those of vectors, once the rotation is known."""
        self.usual.clear()
        self._learn_usual(*self._compared(0))
        for begin, end in self._calm:
            difference = self._motion.between(begin, end)
            self.usual.add(0, difference.m, difference.deg)
        self._calm.clear()
