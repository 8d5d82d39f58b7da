#!/usr/bin/env python3
"""Evaluate live topics from a bare checkout: no install, no `ros2 run`, no `ros2 launch`.

    run_evaluator.py --ros-args -p groundtruth_topic:=/mocap/pose -p estimate_topics:=[/odom]

`--help` lists the parameters. It needs a Python that can import rclpy: that of a sourced ROS 2
installation, or .venv-ros/bin/python of `make ros-environment`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from trajeval_ros.__main__ import ros_evaluator

if __name__ == "__main__":
    sys.exit(ros_evaluator())
