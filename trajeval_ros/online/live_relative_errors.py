"""Live relative errors: a sub-trajectory is measured when its end has arrived."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.relative_errors import relative_errors
from trajeval_ros.metrics.relative_evaluation import position_percent
from trajeval_ros.metrics.sub_trajectories import Length, nearest_ends
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.online.window import PairStore

# Units of lengths that are measured live.
LIVE_UNITS = ("m", "s", "f")
# A robot at rest completes no sub-trajectory; older starts are given up to bound the memory.
MOST_OPEN_STARTS = 200_000


class RelativeEnd(NamedTuple):
    """The end of a sub-trajectory."""

    length: str  # the length as configured, such as 8m
    stamp: int  # timestamp of its last state, nanoseconds
    position_m: float  # position error at its end
    rotation_deg: float  # rotation error at its end
    # Position error in percent of the length, the largest among those of this length that ended in
    # the same update; None if the length is a duration.
    drift_percent: float | None


@dataclass(frozen=True)
class RunningErrors:
    """Mean errors of the sub-trajectories of one length so far."""

    count: int = 0  # number of sub-trajectories
    position_m: float = 0.0  # mean of their position errors
    rotation_deg: float = 0.0  # mean of their rotation errors
    given_up: int = 0  # number of starts that were given up before their ends arrived


class _Sums:
    """Sums over the sub-trajectories of one length."""

    def __init__(self, next_ns: int = NEVER) -> None:
        self.next_ns = next_ns  # no older pair is a start that is still open
        self.count = self.given_up = 0
        self.position_m = self.rotation_deg = 0.0

    @property
    def running(self) -> RunningErrors:
        count = max(self.count, 1)
        means = self.position_m / count, self.rotation_deg / count
        return RunningErrors(self.count, *means, self.given_up)


class RelativeTracker:
    """Measures sub-trajectories when their ends arrive; every pair starts at most one per length.

    A pair that arrives after newer pairs were starts is no start.
    """

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        lengths = dict.fromkeys(protocol.lengths)
        # Grouped by unit.
        self._lengths = [one for unit in LIVE_UNITS for one in lengths if one.unit == unit]
        self._sums = {str(length): _Sums() for length in self._lengths}

    @property
    def running(self) -> dict[str, RunningErrors]:
        """Errors so far by length."""
        return {name: sums.running for name, sums in self._sums.items()}

    def with_lengths(self, protocol: Protocol, newest: int) -> RelativeTracker:
        """Return a tracker of other lengths; new ones start after the newest pair's timestamp."""
        tracker = RelativeTracker(protocol)
        for name in tracker._sums:
            tracker._sums[name] = self._sums.get(name) or _Sums(newest + 1)
        return tracker

    def update(
        self, store: PairStore, scale: float, *, at_end: bool = False
    ) -> tuple[RelativeEnd, ...]:
        """Measure the sub-trajectories whose ends have arrived; return the newest by length.

        `scale`: of the present alignment. `at_end`: no pair will follow, so that the last pair may
        be the nearest to the length.
        """
        ends = (self._measure(store, length, scale, at_end) for length in self._lengths)
        return tuple(end for end in ends if end is not None)

    def oldest_needed(self, store: PairStore) -> int:
        """Return the number of the oldest pair that can still start a sub-trajectory."""
        stamps, oldest = store.stamps(), len(store)
        limit = max(len(store) - MOST_OPEN_STARTS, 0)
        for sums in self._sums.values():
            begin = int(stamps.searchsorted(sums.next_ns))
            if begin < limit:
                sums.given_up += limit - begin
                sums.next_ns, begin = int(stamps[limit]), limit
            oldest = min(oldest, begin)
        return store.begin + oldest

    def _measure(
        self, store: PairStore, length: Length, scale: float, at_end: bool
    ) -> RelativeEnd | None:
        sums, stamps = self._sums[str(length)], store.stamps()
        begin = int(stamps.searchsorted(sums.next_ns))
        if begin == len(stamps):
            return None
        along, value = _along(store, store.begin + begin, length)
        # An end is decided when a pair is at or beyond the length.
        count = len(along)
        if not at_end:
            count = int(along.searchsorted(along[-1] - value, side="right"))
        if not count:
            return None
        following = begin + count
        sums.next_ns = int(stamps[following]) if following < len(stamps) else store.newest + 1
        starts = np.arange(count)
        ends, accepted = nearest_ends(along, starts, value)
        if not accepted.all():
            starts, ends = starts[accepted], ends[accepted]
        count = len(starts)
        if not count:
            return None
        pairs = store.pairs(begin + np.concatenate([starts, ends]))
        errors = relative_errors(
            pairs.groundtruth,
            pairs.estimate,
            np.arange(count),
            np.arange(count, 2 * count),
            self._protocol.gauge,
            scale,
            self._protocol.re_form,
        )
        position_m, rotation_deg = errors.position_m, errors.rotation_deg
        assert rotation_deg is not None
        sums.count += count
        sums.position_m += float(position_m.sum())
        sums.rotation_deg += float(rotation_deg.sum())
        drift = None
        if length.unit == "m":
            drift = float(position_percent(position_m.max(keepdims=True), length.value)[0])
        newest = int(stamps[begin + int(ends[-1])])
        return RelativeEnd(
            str(length), newest, float(position_m[-1]), float(rotation_deg[-1]), drift
        )


def _along(store: PairStore, first: int, length: Length) -> tuple[Floats, float]:
    """Return path (m), time (ns) or number of states up to the pairs from `first` on, (N,).

    The second value is the length in the same unit.
    """
    if length.unit == "m":
        return store.along(first), length.value
    stamps = store.stamps(first)
    if length.unit == "f":
        return np.arange(len(stamps), dtype=np.float64), length.value
    return (stamps - stamps[0]).astype(np.float64), length.value * NANOSECONDS
