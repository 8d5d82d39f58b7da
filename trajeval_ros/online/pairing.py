"""Two streams of states at their own rates, paired as they arrive.

The groundtruth is interpolated at the estimate's stamps with the arithmetic of the offline
association, so that both give the same pairs. An estimated state waits until groundtruth beyond it
has arrived, or until it is clear that none will do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import LARGEST, NANOSECONDS, travelled_distance
from trajeval_ros.metrics.association import bracket_stamps, mix
from trajeval_ros.metrics.coverage import time_without_gaps
from trajeval_ros.metrics.pair_steps import StampedPoses
from trajeval_ros.online.state_buffer import NEVER, StateBuffer
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY, WIDTH, Pairs
from trajeval_ros.online.waypoint_stream import WaypointStream


@dataclass(frozen=True)
class Limits:
    """What a buffer holds at the most; beyond, the oldest is dropped and counted.

    A state takes 88 bytes: 500 000 of each side are 88 MB, and up to twice that while they grow.

    Attributes:
        groundtruth_s: Groundtruth kept behind its newest state, for late estimates, seconds;
            infinite for as much as `groundtruth_states` allows.
        groundtruth_states: The same as a number of states, whatever the rate.
        waiting_states: Estimated states that wait for groundtruth.
    """

    groundtruth_s: float = 10.0
    groundtruth_states: int = 500_000
    waiting_states: int = 500_000

    def horizon(self, newest: int) -> int:
        """Return the stamp from which on states are kept, of a side's newest one, nanoseconds."""
        if math.isinf(self.groundtruth_s):
            return NEVER
        return newest - round(self.groundtruth_s * NANOSECONDS)


