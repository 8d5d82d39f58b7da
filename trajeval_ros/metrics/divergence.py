"""Diverging estimates: displacements that differ from the groundtruth's, by an amount that grows.

Jumps, other frames, axes and units, and drift are no divergence.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from dataclasses import replace

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
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


# A step is plain floats, since arrays of three are slower: time in seconds, displacements of
# groundtruth and estimate, and their lengths.
_Vector = tuple[float, float, float]
_Step = tuple[float, _Vector, _Vector, float, float]


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
        self._newest: tuple[int, _Vector, _Vector] | None = None
        self._waiting: deque[_Step] = deque()
        # Sums with fading memory: products of displacements (9), row by row, of their lengths.
        self._products: tuple[float, ...] = (0.0,) * 9
        self._true_true = self._true_own = self._own_own = self._true_m = self._time_s = 0.0
        self._first_scale = 0.0  # metres per unit of the estimate
        self._learned = self._solved = 0  # number of steps, now and at the solution
        self._rotation: list[float] = np.eye(3).ravel().tolist()  # row by row
        self._sum_m = self._lengths_m = 0.0
        self._before_m = 0.0, 0.0
        self._begin_ns, self._since_m, self._moved_m = 0, 0.0, 0.0
        self._agreeing, self._agreeing_m = 0, 0.0
        self._ran_away = False

    @property
    def is_clear(self) -> bool:
        """Whether the sum of differences is zero."""
        return self._sum_m == 0.0 and (not self.losses or self.losses[-1].is_over)

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and positions (N, 3)."""
        if not len(stamps):
            return
        if self._first is None:
            self._first, self._cell = int(stamps[0]), -1
        cells = (stamps - self._first) // _STEP_NS
        rows = np.flatnonzero(np.diff(cells, prepend=self._cell) > 0)
        self._cell = int(cells[-1])
        columns = (each[rows].tolist() for each in (stamps, groundtruth, estimate))
        for stamp, true, own in zip(*columns, strict=True):
            self._take(stamp, true, own)

    def _take(self, stamp: int, true: _Vector, own: _Vector) -> None:
        newest, self._newest = self._newest, (stamp, true, own)
        if newest is None:
            self._begin_ns = stamp
            return
        time_s = (stamp - newest[0]) / NANOSECONDS
        true_step, own_step = _difference(true, newest[1]), _difference(own, newest[2])
        true_m, own_m = math.hypot(*true_step), math.hypot(*own_step)
        if min(true_m, own_m) <= _SAME:  # compare with the next pose that differs
            self._newest = newest if time_s < _LONGEST_S else self._newest
            return
        if time_s > _LONGEST_S:
            return
        is_lost = bool(self.losses) and not self.losses[-1].is_over
        self._waiting.append((time_s, true_step, own_step, true_m, own_m))
        if len(self._waiting) > _LAG:
            learned = self._waiting.popleft()
            if not is_lost:
                self._learn(learned)
        if self._true_m < _LEAST_M or self._learned < _LEAST_STEPS:
            self._begin_ns = stamp
            return
        scale = self._true_own / self._own_own
        self._first_scale = self._first_scale or scale
        explained_m = _DRIFT * true_m + _NOISE_MPS * time_s
        difference_m = self._difference_m(scale, true_step, own_step)
        if difference_m > explained_m and self._learned >= self._solved + _SOLVE_EVERY:
            self._solve()  # as the last solution does not explain the step
            difference_m = self._difference_m(scale, true_step, own_step)
        if self._sum_m == 0.0 and not is_lost:
            if difference_m <= explained_m and self._agreed:
                return  # the usual case: the sum stays zero
            self._begin_ns, self._since_m, self._moved_m = newest[0], 0.0, 0.0
            self._lengths_m, self._before_m = 0.0, (0.0, 0.0)
        unit = max(1.0, self._true_m / self._time_s / _SLOW_MPS)
        difference_m = (difference_m - explained_m) / unit
        of_lengths_m = (abs(scale * own_m - true_m) - explained_m) / unit
        self._since_m += true_m
        self._moved_m += own_m * (scale if self._agreed else self._first_scale)
        self._sum_m = _accumulated(self._sum_m, difference_m)
        # The smallest of three in a row, since a jump is in one, and an outlier in two.
        self._lengths_m = _accumulated(self._lengths_m, min(of_lengths_m, *self._before_m))
        self._before_m = self._before_m[1], of_lengths_m
        self._judge(stamp, true_m, min(difference_m, of_lengths_m))

    def _judge(self, stamp: int, true_m: float, difference_m: float) -> None:
        """Begin, extend or end a loss."""
        sums, lost = (self._sum_m, self._lengths_m), self.losses[-1:]
        if not lost or lost[0].is_over:
            if self._agreed:
                if any(map(operator.lt, sums, _WARNING_M)):
                    return
            elif self._scale_runs_away:
                self._begin_ns, self._ran_away = self._first or 0, True
            else:
                return
            self.losses.append(Loss.beginning(DIVERGED, self._begin_ns))
        agrees = difference_m <= 0.0
        self._agreeing = self._agreeing + 1 if agrees else 0
        self._agreeing_m = self._agreeing_m + true_m if agrees else 0.0
        known = self.losses[-1]
        is_over = self._agreeing >= _AGREES_AGAIN and self._agreeing_m >= _AGREES_M
        is_over &= not self._ran_away  # any motion agrees with a scale that was never right
        self.losses[-1] = replace(
            known,
            end_ns=stamp,
            true_m=self._since_m,
            moved_m=self._moved_m,
            is_error=known.is_error or not any(map(operator.lt, sums, _ERROR_M)),
            is_over=is_over,
        )
        if is_over:
            self._sum_m = 0.0
            self._waiting.clear()

    def _learn(self, step: _Step) -> None:
        time_s, (x, y, z), (u, v, w), true_m, own_m = step
        scale = self._true_own / self._own_own if self._own_own else 0.0
        if self._true_m > 1.0 and scale * own_m > _OUTLIER * max(true_m, _OUTLIER_M):
            return
        # Only motion is forgotten by time: a hover keeps the fit.
        kept = math.exp(-time_s / _MEMORY_S) if true_m > _NOISE_MPS * time_s else 1.0
        self._true_m = kept * self._true_m + true_m
        self._time_s = kept * self._time_s + time_s
        xu, xv, xw, yu, yv, yw, zu, zv, zw = (kept * each for each in self._products)
        self._products = (
            *(xu + x * u, xv + x * v, xw + x * w),
            *(yu + y * u, yv + y * v, yw + y * w),
            *(zu + z * u, zv + z * v, zw + z * w),
        )
        self._true_true = kept * self._true_true + true_m * true_m
        self._true_own = kept * self._true_own + true_m * own_m
        self._own_own = kept * self._own_own + own_m * own_m
        self._learned += 1

    def _solve(self) -> None:
        # A reflection is allowed: mirrored axes are no divergence.
        left, _, right = np.linalg.svd(np.reshape(self._products, (3, 3)))
        self._rotation, self._solved = (left @ right).ravel().tolist(), self._learned

    def _difference_m(self, scale: float, true: _Vector, own: _Vector) -> float:
        """Return the distance of a displacement from the estimate's, turned and scaled, metres."""
        (x, y, z), turned = own, self._rotation
        return math.hypot(
            scale * (turned[0] * x + turned[1] * y + turned[2] * z) - true[0],
            scale * (turned[3] * x + turned[4] * y + turned[5] * z) - true[1],
            scale * (turned[6] * x + turned[7] * y + turned[8] * z) - true[2],
        )

    @property
    def _agreed(self) -> bool:
        """Whether lengths of displacements correlated before."""
        both = self._true_true * self._own_own
        return self._true_own**2 > (1.0 - _UNLIKE) * both

    @property
    def _scale_runs_away(self) -> bool:
        """Whether the estimate moves ever faster than the groundtruth from the start."""
        scale = self._true_own / self._own_own
        return scale < min(_RUNAWAY, _RUNAWAY_SINCE * self._first_scale)


def _difference(one: _Vector, other: _Vector) -> _Vector:
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


def _accumulated(sum_m: float, more_m: float) -> float:
    return min(max(sum_m + min(more_m, _MOST_STEP_M), 0.0), _MOST_M)
