"""Publishes a robot's traffic for so many seconds: groundtruth poses and odometry.

    publish_traffic.py GROUNDTRUTH_HZ ODOMETRY_HZ SECONDS SPEED ODOMETRY_TOPIC ...

SECONDS are those of the stamps, which pass SPEED times as fast as the clock's.

Poses are serialised before they are due, as a driver in C++ would send them. It begins when all
topics have a subscriber, and prints how many messages it has sent on each.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

VELOCITY = 1.5  # m/s, on a circle of 10 m
RADIUS = 10.0
STEP_S = 0.001
NOISE = np.random.default_rng(1)


def fill(pose: Any, header: Any, time_ns: int, begin_ns: int, noise: float) -> None:
    """Place a pose on the circle, a little beside it if it is an estimate."""
    header.stamp.sec, header.stamp.nanosec = divmod(time_ns, 10**9)
    angle = VELOCITY * (time_ns - begin_ns) * 1e-9 / RADIUS
    pose.position.x = RADIUS * np.cos(angle) + noise * NOISE.standard_normal()
    pose.position.y = RADIUS * np.sin(angle) + noise * NOISE.standard_normal()
    pose.orientation.z, pose.orientation.w = np.sin(0.5 * angle), np.cos(0.5 * angle)


def main() -> None:
    """Publish as asked for on the command line."""
    groundtruth_hz, odometry_hz, seconds, speed = (float(each) for each in sys.argv[1:5])
    rclpy.init()
    node = rclpy.create_node("traffic", start_parameter_services=False)
    qos = QoSProfile(depth=1000)
    truth = node.create_publisher(PoseStamped, "/groundtruth/pose", qos)
    others = [node.create_publisher(Odometry, topic, qos) for topic in sys.argv[5:]]
    until = time.monotonic() + 30.0
    while not all(each.get_subscription_count() for each in (truth, *others)):
        if time.monotonic() > until:
            sys.exit("nobody has subscribed")
        time.sleep(0.05)
    pose, odometry = PoseStamped(), Odometry()
    pose.header.frame_id, odometry.header.frame_id = "world", "odom"
    odometry.child_frame_id = "base_link"
    begin, begin_ns = time.monotonic(), time.time_ns()
    sent = [0, 0]
    while (now := speed * (time.monotonic() - begin)) < seconds:
        while sent[0] < now * groundtruth_hz:
            fill(
                pose.pose,
                pose.header,
                begin_ns + round(sent[0] / groundtruth_hz * 1e9),
                begin_ns,
                0,
            )
            truth.publish(serialize_message(pose))
            sent[0] += 1
        while sent[1] < now * odometry_hz:
            stamp = begin_ns + round(sent[1] / odometry_hz * 1e9)
            fill(odometry.pose.pose, odometry.header, stamp, begin_ns, 0.01)
            payload = serialize_message(odometry)
            for each in others:
                each.publish(payload)
            sent[1] += 1
        time.sleep(STEP_S)
    for each in (truth, *others):
        each.wait_for_all_acked(Duration(seconds=5))
    print(*sent, flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
