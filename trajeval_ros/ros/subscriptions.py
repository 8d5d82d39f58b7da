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

from trajeval_ros.io.checks import nearest
from trajeval_ros.ros.message_types import how_to_install, is_installed, message_class

if TYPE_CHECKING:
    from rclpy.node import Node


# Queue of a subscription, in messages. If it is full, messages are lost even with reliable
# delivery. It holds 20 s of groundtruth at 1 kHz. On a machine with five busy processes per core,
# the node reads its subscriptions up to 4 s late. Only waiting messages take memory.
DEPTH = 20_000
_UNNAMED, _UNKNOWN = "_NODE_NAME_UNKNOWN_", "unknown"  # a node without a name, in ROS and here


def matching(publishers: Sequence[Any], *, is_static: bool = False, depth: int = DEPTH) -> Any:
    """Return the strictest profile that all publishers offer, with a queue of `depth` messages.

    A subscription that requests more than a publisher offers does not connect, and there is no
    error. Therefore it is reliable only if all publishers are, and latched (transient local) only
    if all are. Static transforms are usually published before the subscription, so it is latched
    if any publisher is.
    """
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    offered = [publisher.qos_profile for publisher in publishers]
    reliable = all(item.reliability == ReliabilityPolicy.RELIABLE for item in offered)
    enough = any if is_static else all
    latched = enough(item.durability == DurabilityPolicy.TRANSIENT_LOCAL for item in offered)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


UNMATCHED_AFTER_S = 5.0
_REMIND_EVERY_S = 30.0


@dataclass(frozen=True)
class ReceivedMessages:
    """The messages that waited on a topic."""

    payloads: list[bytes] = field(default_factory=list)  # serialised messages, in order of arrival
    received: list[int] = field(default_factory=list)  # by the middleware, ns since 1970


class Losses:
    """Counts lost messages, from gaps in the sequence numbers of the publishers.

    Humble's middleware has no sequence numbers, and Jazzy's does not distinguish the publishers of
    a topic. Then the count is not exact.
    """

    def __init__(self) -> None:
        self.count = 0  # number of lost messages
        self.is_exact = True
        self._last: dict[bytes, int] = {}

    def see(self, info: dict[str, Any], publishers: int) -> None:
        """Process the middleware's information on a message."""
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


class Senders:
    """Whether the messages of a topic alternate between publishers, or one follows another.

    The publisher of a message is unknown, but the numbers of a publisher increase. A single step
    back is a restart. The middleware lists a killed publisher for some seconds more.
    """

    def __init__(self) -> None:
        self.are_numbered = True  # False with Humble's middleware
        self._steps_back = 0  # since there was one publisher
        self._last: int | None = None
        self._is_told = False  # whether the restart was reported

    def see(self, info: dict[str, Any]) -> None:
        """Process the middleware's information on a message."""
        number = info.get("publication_sequence_number")
        self.are_numbered = number is not None
        if number is not None and self._last is not None and number <= self._last:
            self._steps_back += 1
        self._last = number

    def reset(self) -> None:
        """Forget steps back, because there is one publisher."""
        self._steps_back, self._is_told = 0, False

    @property
    def alternate(self) -> bool:
        """Whether messages of several publishers alternate, or may alternate."""
        return self._steps_back > 1 or not self.are_numbered

    def restarted(self) -> bool:
        """Return once whether the publisher was restarted."""
        is_new = self._steps_back == 1 and not self._is_told
        self._is_told |= is_new
        return is_new


