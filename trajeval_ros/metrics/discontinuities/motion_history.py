"""What is learned from good pairs: the usual differences over all lags, and the body."""

from __future__ import annotations

from collections import deque

from trajeval_ros.metrics.discontinuities.relative_motion import (
    CELL_S,
    LAGS,
    Difference,
    Pair,
    RelativeMotion,
    UsualDifferences,
)

_FIT_LAG = 2  # cells between the pairs that determine rotation, scale and lever arm
_CALM_KEPT = 60  # motions over one period that are learned again with a known rotation
_ALL_LEARNED = 60  # motions over one period; later ones are learned three times per cell
_MOST_MARKS = 40  # earlier pairs that a correction agrees with: more cost time at a step


class MotionHistory:
    """Good pairs, one per cell of time, and what is learned from their differences."""

    def __init__(self, motion: RelativeMotion, begin_s: float, period_s: float) -> None:
        self.usual = UsualDifferences(period_s)
        self.marks: list[Pair] = []  # good pairs, evenly over the present part
        self._mark_cells = 1  # between two marks
        self._motion, self._begin_s, self._period_s = motion, begin_s, period_s
        self._cell = 0
        self._ring: deque[Pair | None] = deque(maxlen=LAGS[-1] + 1)  # good pairs, one per cell
        self._calm: deque[tuple[Pair, Pair]] = deque(maxlen=_CALM_KEPT)
        self._calm_count = 0

    def add_calm(self, previous: Pair, pair: Pair, difference: Difference) -> None:
        """Learn the difference over one period."""
        self._calm.append((previous, pair))
        self._calm_count += 1
        every = max(1, int(CELL_S / self._period_s) // 3)
        if self._calm_count % every == 0 or len(self.usual) < _ALL_LEARNED:
            self.usual.add(0, difference)

    def add(self, pair: Pair) -> None:
        """Learn the differences over all lags, once per cell."""
        cell = self._cell_of(pair)
        if cell == self._cell:
            return
        self._ring.extend([None] * min(cell - self._cell - 1, LAGS[-1] + 1))
        self._cell = cell
        for lag in LAGS:
            earlier = self._ring[-lag] if len(self._ring) >= lag else None
            if earlier is None or not self._is_lag(lag, pair.t - earlier.t):
                continue
            self.usual.add(lag, self._motion.between(earlier, pair))
            if lag == _FIT_LAG and self._motion.learn(earlier, pair):
                self._learn_again()
        self._ring.append(pair)
        if cell % self._mark_cells == 0:
            self.marks.append(pair)
        if len(self.marks) > _MOST_MARKS:
            self.marks, self._mark_cells = self.marks[::2], 2 * self._mark_cells

    def begin_at(self, pair: Pair, *, is_learned: bool = True) -> None:
        """Compare no pairs before and after this one; it is not learned itself if it is not."""
        self._ring.clear()
        self._cell = self._cell_of(pair) - is_learned

    def begin_part(self) -> None:
        """Forget the marks, after a step that is no correction."""
        self.marks, self._mark_cells = [], 1

    def _cell_of(self, pair: Pair) -> int:
        return int((pair.t - self._begin_s) / CELL_S)

    def _is_lag(self, lag: int, seconds: float) -> bool:
        apart_s = abs(seconds - lag * CELL_S)
        return self.usual.is_learned(lag) and apart_s <= 0.5 * CELL_S + self._period_s

    def _learn_again(self) -> None:
        """Replace differences of lengths by those of vectors, once the rotation is known."""
        self.usual.clear()
        pairs = [pair for pair in self._ring if pair is not None]
        for row, pair in enumerate(pairs):
            for lag in LAGS:
                if row >= lag and self._is_lag(lag, pair.t - pairs[row - lag].t):
                    self.usual.add(lag, self._motion.between(pairs[row - lag], pair))
        for one, other in self._calm:
            self.usual.add(0, self._motion.between(one, other))
