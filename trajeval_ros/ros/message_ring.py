"""The serialised messages of the last seconds, in limited memory."""

from __future__ import annotations

import sys
from collections import deque
from typing import NamedTuple

from trajeval_ros.io.bags.write_clip import ClipTopic
from trajeval_ros.ros.subscriptions import ReceivedMessages

# Memory per message in addition to its bytes: the Python objects of message and time, and their
# entries in lists.
_OVERHEAD = sys.getsizeof(b"") + sys.getsizeof(2**60) + 16
# Batches of a latched topic that are kept regardless of their age. They contain the newest message
# of every publisher.
_LATCHED_BATCHES = 50


class _Batch(NamedTuple):
    messages: ReceivedMessages
    last_ns: int
    size: int


class TopicRing:
    """Messages of one topic, in the batches in which they were received.

    Attributes:
        name: Name of the topic.
        type: Type of its newest messages.
        is_latched: Whether late subscribers receive the newest messages.
        batches: Batches, the oldest first.
    """

    def __init__(self, name: str) -> None:
        """Create it empty."""
        self.name, self.type, self.is_latched = name, "", False
        self.batches: deque[_Batch] = deque()

    @property
    def may_forget(self) -> bool:
        """Whether the oldest batch may be removed."""
        return len(self.batches) > (_LATCHED_BATCHES if self.is_latched else 0)


class MessageRing:
    """Keeps the newest messages of topics.

    Attributes:
        size: Memory of the messages, bytes.
        forgotten: Number of messages removed early because of the limit of memory.
    """

    def __init__(self, kept_s: float, most_bytes: int) -> None:
        """Create it empty.

        Args:
            kept_s: Time for which messages are kept, seconds.
            most_bytes: Limit of memory, bytes; above it the oldest messages are removed.
        """
        self.size = self.forgotten = 0
        self._kept_ns, self._most = round(kept_s * 1e9), most_bytes
        self._topics: dict[str, TopicRing] = {}

    def add(self, name: str, kind: str, taken: ReceivedMessages, *, is_latched: bool) -> None:
        """Add received messages, at least one."""
        topic = self._topics.setdefault(name, TopicRing(name))
        if topic.type not in ("", kind):  # a clip has one type per topic
            self.size -= sum(each.size for each in topic.batches)
            topic.batches.clear()
        topic.type, topic.is_latched = kind, is_latched
        size = sum(map(len, taken.payloads)) + _OVERHEAD * len(taken.payloads)
        topic.batches.append(_Batch(taken, taken.received[-1], size))
        self.size += size
        while self.size > self._most and self._forget_oldest():
            pass

    def forget(self, now_ns: int) -> None:
        """Remove old messages.

        Args:
            now_ns: Current time, nanoseconds.
        """
        before = now_ns - self._kept_ns
        for topic in self._topics.values():
            while topic.may_forget and topic.batches[0].last_ns < before:
                self.size -= topic.batches.popleft().size

    def _forget_oldest(self) -> bool:
        """Remove the oldest batch of all topics; return whether one may be removed."""
        filled = [each for each in self._topics.values() if each.may_forget]
        if not filled:
            return False
        oldest = min(filled, key=lambda each: each.batches[0].last_ns).batches.popleft()
        self.size -= oldest.size
        self.forgotten += len(oldest.messages.payloads)
        return True

    def between(self, begin_ns: int, end_ns: int) -> list[ClipTopic]:
        """Return the messages received in a span of time, nanoseconds.

        Latched topics include their messages before it.
        """
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
