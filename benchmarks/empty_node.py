"""A node that subscribes and does nothing, the usual way: what rclpy alone takes.

empty_node.py GROUNDTRUTH_TOPIC ODOMETRY_TOPIC ...
"""

from __future__ import annotations

import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile


def main() -> None:
    """Spin until it is ended."""
    truth, *others = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("empty")
    for topic, kind in ((truth, PoseStamped), *((each, Odometry) for each in others)):
        node.create_subscription(kind, topic, lambda _: None, QoSProfile(depth=1000))
    rclpy.spin(node)


if __name__ == "__main__":
    main()
