"""Discontinuities of a live run, by the same search as recorded ones."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.detector import Discontinuities
from trajeval_ros.metrics.discontinuities.events import SIDES, Event
from trajeval_ros.metrics.stream_health import UNKNOWN

# Pairs wait no longer for the decision whether a step among them stays.
_MOST_HELD_NS = 12 * NANOSECONDS
_MOST_WAITING = 1000  # blocks of a side before the first of the other side
# Time of messages that are examined at a time: less costs time per message, more delays an event.
_BLOCK_NS = NANOSECONDS // 2

_Block: TypeAlias = tuple[StampedPoses, Stamps | None]  # poses and receive times


class LiveDiscontinuities:
    """Takes the states of both sides as they arrive, and examines them when asked."""

    def __init__(self) -> None:
        """Create it before the first state."""
        self.events: list[Event] = []  # of this run, in order of detection
        self._search: Discontinuities | None = None  # None before states of both sides
        self._known = 0  # number of events of the search that were returned
        # States that are not examined yet, by side.
        self._waiting: dict[str, deque[_Block]] = {side: deque() for side in SIDES}
        self._is_over = False

    def add(self, side: str, states: StampedPoses, received: Stamps | None) -> None:
        """Take N states of a side in order of arrival.

        Args:
            side: `groundtruth` or `estimate`.
            states: Their poses, with timestamps by the groundtruth's clock.
            received: (N,) receive times, nanoseconds, may be `UNKNOWN`; None if unknown.
        """
        if self._is_over or not len(states.stamps):
            return
        if received is not None and (received == UNKNOWN).any():
            received = None
        blocks = self._waiting[side]
        blocks.append((states, received))
        if self._search is None and len(blocks) > _MOST_WAITING:
            blocks.popleft()

    def examine(self, *, at_end: bool = False) -> list[Event]:
        """Examine the states that have arrived, in blocks of time; return the new events.

        Frozen parts extend their event while they last. `at_end`: no states will follow.
        """
        if self._search is None:
            self._begin()
        if self._search is None or self._is_over:
            return []
        for side, blocks in self._waiting.items():
            if blocks and (at_end or _span_ns(blocks) >= _BLOCK_NS):
                states, received = _joined(blocks)
                self._search.add(side, *states, received)
                blocks.clear()
        events = self._search.events
        new = events[self._known :]
        if at_end:
            known = [id(event) for event in events]
            new += [event for event in self._search.finish() if id(event) not in known]
            self._is_over = True
        self._known = len(events)
        self.events += new
        return new

    @property
    def frozen(self) -> list[Event]:
        """The events of frozen parts that last."""
        return [] if self._search is None else self._search.frozen

    def settled_until(self, newest: int) -> int:
        """Return the timestamp until which no later event begins.

        `newest` is the newest timestamp; the result is at most some seconds older.
        """
        if self._is_over:
            return newest
        settled = None if self._search is None else self._search.settled_until_ns
        held = newest - _MOST_HELD_NS
        return held if settled is None else max(settled, held)

    def clock_step(self) -> Event | None:
        """Return the newest step of one clock; None if the clocks agree as at the start."""
        steps = [event for event in self.events if event.kind == kinds.CLOCK_STEP]
        apart_s = sum(event.s for event in steps if event.side == kinds.ESTIMATE)
        apart_s -= sum(event.s for event in steps if event.side == kinds.GROUNDTRUTH)
        of_one = [event for event in steps if event.side != kinds.BOTH]
        return of_one[-1] if of_one and abs(apart_s) > 0.5 * abs(of_one[-1].s) else None

    def _begin(self) -> None:
        """Create the search when both sides have states, of which it needs to know the kind."""
        if all(self._waiting.values()):
            firsts = [blocks[0][0].poses[0] for blocks in self._waiting.values()]
            self._search = Discontinuities(oriented=not np.isnan(firsts).any())


def _span_ns(blocks: Sequence[_Block]) -> int:
    """Return the time between the first and the last state of blocks, nanoseconds."""
    return abs(int(blocks[-1][0].stamps[-1] - blocks[0][0].stamps[0]))


def _joined(blocks: Sequence[_Block]) -> _Block:
    """Return blocks as one; receive times are known if those of all blocks are."""
    states, times = zip(*blocks, strict=True)
    known = [received for received in times if received is not None]
    received = np.concatenate(known) if len(known) == len(times) else None
    return StampedPoses.joined(states), received
