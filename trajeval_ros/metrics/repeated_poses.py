"""Frozen estimates: repeated poses while the groundtruth moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.tracking_loss import FROZEN, Loss

# Equal poses differ at most by this, in the estimate's unit and in quaternions.
_SAME = 1e-9
# An estimate at 2 Hz that is published at a higher rate repeats a pose for 0.5 s.
_SHORTEST_S = 1.0
_ERROR_S = 3.0
# Motion of the groundtruth that is no noise; the noise of fixes is metres.
MOVED_M, MOVED_OF_FIXES_M = 0.15, 10.0
_TURNED_RAD = math.radians(10.0)
_STILL = 0.15  # of this motion: the groundtruth has not started to move


class RepeatedPoses:
    """Detects repeated poses while the groundtruth moves, in batches of pairs of any size."""

    def __init__(self, moved_m: float = MOVED_M, max_gap_s: float = math.inf) -> None:
        """Create it before the first pair.

        Args:
            moved_m: Motion of the groundtruth that a repeated pose contradicts.
            max_gap_s: Longer steps between pairs are not in `time_ns`.
        """
        self.losses: list[Loss] = []  # so far, in order
        self.is_clear = True  # whether a later loss will begin at the newest pair or after it
        self.time_ns = 0  # time of the losses, nanoseconds
        self._moved_m, self._max_gap_s = moved_m, max_gap_s
        # First and newest pair of the newest series of equal poses: stamps (2,), time without long
        # steps (2,) and groundtruth (2, 7). The estimate's newest pose (1, 7).
        self._series: tuple[Stamps, Stamps, Floats] | None = None
        self._newest: Floats = np.empty((0, 7))
        # The last pair of the series until which nothing moved: stamp and time without long steps.
        self._begin = 0, 0
        self._closed_ns = 0  # time of the losses that are over

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and poses (N, 7 or more), NaN if unknown."""
        groundtruth, estimate = groundtruth[:, :7], estimate[:, :7]
        if self._series is None and len(stamps):
            self._series = stamps[[0, 0]], np.zeros(2, dtype=np.int64), groundtruth[[0, 0]]
            self._newest, self._begin = estimate[:1].copy(), (int(stamps[0]), 0)
            stamps, groundtruth, estimate = stamps[1:], groundtruth[1:], estimate[1:]
        if self._series is None or not len(stamps):
            return
        steps = np.diff(stamps, prepend=self._series[0][1])
        is_long = steps > self._max_gap_s * NANOSECONDS
        time_ns = self._series[1][1] + np.cumsum(np.where(is_long, 0, steps))
        x = estimate[:, 0]
        if not self._is_open and (np.abs(np.diff(x, prepend=self._newest[0, 0])) > _SAME).all():
            self._begin, self.is_clear = (int(stamps[-1]), int(time_ns[-1])), True
            self._series = stamps[[-1, -1]], time_ns[[-1, -1]], groundtruth[[-1, -1]]
            self._newest = estimate[-1:].copy()
            return
        # Two carried rows precede those of the new pairs.
        columns = zip(self._series, (stamps, time_ns, groundtruth), strict=True)
        stamps, time_ns, groundtruth = (np.concatenate(column) for column in columns)
        apart = np.abs(np.diff(np.concatenate([self._newest, estimate]), axis=0))
        same = np.concatenate([[False, True], ~(apart > _SAME).any(axis=1)])
        rows = np.arange(len(stamps))
        first = np.maximum.accumulate(np.where(same, 0, rows))
        moved_m, turned = np.zeros((2, len(rows)))
        oriented = not np.isnan(self._newest[0, 3])  # else a repeated position is no pose
        if same[2:].any():
            moved_m = np.linalg.norm(groundtruth[:, :3] - groundtruth[first, :3], axis=1)
            if oriented:
                turned = _angles(groundtruth[first, 3:], groundtruth[:, 3:])
        moved = np.maximum(moved_m / self._moved_m, turned / _TURNED_RAD)
        # Of two pairs in succession: one outlier of the groundtruth is no motion.
        has_moved = np.minimum(moved, np.roll(moved, 1)) >= 1.0
        shown = has_moved & (stamps - stamps[first] >= _SHORTEST_S * NANOSECONDS)
        still = np.maximum.accumulate(np.where(moved < _STILL, rows, 0))
        for begin in sorted(set(first[shown | ((first == 0) & self._is_open)].tolist())):
            end = int(first.searchsorted(begin, side="right"))  # after its last row
            if begin or not self._is_open:
                last_still = int(still[begin + int(shown[begin:end].argmax())])
                if last_still > 1:
                    self._begin = int(stamps[last_still]), int(time_ns[last_still])
                self.losses.append(Loss.beginning(FROZEN, self._begin[0]))
            self._extend(
                int(stamps[end - 1]),
                float(moved_m[begin:end].max()),
                math.degrees(turned[begin:end].max()),
                is_over=end < len(rows),
            )
            self.time_ns = self._closed_ns + int(time_ns[end - 1]) - self._begin[1]
            if end < len(rows):
                self._closed_ns = self.time_ns
        if not self._is_open and still[-1] > 1:
            self._begin = int(stamps[still[-1]]), int(time_ns[still[-1]])
        self.is_clear = not self._is_open and bool(still[-1] == rows[-1])
        ends = [int(first[-1]), -1]
        self._series = stamps[ends], time_ns[ends], groundtruth[ends]
        self._newest = estimate[-1:].copy()

    @property
    def _is_open(self) -> bool:
        return bool(self.losses) and not self.losses[-1].is_over

    def _extend(self, end_ns: int, true_m: float, true_deg: float, *, is_over: bool) -> None:
        loss = self.losses[-1]
        self.losses[-1] = replace(
            loss,
            end_ns=end_ns,
            true_m=max(loss.true_m, true_m),
            true_deg=max(loss.true_deg, true_deg),
            is_error=end_ns - loss.begin_ns >= _ERROR_S * NANOSECONDS,
            is_over=is_over,
        )


def _angles(one: Floats, other: Floats) -> Floats:
    """Return the angles between quaternions (N, 4), radians; 0 where they are unknown."""
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(lie.angle(lie.multiply(lie.conjugate(one), other)))
