"""A bag as live traffic: its messages as they were serialised, and the clock."""

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

_DEPTH = 1000  # messages kept for subscribers that are slower
_LAST_DELIVERY_S = 5.0  # what slow subscribers get to acknowledge the last messages
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
    """Publish what is to be played; SIGINT and SIGTERM end it early.

    Args:
        playback: What is played.
        rate: Seconds of bag time per second.
        patience_s: How long to wait until every topic has a subscriber, seconds.
        with_clock: Whether to publish the bag time on /clock.
        arguments: ROS arguments, from `--ros-args` on.
        begin: Told the channels without a subscriber when it begins.
        advance: Told the bag time played and all of it, now and then.

    Raises:
        InputError: The bag is damaged.
        SettingsError: ROS doesn't take the arguments.
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
            publish=lambda channel, payload: publishers[channel].publish(payload),
            tick=tick,
            is_stopped=lambda: stop.is_asked_for,
        )
        _deliver(list(publishers.values()))
        node.destroy_node()
    return played


def _publisher(node: Node, channel: Channel) -> Any:
    """Return a publisher that every kind of subscriber can connect to."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    latched, volatile = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
    qos = QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=latched if channel.is_latched else volatile,
    )
    return node.create_publisher(message_class(channel.type), channel.name, qos)


def _clock(node: Node) -> Callable[[int], None]:
    """Return what publishes a bag time on /clock."""
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


def _deliver(publishers: Sequence[Any]) -> None:
    """Wait until subscribers have acknowledged all messages, which an exit would lose."""
    from rclpy.duration import Duration

    until = time.monotonic() + _LAST_DELIVERY_S
    for publisher in publishers:
        left = max(0.0, until - time.monotonic())
        publisher.wait_for_all_acked(Duration(seconds=left))
