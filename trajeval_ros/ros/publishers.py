"""The topics of one estimate, under `~/NAME/`."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.io.bags.alignment_messages import encode_alignment, encode_paths
from trajeval_ros.online.error_topics import (
    ALIGNED_PATH,
    ALIGNMENT,
    GROUNDTRUTH_PATH,
    NEES_NUMBERS,
    NUMBERS,
    PROTECTION_LEVELS,
    WINDOW_NUMBERS,
    integrity_numbers,
    nees_numbers,
    numbers_of,
    relative_error_topic,
    window_numbers,
)
from trajeval_ros.online.reports import Snapshot, Update
from trajeval_ros.online.trail import Trail
from trajeval_ros.ros.advertise import advertise
from trajeval_ros.ros.stamped_errors import StampedErrors

if TYPE_CHECKING:
    from rclpy.node import Node

_PATH_EVERY_S = 1.0


class Outputs:
    """Publishers of one estimate; numbers are published only if they have a subscriber.

    Errors are `std_msgs/Float64`, which PlotJuggler and rqt_plot can draw. `StampedErrors`
    publishes vectors with timestamps.
    """

    def __init__(self, node: Node, name: str, *, judges: bool) -> None:
        """Create all publishers except those of relative errors.

        Args:
            node: The publishing node.
            name: Name of the estimate.
            judges: Whether its covariances are tested.
        """
        from geometry_msgs.msg import TransformStamped
        from nav_msgs.msg import Path

        self._node, self._name = node, name
        self._numbers: dict[str, Any] = {}
        for each in (*NUMBERS, *WINDOW_NUMBERS):
            self._advertise(each)
        for each in (*NEES_NUMBERS, *PROTECTION_LEVELS.values()) if judges else ():
            self._advertise(each)
        self._stamped = StampedErrors(node, name)
        # Late subscribers receive the newest alignment and paths at once.
        self._alignment = advertise(
            node, TransformStamped, f"~/{name}/{ALIGNMENT}", 1, latched=True
        )
        self._paths = {
            each: advertise(node, Path, f"~/{name}/{each}", 1, latched=True)
            for each in (ALIGNED_PATH, GROUNDTRUTH_PATH)
        }
        self._path_at = 0.0

    def advertise_lengths(self, lengths: Iterable[str]) -> None:
        """Create the publishers of relative errors; a topic's name can't start with a digit."""
        for each in lengths:
            self._advertise(relative_error_topic(each))

    def publish_update(
        self, update: Update, frame: str, offset_ns: int, *, knows_up: bool
    ) -> None:
        """Publish the errors of new pairs, and of sub-trajectories that have ended.

        Args:
            update: The new errors; numbers without a timestamp are of the newest pair.
            frame: Frame of the groundtruth.
            offset_ns: Clock offset that was added to the estimate's timestamps.
            knows_up: Whether the up axis is known; without it, yaw and tilt are not published.
        """
        for errors in update.errors:
            self._stamped.publish(errors, frame, offset_ns, knows_up=knows_up)
        for name in NUMBERS if update.errors else ():
            numbers = numbers_of(update.errors[-1], name, knows_up=knows_up)
            self._publish(name, None if numbers is None else float(numbers[-1]))
        for end in update.ends:
            self._publish(relative_error_topic(end.length), end.position_m)

    def publish_snapshot(self, snapshot: Snapshot) -> None:
        """Publish the errors of the window."""
        for name, number in window_numbers(snapshot).items():
            self._publish(name, number)
        for name, mean in nees_numbers(snapshot).items():
            self._publish(name, mean)
        for name, level in integrity_numbers(snapshot).items():
            self._publish(name, level)

    def publish_geometry(
        self, trail: Trail, alignment: Similarity, frame: str, child_frame: str
    ) -> None:
        """Publish the alignment, and paths in the groundtruth's frame, about once a second.

        Args:
            trail: The pairs, thinned.
            alignment: Similarity from the estimate's frame to the groundtruth's frame.
            frame: Frame of the groundtruth.
            child_frame: Frame of the estimate.
        """
        if time.monotonic() < self._path_at or not len(trail):
            return
        self._path_at = time.monotonic() + _PATH_EVERY_S
        frames = frame, child_frame
        self._alignment.publish(encode_alignment(alignment, trail.columns()[0][-1:], frames))
        for name, path in encode_paths(trail, alignment, frame).items():
            self._paths[name].publish(path)

    def _advertise(self, name: str) -> None:
        from std_msgs.msg import Float64

        if name not in self._numbers:
            self._numbers[name] = advertise(self._node, Float64, f"~/{self._name}/{name}")

    def _publish(self, name: str, value: float | None) -> None:
        from std_msgs.msg import Float64

        if value is not None:
            self._numbers[name].publish(Float64(data=value))
