"""One estimate topic over a whole run: passes its messages to the segments."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.io.bags.pose_messages import PATH_TYPE
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.reports import Update
from trajeval_ros.online.time_steps import TimeSteps
from trajeval_ros.ros.estimate_topic import EstimateTopic
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.poses import StateColumns
from trajeval_ros.ros.sides import TimeAt

FOLLOWS_WITHIN_S = 5.0  # if the time of one side steps back, the other follows within this time


class DecodedMessages(NamedTuple):
    """Messages of an estimate.

    Attributes:
        stamps: (N,), nanoseconds, for the detection of steps back; for a path, of its last pose.
        states: States of all messages, or of one path.
        times: (N,), nanoseconds, times of reception by the middleware; for a path, of arrival.
        newest: Type and bytes of the newest message; None for a path.
    """

    stamps: Stamps
    states: StateColumns
    times: Stamps
    newest: tuple[str, bytes] | None


class EstimateSegments:
    """Keeps the newest segment of an estimate, and older ones that may still receive messages.

    Attributes:
        current: The newest segment.
        ending: Older ones, not closed yet.
        time: Counts how often time has stepped back.
    """

    def __init__(
        self,
        topic: EstimateTopic,
        settings: OnlineSettings,
        folder: Path,
        *,
        hold: bool,
    ) -> None:
        """Create it with the first segment; see `LiveEstimate`."""
        self.time, self._topic = TimeSteps(), topic
        self._own_ahead = self._truth_ahead = 0
        self._begun_at = time.monotonic()
        self.ending: list[LiveEstimate] = []
        self.current = LiveEstimate(topic, settings, folder, hold=hold)

    @property
    def open(self) -> list[LiveEstimate]:
        """All segments that are not closed yet."""
        return [*self.ending, self.current]

    def open_at(self, epoch: int) -> list[LiveEstimate]:
        """The segment of the messages of an epoch, if there is one."""
        return [each for each in self.open if each.epoch == epoch and each.jumps.following is None]

    @property
    def own_epoch(self) -> int:
        """The epoch of the estimate's current messages."""
        return self.time.count + self._own_ahead

    def truth_epoch(self, groundtruth: TimeSteps) -> int:
        """Return the epoch of the groundtruth's current messages, for this estimate."""
        return groundtruth.count + self._truth_ahead

    def messages(self, time_at: TimeAt | None) -> Iterator[DecodedMessages]:
        """Yield the messages that have arrived, and every path separately.

        Args:
            time_at: Returns simulated time; None for the clock of the computer.
        """
        stream = self._topic.side.stream
        for message_type, taken, arrived in self._topic.side.take(time_at):
            received = np.array(taken.received, dtype=np.int64)
            if message_type == PATH_TYPE:
                for payload, each in zip(taken.payloads, arrived, strict=True):
                    path = stream.path(payload)
                    yield DecodedMessages(path.stamps[-1:], path, each[None], None)
                continue
            poses = stream.poses(message_type, taken.payloads, arrived)
            newest = message_type, taken.payloads[-1]
            yield DecodedMessages(poses.stamps, poses, received[poses.rows], newest)

    def take(self, messages: DecodedMessages, part: slice) -> None:
        """Pass a part of the messages to its segment."""
        for each in self.open_at(self.own_epoch):
            if messages.newest is None:
                each.take_path(messages.states, int(messages.times[0]))
            else:
                each.newest = messages.newest
                each.take(messages.states.picked(part), messages.times[part])

    def take_last(self) -> None:
        """Add the states whose timestamps are still under test, at the end of the run."""
        poses = self._topic.side.stream.last_poses()
        for each in self.open_at(self.own_epoch):
            each.take(poses, poses.stamps)

    def begin(self, epoch: int, began_by: str, settings: OnlineSettings, folder: Path) -> None:
        """Start a segment because time stepped back; the previous one ends later.

        Raises:
            InputError: Its file can't be made.
        """
        begun = self._next(began_by, settings, folder)
        begun.epoch = epoch
        self.ending.append(self.current)
        self.current, self._begun_at = begun, time.monotonic()

    def update(self, settings: OnlineSettings) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate the messages that have arrived; yield the new errors of the newest segment.

        After a jump, the segment is complete and a new one starts.
        """
        for each in self.ending:
            each.update()
        yield self.current, self.current.update()
        while self.current.jumps.following is not None:
            ended = self.current
            self.current = self._next("the estimate jumped", settings, ended.folder)
            self.current.clock = ended.clock
            self.ending.append(ended)
            yield self.current, self.current.update()

    def complete(self, groundtruth: TimeSteps) -> list[LiveEstimate]:
        """Return and remove the segments that no further message can belong to.

        If the time of only one side has stepped back, the newest states of the other side belong
        to the new segment, too.
        """
        if self.ending and time.monotonic() >= self._begun_at + FOLLOWS_WITHIN_S:
            if (behind := self.current.epoch - self.truth_epoch(groundtruth)) > 0:
                for each in self.open_at(self.truth_epoch(groundtruth)):
                    self.current.share_groundtruth(each)
                self._truth_ahead += behind
            self._own_ahead += max(self.current.epoch - self.own_epoch, 0)
        reached = min(self.own_epoch, self.truth_epoch(groundtruth))
        done = [
            each
            for each in self.ending
            if each.epoch < reached or each.jumps.following is not None
        ]
        self.ending = [each for each in self.ending if each not in done]
        return done

    def _next(self, began_by: str, settings: OnlineSettings, folder: Path) -> LiveEstimate:
        return LiveEstimate(self._topic, settings, folder, after=self.current, began_by=began_by)
