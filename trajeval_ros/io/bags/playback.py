"""The part of a bag that is played: topics, their names, and the time window."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.recorded_topic import Topic
from trajeval_ros.io.bags.ros1_to_cdr import Convert, converter, is_ros1, ros2_type

CLOCK_TOPIC = "/clock"
_SHORTEST = 4  # bytes of the encapsulation of CDR


@dataclass(frozen=True, eq=False)
class Channel:
    """A topic of the bag, as it is published; equal to itself only.

    Attributes:
        topic: As it was recorded.
        name: As ROS 2 allows it.
        type: As ROS 2 calls it.
        is_latched: Whether late subscribers get earlier messages.
        convert: Converts recorded messages to CDR; None if they are CDR.
    """

    topic: Topic
    name: str
    type: str
    is_latched: bool
    convert: Convert | None


class Playback:
    """The messages of an open bag that are to be played, in order of their log times.

    Attributes:
        channels: The channels that are played.
        notes: Differences from the recording, with reasons.
        begin_ns: The log time at which it begins.
        end_ns: The last log time.
        damaged: Number of messages skipped so far.
    """

    def __init__(
        self,
        bag: Bag,
        is_known: Callable[[str], bool],
        topics: Sequence[str] = (),
        *,
        start_s: float = 0.0,
        end_s: float | None = None,
        with_clock: bool = True,
    ) -> None:
        """Choose the channels and the time window.

        Args:
            bag: An open bag.
            is_known: Whether messages of a type can be published on this machine.
            topics: Names of the requested topics; empty means all.
            start_s: Where to begin, seconds from the bag's beginning.
            end_s: Where to end, seconds from the bag's beginning; None means its end.
            with_clock: Whether the clock is published instead of a recorded one.

        Raises:
            InputError: There is no such topic, one can't be published, or nothing can.
            SettingsError: Begin and end leave nothing.
        """
        self.notes: list[str] = []
        self.damaged = 0
        self._bag = bag
        first, last = bag.span
        self.begin_ns, self.end_ns = _window(first, last, start_s, end_s)
        self._is_whole = self.begin_ns == first and self.end_ns == last
        self.channels = self._choose(topics, is_known, with_clock=with_clock)

    @property
    def duration_s(self) -> float:
        """How long it takes at the rate 1, seconds."""
        return (self.end_ns - self.begin_ns) / NANOSECONDS

    def messages(self) -> Iterator[tuple[int, Channel, bytes]]:
        """Yield log time in ns, channel and CDR of all messages.

        Raises:
            InputError: The bag is damaged.
        """
        channels = {(each.topic.name, each.topic.type): each for each in self.channels}
        window = () if self._is_whole else (self.begin_ns, self.end_ns + 1)
        topics = [each.topic for each in self.channels]
        for topic, log_time, payload in self._bag.messages(topics, *window):
            channel = channels[topic.name, topic.type]
            try:
                cdr = channel.convert(payload) if channel.convert else bytes(payload)
            except Exception:  # of many types, depending on the damage
                cdr = b""
            if len(cdr) <= _SHORTEST:
                self.damaged += 1
                continue
            yield log_time, channel, cdr

    def _choose(
        self, names: Sequence[str], is_known: Callable[[str], bool], *, with_clock: bool
    ) -> list[Channel]:
        """Return the playable channels. Others are noted, and an error if they were requested."""
        path = self._bag.path
        wanted = {"/" + name.lstrip("/") for name in names}
        found = [topic for name in sorted(wanted) for topic in self._bag.find(name)]
        channels: list[Channel] = []
        refused: dict[str, list[str]] = {}
        for topic in found or self._bag.topics:
            channel, reason = self._channel(topic, channels, is_known, with_clock=with_clock)
            if channel is not None:
                channels.append(channel)
            elif topic.name in wanted:
                raise InputError(f"{path}: {topic.name} can't be played: {reason}")
            elif topic.count:
                refused.setdefault(reason, []).append(topic.name)
        for reason, left_out in refused.items():
            self.notes.append(f"{', '.join(left_out)} not played: {reason}")
        if not channels:
            why = f": {'; '.join(self.notes)}" if self.notes else ""
            raise InputError(f"{path} has no playable topic{why}")
        self.notes += [
            f"{each.topic.name} is published as {each.name}, a valid ROS 2 name"
            for each in channels
            if each.name != each.topic.name
        ]
        return channels

    @staticmethod
    def _channel(
        topic: Topic,
        others: Sequence[Channel],
        is_known: Callable[[str], bool],
        *,
        with_clock: bool,
    ) -> tuple[Channel | None, str]:
        """Return how a topic is published, or None and the reason why it can't be."""
        kind = ros2_type(topic.type)
        if with_clock and topic.name == CLOCK_TOPIC:
            return None, f"{CLOCK_TOPIC} is generated; to play the recorded one, use --no-clock"
        if any(each.topic.name == topic.name for each in others):
            return None, "another topic of this name has a different type"
        if not is_known(kind):
            return None, f"{kind} is not installed; install the ROS package {kind.split('/')[0]}"
        convert = None
        if is_ros1(topic):
            convert = converter(topic)
            if convert is None:
                return None, f"{kind} has different fields in ROS 1 and ROS 2"
        name = allowed_name(topic.name, {each.name for each in others})
        return Channel(topic, name, kind, _is_latched(topic), convert), ""


def allowed_name(name: str, taken: Collection[str] = ()) -> str:
    """Return a topic's name with underscores for characters that ROS 2 does not allow.

    Args:
        name: As it was recorded.
        taken: Names of other topics.
    """
    tokens = [re.sub(r"\W+", "_", token, flags=re.ASCII) for token in name.split("/") if token]
    tokens = [f"_{token}" if token[0].isdigit() else token for token in tokens]
    allowed = "/" + "/".join(tokens or ["unnamed"])
    count = 1
    while (free := allowed if count == 1 else f"{allowed}_{count}") in taken:
        count += 1
    return free


def _is_latched(topic: Topic) -> bool:
    """Return whether the recorded publishers were latched."""
    from rosbags.interfaces import ConnectionExtRosbag1, QosDurability

    if topic.name.endswith("/tf_static"):
        return True
    extensions = [connection.ext for connection in topic.connections]
    profiles = []
    for each in extensions:
        if isinstance(each, ConnectionExtRosbag1):
            if each.latching:
                return True
        else:
            profiles += each.offered_qos_profiles
    return bool(profiles) and all(
        profile.durability == QosDurability.TRANSIENT_LOCAL for profile in profiles
    )


def _window(first: int, last: int, start_s: float, end_s: float | None) -> tuple[int, int]:
    """Return the first and the last log time that are played, ns."""
    length = (last - first) / NANOSECONDS
    if not (math.isfinite(start_s) and start_s >= 0.0):
        raise SettingsError(f"--start {start_s:g} must be at least 0 s")
    if start_s > length:
        raise SettingsError(
            f"--start {start_s:g} is after the end of the bag, which lasts {length:.3f} s"
        )
    if end_s is None or end_s >= length:
        end_s = None
    elif not end_s > start_s:
        raise SettingsError(f"--end {end_s:g} must be after --start {start_s:g}")
    begin = first + round(start_s * NANOSECONDS)
    return begin, last if end_s is None else first + round(end_s * NANOSECONDS)
