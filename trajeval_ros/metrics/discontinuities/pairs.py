"""Pairs of both sides at the slower side's timestamps."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities.exoneration import GAP_PERIODS
from trajeval_ros.metrics.discontinuities.pose_stream import Innovation, SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import PAIR_WIDTH
from trajeval_ros.metrics.statistics import median

_LEAST_POSES, _LEAST_OVERLAP_S = (10, 5), 4.0  # before the rates are known
_LEAST_GAP_S = 0.175  # a shorter step of timestamps is interpolated at any rate
_MEMORY_S = 70.0  # of poses: the longest excursion whose return is known, and its neighbours


class PairSource:
    """Pairs the poses of two streams; a corrected clock rewinds it."""

    def __init__(self, streams: tuple[SidePoses, SidePoses]) -> None:
        self.streams = streams
        self.periods: tuple[float, float] | None = None  # seconds, of both sides; None: unknown
        self.begin_s = 0.0
        self.base = 1  # index of the slower side
        self._next = 0  # row of the next pose of the slower side to pair

    @property
    def period_s(self) -> float:
        """The slower side's period."""
        assert self.periods is not None
        return self.periods[self.base]

    def begin(self, *, at_end: bool) -> bool:
        """Determine the rates and the slower side; return whether they are known."""
        groundtruth, estimate = self.streams
        if len(groundtruth) < _LEAST_POSES[0] or len(estimate) < _LEAST_POSES[1]:
            return False
        begin_s = float(max(groundtruth.stamps[0], estimate.stamps[0]))
        overlap_s = min(groundtruth.stamps[-1], estimate.stamps[-1]) - begin_s
        if overlap_s < _LEAST_OVERLAP_S and not at_end:
            return False
        until_s = begin_s + _LEAST_OVERLAP_S  # the same poses for batches of any size
        first, second = (
            median(np.diff(side.stamps[: max(side.row_after(until_s), 2)]))
            for side in self.streams
        )
        self.periods, self.base = (first, second), 0 if first > 1.5 * second else 1
        self.begin_s = begin_s
        return True

    def new_pairs(self) -> Floats:
        """Interpolate the faster side at the new timestamps of the slower one; (N, 15)."""
        base, other = self.streams[self.base], self.streams[1 - self.base]
        begin = self._next
        end = base.row_after(float(other.stamps[-1])) if len(other) > 1 else begin
        if end <= begin:
            return np.empty((0, PAIR_WIDTH))
        self._next = end
        return self._at_poses(self.base, slice(begin, end))

    def within(self, number: int, begin_s: float, end_s: float) -> Floats:
        """Interpolate the other side at the timestamps of one within a time; (N, 15)."""
        stream = self.streams[number]
        return self._at_poses(number, slice(stream.row_after(begin_s), stream.row_from(end_s)))

    def _at_poses(self, number: int, rows: slice) -> Floats:
        assert self.periods is not None
        longest_s = max(GAP_PERIODS * self.periods[1 - number], _LEAST_GAP_S)
        stream = self.streams[number]
        seconds, poses = stream.stamps[rows], stream.poses[rows]
        if not len(seconds):
            return np.empty((0, PAIR_WIDTH))
        between, is_known = self.streams[1 - number].at(seconds, longest_s)
        sides = (poses, between) if number == 0 else (between, poses)
        return np.hstack([seconds[:, None], *sides])[is_known]

    def rewind(self, after_s: float) -> None:
        """Pair again all poses after a time."""
        self._next = self.streams[self.base].row_from(after_s + 1e-9)

    def drop_old(self, oldest_s: float | None) -> None:
        """Forget poses that are not needed any more; `oldest_s`: the begin of an open step."""
        newest = [stream.newest_s for stream in self.streams]
        newest_s = min(newest) if oldest_s is None else min(*newest, oldest_s + _MEMORY_S)
        newest_s = max(newest_s, max(newest) - _MEMORY_S)
        for number, stream in enumerate(self.streams):
            if len(stream) and newest_s - stream.stamps[0] > 1.5 * _MEMORY_S:
                dropped = stream.drop_before(newest_s - _MEMORY_S)
                if number == self.base:
                    self._next = max(self._next - dropped, 0)

    def innovation(self, number: int, begin_s: float, end_s: float) -> Innovation:
        """Return the largest innovation of one side between the times of two pairs."""
        assert self.periods is not None
        margin_s = 0.0 if number == self.base else 1.01 * self.periods[number]
        return self.streams[number].innovation(begin_s, end_s, margin_s)
