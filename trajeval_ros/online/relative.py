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

    def add(self, errors: RelativeErrors) -> None:
        """Take more errors into the means."""
        self.count += len(errors.ends)
        share = 1.0 / self.count
        self.position_m += share * float((errors.position_m - self.position_m).sum())
        self.rotation_deg += share * float((errors.rotation_deg - self.rotation_deg).sum())


class RelativeTracker:
    """Finds the ends of sub-trajectories of several lengths, each pair once."""

    def __init__(self, protocol: Protocol) -> None:
        """Begin, for the protocol's lengths in metres and seconds."""
        self._protocol = protocol
        self._lengths = [length for length in protocol.lengths if length.unit != "%"]
        self._next = dict.fromkeys(self._lengths, 0)
        self.running = {str(length): RunningErrors() for length in self._lengths}

    def update(self, store: PairStore, scale: float) -> tuple[RelativeEnd, ...]:
        """Measure the sub-trajectories whose ends have arrived.

        Args:
            store: All pairs from the oldest open start on.
            scale: Of the present alignment.
        """
        found: list[tuple[Length, Indices, Indices]] = []
        for length in self._lengths:
            starts, ends = self._ended(store, length)
            if len(starts):
                found.append((length, starts, ends))
        if not found:
            return ()
        starts = np.concatenate([each[1] for each in found])
        ends = np.concatenate([each[2] for each in found])
        errors = self._errors(store, starts, ends, scale)
        reports, begin = [], 0
        for length, mine, _ in found:
            part = slice(begin, begin + len(mine))
            begin = part.stop
            self.running[str(length)].add(_part(errors, part))
            reports.append(
                RelativeEnd(
                    str(length),
                    int(store.stamps()[ends[part][-1] - store.begin]),
                    float(errors.position_m[part][-1]),
                    float(errors.rotation_deg[part][-1]),
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

    def _ended(self, store: PairStore, length: Length) -> tuple[Indices, Indices]:
        """Return the pairs, by number, that begin and end sub-trajectories decided by now."""
        first = self._next[length]
        if length.unit == "s":
            stamps = store.stamps(first)
            along = (stamps - stamps[0]) / NANOSECONDS
        else:
            along = store.along(first)
        # An end is decided when there is a pair at or beyond the length.
        decided = int(np.searchsorted(along, along[-1] - length.value, side="right"))
        if not decided:
            return _NOTHING, _NOTHING
        self._next[length] = first + decided
        starts, ends = nearest_ends(along, np.arange(decided), length.value)
        return starts + first, ends + first

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


_NOTHING: Indices = np.empty(0, dtype=np.int64)


def _states(rows: Floats) -> States:
    velocities = rows[:, VELOCITY]
    return States(
        rows[:, POSITION],
        rows[:, QUATERNION],
        None if np.isnan(velocities).any() else velocities,
    )


def _part(errors: RelativeErrors, rows: slice) -> RelativeErrors:
    return RelativeErrors(
        starts=errors.starts[rows],
        ends=errors.ends[rows],
        position_m=errors.position_m[rows],
        rotation_deg=errors.rotation_deg[rows],
        yaw_deg=errors.yaw_deg[rows],
        tilt_deg=None,
    )
