"""Playback of a bag: its serialised messages, unchanged, and the clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.playback import CLOCK_TOPIC, Channel, Playback, PlaybackResult, play
from trajeval_ros.ros.lifetime import StopSignal, ros
from trajeval_ros.ros.message_types import message_class

if TYPE_CHECKING:
    from rclpy.node import Node

NODE_NAME = "trajeval_replay"

_LATCHED_DEPTH = 1000  # messages kept for late subscribers
# Time for slow subscribers to acknowledge the last messages. Fast DDS removes a killed subscriber
# after 20 s.
_LAST_DELIVERY_S = 30.0
_LAST_DELIVERY_STOPPED_S = 5.0
_ASK_EVERY_S = 0.2
_LOOK_EVERY_S = 0.02
_DISCOVERY_S = 2.0  # a node's readers of transforms are discovered with those of poses


def replay(
    playback: Playback,
    rate: float,
    *,
    patience_s: float,
    with_clock: bool,
    arguments: Sequence[str] = (),
    begin: Callable[[Sequence[Channel]], None],
    advance: Callable[[int, int], None],
) -> PlaybackResult[Channel]:
    """Publish a playback; SIGINT, SIGTERM and SIGHUP end it early.

    It starts after `patience_s`, or as soon as all topics with poses have a subscriber; without
    such topics, as soon as all have one. `begin` is called with those that have none, and
    `advance` periodically with the played and the total bag time.
    """
    with ros(arguments) as stop:
        import rclpy

        node = rclpy.create_node(NODE_NAME, start_parameter_services=False)  # nothing spins it
        publishers = {item: _publisher(node, item) for item in playback.channels}
        set_clock = _clock(node) if with_clock else None
        awaited = {item: publishers[item] for item in playback.awaited}
        begin(_without_subscriber(awaited, patience_s, stop))
        others = {item: to for item, to in publishers.items() if item.topic.holds_transforms}
        _without_subscriber(others, min(patience_s, _DISCOVERY_S), stop)

        def tick(time_ns: int) -> None:
            if set_clock is not None:
                set_clock(time_ns)
            advance(time_ns - playback.begin_ns, playback.end_ns - playback.begin_ns)

        played = play(
            playback.messages(),
            playback.begin_ns,
            rate,
            publish=lambda channel, payload: _send(publishers[channel], payload, stop),
            tick=tick,
            is_stopped=lambda: stop.is_asked_for,
        )
        _deliver(list(publishers.values()), stop)
        node.destroy_node()
    return played


def _publisher(node: Node, channel: Channel) -> Any:
    """Return a publisher that is compatible with all subscribers.

    It keeps every message until all reliable subscribers have acknowledged it. If its memory is
    full, sending fails. A latched topic keeps a fixed number of messages instead, because messages
    for late subscribers are never removed.
    """
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    if channel.is_latched:
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=_LATCHED_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
    else:
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_ALL,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.VOLATILE,
        )
    return node.create_publisher(message_class(channel.type), channel.name, qos)


def _send(publisher: Any, payload: bytes, stop: StopSignal) -> float:
    """Publish a message as soon as there is room for it; return the waiting time, seconds.

    A signal ends the waiting, and the message is not sent.
    """
    from rclpy.duration import Duration

    began = time.monotonic()
    waited_s, acknowledged = 0.0, False
    while True:
        try:
            publisher.publish(payload)
        except RuntimeError:  # the base of rclpy's error, which is private
            # If all messages are acknowledged, the reason is not a lack of room.
            if acknowledged:
                raise
        else:
            return waited_s
        if stop.is_asked_for:
            return waited_s
        acknowledged = publisher.wait_for_all_acked(Duration(seconds=_ASK_EVERY_S))
        waited_s = time.monotonic() - began


def _clock(node: Node) -> Callable[[int], None]:
    from rosgraph_msgs.msg import Clock

    publisher = node.create_publisher(Clock, CLOCK_TOPIC, 1)

    def publish(time_ns: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time_ns, NANOSECONDS)
        publisher.publish(message)

    return publish


def _without_subscriber(
    publishers: dict[Channel, Any], patience_s: float, stop: StopSignal
) -> list[Channel]:
    """Wait until all channels have a subscriber; return those that still have none."""
    until = time.monotonic() + patience_s
    while True:
        alone = [item for item, to in publishers.items() if not to.get_subscription_count()]
        if not alone or time.monotonic() >= until or stop.is_asked_for:
            return alone
        time.sleep(_LOOK_EVERY_S)


def _deliver(publishers: Sequence[Any], stop: StopSignal) -> None:
    """Wait until subscribers have acknowledged all messages; an exit loses the others."""
    from rclpy.duration import Duration

    began = time.monotonic()
    for publisher in publishers:
        while not publisher.wait_for_all_acked(Duration(seconds=_ASK_EVERY_S)):
            patience_s = _LAST_DELIVERY_STOPPED_S if stop.is_asked_for else _LAST_DELIVERY_S
            if time.monotonic() > began + patience_s:
                return
