"""Relative errors as they come: a sub-trajectory is measured when its end has arrived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.errors import RelativeErrors, States, errors_at_ends
from trajeval_ros.online.pairing import POSITION, QUATERNION, VELOCITY
from trajeval_ros.online.window import PairStore
from trajeval_ros.protocol import Protocol
from trajeval_ros.sub_trajectories import Length, nearest_ends
from trajeval_ros.trajectory import NANOSECONDS

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

# A robot at rest ends no sub-trajectory; its pairs are not kept for ever.
MOST_OPEN_STARTS = 200_000


@dataclass(frozen=True)
class RelativeEnd:
    """A sub-trajectory that ended.

    Attributes:
        length: As asked for, such as 8m.
        stamp: Of its last state, nanoseconds.
        position_m: Position error at its end.
        rotation_deg: Rotation error at its end.
    """

    length: str
    stamp: int
    position_m: float
    rotation_deg: float


@dataclass
class RunningErrors:
    """Errors of the sub-trajectories of one length so far.

    Attributes:
        count: Number of sub-trajectories.
        position_m: Mean of their position errors.
        rotation_deg: Mean of their rotation errors.
        given_up: Number of starts that were forgotten before their ends came.
    """

    count: int = 0
    position_m: float = 0.0
    rotation_deg: float = 0.0
    given_up: int = 0

    def add(self, position_m: Floats, rotation_deg: Floats) -> None:
        """Take more errors into the means."""
        self.count += len(position_m)
        share = 1.0 / self.count
        self.position_m += share * float((position_m - self.position_m).sum())
        self.rotation_deg += share * float((rotation_deg - self.rotation_deg).sum())


class RelativeTracker:
    """Finds the ends of sub-trajectories of several lengths, each pair once."""

    def __init__(self, protocol: Protocol) -> None:
        """Begin, for the protocol's lengths in metres and seconds."""
        self._protocol = protocol
        self._lengths = [length for length in protocol.lengths if length.unit != "%"]
        self._next = dict.fromkeys(self._lengths, 0)
        self.running = {str(length): RunningErrors() for length in self._lengths}

    def with_lengths(self, protocol: Protocol, begin: int) -> RelativeTracker:
        """Return a tracker of other lengths; new ones count from a pair, by number."""
        tracker = RelativeTracker(protocol)
        for length in tracker._next:
            tracker._next[length] = self._next.get(length, begin)
            if length in self._next:
                tracker.running[str(length)] = self.running[str(length)]
        return tracker

    def update(self, store: PairStore, scale: float) -> tuple[RelativeEnd, ...]:
        """Measure the sub-trajectories whose ends have arrived.

        Args:
            store: All pairs from the oldest open start on.
            scale: Of the present alignment.
        """
        found = [*self._ended(store, "m"), *self._ended(store, "s")]
        if not found:
            return ()
        starts = np.concatenate([each[1] for each in found])
        ends = np.concatenate([each[2] for each in found])
        errors = self._errors(store, starts, ends, scale)
        reports, begin = [], 0
        for length, mine, _ in found:
            part = slice(begin, begin + len(mine))
            begin = part.stop
            self.running[str(length)].add(errors.position_m[part], errors.rotation_deg[part])
            last = part.stop - 1
            reports.append(
                RelativeEnd(
                    str(length),
                    int(store.stamps()[ends[last] - store.begin]),
                    float(errors.position_m[last]),
                    float(errors.rotation_deg[last]),
                )
            )
        return tuple(reports)

    def oldest_needed(self, store: PairStore) -> int:
        """Return the number of the oldest pair that may still begin a sub-trajectory."""
        limit = store.end - MOST_OPEN_STARTS
        for length, start in self._next.items():
            if start < limit:
                self.running[str(length)].given_up += limit - start
                self._next[length] = limit
        return min(self._next.values(), default=store.end)

    def _ended(self, store: PairStore, unit: str) -> list[tuple[Length, Indices, Indices]]:
        """Return the pairs, by number, that begin and end sub-trajectories decided by now."""
        lengths = [length for length in self._lengths if length.unit == unit]
        if not lengths:
            return []
        first = min(self._next[length] for length in lengths)
        along = store.along(first) if unit == "m" else _seconds(store.stamps(first))
        starts: list[Indices] = []
        for length in lengths:
            # An end is decided when there is a pair at or beyond the length.
            decided = int(np.searchsorted(along, along[-1] - length.value, side="right"))
            begin = self._next[length] - first
            starts.append(np.arange(begin, max(begin, decided)))
            self._next[length] = first + max(begin, decided)
        count = [len(each) for each in starts]
        if not any(count):
            return []
        every = np.concatenate(starts)
        values = np.repeat([length.value for length in lengths], count)
        ends, accepted = nearest_ends(along, every, values)
        found, begin = [], 0
        for length, mine in zip(lengths, count, strict=True):
            rows = np.flatnonzero(accepted[begin : begin + mine]) + begin
            begin += mine
            if len(rows):
                found.append((length, every[rows] + first, ends[rows] + first))
        return found

    def _errors(
        self, store: PairStore, starts: Indices, ends: Indices, scale: float
    ) -> RelativeErrors:
        rows = np.concatenate([starts, ends]) - store.begin
        count = np.arange(len(starts))
        return errors_at_ends(
            _states(store.groundtruth()[rows]),
            _states(store.estimate()[rows]),
            count,
            count + len(starts),
            self._protocol.gauge,
            scale,
            self._protocol.re_form,
        )


def _seconds(stamps: NDArray[np.int64]) -> Floats:
    since: Floats = (stamps - stamps[0]) / NANOSECONDS
    return since


def _states(rows: Floats) -> States:
    velocities = rows[:, VELOCITY]
    return States(
        rows[:, POSITION],
        rows[:, QUATERNION],
        None if np.isnan(velocities).any() else velocities,
    )
