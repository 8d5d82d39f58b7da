"""Roles that the names of files and topics state."""

from __future__ import annotations

import re

# The rooms of EuRoC's sequences are called "Vicon room".
_GROUNDTRUTH = re.compile(
    r"(?<![a-z])(gt|(ground.?)?truth|vicon(?!.?room)|mocap|optitrack|qualisys|vrpn|leica|rtk"
    r"|reference)(?![a-z])",
    re.IGNORECASE,
)
_ESTIMATE = re.compile(
    r"(vio|vins|slam|odometry|odom|openvins|rovio|okvis|msckf|estimate|kimera|svo)(?![a-z])",
    re.IGNORECASE,
)


def is_named_groundtruth(name: str) -> bool:
    """Return whether a name has a word for groundtruth, or for a system that measures it.

    Example:
        >>> from trajeval_ros.formatting.source_roles import is_named_groundtruth
        >>> is_named_groundtruth("/vicon/pose"), is_named_groundtruth("vicon_room1.txt")
        (True, False)
    """
    return _GROUNDTRUTH.search(name) is not None


def is_named_estimate(name: str) -> bool:
    """Return whether a name has a word for an estimate, or for an estimator."""
    return _ESTIMATE.search(name) is not None


def own_name(source: str) -> str:
    """Return the topic of a source `BAG:/topic`, or the name of its file without folders."""
    _, colon, topic = source.rpartition(":/")
    return topic if colon and not topic.startswith("/") else source.rpartition("/")[2]
