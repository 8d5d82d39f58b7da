"""Messages of a topic as bytes, taken by hand at the evaluator's own rate.

A callback for each message costs ten times as much as a look at the queue every 50 ms, most of it
in the executor's wait set. So subscriptions are kept out of the wait set, and drained.
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
    """What waited on a topic.

    Attributes:
        payloads: Serialised messages, in order of arrival.
        received: When the middleware received each, nanoseconds since 1970.
    """

    payloads: list[bytes] = field(default_factory=list)
    received: list[int] = field(default_factory=list)


class Losses:
    """Counts messages that never arrived, by the gaps in their publishers' numbers.

    Attributes:
        count: Messages lost.
        is_exact: Whether all gaps could be seen: Humble's middleware doesn't tell numbers, and
            Jazzy's doesn't tell one publisher's from another's.
    """

    def __init__(self) -> None:
        """Create it without a loss."""
        self.count = 0
        self.is_exact = True
        self._last: dict[bytes, int] = {}

    def see(self, info: dict[str, Any], publishers: int) -> None:
        """Take the middleware's information on a message, and the number of publishers."""
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
    """Subscribes to a topic as its publishers offer it, and again when they change.

    Attributes:
        topic: Its name after remapping.
        is_static: Whether it carries static transforms, which nobody needs to publish.
        type: Of its messages; empty until somebody publishes it.
        losses: Messages that were published and never arrived.
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
        """Start to look for publishers.

        Args:
            node: Subscribes.
            topic: A name, as a user gives it.
            types: Those that can be read; None for all that are installed.
            is_static: See the attribute.
            is_optional: Whether to say nothing while nobody publishes it.
        """
        self.topic, self.is_static = node.resolve_topic_name(topic), is_static
        self._is_optional = is_optional or is_static
        self.type = ""
        self.losses = Losses()
        # What a node is asked for it remaps itself; a name that is remapped already could become
        # another one.
        self._node, self._name, self._types = node, topic, types if types is None else tuple(types)
        self._group = _polled()
        self._subscription: Any = None
        self._profile: Any = None
        self._class: Any = None
        self._publishers = 0
        self._remind_at = time.monotonic() + UNMATCHED_AFTER_S

    @property
    def is_latched(self) -> bool:
        """Whether its publishers hand the newest messages to subscribers that come late."""
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
        """Return what has arrived since the last call."""
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
        """Subscribe no more."""
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
    """Return no event handlers: they join the wait set, and the graph has the same information."""
    from rclpy.node import SubscriptionEventCallbacks  # its own module has another name in Humble

    return SubscriptionEventCallbacks(use_default_callbacks=False)


def _never(message: Any) -> None:
    raise AssertionError(f"a polled subscription was spun: {message!r}")
