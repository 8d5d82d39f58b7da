#!/usr/bin/env python3
"""Replay a bag as live ROS 2 traffic from a bare checkout: no install, no `ros2 run`.

    replay_bag.py BAG [OPTION ...] [--ros-args ...]

The options are those of `trajeval replay`. It needs a Python that can import rclpy: that of a
sourced ROS 2 installation, or .venv-ros/bin/python of `make ros-environment`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from trajeval_ros.__main__ import ros_replay

if __name__ == "__main__":
    sys.exit(ros_replay())
