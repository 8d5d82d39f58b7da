"""Pairing of two streams of states with different rates, as they arrive.

One side is interpolated at the timestamps of the other, with the code of the offline association,
so that both make the same pairs. A state of the other side waits until the interpolated side has
states beyond it, or until the end. Both sides are kept for a while, because states can be late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans, Indices, Stamps
from trajeval_ros.geometry.interpolation import Bracket
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.geometry.valid_poses import add_counts, count_up
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AssociationRule
from trajeval_ros.metrics.coverage import StampedPoses, time_without_gaps
from trajeval_ros.online.state_buffer import NEVER, BufferLimits, StateCounts, Tail


@dataclass(frozen=True, eq=False)
class PairedStates:
    """N pairs in order of time: states of both sides with equal timestamps."""

    groundtruth: Trajectory
    estimate: Trajectory  # in its own frame

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.estimate)

    @property
    def stamps(self) -> Stamps:
        """Timestamps (N,), nanoseconds."""
        return self.estimate.stamps

    def part(self, rows: slice | Booleans) -> PairedStates:
        """Return the pairs of a slice or a mask."""
        return PairedStates(self.groundtruth[rows], self.estimate[rows])

    def without_covariances(self) -> PairedStates:
        """Return the pairs without covariances."""
        sides = (self.groundtruth, self.estimate)
        if all(side.covariances is None for side in sides):
            return self
        return PairedStates(*(replace(side, covariances=None) for side in sides))


class DecidedStates(NamedTuple):
    """N groundtruth states in order of time, and which of them are in a pair."""

    states: StampedPoses
    paired: Booleans  # (N,)


class Pairing:
    """Pairs the states of two sides in bounded memory.

    Association `linear` interpolates the groundtruth, and `groundtruth-stamps` the estimate.
    """

    def __init__(
        self, rule: AssociationRule | None = None, limits: BufferLimits | None = None
    ) -> None:
        """Create it without states, by default for a groundtruth of poses."""
        self.rule = (rule or AssociationRule()).for_kind("poses")  # as resolved so far
        self.limits = limits or BufferLimits()  # limits of the memory
        # The newest states of both sides. Column `waits`: of a state without a decision.
        self.groundtruth, self.estimate = Tail(), Tail()
        # Of the interpolated side, they count as dropped `too_late`, a state whose neighbours have
        # been forgotten; and `after_use`, one that arrived after its neighbours were used.
        self.groundtruth_counts, self.estimate_counts = StateCounts(), StateCounts()
        # In the same order as offline, whatever occurs first.
        self._unpaired = dict.fromkeys(Bracket.reasons(self.interpolated), 0)
        self._groundtruth_decided: list[DecidedStates] = []
        self._waits_from = NEVER  # no older state waits
        self._forgotten_until = self._paired_until = NEVER
        self._is_full = False  # whether states were dropped by number, not by age
        self._left_time_ns, self._left_path_m = 0, 0.0  # of the groundtruth that was forgotten

    @property
    def at_groundtruth(self) -> bool:
        """Whether the estimate is interpolated."""
        return self.rule.method == AT_GROUNDTRUTH

    @property
    def interpolated(self) -> str:
        """The side that is interpolated, `groundtruth` or `estimate`."""
        return "estimate" if self.at_groundtruth else "groundtruth"

    @property
    def _waiting_side(self) -> Tail:
        return self.groundtruth if self.at_groundtruth else self.estimate

    @property
    def _track(self) -> Tail:
        """The states of the interpolated side."""
        return self.estimate if self.at_groundtruth else self.groundtruth

    def pair_at_groundtruth(self) -> None:
        """Interpolate the estimate from now on; call it before the first groundtruth."""
        self.rule = replace(self.rule, method=AT_GROUNDTRUTH)
        self.estimate_counts.dropped = self.dropped
        self._unpaired = dict.fromkeys(Bracket.reasons(self.interpolated), 0)
        self._waits_from = NEVER

    def add_groundtruth(self, block: Trajectory) -> None:
        """Take groundtruth states in any order."""
        self._add(self.groundtruth, self.groundtruth_counts, block)

    def add_estimate(self, block: Trajectory) -> None:
        """Take estimated states in any order; covariances of interpolated ones are dropped."""
        self._add(self.estimate, self.estimate_counts, block)

    @property
    def groundtruth_count(self) -> int:
        """Number of groundtruth states so far, without waiting ones."""
        return self._count(self.groundtruth)

    @property
    def estimate_count(self) -> int:
        """Number of estimated states so far, without waiting ones."""
        return self._count(self.estimate)

    def _count(self, side: Tail) -> int:
        return side.dropped + len(side) - (self.waiting if side is self._waiting_side else 0)

    @property
    def groundtruth_time(self) -> int:
        """Groundtruth time that pairs can cover, nanoseconds; fixes and points have no gaps."""
        stamps = self.groundtruth.stamps[: self._groundtruth_rows]
        return self._left_time_ns + time_without_gaps(stamps, self.rule)

    @property
    def groundtruth_path_m(self) -> float:
        """Length of the path through the groundtruth states, metres."""
        return self._left_path_m + _path_m(self.groundtruth, self._groundtruth_rows)

    @property
    def _groundtruth_rows(self) -> int:
        """Number of the stored groundtruth states before those that wait."""
        return self._first_waiting if self.at_groundtruth else len(self.groundtruth)

    @property
    def dropped(self) -> dict[str, int]:
        """Number of states without a pair by reason, as offline.

        Two more reasons exist live. `too_late`: the states around it have been forgotten.
        `waited_too_long`: too many states were waiting.
        """
        return add_counts(self.estimate_counts.dropped, self._unpaired)

    @property
    def newest(self) -> int:
        """The newest timestamp of both sides, nanoseconds; the least int64 without states."""
        return max(self.groundtruth.newest, self.estimate.newest)

    @property
    def waiting(self) -> int:
        """Number of states that wait for the other side."""
        return len(self._waiting_rows(len(self._waiting_side)))

    @property
    def _first_waiting(self) -> int:
        """Row of the first state that can wait."""
        return int(self._waiting_side.stamps.searchsorted(self._waits_from))

    def _waiting_rows(self, end: int) -> Indices:
        """Return the rows before `end` that wait."""
        first = self._first_waiting
        if end <= first:
            return np.empty(0, dtype=np.int64)
        rows: Indices = np.flatnonzero(self._waiting_side.column("waits")[first:end])
        return rows + first

    @property
    def why_forgotten(self) -> str:
        """The sentence about states that were dropped because of the limits; empty if none."""
        reasons = []
        waits = ("fix or point", "fixes or points") if self.at_groundtruth else ("pose", "poses")
        late, waited = self._unpaired.get("too_late"), self._unpaired.get("waited_too_long")
        if late:
            memory = (
                f"the newest {self.limits.past_states} states"
                if self._is_full
                else f"{self.limits.past_s:g} s (max_delay)"
            )
            reasons.append(
                f"{counted(late, *waits)} dropped: later than the {self.interpolated} buffer of "
                f"{memory}"
            )
        if waited:
            reasons.append(
                f"{counted(waited, *waits)} dropped: more than {self.limits.waiting_states} were "
                f"waiting for {self.interpolated}"
            )
        return "; ".join(reasons)

    def made(self, *, at_end: bool = False) -> PairedStates | None:
        """Return the pairs that are possible now; None without any."""
        side, track = self._waiting_side, self._track
        end = len(side) if at_end else int(side.stamps.searchsorted(track.newest, side="right"))
        rows = self._waiting_rows(end)
        if not len(rows):
            return None
        states = side.trajectory(rows)
        side.column("waits")[rows] = False
        self._waits_from = int(states.stamps[-1]) + 1
        if not len(track):
            self._count_decided(states, _behind_everything(len(rows)))
            return None
        # The states around the new timestamps.
        begin = max(int(track.stamps.searchsorted(states.stamps[0], side="right")) - 1, 0)
        beyond = int(track.stamps.searchsorted(states.stamps[-1])) + 1
        around = track.trajectory(slice(min(begin, len(track) - 1), beyond))
        between, bracket = self.rule.interpolated(around, states.stamps)
        self._count_decided(states, bracket)
        if len(between) < len(states):
            states = states[bracket.usable]
        if not len(states):
            return None
        sides = (states, between) if self.at_groundtruth else (between, states)
        return PairedStates(*sides)

    def _count_decided(self, states: Trajectory, bracket: Bracket) -> None:
        """Count states (N,) whose association has been decided, in order of time."""
        stamps, usable = states.stamps, bracket.usable
        if usable.any():
            self._paired_until = max(self._paired_until, int(stamps[usable][-1]))
        if not usable.all():
            too_late = int(np.count_nonzero(bracket.early & (stamps <= self._forgotten_until)))
            for reason, number in bracket.dropped(self.interpolated).items():
                self._drop(reason, number - (too_late if reason.startswith("before_") else 0))
            self._drop("too_late", too_late)
        if self.at_groundtruth:
            self._groundtruth_decided.append(DecidedStates(StampedPoses.of(states), usable))

    def take_decided(self) -> Sequence[DecidedStates]:
        """Return the groundtruth states that were decided since the last call, for their stamps.

        There are none if the groundtruth is interpolated.
        """
        decided, self._groundtruth_decided = self._groundtruth_decided, []
        return decided

    @property
    def unused_from(self) -> int:
        """The timestamp from which on no state is in a pair yet, nanoseconds."""
        rows = self._waiting_rows(len(self._waiting_side))
        return int(self._waiting_side.stamps[rows[0]]) if len(rows) else self._paired_until + 1

    @property
    def forgettable(self) -> int:
        """Number of the oldest interpolated states that the limits do not keep."""
        track, side = self._track, self._waiting_side
        if not len(track):
            return 0
        keep_from, first = self.limits.horizon(track.newest), self._first_waiting
        if first < len(side):
            keep_from = min(keep_from, int(side.stamps[first]))
        # Keep one state before the oldest relevant timestamp, for the interpolation.
        old = int(track.stamps.searchsorted(keep_from, side="right")) - 1
        return max(old, len(track) - self.limits.past_states, 0)

    def forget(self) -> None:
        """Drop states that are older than the limits allow."""
        track, side, old = self._track, self._waiting_side, self.forgettable
        if old:
            horizon = self.limits.horizon(track.newest)
            self._is_full |= int(track.stamps[old]) > horizon
            self._forgotten_until = int(track.stamps[old - 1])
            self._leave(track, old)
        if not len(side):
            return
        # Of the other side, states are kept so that a repeated timestamp is detected.
        decided = self._first_waiting - 1
        old = int(side.stamps.searchsorted(self.limits.horizon(side.newest)))
        self._leave(side, max(min(decided, max(old, decided - self.limits.past_states)), 0))

    def _add(self, side: Tail, counts: StateCounts, block: Trajectory) -> None:
        if not len(block):
            return
        counts.count(block.stamps)
        is_track, oldest = side is self._track, int(block.stamps.min())
        if is_track and oldest <= side.newest:
            if self._forgotten_until > NEVER and oldest < side.stamps[0]:
                known = block.stamps >= side.stamps[0]
                counts.drop("too_late", int(np.count_nonzero(~known)))
                block = block[known]
            counts.drop("after_use", int(np.count_nonzero(block.stamps <= self._paired_until)))
        _, new = side.add(block, waits=np.ones(len(block), dtype=bool))
        counts.drop("duplicate_stamp", len(block) - new)
        if not is_track:
            self._waits_from = min(self._waits_from, oldest)
            if len(side) > self.limits.waiting_states:
                self._drop_waiting()

    def _drop_waiting(self) -> None:
        side = self._waiting_side
        rows = self._waiting_rows(len(side))
        excess = len(rows) - self.limits.waiting_states
        if excess > 0:
            self._leave(side, int(rows[excess]))
            self._drop("waited_too_long", excess)

    def _leave(self, side: Tail, count: int) -> None:
        """Drop the oldest states of a side, and add what the sums need of them."""
        if not count:
            return
        if side is self.groundtruth:
            stamps = side.stamps[: count + 1]
            self._left_time_ns += time_without_gaps(stamps, self.rule)
            self._left_path_m += _path_m(side, count + 1)
        side.drop_before(count)

    def _drop(self, reason: str, count: int) -> None:
        count_up(self._unpaired, reason, count)


def _path_m(side: Tail, count: int) -> float:
    """Return the length of the path through the oldest states, metres."""
    if not count or not len(side):
        return 0.0
    return float(travelled_distance(side.column("positions")[:count])[-1])


def _behind_everything(count: int) -> Bracket:
    """Return the bracket of N stamps when the interpolated side has no states: all are late."""
    nowhere, never = np.zeros(count, np.int64), np.zeros(count, dtype=bool)
    return Bracket(nowhere, nowhere, np.zeros(count), never, ~never, never)
