"""The health of a stream of messages: rate, gaps, and the delay from timestamp to arrival."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

UNKNOWN = int(np.iinfo(np.int64).min)  # an unknown time of arrival
# Clocks that NTP synchronises, and simulated time between two messages of /clock at 100 Hz, differ
# by up to 10 ms. A timestamp farther ahead of its arrival is wrong.
FUTURE_NS = 10_000_000
_RECENT_NS, _RECENT_MESSAGES = 10 * NANOSECONDS, 2000  # the newest 10 s, at 200 Hz or less
FEWEST_RECENT = 10  # messages of slow streams, such as keyframes
_LEAST_S = 1.0  # of a stream, to continue its arrivals beyond the newest messages
# Bins of intervals are 2.2 % wide, up to 2^60 ns.
_PER_OCTAVE, _BINS = 32, 32 * 60
_FEWEST_INTERVALS, _SHORT = 10, 0.05
# Intervals of a stream with a period: at most 10 % are over 0.3 periods from a multiple of it.
_OFF, _MOST_OFF = 0.3, 0.1
_KEPT = 4096  # delays for the percentiles of a run: error of a percentile about 0.3 % of the ranks


@dataclass(frozen=True)
class StreamHealth:
    """The health of a stream; a value is None if there are too few messages."""

    messages: int = 0  # number of messages
    rate_hz: float | None = None  # from the mean interval of the timestamps
    jitter_s: float | None = None  # standard deviation of the intervals, seconds
    largest_gap_s: float | None = None  # largest interval, seconds
    # Median of arrival minus timestamp, seconds: the delay, and the difference of the clocks.
    arrival_p50_s: float | None = None
    arrival_p95_s: float | None = None  # its 95th percentile, seconds
    arrival_max_s: float | None = None  # its maximum, seconds
    from_future: int = 0  # messages with a timestamp later than their arrival, by `FUTURE_NS`
    # Messages that are missing by the stream's own period; None if the intervals are not
    # multiples of a period, as those of keyframes.
    missed: int | None = None


class StreamMonitor:
    """Measures the health of a stream at a constant cost per message, in constant memory.

    Results do not depend on how messages are grouped into calls. Intervals are those between
    successive largest timestamps, so a message out of order adds none.
    """

    def __init__(self) -> None:
        self._messages = self._from_future = 0
        self._first = self._newest = 0  # timestamps, nanoseconds
        # Intervals are summed relative to the first one, since squares lose digits.
        self._usual_s: float | None = None
        self._intervals, self._squares_s2, self._largest_ns = 0, 0.0, 0
        self._counts, self._sums_ns = np.zeros((2, _BINS), dtype=np.int64)  # of intervals
        self._most_s = -math.inf
        self._delays_s, self._step, self._delays = np.empty(0), 1, 0
        self._recent = np.empty((2, 0), dtype=np.int64)  # timestamps and arrivals

    def add(self, stamps: Stamps, arrived: Stamps) -> None:
        """Add messages: timestamps (N,) and times of arrival (N,), which may be `UNKNOWN`, ns."""
        if not len(stamps):
            return
        if not self._messages:
            self._first = self._newest = int(stamps[0])
        self._messages += len(stamps)
        steps = np.diff(np.maximum.accumulate(np.concatenate([[self._newest], stamps])))
        self._add_intervals(steps[steps > 0])
        self._newest = max(self._newest, int(stamps.max()))
        known = arrived != UNKNOWN
        delays_s = (arrived[known] - stamps[known]) / NANOSECONDS
        self._from_future += int(np.count_nonzero(delays_s < -FUTURE_NS / NANOSECONDS))
        self._most_s = max(self._most_s, float(delays_s.max(initial=-math.inf)))
        self._keep(delays_s)
        together = np.concatenate([self._recent, [stamps, arrived]], axis=1)
        self._recent = together[:, -_RECENT_MESSAGES:]

    def whole(self) -> StreamHealth:
        """Return the health since the start; percentiles are of at most 4096 messages."""
        health = StreamHealth(self._messages, from_future=self._from_future, missed=self._missed)
        if self._intervals and self._usual_s is not None:
            mean_s = (self._newest - self._first) / NANOSECONDS / self._intervals
            variance = self._squares_s2 / self._intervals - (mean_s - self._usual_s) ** 2
            health = replace(
                health,
                rate_hz=1.0 / mean_s,
                jitter_s=math.sqrt(max(variance, 0.0)),
                largest_gap_s=self._largest_ns / NANOSECONDS,
            )
        if not len(self._delays_s):
            return health
        p50_s, p95_s = np.percentile(self._delays_s, (50, 95)).tolist()
        return replace(
            health, arrival_p50_s=p50_s, arrival_p95_s=p95_s, arrival_max_s=self._most_s
        )

    def recent(self) -> StreamHealth:
        """Return the health of the newest 10 s: of at most 2000 and at least 10 messages."""
        return health_of(*self._newest_messages())

    def arrival_after(self, other: StreamMonitor) -> float | None:
        """Return how long after the other stream's messages of the same time these arrive.

        The 95th percentile of the newest 10 s, seconds; None with less than 10 messages, or less
        than 1 s of the other stream. Arrivals are compared at equal timestamps, since a replay at
        another rate changes all delays.
        """
        newest, theirs = (item._newest_messages() for item in (self, other))
        newest, theirs = (item[:, item[1] != UNKNOWN] for item in (newest, theirs))
        if min(newest.shape[1], theirs.shape[1]) < FEWEST_RECENT:
            return None
        theirs = theirs[:, np.argsort(theirs[0], kind="stable")]
        (stamps, arrived), (others, expected) = (
            (item - theirs[:, :1]) / NANOSECONDS for item in (newest, theirs)
        )
        if others[-1] < _LEAST_S:
            return None
        slope = expected[-1] / others[-1]  # 1 in real time
        outside_s = stamps - np.clip(stamps, 0.0, others[-1])
        after_s = arrived - np.interp(stamps, others, expected) - slope * outside_s
        return float(np.percentile(after_s, 95))

    def _newest_messages(self) -> Stamps:
        """Return timestamps and arrivals (2, N) of the newest 10 s."""
        young = self._recent[0] >= self._newest - _RECENT_NS
        young[-FEWEST_RECENT:] = True
        return self._recent[:, young]

    def _add_intervals(self, steps: Stamps) -> None:
        """Add intervals (N,), positive, nanoseconds."""
        if not len(steps):
            return
        seconds = steps / NANOSECONDS
        if self._usual_s is None:
            self._usual_s = float(seconds[0])
        self._intervals += len(steps)
        self._squares_s2 += float(((seconds - self._usual_s) ** 2).sum())
        self._largest_ns = max(self._largest_ns, int(steps.max()))
        bins = np.minimum(np.log2(steps) * _PER_OCTAVE, _BINS - 1).astype(np.int64)
        np.add.at(self._counts, bins, 1)
        np.add.at(self._sums_ns, bins, steps)

    def _keep(self, delays_s: Floats) -> None:
        """Keep every delay until the limit is reached, then every second, fourth, and so on."""
        kept = [self._delays_s, delays_s[-self._delays % self._step :: self._step]]
        self._delays += len(delays_s)
        self._delays_s = np.concatenate(kept)
        while len(self._delays_s) > _KEPT:
            self._delays_s, self._step = self._delays_s[::2], 2 * self._step

    @property
    def _missed(self) -> int | None:
        """The number of messages that are missing between others; None without a period.

        The period is the mean of the shortest intervals: of those below 1.5 times the 5th
        percentile. An interval of n periods misses n - 1 messages.
        """
        used = np.flatnonzero(self._counts)
        counts = self._counts[used]
        if counts.sum() < _FEWEST_INTERVALS:
            return None
        means_ns = self._sums_ns[used] / counts
        short = means_ns[counts.cumsum().searchsorted(_SHORT * counts.sum())]
        near = means_ns < 1.5 * short
        period_ns = (means_ns * counts)[near].sum() / counts[near].sum()
        multiples = means_ns / period_ns
        whole = np.maximum(np.round(multiples), 1.0)
        if counts[np.abs(multiples - whole) > _OFF].sum() > _MOST_OFF * counts.sum():
            return None
        return int(((whole - 1.0) * counts).sum())


def health_of(stamps: Stamps, arrived: Stamps) -> StreamHealth:
    """Return the health of a recorded stream: timestamps (N,) and arrivals (N,), nanoseconds."""
    monitor = StreamMonitor()
    monitor.add(stamps, arrived)
    return monitor.whole()
