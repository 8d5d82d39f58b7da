"""The times at which recorded messages are played: bag time by a monotonic clock."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from trajeval_ros.geometry.trajectory import NANOSECONDS

TICK_S = 0.01
_SHORTEST_SLEEP_S = (
    0.001  # messages due sooner are sent at once: a wake-up takes as long as sending
)

ChannelT = TypeVar("ChannelT", bound=Hashable)


@dataclass
class PlaybackResult(Generic[ChannelT]):
    """Result of a playback.

    Attributes:
        counts: Number of messages by channel.
        worst_lag_s: By how much the latest message was late, seconds; waiting is not counted.
        waited_s: How long sending waited for subscribers, seconds.
        reached_ns: Bag time of the end.
        took_s: How long it took, seconds.
        is_complete: Whether all messages were played.
    """

    counts: Counter[ChannelT] = field(default_factory=Counter)
    worst_lag_s: float = 0.0
    waited_s: float = 0.0
    reached_ns: int = 0
    took_s: float = 0.0
    is_complete: bool = True


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
        begin_ns: Bag time of the beginning.
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
