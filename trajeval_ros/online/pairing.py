"""Pairing of two streams of states with different rates, as they arrive.

One side is interpolated at the timestamps of the other, with the code of the offline association,
so that both make the same pairs. A state of the other side waits until the interpolated side has
states beyond it, or until the end. `DensePairing` and `SparsePairing` define which side is
interpolated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.interpolation import Bracket, bracket_stamps, mix
from trajeval_ros.geometry.valid_poses import add_counts, count_up
from trajeval_ros.metrics.completeness import Interpolation
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.online.state_buffer import NEVER, BufferLimits, StateBuffer, StateCounts
from trajeval_ros.online.state_rows import QUATERNION, WIDTH, Pairs


class Decided(NamedTuple):
    """States whose association has been decided, in order of time."""

    stamps: Stamps  # (N,) nanoseconds
    rows: Floats  # (N, k) states
    bracket: Bracket  # their position between the states of the interpolated side

    def until(self, count: int) -> Decided:
        """Return the first `count` states."""
        return Decided(self.stamps[:count], self.rows[:count], self.bracket.until(count))


class Pairing(ABC):
    """Pairs the states of two sides in bounded memory."""

    interpolated: ClassVar[str]  # the interpolated side, `groundtruth` or `estimate`
    waits: ClassVar[tuple[str, str]]  # name of the waiting states, singular and plural

    def __init__(self, max_gap_s: float = 0.5, limits: BufferLimits | None = None) -> None:
        self.max_gap_s = max_gap_s  # longest step of the interpolated side, seconds
        self.limits = limits or BufferLimits()  # limits of the memory
        # Besides invalid states, they count `too_late`, a state of the interpolated side whose
        # neighbours have been forgotten; and `after_use`, a state that arrived after its
        # neighbours were used without it.
        self.groundtruth_counts, self.estimate_counts = StateCounts(), StateCounts()
        self._track, self._waiting = StateBuffer(), StateBuffer()
        self._track_count = 0  # states of the interpolated side so far
        # In the same order as offline, whatever occurs first.
        self._unpaired = dict.fromkeys(Bracket.reasons(self.interpolated), 0)
        self._decided: Decided | None = None  # by the last `made`, not counted yet
        self._seen: Stamps = np.empty(0, dtype=np.int64)
        self._forgotten_until = self._paired_until = self._decided_until = NEVER
        self._is_full = False  # whether states were dropped by number, not by age

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states, (N,) and (N, 10), in any order."""
        add = self._interpolate if self._is_groundtruth_interpolated else self._let_wait
        add(stamps, rows)

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take estimated states, (N,) and (N, 10) or (N, 46), in any order.

        Covariances of interpolated states are dropped, as offline.
        """
        add = self._let_wait if self._is_groundtruth_interpolated else self._interpolate
        add(stamps, rows)

    @property
    def _is_groundtruth_interpolated(self) -> bool:
        return self.interpolated == "groundtruth"

    @abstractmethod
    def take_waypoints(self) -> StampedPoses:
        """Return the groundtruth's waypoints since the last call, for the coverage."""

    @property
    def newest_groundtruth(self) -> tuple[Stamps, Floats]:
        """Copies of the newest groundtruth states that are stored, (N,) and (N, 10)."""
        stored = self._track if self._is_groundtruth_interpolated else self._waiting
        stamps, rows = stored.held
        return stamps.copy(), rows.copy()

    @property
    @abstractmethod
    def groundtruth_count(self) -> int:
        """Number of groundtruth states so far."""

    @property
    @abstractmethod
    def groundtruth_time(self) -> int:
        """Groundtruth time that pairs can cover, nanoseconds."""

    @property
    @abstractmethod
    def groundtruth_path_m(self) -> float:
        """Length of the path through the groundtruth states, metres."""

    @property
    def interpolation(self) -> Interpolation | None:
        """How far interpolation of the estimate may be off; None if it isn't interpolated."""
        return None

    @property
    @abstractmethod
    def estimate_count(self) -> int:
        """Number of estimated states so far, without waiting ones."""

    @property
    def _sides(self) -> tuple[StateCounts, StateCounts]:
        """The counts of the interpolated and of the waiting side."""
        sides = self.groundtruth_counts, self.estimate_counts
        return sides if self._is_groundtruth_interpolated else sides[::-1]

    @property
    def dropped(self) -> dict[str, int]:
        """Number of states without a pair by reason, as offline.

        Two more reasons exist live. `too_late`: the states around it have been forgotten.
        `waited_too_long`: too many states were waiting.
        """
        return add_counts(self.estimate_counts.dropped, self._unpaired)

    @property
    def waiting(self) -> int:
        """Number of states that wait for the other side."""
        return len(self._waiting)

    @property
    def why_forgotten(self) -> str:
        """The sentence about states that were dropped because of the limits; empty if none."""
        told = []
        late, waited = self._unpaired.get("too_late"), self._unpaired.get("waited_too_long")
        if late:
            memory = (
                f"the newest {self.limits.past_states} states"
                if self._is_full
                else f"{self.limits.past_s:g} s (max_delay)"
            )
            told.append(
                f"{counted(late, *self.waits)} dropped: later than the {self.interpolated} "
                f"buffer of {memory}"
            )
        if waited:
            told.append(
                f"{counted(waited, *self.waits)} dropped: more than "
                f"{self.limits.waiting_states} were waiting for {self.interpolated}"
            )
        return "; ".join(told)

    def made(self, *, at_end: bool = False) -> Pairs:
        """Return the pairs that are possible now; `settle` takes them as used."""
        self._decided = None
        track_stamps, track = self._track.held
        waiting, rows = self._waiting.held
        ready = len(waiting)
        if not at_end:
            ready = int(waiting.searchsorted(self._track.newest, side="right"))
        if not ready:
            return Pairs.none()
        stamps, rows = waiting[:ready].copy(), rows[:ready].copy()
        bracket = (
            bracket_stamps(track_stamps, stamps, self.max_gap_s)
            if len(track_stamps)
            else _behind_everything(ready)
        )
        self._decided = Decided(stamps, rows, bracket)
        start, end, fraction = bracket.start, bracket.end, bracket.fraction
        usable = bracket.usable
        if not usable.all():
            start, end, fraction = start[usable], end[usable], fraction[usable]
            stamps, rows = stamps[usable], rows[usable]
        between = mix(track, start, end, fraction)
        if len(stamps) and not np.isnan(between[0, QUATERNION.start]):
            quaternions = track[:, QUATERNION]
            between[:, QUATERNION] = lie.slerp(quaternions[start], quaternions[end], fraction)
        sides = (between, rows) if self._is_groundtruth_interpolated else (rows, between)
        return Pairs(stamps, *sides)

    def hand_over(self, following: Pairing) -> None:
        """Give another pairing the states that wait, and the interpolated ones around and after.

        Both pairings need the two interpolated states around the border. Every other state belongs
        to one of them.
        """
        held, rows = self._waiting.held
        waiting, rows = held.copy(), rows.copy()
        stamps, track = self._track.held
        border = int(waiting[0]) if len(waiting) else self._paired_until + 1
        begin = max(int(stamps.searchsorted(border, side="right")) - 1, 0)
        end = min(int(stamps.searchsorted(border)), len(stamps) - 1)
        following._interpolate(stamps[begin:].copy(), track[begin:].copy())
        following._let_wait(waiting, rows)
        interpolated, waited = self._sides
        self._waiting.drop(len(waiting))
        waited.take_back(len(waiting), self._decided_until)
        beyond = len(stamps) - 1 - end
        if beyond and len(stamps):
            interpolated.take_back(beyond, int(stamps[end]))
            self._track_count -= beyond
            self._track.end -= beyond

    def settle(self, before: int | None = None) -> None:
        """Take the last pairs of `made` as used, and drop states older than the limits allow.

        With a timestamp `before`, later pairs are not used: their states continue to wait.
        """
        decided, self._decided = self._decided, None
        if decided is not None and before is not None:
            decided = decided.until(int(decided.stamps.searchsorted(before)))
        if decided is not None and len(decided.stamps):
            self._waiting.drop(len(decided.stamps))
            self._decided_until = int(decided.stamps[-1])
            paired = decided.stamps[decided.bracket.usable]
            if len(paired):
                self._paired_until = max(self._paired_until, int(paired[-1]))
            self._pass(decided)
        stamps, _ = self._track.held
        if not len(stamps):
            return
        keep_from = self.limits.horizon(self._track.newest)
        waiting, _ = self._waiting.held
        if len(waiting):
            keep_from = min(keep_from, int(waiting[0]))
        # Keep one state before the oldest relevant timestamp, for the interpolation.
        old = int(stamps.searchsorted(keep_from, side="right")) - 1
        excess = len(stamps) - self.limits.past_states
        self._is_full |= excess > max(old, 0)
        old = max(old, excess, 0)
        if old:
            self._leave(old)
            self._forgotten_until = int(stamps[old - 1])
            self._track.drop(old)

    def _pass(self, decided: Decided) -> None:
        bracket = decided.bracket
        late = bracket.early & (decided.stamps <= self._forgotten_until)
        too_late = int(np.count_nonzero(late))
        for reason, count in bracket.dropped(self.interpolated).items():
            self._drop(reason, count - (too_late if reason.startswith("before_") else 0))
        self._drop("too_late", too_late)

    def _leave(self, count: int) -> None:  # noqa: B027 - optional hook
        """Called before the `count` oldest interpolated states are dropped."""

    def _interpolate(self, stamps: Stamps, rows: Floats) -> None:
        counts = self._sides[0]
        stamps, rows = counts.take(stamps, rows[:, :WIDTH])
        if not len(stamps):
            return
        if _continue(self._track.newest, stamps):
            self._track.append(stamps, rows)
            self._track_count += len(stamps)
            return
        if self._forgotten_until > NEVER:  # states older than the oldest stored one are too late
            old: Booleans = stamps < self._track.held[0][0]
            counts.drop("too_late", int(np.count_nonzero(old)))
            stamps, rows = stamps[~old], rows[~old]
        counts.drop("after_use", int(np.count_nonzero(stamps <= self._paired_until)))
        duplicates = self._track.merge(stamps, rows)
        counts.drop("duplicate_stamp", duplicates)
        self._track_count += len(stamps) - duplicates

    def _let_wait(self, stamps: Stamps, rows: Floats) -> None:
        counts = self._sides[1]
        stamps, rows = counts.take(stamps, rows)
        if not len(stamps):
            return
        if _continue(int(self._seen[-1]) if len(self._seen) else NEVER, stamps):
            self._waiting.append(stamps, rows)
            self._seen = np.concatenate([self._seen, stamps])
        else:
            # A timestamp that was seen before is a duplicate, as offline.
            new, first = np.unique(stamps, return_index=True)
            unseen = ~np.isin(new, self._seen)
            self._waiting.merge(new[unseen], rows[first[unseen]])
            self._seen = np.union1d(self._seen, new)
            counts.drop("duplicate_stamp", len(stamps) - int(np.count_nonzero(unseen)))
        forget = int(self._seen.searchsorted(self.limits.horizon(int(self._seen[-1]))))
        self._seen = self._seen[max(forget, len(self._seen) - self.limits.waiting_states) :]
        excess = len(self._waiting) - self.limits.waiting_states
        if excess > 0:
            self._waiting.drop(excess)
            self._drop("waited_too_long", excess)

    def _drop(self, reason: str, count: int) -> None:
        count_up(self._unpaired, reason, count)


def _behind_everything(count: int) -> Bracket:
    """Return the bracket of N stamps when the interpolated side has no states: all are late."""
    nowhere, never = np.zeros(count, np.int64), np.zeros(count, dtype=bool)
    return Bracket(nowhere, nowhere, np.zeros(count), never, ~never, never)


def _continue(newest: int, stamps: Stamps) -> bool:
    """Return whether stamps (N,), N > 0, are strictly increasing and newer than `newest`."""
    return bool(stamps[0] > newest and (stamps[1:] > stamps[:-1]).all())
