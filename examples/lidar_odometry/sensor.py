"""The simulated lidar and motion capture as a ROS 2 node.

    python -m examples.lidar_odometry.sensor SECONDS TOPIC... [--real-time]

It publishes /points and /groundtruth/pose. A sweep is published at its end and stamped at its
beginning, as by many drivers. By default the node works in lockstep: it publishes the next sweep
when all odometry topics have answered the last one. The timestamps are those of the flight, and no
sweep is lost on a busy machine. With --real-time, timestamps are those of the clock.

At the end it prints the numbers of published and received messages as JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from examples.lidar_odometry.odometry import cloud_message, fill_pose, set_header
from examples.lidar_odometry.world import PERIOD_S, START_S, Flight
from trajeval_ros.exceptions import InputError

GROUNDTRUTH_TOPIC = "/groundtruth/pose"
_PATIENCE_S = 60.0
_EVERY = 2  # of the groundtruth: 100 poses per second


def run_node(
    seconds: float, topics: Sequence[str], arguments: Sequence[str], *, is_real_time: bool
) -> dict[str, int]:
    """Publish a flight; return the numbers of published and received messages by topic.

    Args:
        seconds: Duration of the flight.
        topics: Odometry that has to answer.
        arguments: For ROS.
        is_real_time: Whether to publish by the clock, whatever is answered.

    Raises:
        InputError: A sweep is not answered.
    """
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Odometry
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import PointCloud2

    from trajeval_ros.ros.lifetime import ros

    flight = Flight()
    sweeps = sweeps_in(seconds)
    with ros(arguments):
        node = rclpy.create_node("lidar")
        clouds = node.create_publisher(PointCloud2, "/points", QoSProfile(depth=5))
        poses = node.create_publisher(PoseStamped, GROUNDTRUTH_TOPIC, QoSProfile(depth=1000))
        answers = dict.fromkeys(topics, 0)

        def hear(topic: str) -> Callable[[Any], None]:
            def count(_: Any) -> None:
                answers[topic] += 1

            return count

        for topic in topics:
            node.create_subscription(Odometry, topic, hear(topic), QoSProfile(depth=50))

        def until(condition: Callable[[], bool], patience_s: float) -> bool:
            end = time.monotonic() + patience_s
            while not condition() and time.monotonic() < end:
                rclpy.spin_once(node, timeout_sec=0.01)
            return condition()

        # Estimators receive clouds after all others receive their odometry.
        if not until(
            lambda: (
                clouds.get_subscription_count() >= len(topics)
                and poses.get_subscription_count() >= _LISTENERS
            ),
            _PATIENCE_S,
        ):
            raise InputError(f"not all programs have started within {_PATIENCE_S:g} s")
        truth = flight.groundtruth
        quaternions = truth.quaternions
        assert quaternions is not None
        shift = time.time_ns() - int(truth.stamps[0]) if is_real_time else 0
        published = place = 0
        for number in range(sweeps):
            stamp, points, after = flight.sweep(number)
            end = stamp + round(PERIOD_S * 1e9)
            # The groundtruth of the sweep arrives before it, with a pose after its end.
            while not place or truth.stamps[place - _EVERY] < end:
                due = int(truth.stamps[place]) + shift
                if is_real_time:
                    until(lambda: time.time_ns() >= due, PERIOD_S)  # noqa: B023
                poses.publish(_pose(truth.positions[place], quaternions[place], due))
                place, published = place + _EVERY, published + 1
            clouds.publish(cloud_message(np.column_stack([points, after]), stamp + shift))
            if is_real_time:
                continue
            if not until(lambda: min(answers.values()) > number, _PATIENCE_S):  # noqa: B023
                late = min(answers, key=lambda topic: answers[topic])
                raise InputError(
                    f"{late}: no answer to scan {number + 1} of {sweeps} within {_PATIENCE_S:g} s"
                )
        until(lambda: min(answers.values()) == sweeps, _AFTER_S)
        poses.wait_for_all_acked(Duration(seconds=_PATIENCE_S))
        node.destroy_node()
    return {GROUNDTRUTH_TOPIC: published, **answers}


_LISTENERS = 2  # of the groundtruth: the evaluator and the recorder
_AFTER_S = 3.0  # for the last answers in real time


def sweeps_in(seconds: float) -> int:
    """Return the number of complete sweeps in the first seconds of the flight."""
    return round((seconds - START_S) / PERIOD_S)


def _pose(position: Any, quaternion: Any, stamp: int) -> Any:
    from geometry_msgs.msg import PoseStamped

    message = PoseStamped()
    set_header(message.header, stamp, "world")
    fill_pose(message.pose, position, quaternion)
    return message


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A simulated lidar as a ROS 2 node.")
    parser.add_argument("seconds", type=float, help="duration of the flight")
    parser.add_argument("topics", nargs="+", help="odometry that has to answer")
    parser.add_argument("--real-time", action="store_true", help="publish by the clock")
    known, remaining = parser.parse_known_args()
    try:
        counts = run_node(known.seconds, known.topics, remaining, is_real_time=known.real_time)
    except InputError as error:
        parser.exit(2, f"{error}\n")
    print(json.dumps(counts))
