"""How much one stream's motions usually differ from those around them, by their duration."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.metrics.discontinuities.open_step import GAP
from trajeval_ros.metrics.discontinuities.pose_stream import SidePoses
from trajeval_ros.metrics.discontinuities.relative_motion import CELL_S
from trajeval_ros.metrics.discontinuities.stream_motion import StreamMotions, stream_motions
from trajeval_ros.metrics.discontinuities.usual_differences import (
    LEAST_DEG,
    LEAST_M,
    UsualDifferences,
)

_REST_MPS, _REST_DEGPS = 0.05, 3.0  # slower motion is not learned: it is smoother than any other
# What a healthy robot changes of its velocity within a period, over the period, m/s^2 and deg/s^2:
# larger values hide small steps of slow streams, smaller ones report brisk starts.
_ACCELERATION, _ANGULAR_ACCELERATION = 10.0, 1000.0


class StreamLimits:
    """Limits of the motions of one stream, from the usual ones of the last minutes."""

    def __init__(self, stream: SidePoses, period_s: float) -> None:
        """Create it once the usual time between poses is known."""
        self.longest_s = GAP * period_s  # of a step between poses without a gap
        self.learned_until_s = self.part_s = float(stream.stamps[0])
        self._stream = stream
        self._usual = UsualDifferences(period_s)
        self._least_m = LEAST_M + _ACCELERATION * period_s**2
        self._least_deg = LEAST_DEG + _ANGULAR_ACCELERATION * period_s**2
        self._every = max(1, int(CELL_S / period_s) // 3)  # three motions per cell are learned
        self._kept: list[Floats] = []  # usual motions (N, 2) to learn, metres and deg

    def limit(self, seconds: Floats) -> tuple[Floats, Floats]:
        """Return the largest usual difference over times (N,), metres and deg."""
        m, deg = self._usual.limit(seconds)
        return np.maximum(m, self._least_m), np.maximum(deg, self._least_deg)

    def keep(self, motions: StreamMotions, usual: Booleans) -> None:
        """Keep the usual ones (N,) of N motions between successive poses, until `learn`."""
        kept = usual & (motions.seconds < self.longest_s) & _moves(motions)
        self._kept.append(np.column_stack([motions.m, motions.deg])[kept])

    def learn(self, end: int) -> None:
        """Learn what was kept, and the motions over longer times that end before row `end`."""
        if self._kept:
            self._usual.add(0, *np.concatenate(self._kept)[:: self._every].T)
        self._kept.clear()
        stamps, poses = self._stream.stamps, self._stream.poses
        first = max(int(stamps.searchsorted(self.learned_until_s)) - 1, 0)
        self.learned_until_s = float(stamps[end])
        marks = first + 1 + np.flatnonzero(np.diff(np.floor(stamps[first:end] / CELL_S)))
        lags = self._usual.lags
        ends, lags_s = np.tile(marks, len(lags)), np.repeat(CELL_S * lags, len(marks))
        begins = stamps.searchsorted(stamps[ends] - lags_s)
        late_s = stamps[ends] - stamps[begins] - lags_s
        known = (np.abs(late_s) < 0.5 * CELL_S) & (begins > 0) & (begins < ends)
        known &= stamps[begins] >= self.part_s
        if not known.any():
            return
        numbers = 1 + np.flatnonzero(known) // len(marks)
        motions = stream_motions(stamps, poses, begins[known], ends[known], 0.0)
        moves = _moves(motions)
        self._usual.add(numbers[moves], motions.m[moves], motions.deg[moves])


def _moves(motions: StreamMotions) -> Booleans:
    """Return which motions (N,) are no rest."""
    moves: Booleans = (motions.mps > _REST_MPS) | (motions.degps > _REST_DEGPS)
    return moves
