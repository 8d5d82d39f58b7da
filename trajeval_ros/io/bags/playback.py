"""Playback of a bag: topics, their names, the time window, and the pace."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import time
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.containers import Topic
from trajeval_ros.io.bags.message_definitions import types_in

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Convert = Callable[[bytes], bytes]

_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_HEADER = "std_msgs/msg/Header"  # without `seq` in ROS 2
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
CLOCK_TOPIC = "/clock"
_SHORTEST = 4  # bytes of the encapsulation of CDR
TICK_S = 0.01
# Messages due sooner are sent at once: a wake-up takes as long as sending.
_SHORTEST_SLEEP_S = 0.001
ChannelT = TypeVar("ChannelT", bound=Hashable)


def ros2_type(message_type: str) -> str:
    """Return the name in ROS 2 of a type of ROS 1."""
    return _RENAMED.get(message_type, message_type)


def converter(topic: Topic) -> Convert | None:
    """Return a function that converts messages of ROS 1 to CDR; None if the fields differ."""
    from rosbags.typesys import Stores, get_typestore

    ros2 = get_typestore(Stores.ROS2_JAZZY)
    store = get_typestore(Stores.EMPTY)
    name = topic.type
    try:
        recorded = types_in("MSG", topic.connections[0].definition, topic.type)
        kept = (_HEADER, *_TIMES)
        store.register({key: value for key, value in recorded.items() if key not in kept})
        store.register({key: ros2.fielddefs[key] for key in kept if key not in store.fielddefs})
        store.get_msgdef(name)
    except Exception:  # rosbags raises many types; the standard definition is used instead
        store, name = ros2, ros2_type(name)
        if name not in ros2.fielddefs:
            return None
    if ros2_type(name) in ros2.fielddefs:
        here, there = _layout(store, name), _layout(ros2, ros2_type(name))
        if here != there:
            return None
    return lambda payload: bytes(store.ros1_to_cdr(payload, name))


def _layout(store: Typestore, message_type: str) -> list[Any]:
    """Return the types of all fields without names, with the types in nested messages."""
    return [_spelled_out(store, kind) for _, kind in store.fielddefs[message_type][1]]


def _spelled_out(store: Typestore, kind: Any) -> Any:
    """Return a field's type with the layout in place of a message's name."""
    from rosbags.interfaces import Nodetype

    node, content = kind
    if node == Nodetype.NAME:
        return _layout(store, content)
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        inner, length = content
        return node, _spelled_out(store, inner), length
    return node, content


@dataclass(frozen=True, eq=False)
class Channel:
    """A topic of the bag, as it is published; equal to itself only."""

    topic: Topic  # as it was recorded
    name: str  # as ROS 2 allows it
    type: str  # as ROS 2 calls it
    is_latched: bool  # whether late subscribers get earlier messages
    convert: Convert | None  # converts recorded messages to CDR; None if they are CDR


class Playback:
    """The messages of an open bag that are to be played, in order of their log times."""

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

        `topics`: names of the requested topics; empty means all. `start_s`, `end_s`: seconds from
        the bag's beginning; None means its end.
        """
        self.notes: list[str] = []  # differences from the recording, with reasons
        self.damaged = 0  # number of messages skipped so far
        self._bag = bag
        first, last = bag.span
        # The first and the last log time that are played.
        self.begin_ns, self.end_ns = _window(first, last, start_s, end_s)
        self._is_whole = self.begin_ns == first and self.end_ns == last
        self.channels = self._choose(topics, is_known, with_clock=with_clock)

    @property
    def duration_s(self) -> float:
        """How long it takes at the rate 1, seconds."""
        return (self.end_ns - self.begin_ns) / NANOSECONDS

    @property
    def awaited(self) -> list[Channel]:
        """The channels with poses, which evaluators read; without any transforms, else all."""
        topics = self.channels
        posed = [topic for topic in topics if topic.topic.count and topic.topic.holds_poses]
        return posed or [topic for topic in topics if topic.topic.holds_transforms] or topics

    def messages(self) -> Iterator[tuple[int, Channel, bytes]]:
        """Yield log time in ns, channel and CDR of all messages."""
        channels = {(item.topic.name, item.topic.type): item for item in self.channels}
        window = () if self._is_whole else (self.begin_ns, self.end_ns + 1)
        topics = [item.topic for item in self.channels]
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
        requested = {"/" + name.lstrip("/") for name in names}
        topics = [topic for name in sorted(requested) for topic in self._bag.find(name)]
        channels: list[Channel] = []
        refused: dict[str, list[str]] = {}
        for topic in topics or self._bag.topics:
            channel, reason = self._channel(topic, channels, is_known, with_clock=with_clock)
            if channel is not None:
                channels.append(channel)
            elif topic.name in requested:
                raise InputError(f"{path}: {topic.name} can't be played: {reason}")
            elif topic.count:
                refused.setdefault(reason, []).append(topic.name)
        for reason, left_out in refused.items():
            self.notes.append(f"{', '.join(left_out)} not played: {reason}")
        if not channels:
            why = f": {'; '.join(self.notes)}" if self.notes else ""
            raise InputError(f"{path} has no playable topic{why}")
        self.notes += [
            f"{item.topic.name} is published as {item.name}, a valid ROS 2 name"
            for item in channels
            if item.name != item.topic.name
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
        if any(other.topic.name == topic.name for other in others):
            return None, "another topic of this name has a different type"
        if not is_known(kind):
            return None, f"{kind} is not installed; install the ROS package {kind.split('/')[0]}"
        convert = None
        if topic.connections[0].encoding == "ros1":
            convert = converter(topic)
            if convert is None:
                return None, f"{kind} has different fields in ROS 1 and ROS 2"
        name = allowed_name(topic.name, {other.name for other in others})
        return Channel(topic, name, kind, _is_latched(topic), convert), ""


def allowed_name(name: str, taken: Collection[str] = ()) -> str:
    """Return a topic's name with underscores for characters that ROS 2 does not allow."""
    tokens = [re.sub(r"\W+", "_", token, flags=re.ASCII) for token in name.split("/") if token]
    tokens = [f"_{token}" if token[0].isdigit() else token for token in tokens]
    allowed = "/" + "/".join(tokens or ["unnamed"])
    count = 1
    while (free := allowed if count == 1 else f"{allowed}_{count}") in taken:
        count += 1
    return free


def _is_latched(topic: Topic) -> bool:
    """Return whether the recorded publishers were latched."""
    from rosbags.interfaces import QosDurability
    from rosbags.rosbag2.metadata import parse_qos

    if topic.name.endswith("/tf_static") or any(
        connection.is_latching for connection in topic.connections
    ):
        return True
    profiles = []
    for connection in topic.connections:
        with contextlib.suppress(Exception):  # of many types, if it is invalid
            profiles += parse_qos(connection.qos) if connection.qos else []
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


@dataclass
class PlaybackResult(Generic[ChannelT]):
    """Result of a playback."""

    counts: Counter[ChannelT] = field(default_factory=Counter)  # number of messages by channel
    worst_lag_s: float = 0.0  # by how much the latest message was late; waiting is not counted
    waited_s: float = 0.0  # how long sending waited for subscribers, seconds
    reached_ns: int = 0  # bag time of the end
    took_s: float = 0.0  # how long it took, seconds
    is_complete: bool = True  # whether all messages were played


def play(
    messages: Iterable[tuple[int, ChannelT, bytes]],
    begin_ns: int,
    rate: float,
    *,
    publish: Callable[[ChannelT, bytes], float],
    tick: Callable[[int], None],
    is_stopped: Callable[[], bool] = lambda: False,
) -> PlaybackResult[ChannelT]:
    """Publish messages when they are due. Late messages are published at once, none is skipped.

    Bag time stops while sending waits for subscribers. Otherwise slow subscribers receive all
    messages of that time at once.

    Args:
        messages: Bag time in ns, channel and payload, in order of time.
        rate: Seconds of bag time per second.
        publish: Sends a message; returns how long it waited for subscribers, seconds.
        tick: Called with the bag time every `TICK_S`. It never decreases, and never passes a
            message that is not sent.
        is_stopped: Called at least every `TICK_S` while waiting.
    """
    played: PlaybackResult[ChannelT] = PlaybackResult(reached_ns=begin_ns)
    stream = iter(messages)
    opening = list(itertools.islice(stream, 1))  # the time to open the bag is not counted
    began = next_tick = time.monotonic()
    for time_ns, channel, payload in itertools.chain(opening, stream):
        due = began + (time_ns - begin_ns) / NANOSECONDS / rate
        while True:
            if is_stopped():
                played.is_complete = False
                break
            moment = time.monotonic()
            if moment >= next_tick:
                elapsed_ns = int((moment - began) * rate * NANOSECONDS)
                played.reached_ns = max(played.reached_ns, min(begin_ns + elapsed_ns, time_ns))
                tick(played.reached_ns)
                next_tick += TICK_S * (1 + (moment - next_tick) // TICK_S)
            if moment >= due:
                break
            time.sleep(max(_SHORTEST_SLEEP_S, min(due, next_tick) - moment))
        if not played.is_complete:
            break
        waited_s = publish(channel, payload)
        began += waited_s
        played.waited_s += waited_s
        played.counts[channel] += 1
        played.worst_lag_s = max(played.worst_lag_s, moment - due)
        played.reached_ns = max(played.reached_ns, time_ns)
    tick(played.reached_ns)
    played.took_s = time.monotonic() - began
    return played
