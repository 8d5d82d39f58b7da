"""Diverging estimates: displacements that differ from the groundtruth's, by an amount that grows.

Jumps, other frames, axes and units, and drift are no divergence.
"""

from __future__ import annotations

import math
import operator
from dataclasses import replace

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.tracking_loss import DIVERGED, Loss

_SAME = 1e-9  # in the estimate's unit: a repeated position
# Displacements are compared over this time: shorter ones are noise, longer ones delay an alarm.
_STEP_NS = NANOSECONDS // 2
_LONGEST_S = 3.0  # across a longer gap, displacements are not compared
# Rotation and scale between the frames are those of the last 30 s, without the last 2 s.
_MEMORY_S, _LAG, _SOLVE_EVERY = 30.0, 4, 4
_LEAST_M, _LEAST_STEPS = 2.0, 16  # path and number of displacements that determine them
_OUTLIER, _OUTLIER_M = 4.0, 0.25  # a displacement of 4 times the groundtruth's is not learned
_UNLIKE = 0.1  # largest share of squared lengths that do not correlate, before a divergence
# Difference that drift and noise explain: of the distance, and m/s.
_DRIFT, _NOISE_MPS = 0.3, 0.1
_MOST_STEP_M = 0.4  # of one difference: a jump is in one
# Accumulated differences in metres: of displacements, and of their lengths. At higher speeds, all
# are proportional to the speed.
_SLOW_MPS = 2.0
_WARNING_M, _ERROR_M, _MOST_M = (0.5, 0.2), (1.0, 0.4), 5.0
# Scale of an estimate that never agreed, now and relative to its first value.
_RUNAWAY, _RUNAWAY_SINCE = 0.1, 1.0 / 3.0
_AGREES_AGAIN, _AGREES_M = 6, 0.5  # steps in a row that end a divergence, with this motion


# Steps are columns (9, n): time in seconds, displacements of groundtruth and estimate, and their
# lengths. Their sums are columns (14, n): path of the groundtruth, time, squares and the product
# of lengths, and the products of displacements, row by row.
_TIME_S, _TRUE, _OWN, _TRUE_M, _OWN_M = 0, slice(1, 4), slice(4, 7), 7, 8
_PRODUCTS = slice(5, 14)
_BLOCK = 512  # steps that are compared at a time
_TINY = 1e-300  # in place of a divisor of zero


