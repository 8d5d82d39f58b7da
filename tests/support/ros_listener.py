"""A program that subscribes, and writes what it received: ros_listener.py FILE TOPIC=TYPE ...

It prints `ready` when its subscriptions exist. SIGTERM makes it take what has arrived, and end.
"""

from __future__ import annotations

import importlib
import pickle
import signal
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

LOOK_EVERY_S = 0.02
QUIET_S = 0.3  # without a message, after which all has arrived


def main() -> None:
    output, *expected = sys.argv[1:]
    stopped: list[int] = []
    for item in (signal.SIGINT, signal.SIGTERM):
        signal.signal(item, lambda number, _: stopped.append(number))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("listener")
    subscriptions = {topic: subscribe(node, topic, kind) for topic, kind in map(split, expected)}
    print("ready", flush=True)
    received: list[tuple[str, bytes]] = []
    quiet_s = 0.0
    while not stopped or quiet_s < QUIET_S:
        before = len(received)
        for topic, (subscription, message_class) in subscriptions.items():
            with subscription.handle:  # taken without an executor, which costs ten times as much
                while taken := subscription.handle.take_message(message_class, True):
                    received.append((topic, taken[0]))
        quiet_s = 0.0 if len(received) > before else quiet_s + LOOK_EVERY_S
        time.sleep(LOOK_EVERY_S)
    Path(output).write_bytes(pickle.dumps(received))
    node.destroy_node()
    rclpy.try_shutdown()


def split(argument: str) -> tuple[str, str]:
    topic, _, kind = argument.partition("=")
    return topic, kind


def subscribe(node: Any, topic: str, kind: str) -> tuple[Any, Any]:
    """Return a subscription that nothing spins, and the class of its messages."""
    package, _, name = kind.partition("/msg/")
    message_class: Any = getattr(importlib.import_module(f"{package}.msg"), name)
    is_static = topic.endswith("_static")
    qos = QoSProfile(
        depth=5000,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_static else DurabilityPolicy.VOLATILE,
    )
    return node.create_subscription(message_class, topic, print, qos, raw=True), message_class


if __name__ == "__main__":
    main()
