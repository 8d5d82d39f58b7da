"""Publishes a robot's traffic for so many seconds: groundtruth poses, odometry and images.

    publish_traffic.py [--field] GROUNDTRUTH_HZ SECONDS SPEED
        ODOMETRY_TOPIC@HZ ... IMAGE_TOPIC@HZ:BYTES ...

SECONDS are those of the stamps, which pass SPEED times as fast as the clock's. With --field the
groundtruth is of a marker, estimates have covariances, and begin anew elsewhere now and then.

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
RESTART_S, RESTARTED_M = 1200.0, 40.0
# With --field: the marker in the body, which isn't turned, and the estimates' variances.
MARKER_M = (0.12, 0.03, 0.15)
VARIANCES = (1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6)
NOISE = np.random.default_rng(1)


def fill(pose: Any, header: Any, time_ns: int, begin_ns: int, noise: float) -> None:
    """Place a pose on the circle, a little beside it if it is an estimate."""
    header.stamp.sec, header.stamp.nanosec = divmod(time_ns, 10**9)
    angle = VELOCITY * (time_ns - begin_ns) * 1e-9 / RADIUS
    pose.position.x = RADIUS * np.cos(angle) + noise * NOISE.standard_normal()
    pose.position.y = RADIUS * np.sin(angle) + noise * NOISE.standard_normal()
    pose.orientation.z, pose.orientation.w = np.sin(0.5 * angle), np.cos(0.5 * angle)


class Pictures:
    """Publishes images of noise, which no compression makes smaller."""

    def __init__(self, asked: str) -> None:
        """Begin; asked for as TOPIC@HZ:BYTES."""
        self.topic, _, numbers = asked.partition("@")
        hz, _, size = numbers.partition(":")
        self._hz, self._size, self._sent = float(hz), int(size), 0

    def advertise(self, node: Any) -> None:
        """Make the publisher."""
        from sensor_msgs.msg import Image

        image = Image()
        image.data = NOISE.integers(0, 256, self._size, np.uint8).tobytes()
        self._message = serialize_message(image)
        self._publisher = node.create_publisher(Image, self.topic, QoSProfile(depth=10))

    def publish_until(self, now: float) -> None:
        """Publish what is due."""
        while self._sent < now * self._hz:
            self._publisher.publish(self._message)
            self._sent += 1


def to_marker(pose: Any) -> None:
    """Move a pose that is turned about z alone from the body to the marker."""
    sine = 2.0 * pose.orientation.z * pose.orientation.w
    cosine = 1.0 - 2.0 * pose.orientation.z**2
    pose.position.x += cosine * MARKER_M[0] - sine * MARKER_M[1]
    pose.position.y += sine * MARKER_M[0] + cosine * MARKER_M[1]
    pose.position.z = MARKER_M[2]


def main() -> None:
    """Publish as asked for on the command line."""
    arguments = sys.argv[1:]
    if is_field := arguments[0] == "--field":
        del arguments[0]
    groundtruth_hz, seconds, speed = (float(argument) for argument in arguments[:3])
    topics = [argument.partition("@") for argument in arguments[3:] if ":" not in argument]
    pictures = [Pictures(argument) for argument in arguments[3:] if ":" in argument]
    rates = [groundtruth_hz, *(float(hz) for _, _, hz in topics)]
    rclpy.init()
    node = rclpy.create_node("traffic", start_parameter_services=False)
    qos = QoSProfile(depth=1000)
    truth = node.create_publisher(PoseStamped, "/groundtruth/pose", qos)
    others = [node.create_publisher(Odometry, topic, qos) for topic, _, _ in topics]
    for item in pictures:
        item.advertise(node)
    until = time.monotonic() + 30.0
    while not all(other.get_subscription_count() for other in (truth, *others)):
        if time.monotonic() > until:
            sys.exit("no subscribers")
        time.sleep(0.05)
    pose, odometry = PoseStamped(), Odometry()
    pose.header.frame_id, odometry.header.frame_id = "world", "odom"
    odometry.child_frame_id = "base_link"
    if is_field:
        odometry.pose.covariance = np.diag(VARIANCES).ravel()
    begin, begin_ns = time.monotonic(), time.time_ns()
    sent = [0] * len(rates)
    while (now := speed * (time.monotonic() - begin)) < seconds:
        while sent[0] < now * groundtruth_hz:
            fill(
                pose.pose,
                pose.header,
                begin_ns + round(sent[0] / groundtruth_hz * 1e9),
                begin_ns,
                0,
            )
            if is_field:
                to_marker(pose.pose)
            truth.publish(serialize_message(pose))
            sent[0] += 1
        for number, other in enumerate(others, start=1):
            while sent[number] < now * rates[number]:
                stamp = begin_ns + round(sent[number] / rates[number] * 1e9)
                fill(odometry.pose.pose, odometry.header, stamp, begin_ns, 0.01)
                if is_field:
                    restarts = int(sent[number] / rates[number] / RESTART_S)
                    odometry.pose.pose.position.x += RESTARTED_M * restarts
                other.publish(serialize_message(odometry))
                sent[number] += 1
        for picture in pictures:
            picture.publish_until(now)
        time.sleep(STEP_S)
    for other in (truth, *others):
        other.wait_for_all_acked(Duration(seconds=5))
    print(*sent, flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
