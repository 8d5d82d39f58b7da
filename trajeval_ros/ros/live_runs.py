"""The runs of a node: a reset, a restart or a step back of time begins another run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.outlier_stamps import NEAR_NS
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.pose_messages import PATH_TYPE
from trajeval_ros.metrics.discontinuities.events import CLOCK_STEP, SIDES, Event
from trajeval_ros.online.reports import Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.message_tail import DecodedMessages
from trajeval_ros.ros.pose_source import PoseSource, TimeAt
from trajeval_ros.ros.recorded_state import write_states

FOLLOWS_WITHIN_S = 5.0  # if the time of one source steps back, the others follow within this time
_MOST_OPEN = 20  # runs that may still receive messages
_QUIET_S = 0.1
_LAST_MESSAGES_S = 2.0


class LiveRuns:
    """Passes messages to the run that they belong to.

    A new run begins at steps back of time and at restarts of an estimate, if these are chosen.
    After a step back in the time of one source, the other sources follow soon. Until then their
    messages belong to the previous run, which stays open.

    `on_begun` is called with the previous run and the new one, before its first message, and
    `on_closed` with a previous run that is complete and the reasons for missing pairs.
    """

    def __init__(
        self,
        sources: Sequence[PoseSource],
        begin: Callable[[], LiveRun],
        new_folder: Callable[[], Path],
        *,
        at_time_jumps: bool = True,
        at_restarts: bool = False,
    ) -> None:
        self._sources, self._begin, self._new_folder = sources, begin, new_folder
        self._at_time_jumps, self._at_restarts = at_time_jumps, at_restarts
        self.on_begun: Callable[[LiveRun, LiveRun], object] = lambda *_: None
        self.on_closed: Callable[[LiveRun, list[str]], object] = lambda *_: None
        self._newest: list[int | None] = [None for _ in sources]  # timestamps
        self._ending: list[tuple[LiveRun, float]] = []  # and the times at which they end at last
        self._steps: dict[int, Event] = {}  # newest steps back of time, by source
        for source in sources:
            source.stream.starts_new_run = at_time_jumps
        self._enter(begin())

    @property
    def _open(self) -> list[LiveRun]:
        return [*(run for run, _ in self._ending), self.current]

    def take(self, time_at: TimeAt | None) -> None:
        """Receive the messages that have arrived; `time_at` returns simulated time."""
        for place, source in enumerate(self._sources):
            for messages in _decoded(source, time_at):
                for part, back_ns in self._parts(place, messages.stamps):
                    if back_ns:
                        self._step_back(place, int(messages.stamps[part][0]), back_ns)
                    taken = messages if messages.is_path else messages.part(part)
                    self._run_of[place].take(place, taken)
        self.current.decide()
        groundtruth, *estimates = (item.stream for item in self._sources)
        for stream in estimates:
            stream.clocks.update(groundtruth.arrivals, stream.arrivals)

    def discard(self) -> None:
        """Drop the messages that have arrived."""
        for source in self._sources:
            source.discard()

    def update(self) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate the messages that were taken; yield the new errors of the newest run."""
        for run, _ in self._ending:
            for _ in run.update():
                pass
        yield from self.current.update()
        while self.current.restarted is not None:
            self._begin_after_restart()
            yield from self.current.update()
        self._close_complete()

    def drain(self, time_at: TimeAt | None) -> None:
        """Receive and evaluate the last messages, including those in transit."""
        until = time.monotonic() + _LAST_MESSAGES_S
        quiet_since = time.monotonic()
        while time.monotonic() < min(until, quiet_since + _QUIET_S):
            before = self._received
            self.take(time_at)
            if self._received > before:
                quiet_since = time.monotonic()
            time.sleep(_QUIET_S / 10)
        self.conclude(time_at)

    def conclude(self, time_at: TimeAt | None) -> None:
        """Evaluate everything that has arrived, including poses that wait for groundtruth.

        All runs but the newest one are closed.
        """
        self.take(time_at)
        for place, source in enumerate(self._sources):
            poses = source.stream.last_poses()
            messages = DecodedMessages(poses, poses.stamps)
            self._run_of[place].take(place, messages)
        for run in self._open:
            run.decide(at_end=True)
        for _ in self.update():
            pass
        for estimate in self.current.estimates:
            estimate.examine(at_end=True)
        for _ in self.update():
            pass
        while self._ending:
            self._close_oldest()
        self.current.conclude()

    def reset(self, time_at: TimeAt | None) -> None:
        """End the newest run with the messages that have arrived, and begin another one.

        If another one can't begin, the newest one continues.
        """
        begun = self._begin()
        self.conclude(time_at)
        self._newest = [None for _ in self._sources]
        for source in self._sources:
            source.stream.reset()
        self._follow(begun)
        self._enter(begun)
        self._close_oldest()
        for source in self._sources:
            source.stream.forget_clocks()

    def _enter(self, run: LiveRun) -> None:
        """Pass the messages of all sources to a run, the newest one."""
        self.current = run
        self._run_of = [run for _ in self._sources]
        run.end_at_restarts(self._at_restarts)
        for place, source in enumerate(self._sources):
            source.stream.begin_run(run.status_of(place))
        write_states(run)

    def _follow(self, begun: LiveRun) -> None:
        """Make a run the newest one; messages continue to go to the previous one."""
        ended, self.current = self.current, begun
        ended.end_at_restarts(False)  # a run between this one and the next is not possible
        begun.end_at_restarts(self._at_restarts)
        self._ending.append((ended, time.monotonic() + FOLLOWS_WITHIN_S))
        write_states(begun)
        self.on_begun(ended, begun)

    def _begin_after_restart(self) -> None:
        ended = self.current
        estimate = ended.restarted
        assert estimate is not None
        while self._ending:
            self._close_oldest()
        begun = ended.following(self._new_folder(), f"{estimate.name} jumped")
        self._follow(begun)
        self._enter(begun)
        begun.continue_after(ended)
        self._close_oldest()

    def _step_back(self, place: int, stamp: int, back_ns: int) -> None:
        """Pass a source, whose time has stepped back, to the next run."""
        side, back_s = SIDES[bool(place)], back_ns / NANOSECONDS
        self._steps[place] = Event(CLOCK_STEP, side, stamp + back_ns, stamp, s=-back_s)
        runs = self._open
        follower = runs.index(self._run_of[place]) + 1
        if follower == len(runs):
            if self.current.holds:
                self.current.decide(at_end=True)
                while self.current.restarted is not None:
                    self._begin_after_restart()
            reason = f"time of {self._sources[place].source} stepped back by {back_s:.1f} s"
            self._follow(self.current.following(self._new_folder(), reason))
            runs = self._open
            follower = len(runs) - 1
        self._pass(place, runs[follower])
        if len(self._ending) > _MOST_OPEN:
            self._close_oldest()

    def _pass(self, place: int, run: LiveRun) -> None:
        self._run_of[place] = run
        self._sources[place].stream.begin_run(run.status_of(place))

    def _close_complete(self) -> None:
        while self._ending:
            run, until = self._ending[0]
            if run in self._run_of and time.monotonic() < until:
                return
            self._close_oldest()

    def _close_oldest(self) -> None:
        """Close the oldest run; sources whose messages still belong to it go to the next one.

        If the time of the groundtruth did not step back, its newest states belong to the next run,
        too.
        """
        (run, until), *self._ending = self._ending
        behind = [place for place, item in enumerate(self._run_of) if item is run]
        stepped_back = [place for place in range(len(self._sources)) if place not in behind]
        if behind and time.monotonic() >= until:
            for place in stepped_back:
                self._open[0].begin_with_clock_step(place, self._steps[place])
        if 0 in behind:
            self._open[0].continue_after(run, stepped_back)
        for place in behind:
            self._pass(place, self._open[0])
        run.conclude()
        write_states(run)
        self.on_closed(run, run.close())

    def _parts(self, place: int, stamps: Stamps) -> Iterator[tuple[slice, int]]:
        """Yield the parts of a source's messages between steps back, and the steps before them.

        A step back is longer than one second; 0 stands for none.
        """
        if not self._at_time_jumps or not len(stamps):
            yield slice(None), 0
            return
        newest, self._newest[place] = self._newest[place], int(stamps[-1])
        before = stamps[:1] if newest is None else np.array([newest])
        steps = np.diff(np.concatenate([before, stamps]))
        rows = np.flatnonzero(steps < -NEAR_NS).tolist()
        begins = rows if rows[:1] == [0] else [0, *rows]
        for begin, end in zip(begins, [*begins[1:], len(stamps)], strict=True):
            yield slice(begin, end), -int(steps[begin]) if begin in rows else 0

    @property
    def _received(self) -> int:
        return sum(source.stream.status.poses for source in self._sources)


def _decoded(source: PoseSource, time_at: TimeAt | None) -> Iterator[DecodedMessages]:
    """Yield the messages of a source that have arrived, and every path separately."""
    stream = source.stream
    for message_type, taken, arrived in source.take(time_at):
        received = np.array(taken.received, dtype=np.int64)
        if message_type == PATH_TYPE:
            for payload, item in zip(taken.payloads, arrived, strict=True):
                path = stream.path(payload)
                yield DecodedMessages(path, item[None], is_path=True)
            continue
        poses, rows = stream.poses(message_type, taken.payloads, arrived)
        resets, stream.resets = tuple(stream.resets), []
        yield DecodedMessages(poses, received[rows], resets=resets)
