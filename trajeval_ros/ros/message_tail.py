"""Decoded messages, and the newest of them: for the start of a run, and for the next run."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.online.state_buffer import NEVER


class DecodedMessages(NamedTuple):
    """Messages of one source: some poses, or one path.

    Times (N,) are the receive times of the middleware; for a path, its time of arrival.
    """

    states: Trajectory
    times: Stamps
    is_path: bool = False
    resets: tuple[int, ...] = ()  # timestamps of first poses after declared resets

    @property
    def stamps(self) -> Stamps:
        """Timestamps for the detection of steps back; a path has only that of its last pose."""
        return self.states.stamps[-1:] if self.is_path else self.states.stamps

    def part(self, rows: slice | Booleans) -> DecodedMessages:
        """Return some of the messages, or a path with some of its poses."""
        count = len(self.states)
        if isinstance(rows, slice) and rows.indices(count) == (0, count, 1):
            return self  # a copy costs as much as the evaluation of a few messages
        states = self.states[rows]
        if len(states) in (0, count):
            return self._replace(states=states, times=self.times[: len(states)])
        first, last = states.stamps.min(), states.stamps.max()
        resets = tuple(stamp for stamp in self.resets if first <= stamp <= last)
        times = self.times if self.is_path else self.times[rows]
        return self._replace(states=states, times=times, resets=resets)


class MessageTail:
    """The newest messages of all sources, in order of arrival; of a path the newest version."""

    def __init__(self) -> None:
        self._blocks: dict[int, deque[tuple[int, DecodedMessages]]] = {}  # numbered, by source
        self._number = 0

    def add(self, source: int, messages: DecodedMessages) -> None:
        """Add messages of a source."""
        if not len(messages.states):
            return
        blocks = self._blocks.setdefault(source, deque())
        if messages.is_path:
            blocks.clear()
        blocks.append((self._number, messages))
        self._number += 1

    def forget(self, past_s: float) -> None:
        """Drop messages that are older than the newest one of their source, seconds.

        After a step back of time, those before it are dropped, too.
        """
        past_ns = round(past_s * NANOSECONDS)
        for blocks in self._blocks.values():
            newest = int(blocks[-1][1].stamps[-1])
            while not newest - past_ns <= blocks[0][1].stamps[-1] <= newest:
                blocks.popleft()

    def first(self, source: int) -> int | None:
        """Return the earliest timestamp of a source, nanoseconds; None without messages."""
        blocks = self._blocks.get(source, ())
        return min((int(item.states.stamps.min()) for _, item in blocks), default=None)

    def __iter__(self) -> Iterator[tuple[int, DecodedMessages]]:
        """Yield sources and messages."""
        for _, source, messages in heapq.merge(
            *(
                [(number, source, messages) for number, messages in blocks]
                for source, blocks in self._blocks.items()
            ),
            key=lambda item: item[0],
        ):
            yield source, messages

    def since(
        self, begins: Mapping[int, int], before: set[int]
    ) -> Iterator[tuple[int, DecodedMessages]]:
        """Yield the messages from timestamps on, nanoseconds, by source.

        Of the sources in `before`, the last state before the timestamp is included, because states
        between both are interpolated.
        """
        begins = dict(begins)
        for source in before & begins.keys():
            stamps = [item.states.stamps for _, item in self._blocks.get(source, ())]
            earlier = np.concatenate([np.empty(0, np.int64), *stamps])
            earlier = earlier[earlier <= begins[source]]
            begins[source] = int(earlier.max(initial=NEVER))
        for source, messages in self:
            if source in begins:
                part = messages.part(messages.states.stamps >= begins[source])
                if len(part.states):
                    yield source, part