class TopicInput:
    """Subscribes to a topic with the type and quality of service of its current publishers."""

    def __init__(
        self,
        node: Node,
        topic: str,
        types: Sequence[str],
        *,
        is_static: bool = False,
        is_optional: bool = False,
        depth: int = DEPTH,
    ) -> None:
        self.topic = node.resolve_topic_name(topic)  # after remapping
        self.is_static = is_static  # static transforms are optional
        self._is_optional = is_optional or is_static  # a missing publisher is not reported
        self.type = ""  # type of its messages; empty without a publisher
        self.publishers: list[str] = []  # names of the nodes that publish it
        self.are_named = True  # whether these are all names that will be known
        self.losses = Losses()  # counts messages that were published and did not arrive
        self.senders = Senders()
        # The node remaps names itself, so this is the name before remapping. A second remapping
        # can change a name again.
        self._node, self._name, self._types = node, topic, tuple(types)
        self._depth = depth
        self._group = _polled()
        self._subscription: Any = None
        self._profile: Any = None
        self._class: Any = None
        self._remind_at = time.monotonic() + UNMATCHED_AFTER_S

    def match(self) -> str:
        """Connect to the present publishers; return a sentence for the log, or an empty text."""
        publishers = _publishers_of(self._node, self._name, self._types)
        if not publishers:
            return "" if self._is_optional else self._remind()
        profile = matching(publishers, is_static=self.is_static, depth=self._depth)
        kind = publishers[0].topic_type
        self._remind_at = time.monotonic() + UNMATCHED_AFTER_S
        # A node's name can arrive after its publishers. That of a program without ROS never does.
        names = sorted(publisher.node_name.replace(_UNNAMED, _UNKNOWN) for publisher in publishers)
        self.are_named = _UNKNOWN not in names or names == self.publishers
        self.publishers = names
        again = self._subscription is not None
        if again:
            if kind == self.type and _offer(profile) == _offer(self._profile):
                return ""
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
        verb = "subscribed again" if again else "subscribed"
        return f"{verb} to {self.topic}: {kind}, {_offer(profile)}"

    def take(self) -> ReceivedMessages:
        """Return the messages since the last call."""
        taken = ReceivedMessages()
        if self._subscription is None:
            return taken
        handle = self._subscription.handle
        with handle:
            while (message := handle.take_message(self._class, True)) is not None:
                payload, info = message
                self.losses.see(info, len(self.publishers))
                self.senders.see(info)
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
        return _why_unmatched(self._node, self._name, self._types)


def _offer(profile: Any) -> str:
    return f"{profile.reliability.name.lower()}, {profile.durability.name.lower()}"


def _polled() -> Any:
    """Return a callback group that keeps its subscriptions out of the executor's wait set."""
    from rclpy.callback_groups import CallbackGroup

    class Polled(CallbackGroup):  # type: ignore[misc]
        def can_execute(self, entity: Any) -> bool:  # noqa: ARG002
            return False

        def beginning_execution(self, entity: Any) -> bool:  # noqa: ARG002
            return False

        def ending_execution(self, entity: Any) -> None:
            pass

    return Polled()


def _no_events() -> Any:
    """Return a setting without event handlers, because these are in the executor's wait set.

    The ROS graph has the same information.
    """
    from rclpy.node import SubscriptionEventCallbacks  # defined elsewhere in Humble

    return SubscriptionEventCallbacks(use_default_callbacks=False)


def _never(message: Any) -> None:
    raise AssertionError(f"a polled subscription was spun: {message!r}")


def _publishers_of(node: Node, name: str, types: tuple[str, ...]) -> list[Any]:
    """Return the endpoints that publish a topic with one of the types, all of one type."""
    publishers = [
        item
        for item in node.get_publishers_info_by_topic(name)
        if item.topic_type in types and is_installed(item.topic_type)
    ]
    return [item for item in publishers if item.topic_type == publishers[0].topic_type]


def _why_unmatched(node: Node, name: str, types: tuple[str, ...]) -> str:
    """Return why no message is received on a topic, and similar names or other types."""
    topic = node.resolve_topic_name(name)
    there = node.get_publishers_info_by_topic(name)
    for item in there:
        kind = item.topic_type
        if kind in types:
            return f"{topic} has type {kind}, which is not installed; {how_to_install(kind)}"
    if there:
        kinds = ", ".join(sorted({item.topic_type for item in there}))
        return f"{topic} has type {kinds}, not a supported type of poses ({', '.join(types)})"
    poses = [
        other
        for other, kinds in node.get_topic_names_and_types()
        if any(kind in types for kind in kinds)
        and node.count_publishers(other)
        and not other.startswith(f"{node.get_fully_qualified_name()}/")
    ]
    if poses:
        return f"no publisher on {topic}; poses are on {nearest(topic, poses)}"
    return f"no publisher on {topic}, and no poses on any other topic"