class PairingBuffer:
    """Pairs one estimate's states with interpolated groundtruth, in bounded memory.

    Attributes:
        dropped: Number of estimated states that are in no pair, by reason, as offline, and
            `too_late`: its groundtruth had been forgotten; `waited_too_long`: none came.
        groundtruth_dropped: Number of groundtruth states that could not be used, by reason, and
            `too_late`: its neighbours had been forgotten, as when a bag is played anew;
            `after_use`: a state that arrived after its neighbours had been used without it.
        groundtruth_count: Number of groundtruth states so far.
    """

    def __init__(self, max_gap_s: float = 0.5, limits: Limits | None = None) -> None:
        """Begin empty.

        Args:
            max_gap_s: Never interpolate across a longer step of the groundtruth.
            limits: What to hold at the most.
        """
        self.max_gap_s = max_gap_s
        self.limits = limits or Limits()
        self.dropped: dict[str, int] = {}
        self.groundtruth_dropped: dict[str, int] = {}
        self.groundtruth_count = 0
        self._truth, self._waiting = StateBuffer(), StateBuffer()
        self._seen: Stamps = np.empty(0, dtype=np.int64)
        self._forgotten_until = self._paired_until = NEVER
        self._is_full = False  # whether memory has ended before time
        self._forgotten_time, self._forgotten_path_m = 0, 0.0
        self._max_gap_ns = round(max_gap_s * NANOSECONDS)
        self._waypoints = WaypointStream(self._max_gap_ns)

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states, (N,) and (N, 10), in any order."""
        stamps, rows = self._finite(stamps, rows, self.groundtruth_dropped)
        if not len(stamps):
            return
        if _continue(self._truth.newest, stamps):
            self._truth.append(stamps, rows)
            self.groundtruth_count += len(stamps)
        else:
            if self._forgotten_until > NEVER:  # up to the oldest that is held all is counted
                old = stamps < self._truth.held[0][0]
                self._count(self.groundtruth_dropped, "too_late", int(np.count_nonzero(old)))
                stamps, rows = stamps[~old], rows[~old]
            after_use = int(np.count_nonzero(stamps <= self._paired_until))
            self._count(self.groundtruth_dropped, "after_use", after_use)
            duplicates = self._truth.merge(stamps, rows)
            self._count(self.groundtruth_dropped, "duplicate_stamp", duplicates)
            self.groundtruth_count += len(stamps) - duplicates

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take estimated states, (N,) and (N, 10), in any order."""
        stamps, rows = self._finite(stamps, rows, self.dropped)
        if not len(stamps):
            return
        if _continue(int(self._seen[-1]) if len(self._seen) else NEVER, stamps):
            self._waiting.append(stamps, rows)
            self._seen = np.concatenate([self._seen, stamps])
        else:
            # A stamp that was there before is a duplicate, as it would be offline.
            new, first = np.unique(stamps, return_index=True)
            unseen = ~np.isin(new, self._seen)
            self._waiting.merge(new[unseen], rows[first[unseen]])
            self._seen = np.union1d(self._seen, new)
            duplicates = len(stamps) - int(np.count_nonzero(unseen))
            self._count(self.dropped, "duplicate_stamp", duplicates)
        forget = int(self._seen.searchsorted(self.limits.horizon(int(self._seen[-1]))))
        self._seen = self._seen[max(forget, len(self._seen) - self.limits.waiting_states) :]
        excess = len(self._waiting) - self.limits.waiting_states
        if excess > 0:
            self._waiting.drop(excess)
            self._count(self.dropped, "waited_too_long", excess)

    def take(self, *, at_end: bool = False) -> Pairs:
        """Return the pairs that have become possible, and forget them.

        Args:
            at_end: No more groundtruth will come: what still waits is decided now.
        """
        truth_stamps, truth = self._truth.held
        waiting, rows = self._waiting.held
        ready = len(waiting)
        if not at_end:
            ready = int(waiting.searchsorted(self._truth.newest, side="right"))
        if not ready or not len(truth_stamps):
            if at_end:
                self._count(self.dropped, "after_groundtruth", ready)
                self._waiting.drop(ready)
            self._forget()
            return Pairs(np.empty(0, np.int64), np.empty((0, WIDTH)), np.empty((0, WIDTH)))
        stamps, rows = waiting[:ready].copy(), rows[:ready].copy()
        self._waiting.drop(ready)
        bracket = bracket_stamps(truth_stamps, stamps, self.max_gap_s)
        start, end, fraction = bracket.start, bracket.end, bracket.fraction
        usable = bracket.usable
        if not usable.all():
            too_late = int(np.count_nonzero(bracket.early & (stamps <= self._forgotten_until)))
            for reason, count in bracket.dropped().items():
                late = too_late if reason == "before_groundtruth" else 0
                self._count(self.dropped, reason, count - late)
            self._count(self.dropped, "too_late", too_late)
            start, end, fraction = start[usable], end[usable], fraction[usable]
            stamps, rows = stamps[usable], rows[usable]
        between = mix(truth, start, end, fraction)
        assert between is not None
        if len(stamps):
            if not np.isnan(between[0, QUATERNION.start]):
                quaternions = truth[:, QUATERNION]
                between[:, QUATERNION] = lie.slerp(quaternions[start], quaternions[end], fraction)
            self._paired_until = max(self._paired_until, int(stamps[-1]))
        self._forget()
        return Pairs(stamps, between, rows)

    def take_waypoints(self) -> StampedPoses:
        """Return the groundtruth's waypoints since the last call, up to the newest pair at least.

        They tell how far the groundtruth got between pairs, also after it has been forgotten.
        """
        self._pass_by(0)
        return self._waypoints.take()

    @property
    def why_forgotten(self) -> str:
        """Which estimated states a longer memory would have paired; empty if there are none."""
        told = []
        late, waited = self.dropped.get("too_late"), self.dropped.get("waited_too_long")
        if late:
            memory = (
                f"the newest {self.limits.groundtruth_states} states"
                if self._is_full
                else f"{self.limits.groundtruth_s:g} s (max_delay)"
            )
            told.append(
                f"{late} poses came too late to be paired: the groundtruth is remembered for "
                f"{memory}"
            )
        if waited:
            told.append(
                f"{waited} poses were dropped, since more than {self.limits.waiting_states} "
                "waited for groundtruth"
            )
        return "; ".join(told)

    @property
    def waiting(self) -> int:
        """Number of estimated states that wait for groundtruth."""
        return len(self._waiting)

    @property
    def groundtruth_time(self) -> int:
        """Sum of the groundtruth's steps that are no gaps, nanoseconds."""
        return self._forgotten_time + time_without_gaps(self._truth.held[0], self._max_gap_ns)

    @property
    def groundtruth_path_m(self) -> float:
        """Length of the path through the groundtruth states, metres."""
        return self._forgotten_path_m + _path_m(self._truth.held[1])

    def _finite(
        self, stamps: Stamps, rows: Floats, counts: dict[str, int]
    ) -> tuple[Stamps, Floats]:
        """Leave out rows that are no poses, and count them as the readers do.

        A velocity that can't be one is left out alone.
        """
        wild = np.abs(rows[:, VELOCITY]) > LARGEST
        if wild.any():
            rows = rows.copy()
            rows[wild.any(axis=1), VELOCITY] = np.nan
        # `states` writes it into all four columns.
        no_length = rows[:, QUATERNION.start] == np.inf
        finite = np.isfinite(rows[:, POSITION]).all(axis=1)
        keep = finite & ~no_length
        if keep.all():
            return stamps, rows
        self._count(counts, "not_finite", int(np.count_nonzero(~finite)))
        self._count(counts, "zero_quaternion", int(np.count_nonzero(finite & no_length)))
        return stamps[keep], rows[keep]

    def _pass_by(self, end: int) -> None:
        """Take the waypoints up to the newest pair, and among the states before a row."""
        stamps, rows = self._truth.held
        paired = int(stamps.searchsorted(self._paired_until, side="right"))
        self._waypoints.pass_by(stamps, rows, max(end, paired))

    def _forget(self) -> None:
        stamps, rows = self._truth.held
        if not len(stamps):
            return
        keep_from = self.limits.horizon(self._truth.newest)
        waiting, _ = self._waiting.held
        if len(waiting):
            keep_from = min(keep_from, int(waiting[0]))
        # One state before the oldest stamp of interest, to interpolate from.
        old = int(stamps.searchsorted(keep_from, side="right")) - 1
        excess = len(stamps) - self.limits.groundtruth_states
        self._is_full |= excess > max(old, 0)
        old = max(old, excess, 0)
        if old:
            if int(stamps[old - 1]) > self._waypoints.newest:
                self._pass_by(old)
            self._forgotten_until = int(stamps[old - 1])
            self._forgotten_time += time_without_gaps(stamps[: old + 1], self._max_gap_ns)
            self._forgotten_path_m += _path_m(rows[: old + 1])
            self._truth.drop(old)

    @staticmethod
    def _count(counts: dict[str, int], reason: str, count: int) -> None:
        if count:
            counts[reason] = counts.get(reason, 0) + count


def _continue(newest: int, stamps: Stamps) -> bool:
    """Return whether the stamps (N,), N > 0, are in order, once each, and all newer."""
    return bool(stamps[0] > newest and (stamps[1:] > stamps[:-1]).all())


def _path_m(rows: Floats) -> float:
    """Return the length of the path through states (N, 10), metres."""
    return float(travelled_distance(rows[:, POSITION])[-1]) if len(rows) else 0.0
