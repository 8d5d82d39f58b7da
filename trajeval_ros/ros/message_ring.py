"""The messages of the last seconds, as bytes, within a bound of memory."""

from __future__ import annotations

import sys
from collections import deque
from typing import NamedTuple

from trajeval_ros.io.bags.write_clip import ClipTopic
from trajeval_ros.ros.subscriptions import ReceivedMessages

# What Python adds to the bytes of a message: objects of it and of its time, and their places.
_OVERHEAD = sys.getsizeof(b"") + sys.getsizeof(2**60) + 16
# Of a latched topic so many batches stay, however old: each publisher's newest among them.
_LATCHED_BATCHES = 50


class _Batch(NamedTuple):
    messages: ReceivedMessages
    last_ns: int
    size: int


class TopicRing:
    """Messages of one topic, batch by batch as they were taken.

    Attributes:
        name: Of the topic.
        type: Of its messages, the newest.
        is_latched: Whether subscribers that come late get them.
        batches: The oldest first.
    """

    def __init__(self, name: str) -> None:
        """Create it empty."""
        self.name, self.type, self.is_latched = name, "", False
        self.batches: deque[_Batch] = deque()

    @property
    def may_forget(self) -> bool:
        """Whether the oldest batch may go."""
        return len(self.batches) > (_LATCHED_BATCHES if self.is_latched else 0)


class MessageRing:
    """Keeps the newest messages of topics.

    Attributes:
        size: Bytes of memory that they take.
        forgotten: Messages that went before their time, since memory is bounded.
    """

    def __init__(self, kept_s: float, most_bytes: int) -> None:
        """Create it empty.

        Args:
            kept_s: For how long messages are kept.
            most_bytes: What all of them may take; beyond it the oldest go.
        """
        self.size = self.forgotten = 0
        self._kept_ns, self._most = round(kept_s * 1e9), most_bytes
        self._topics: dict[str, TopicRing] = {}

    def add(self, name: str, kind: str, taken: ReceivedMessages, *, is_latched: bool) -> None:
        """Keep messages that have just been taken, at least one."""
        topic = self._topics.setdefault(name, TopicRing(name))
        if topic.type not in ("", kind):  # another type can't stand under the same name
            self.size -= sum(each.size for each in topic.batches)
            topic.batches.clear()
        topic.type, topic.is_latched = kind, is_latched
        size = sum(map(len, taken.payloads)) + _OVERHEAD * len(taken.payloads)
        topic.batches.append(_Batch(taken, taken.received[-1], size))
        self.size += size
        while self.size > self._most and self._forget_oldest():
            pass

    def forget(self, now_ns: int) -> None:
        """Forget what is too old."""
        before = now_ns - self._kept_ns
        for topic in self._topics.values():
            while topic.may_forget and topic.batches[0].last_ns < before:
                self.size -= topic.batches.popleft().size

    def _forget_oldest(self) -> bool:
        """Forget the oldest batch of all; return whether there was one that may go."""
        filled = [each for each in self._topics.values() if each.may_forget]
        if not filled:
            return False
        oldest = min(filled, key=lambda each: each.batches[0].last_ns).batches.popleft()
        self.size -= oldest.size
        self.forgotten += len(oldest.messages.payloads)
        return True

    def between(self, begin_ns: int, end_ns: int) -> list[ClipTopic]:
        """Return the messages received in a span, and of latched topics those before it."""
        found = []
        for topic in self._topics.values():
            begin = 0 if topic.is_latched else begin_ns
            rows = [
                (time, payload)
                for batch in topic.batches
                for time, payload in zip(
                    batch.messages.received, batch.messages.payloads, strict=True
                )
                if begin <= time <= end_ns
            ]
            if rows:
                times, payloads = zip(*rows, strict=True)
                found.append(ClipTopic(topic.name, topic.type, times, payloads, topic.is_latched))
        return found