class Divergence:
    """Accumulates the differences of displacements; a CUSUM test of each of two series.

    Displacements of the estimate are rotated and scaled to those of the groundtruth by the fit of
    the last ones. Their lengths are compared, too, because after a restart in another frame only
    these agree. An estimate diverges if both sums exceed their limits.
    """

    def __init__(self) -> None:
        self.losses: list[Loss] = []
        self._first: int | None = None  # stamp
        self._cell = 0  # of the newest used pair
        # The newest used pair, if any: stamp (1,), positions of groundtruth and estimate (1, 6).
        self._newest: tuple[Stamps, Floats] = (np.empty(0, dtype=np.int64), np.empty((0, 6)))
        self._waiting: Floats = np.zeros((9, _LAG))  # the last steps, or zeros: not yet learned
        self._sums: Floats = np.zeros((14, 1))  # of learned steps, with fading memory
        self._first_scale = 0.0  # metres per unit of the estimate
        self._learned = self._solved = 0  # number of steps, now and at the solution
        self._rotation: Floats = np.eye(3)
        self._sum_m = self._lengths_m = 0.0
        self._before_m = 0.0, 0.0
        self._begin_ns, self._since_m, self._moved_m = 0, 0.0, 0.0
        self._agreeing, self._agreeing_m = 0, 0.0
        self._ran_away = False

    @property
    def is_clear(self) -> bool:
        """Whether the sum of differences is zero."""
        return self._sum_m == 0.0 and not self._is_lost

    @property
    def _is_lost(self) -> bool:
        return bool(self.losses) and not self.losses[-1].is_over

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and positions (N, 3)."""
        if not len(stamps):
            return
        if self._first is None:
            self._first, self._cell = int(stamps[0]), -1
        cells = (stamps - self._first) // _STEP_NS
        rows = np.flatnonzero(np.diff(cells, prepend=self._cell) > 0)
        self._cell = int(cells[-1])
        if not len(rows):
            return
        stamps = np.append(self._newest[0], stamps[rows])
        pairs = np.vstack([self._newest[1], np.hstack([groundtruth[rows], estimate[rows]])])
        rows = _compared(stamps, pairs)
        begins, self._newest = rows[:-1], (stamps[rows[-1:]], pairs[rows[-1:]])
        spans, moved = np.stack([stamps[begins], stamps[1:]]), (pairs[1:] - pairs[begins]).T
        seconds = np.diff(spans, axis=0) / NANOSECONDS
        steps = np.vstack([seconds, moved, _lengths(moved[:3]), _lengths(moved[3:])])
        used = (steps[_TRUE_M:].min(axis=0) > _SAME) & (steps[_TIME_S] <= _LONGEST_S)
        spans, steps = spans[:, used], steps[:, used]
        while steps.size:
            taken = self._take(spans[:, :_BLOCK], steps[:, :_BLOCK])
            spans, steps = spans[:, taken:], steps[:, taken:]

    def _take(self, spans: Stamps, steps: Floats) -> int:
        """Take n steps with stamps (2, n), or until a loss begins or ends, and return how many."""
        is_lost, queue = self._is_lost, np.hstack([self._waiting, steps])
        sums, learned = self._summed(queue[:, : steps.shape[1]] * (not is_lost))
        path_m, path_s, true_true, true_own, own_own = sums[: _PRODUCTS.start]
        scales = true_own / np.maximum(own_own, _TINY)  # before the first learned step: 0
        known = (path_m >= _LEAST_M) & (learned >= _LEAST_STEPS)
        if not self._first_scale and known.any():
            self._first_scale = float(scales[known.argmax()])
        # Whether lengths of displacements correlated before, and whether the estimate moves ever
        # faster than the groundtruth from the start.
        agreed = true_own**2 > (1.0 - _UNLIKE) * true_true * own_own
        runs_away = scales < min(_RUNAWAY, _RUNAWAY_SINCE * self._first_scale)
        true_m, own_m = steps[_TRUE_M:]
        explained_m = _DRIFT * true_m + _NOISE_MPS * steps[_TIME_S]
        units = np.maximum(1.0, path_m / np.maximum(path_s, _TINY) / _SLOW_MPS)

        def compared() -> tuple[Floats, list[bool]]:
            apart_m = _lengths(scales * (self._rotation @ steps[_OWN]) - steps[_TRUE])
            excess_m = (apart_m - explained_m) / units
            return excess_m, (~known | agreed & (excess_m <= 0.0)).tolist()

        excess_m, agrees = compared()
        of_lengths_m = (np.abs(scales * own_m - true_m) - explained_m) / units
        moved_m = own_m * np.where(agreed, scales, self._first_scale)
        taken = len(true_m)
        for row in range(taken):
            is_unexplained = not agrees[row] and excess_m[row] > 0.0
            if is_unexplained and learned[row] >= self._solved + _SOLVE_EVERY:
                self._solve(sums[_PRODUCTS, row])  # as the last solution does not explain the step
                self._solved, (excess_m, agrees) = int(learned[row]), compared()
            if self._sum_m == 0.0 and not is_lost:
                if agrees[row]:
                    continue  # the usual case: the sum stays zero
                self._begin_ns, self._since_m, self._moved_m = int(spans[0, row]), 0.0, 0.0
                self._lengths_m, self._before_m = 0.0, (0.0, 0.0)
            self._since_m += float(true_m[row])
            self._moved_m += float(moved_m[row])
            self._sum_m = _accumulated(self._sum_m, float(excess_m[row]))
            # The smallest of three in a row, since a jump is in one, and an outlier in two.
            both_m = float(excess_m[row]), float(of_lengths_m[row])
            self._lengths_m = _accumulated(self._lengths_m, min(both_m[1], *self._before_m))
            self._before_m = self._before_m[1], both_m[1]
            evidence = bool(agreed[row]), bool(runs_away[row])
            if self._judge(int(spans[1, row]), float(true_m[row]), min(both_m), *evidence):
                queue[:], taken = 0.0, row + 1
                break
        self._sums, self._learned = sums[:, taken - 1 : taken], int(learned[taken - 1])
        self._waiting = queue[:, taken : taken + _LAG]
        return taken

    def _judge(
        self, end_ns: int, true_m: float, difference_m: float, agreed: bool, runs_away: bool
    ) -> bool:
        """Begin, extend or end a loss; return whether one begins or ends."""
        sums, begins = (self._sum_m, self._lengths_m), not self._is_lost
        if begins:
            if agreed:
                if any(map(operator.lt, sums, _WARNING_M)):
                    return False
            elif runs_away:
                self._begin_ns, self._ran_away = self._first or 0, True
            else:
                return False
            self.losses.append(Loss.beginning(DIVERGED, self._begin_ns))
        agrees = difference_m <= 0.0
        self._agreeing = self._agreeing + 1 if agrees else 0
        self._agreeing_m = self._agreeing_m + true_m if agrees else 0.0
        known = self.losses[-1]
        is_over = self._agreeing >= _AGREES_AGAIN and self._agreeing_m >= _AGREES_M
        is_over &= not self._ran_away  # any motion agrees with a scale that was never right
        self.losses[-1] = replace(
            known,
            end_ns=end_ns,
            true_m=self._since_m,
            moved_m=self._moved_m,
            is_error=known.is_error or not any(map(operator.lt, sums, _ERROR_M)),
            is_over=is_over,
        )
        if is_over:
            self._sum_m = 0.0
        return begins or is_over

    def _summed(self, steps: Floats) -> tuple[Floats, Indices]:
        """Return the sums (14, n) and the number (n,) of learned steps after each of n steps."""
        while True:
            time_s, true_m, own_m = steps[[_TIME_S, _TRUE_M, _OWN_M]]
            # Only motion is forgotten by time: a hover keeps the fit.
            moves = true_m > _NOISE_MPS * time_s
            kept = np.exp(np.cumsum(np.where(moves, time_s, 0.0)) / -_MEMORY_S)
            products = (steps[_TRUE, None] * steps[_OWN]).reshape(9, -1)
            added = np.vstack([true_m, time_s, true_m**2, true_m * own_m, own_m**2, products])
            sums = kept * (self._sums + np.cumsum(added / kept, axis=1))
            path_m, _, _, true_own, own_own = np.hstack([self._sums, sums])[: _PRODUCTS.start, :-1]
            scaled_m = own_m * true_own / np.maximum(own_own, _TINY)
            outliers = (path_m > 1.0) & (scaled_m > _OUTLIER * np.maximum(true_m, _OUTLIER_M))
            if not outliers.any():
                return sums, self._learned + np.cumsum(time_s > 0.0)
            steps[:, outliers.argmax()] = 0.0  # not learned

    def _solve(self, products: Floats) -> None:
        # A reflection is allowed: mirrored axes are no divergence.
        left, _, right = np.linalg.svd(products.reshape(3, 3))
        self._rotation = left @ right


def _compared(stamps: Stamps, pairs: Floats) -> Indices:
    """Return the row with which each of the rows after the first is compared, and the next one.

    It is the newest row until the positions (n, 6) of both sides differ, or for some seconds.
    """
    rows = np.arange(len(stamps))
    moved = np.diff(pairs, axis=0)
    if min(_lengths(item).min(initial=1.0) for item in (moved.T[:3], moved.T[3:])) > _SAME:
        return rows
    true, own = pairs[:, :3].tolist(), pairs[:, 3:].tolist()
    begin = 0
    for row, stamp in enumerate(stamps.tolist()):
        repeats = min(math.dist(true[begin], true[row]), math.dist(own[begin], own[row])) <= _SAME
        if not repeats or stamp - stamps[begin] >= _LONGEST_S * NANOSECONDS:
            begin = row
        rows[row] = begin
    return rows


def _lengths(vectors: Floats) -> Floats:
    """Return the lengths (n,) of vectors (3, n)."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=0)))


def _accumulated(sum_m: float, more_m: float) -> float:
    return min(max(sum_m + min(more_m, _MOST_STEP_M), 0.0), _MOST_M)
