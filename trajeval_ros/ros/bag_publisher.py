"""Playback of a bag: its serialised messages, unchanged, and the clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.pacing import PlaybackResult, play
from trajeval_ros.io.bags.playback import CLOCK_TOPIC, Channel, Playback
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

    Args:
        playback: The channels and messages to publish.
        rate: Seconds of bag time per second.
        patience_s: Longest time to wait until every topic has a subscriber, seconds.
        with_clock: Whether to publish the bag time on /clock.
        arguments: ROS arguments, from `--ros-args` on.
        begin: Called at the start with the channels without a subscriber.
        advance: Called periodically with the played and the total bag time.

    Raises:
        InputError: The bag is damaged.
        SettingsError: ROS rejects the arguments.
    """
    with ros(arguments) as stop:
        import rclpy

        node = rclpy.create_node(NODE_NAME, start_parameter_services=False)  # nothing spins it
        publishers = {each: _publisher(node, each) for each in playback.channels}
        set_clock = _clock(node) if with_clock else _no_clock
        begin(_without_subscriber(publishers, patience_s, stop))

        def tick(time_ns: int) -> None:
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
    """Return a function that publishes a bag time on /clock."""
    from rosgraph_msgs.msg import Clock

    publisher = node.create_publisher(Clock, CLOCK_TOPIC, 1)

    def publish(time_ns: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time_ns, NANOSECONDS)
        publisher.publish(message)

    return publish


def _no_clock(time_ns: int) -> None:
    pass


def _without_subscriber(
    publishers: dict[Channel, Any], patience_s: float, stop: StopSignal
) -> list[Channel]:
    """Wait until every topic has a subscriber; return the channels that still have none."""
    until = time.monotonic() + patience_s
    while True:
        alone = [each for each, to in publishers.items() if not to.get_subscription_count()]
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
