"""Runs of a marker whose messages have covariances."""

from __future__ import annotations

from live_runs import ESTIMATE, GROUNDTRUTH
from marker_flights import of_marker
from ros_bags import ODOM, Message, messages_of
from uncertain_runs import sides as uncertain

from trajeval_ros.geometry.trajectory import Trajectory


def uncertain_messages(seed: int, groundtruth_kind: str) -> tuple[list[Message], Trajectory]:
    groundtruth, estimate = uncertain(seed)
    both = [
        *messages_of(of_marker(groundtruth), GROUNDTRUTH, groundtruth_kind),
        *messages_of(estimate, ESTIMATE, ODOM),
    ]
    return sorted(both, key=lambda item: item[2]), estimate
