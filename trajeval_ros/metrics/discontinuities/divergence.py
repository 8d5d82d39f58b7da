"""Diverging estimates: displacements that differ from the groundtruth's by more than usual.

Jumps, other frames, axes and units, and drift are no divergence.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import DIVERGED, ESTIMATE, Loss

_SAME = 1e-9  # in the estimate's unit: a repeated position
# Displacements are compared over this time: shorter ones are noise, longer ones delay an alarm.
_STEP_NS = NANOSECONDS // 2
_LONGEST_S = 3.0  # across a longer gap, displacements are not compared
_CHUNK = 8  # displacements that are learned together, one such time later: a divergence is not
_MEMORY_S = 30.0  # of the rotation and scale between the frames
_LEAST_M, _LEAST_STEPS = 2.0, 16  # path and number of displacements that determine them
_OUTLIER = 4.0  # multiple of a usual difference from which on a displacement is not fitted
_UNLIKE = 0.1  # largest share of squared lengths that do not correlate, before a divergence
# Differences are learned as ratios to the distance, to which the noise of positions adds.
_MOVES_MPS, _NOISE_MPS = 0.1, 0.3
_KEPT, _LEAST_KEPT = 240, 16  # ratios
_TIMES_USUAL = 2.5  # multiple of the 95th percentile that is not usual
_DRIFT = 0.06, 0.3  # bounds of a ratio that is not usual
# Sums of the excesses, in limits: of one displacement, since a jump is in one; in the frames and
# in the bodies; and the largest. One sum of the smaller excess names good estimates, too.
_MOST_EXCESS, _LEAST_SUMS, _MOST_SUM = 1.0, (3.0, 2.0), 12.0
# Multiple of the mean difference of one displacement that the sum of all has in a divergence: of
# noise, the sum differs by as much as one. More delays an alarm.
_TIMES_STEP = 2.0
# Scale of an estimate that never agreed, now and relative to its first value.
_RUNAWAY, _RUNAWAY_SINCE = 0.1, 1.0 / 3.0
_AGREES_AGAIN, _AGREES_M = 6, 0.5  # displacements that end a divergence, and their path

# Steps are columns (15, n): time in seconds; displacements of groundtruth and of estimate, in
# their frames and in their bodies, and their lengths.
_TIME_S, _GROUNDTRUTH, _GROUNDTRUTH_M = 0, slice(1, 7), 7
_ESTIMATE, _ESTIMATE_M, _WIDTH = slice(8, 14), 14, 15
_POSITIONS = [0, 1, 2, 7, 8, 9]  # columns of two poses


class Divergence:
    """Accumulates differences of displacements beyond the usual ones: a CUSUM test of two series.

    Displacements of the estimate are rotated and scaled to those of the groundtruth by the fit of
    the last ones, in the frames and in the bodies, because after a restart in another frame only
    the latter agree; without orientations, their lengths. An estimate diverges if both sums exceed
    their limits, and the displacement since their begin differs, too: noise does not add up.
    """

    def __init__(self) -> None:
        self.events: list[Loss] = []
        self._first: int | None = None  # stamp
        self._cell = -1  # of the newest used pair
        # The newest used pair, if any: stamp (1,), poses of groundtruth and estimate (1, 14).
        self._newest: tuple[Stamps, Floats] = (np.empty(0, dtype=np.int64), np.empty((0, 14)))
        self._chunk: Floats = np.empty((_WIDTH, 0))
        self._waiting: Floats = np.empty((_WIDTH, 0))  # the chunk before, not yet learned
        # Of learned steps, with fading memory: path, time, squares and product of the lengths.
        self._sums: Floats = np.zeros(5)
        self._products: Floats = np.zeros((2, 3, 3))
        self._learned = 0
        self._ratios: list[float] = []
        self._rotations: Floats | None = None  # (2, 3, 3), of frames and bodies
        self._scale = self._first_scale = 0.0  # metres per unit of the estimate
        self._limit = _DRIFT[1]
        self._agreed = self._runs_away = False
        self._sum = 0.0
        self._ran_away = False

    @property
    def is_clear(self) -> bool:
        """Whether the sum of differences is zero."""
        return self._sum == 0.0 and not self._is_lost

    @property
    def _is_lost(self) -> bool:
        return bool(self.events) and not self.events[-1].is_over

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and poses (N, 7), NaN if unknown."""
        if not len(stamps):
            return
        if self._first is None:
            self._first = int(stamps[0])
        cells = (stamps - self._first) // _STEP_NS
        rows = np.flatnonzero(np.diff(cells, prepend=self._cell) > 0)
        self._cell = int(cells[-1])
        if not len(rows):
            return
        stamps = np.append(self._newest[0], stamps[rows])
        pairs = np.vstack([self._newest[1], np.hstack([groundtruth[rows], estimate[rows]])])
        # A repeated position of one side is no motion, also if the other side moves.
        moved = np.abs(np.diff(pairs[:, _POSITIONS], axis=0)) > _SAME
        kept = np.append(True, moved[:, :3].any(axis=1) & moved[:, 3:].any(axis=1))
        stamps, pairs = stamps[kept], pairs[kept]
        self._newest = stamps[-1:], pairs[-1:]
        columns = [np.diff(stamps)[None] / NANOSECONDS]
        for side in (pairs[:, :7], pairs[:, 7:]):
            steps = np.diff(side[:, :3], axis=0)
            inside = lie.rotate(lie.conjugate(side[:-1, 3:]), steps)
            columns += [steps.T, inside.T, _lengths(steps.T)[None]]
        steps, spans = np.vstack(columns), np.stack([stamps[:-1], stamps[1:]])
        used = steps[_TIME_S] <= _LONGEST_S
        spans, steps = spans[:, used], steps[:, used]
        while steps.size:
            taken = _CHUNK - self._chunk.shape[1]
            self._take(spans[:, :taken], steps[:, :taken])
            spans, steps = spans[:, taken:], steps[:, taken:]

    def _take(self, spans: Stamps, steps: Floats) -> None:
        """Take n steps with stamps (2, n) of one chunk."""
        if self._rotations is not None:
            apart_m = self._apart_m(steps)
            ratios = self._ratios_of(steps, apart_m)
            excess, of_body = (ratio / self._limit - 1.0 for ratio in ratios)
            if self._sum or self._is_lost or self._runs_away or (excess > 0.0).any():
                scale = self._scale if self._agreed else self._first_scale
                columns = (
                    *spans,
                    steps[_GROUNDTRUTH_M],
                    scale * steps[_ESTIMATE_M],
                    excess,
                    of_body,
                )
                rows = zip(*(column.tolist() for column in columns), strict=True)
                for row, step_m in zip(rows, apart_m[0].T.tolist(), strict=True):
                    self._follow(*row, apart_m=step_m)
        self._chunk = np.hstack([self._chunk, steps])
        if self._chunk.shape[1] == _CHUNK:
            if self._is_lost:
                self._chunk = self._chunk[:, :0]
            if self._waiting.size:
                self._learn(self._waiting)
            self._waiting, self._chunk = self._chunk, np.empty((_WIDTH, 0))

    def _follow(
        self,
        begin_ns: int,
        end_ns: int,
        groundtruth_m: float,
        moved_m: float,
        excess: float,
        of_body: float,
        *,
        apart_m: Sequence[float],
    ) -> None:
        """Accumulate one step that differs by a vector; begin, extend or end an event."""
        if self._sum == 0.0 and not self._is_lost:
            if excess <= 0.0 and not self._runs_away:
                return
            self._begin_ns, self._since_m, self._moved_m = begin_ns, 0.0, 0.0
            self._of_body = self._before = 0.0
            self._apart_since_m, self._lengths_since_m, self._steps_since = [0.0] * 3, 0.0, 0
        self._since_m += groundtruth_m
        self._moved_m += moved_m
        self._sum = _accumulated(self._sum, excess)
        if not self._is_lost:
            # The smaller of two in a row, since a jump is in one.
            self._of_body = _accumulated(self._of_body, min(of_body, self._before))
            self._before = of_body
            self._apart_since_m = list(map(operator.add, self._apart_since_m, apart_m))
            self._lengths_since_m += math.hypot(*apart_m)
            self._steps_since += 1
            if self._agreed:
                lasted_s = (end_ns - self._begin_ns) / NANOSECONDS
                usual_m = max(
                    self._limit * (self._since_m + _NOISE_MPS * lasted_s),
                    _TIMES_STEP * self._lengths_since_m / self._steps_since,
                )
                is_noise = math.hypot(*self._apart_since_m) < usual_m
                if self._sum < _LEAST_SUMS[0] or self._of_body < _LEAST_SUMS[1] or is_noise:
                    return
            elif self._runs_away:
                self._begin_ns, self._ran_away = self._first or 0, True
            else:
                return
            self._agreeing, self._agreeing_m = 0, 0.0
            event = Loss(DIVERGED, ESTIMATE, self._begin_ns, end_ns, certainty="sure")
            self.events.append(event)
        agrees = min(excess, of_body) <= 0.0
        self._agreeing = self._agreeing + 1 if agrees else 0
        self._agreeing_m = self._agreeing_m + groundtruth_m if agrees else 0.0
        event = self.events[-1]
        event.end_ns, event.m, event.moved_m = end_ns, self._since_m, self._moved_m
        event.s = (end_ns - event.t_ns) / NANOSECONDS
        is_over = self._agreeing >= _AGREES_AGAIN and self._agreeing_m >= _AGREES_M
        if is_over and not self._ran_away:  # any motion agrees with a scale that was never right
            event.is_over, self._sum = True, 0.0

    def _ratios_of(self, steps: Floats, apart_m: Floats) -> tuple[Floats, Floats]:
        """Return the ratios (n,) of differences (2, 3, n) and distance, in frames and bodies.

        Without orientations, differences of lengths take the place of those in the bodies.
        """
        in_frame_m, in_body_m = _lengths(apart_m)
        lengths_m = np.abs(self._scale * steps[_ESTIMATE_M] - steps[_GROUNDTRUTH_M])
        unit_m = steps[_GROUNDTRUTH_M] + _NOISE_MPS * steps[_TIME_S]
        return in_frame_m / unit_m, np.where(np.isnan(in_body_m), lengths_m, in_body_m) / unit_m

    def _apart_m(self, steps: Floats) -> Floats:
        """Return the differences (2, 3, n) of displacements, in the frames and in the bodies."""
        assert self._rotations is not None
        moved, true = steps[_ESTIMATE].reshape(2, 3, -1), steps[_GROUNDTRUTH].reshape(2, 3, -1)
        return np.asarray(self._scale * self._rotations @ moved - true)

    def _learn(self, steps: Floats) -> None:
        """Fit rotation and scale to steps (15, n) and those before, and learn the differences."""
        if self._rotations is not None:
            ratios = np.minimum(*self._ratios_of(steps, self._apart_m(steps)))
            moves = steps[_GROUNDTRUTH_M] > _MOVES_MPS * steps[_TIME_S]
            # What may be a divergence is not usual, unless it lasts without being one.
            if not self._sum or self._steps_since > _CHUNK:
                self._ratios = [*self._ratios, *ratios[moves].tolist()][-_KEPT:]
            if len(self._ratios) >= _LEAST_KEPT:
                tail = sorted(self._ratios)[int(0.95 * len(self._ratios))]
                self._limit = min(max(_TIMES_USUAL * tail, _DRIFT[0]), _DRIFT[1])
            if self._agreed:
                steps = steps[:, ratios <= _OUTLIER * self._limit]
        time_s, groundtruth_m, estimate_m = steps[[_TIME_S, _GROUNDTRUTH_M, _ESTIMATE_M]]
        # Only motion is forgotten by time: a hover keeps the fit.
        moving_s = float(time_s[groundtruth_m > _MOVES_MPS * time_s].sum())
        kept = math.exp(-moving_s / _MEMORY_S)
        added = groundtruth_m, time_s, groundtruth_m**2, groundtruth_m * estimate_m, estimate_m**2
        self._sums = kept * self._sums + np.stack(added).sum(axis=1)
        moved, true = steps[_ESTIMATE].reshape(2, 3, -1), steps[_GROUNDTRUTH].reshape(2, 3, -1)
        products = true @ moved.swapaxes(1, 2)
        if math.isnan(products[1, 0, 0]):  # without orientations
            products[1] = 0.0
        self._products = kept * self._products + products
        self._learned += len(time_s)
        path_m, _, squares, product, estimate_squares = self._sums.tolist()
        if estimate_squares == 0.0:
            return
        self._scale = product / estimate_squares
        if path_m < _LEAST_M or self._learned < _LEAST_STEPS:
            return
        self._first_scale = self._first_scale or self._scale
        # Whether lengths of displacements correlated before, and whether the estimate moves ever
        # faster than the groundtruth from the start.
        self._agreed = product * product > (1.0 - _UNLIKE) * squares * estimate_squares
        self._runs_away = self._scale < min(_RUNAWAY, _RUNAWAY_SINCE * self._first_scale)
        # A reflection is allowed: mirrored axes are no divergence.
        left, _, right = np.linalg.svd(self._products)
        self._rotations = left @ right


def _lengths(vectors: Floats) -> Floats:
    """Return the lengths (..., n) of vectors (..., 3, n)."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-2)))


def _accumulated(total: float, more: float) -> float:
    return min(max(total + min(more, _MOST_EXCESS), 0.0), _MOST_SUM)
