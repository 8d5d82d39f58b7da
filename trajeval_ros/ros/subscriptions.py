"""Serialised messages of a topic, read at the rate of the evaluator instead of in callbacks.

Callbacks take ten times as much CPU time as reading the queue every 50 ms, mostly in the
executor's wait set. So subscriptions are not in the wait set, and their queues are read
periodically.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.ros.graph import publishers_of, why_unmatched
from trajeval_ros.ros.message_types import message_class
from trajeval_ros.ros.qos import is_same, matching

if TYPE_CHECKING:
    from rclpy.node import Node

UNMATCHED_AFTER_S = 5.0
_REMIND_EVERY_S = 30.0


@dataclass(frozen=True)
class ReceivedMessages:
    """The messages that waited on a topic.

    Attributes:
        payloads: Serialised messages, in order of arrival.
        received: Times of reception by the middleware, nanoseconds since 1970.
    """

    payloads: list[bytes] = field(default_factory=list)
    received: list[int] = field(default_factory=list)


class Losses:
    """Counts lost messages, from gaps in the sequence numbers of the publishers.

    Attributes:
        count: Number of lost messages.
        is_exact: Whether all gaps can be detected. Humble's middleware has no sequence numbers,
            and Jazzy's does not distinguish the publishers of a topic.
    """

    def __init__(self) -> None:
        """Create it without a loss."""
        self.count = 0
        self.is_exact = True
        self._last: dict[bytes, int] = {}

    def see(self, info: dict[str, Any], publishers: int) -> None:
        """Process the middleware's information on a message.

        Args:
            info: The information.
            publishers: Number of publishers of the topic.
        """
        number = info.get("publication_sequence_number")
        identity = bytes((info.get("publisher_gid") or {}).get("data", b""))
        if number is None or (publishers > 1 and not identity):
            self.is_exact = False
            self._last.clear()
            return
        last = self._last.get(identity)
        # A publisher that restarts counts from one again.
        if last is not None and number > last:
            self.count += number - last - 1
        self._last[identity] = number


class TopicInput:
    """Subscribes to a topic with the type and quality of service of its current publishers.

    Attributes:
        topic: Its name after remapping.
        is_static: Whether it carries static transforms, which are optional.
        type: Type of its messages; empty without a publisher.
        losses: Counts messages that were published and did not arrive.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        types: Sequence[str] | None,
        *,
        is_static: bool = False,
        is_optional: bool = False,
    ) -> None:
        """Start to search for publishers.

        Args:
            node: The subscribing node.
            topic: Name in the notation of the user, before remapping.
            types: Readable types; None for all installed types.
            is_static: See the attribute.
            is_optional: Whether a missing publisher is not reported.
        """
        self.topic, self.is_static = node.resolve_topic_name(topic), is_static
        self._is_optional = is_optional or is_static
        self.type = ""
        self.losses = Losses()
        # The node remaps names itself, so this is the name before remapping. A second remapping
        # can change a name again.
        self._node, self._name, self._types = node, topic, types if types is None else tuple(types)
        self._group = _polled()
        self._subscription: Any = None
        self._profile: Any = None
        self._class: Any = None
        self._publishers = 0
        self._remind_at = time.monotonic() + UNMATCHED_AFTER_S

    @property
    def is_latched(self) -> bool:
        """Whether late subscribers receive the newest messages from its publishers."""
        from rclpy.qos import DurabilityPolicy

        latched = DurabilityPolicy.TRANSIENT_LOCAL
        return self._profile is not None and bool(self._profile.durability == latched)

    def match(self) -> str:
        """Connect to the present publishers; return a sentence for the log, or an empty text."""
        publishers = publishers_of(self._node, self._name, self._types)
        if not publishers:
            unknown = self._types is None and self._node.count_publishers(self._name)
            return "" if self._is_optional and not unknown else self._remind()
        profile = matching(publishers, is_static=self.is_static)
        kind = publishers[0].topic_type
        self._remind_at = time.monotonic() + UNMATCHED_AFTER_S
        joined = len(publishers) > max(1, self._publishers)
        self._publishers = len(publishers)
        if joined:
            names = ", ".join(sorted({each.node_name for each in publishers}))
            mixed = (
                f"; messages of {counted(len(publishers), 'publisher')} on {self.topic} are "
                f"mixed ({names})"
            )
        else:
            mixed = ""
        again = self._subscription is not None
        if again:
            if kind == self.type and is_same(profile, self._profile):
                return mixed.removeprefix("; ")
            self._node.destroy_subscription(self._subscription)
        self.type, self._profile, self._class = kind, profile, message_class(kind)
        self._subscription = self._node.create_subscription(
            self._class,
            self._name,
            _never,
            profile,
            raw=True,
            callback_group=self._group,
            event_callbacks=_no_events(),
        )
        offer = f"{profile.reliability.name.lower()}, {profile.durability.name.lower()}"
        verb = "subscribed again" if again else "subscribed"
        return f"{verb} to {self.topic}: {kind}, {offer}{mixed}"

    def take(self) -> ReceivedMessages:
        """Return the messages since the last call."""
        taken = ReceivedMessages()
        if self._subscription is None:
            return taken
        handle = self._subscription.handle
        with handle:
            while (message := handle.take_message(self._class, True)) is not None:
                payload, info = message
                self.losses.see(info, self._publishers)
                taken.payloads.append(payload)
                taken.received.append(info["received_timestamp"])
        return taken

    def leave(self) -> None:
        """Unsubscribe."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _remind(self) -> str:
        if time.monotonic() < self._remind_at:
            return ""
        self._remind_at = time.monotonic() + _REMIND_EVERY_S
        return why_unmatched(self._node, self._name, self._types)


def _polled() -> Any:
    """Return a callback group that keeps its subscriptions out of the executor's wait set."""
    from rclpy.callback_groups import CallbackGroup

    class Polled(CallbackGroup):  # type: ignore[misc]
        def can_execute(self, entity: Any) -> bool:
            del entity
            return False

        def beginning_execution(self, entity: Any) -> bool:
            del entity
            return False

        def ending_execution(self, entity: Any) -> None:
            del entity

    return Polled()


def _no_events() -> Any:
    """Return a setting without event handlers, because these are in the executor's wait set.

    The ROS graph has the same information.
    """
    from rclpy.node import SubscriptionEventCallbacks  # defined elsewhere in Humble

    return SubscriptionEventCallbacks(use_default_callbacks=False)


def _never(message: Any) -> None:
    raise AssertionError(f"a polled subscription was spun: {message!r}")
