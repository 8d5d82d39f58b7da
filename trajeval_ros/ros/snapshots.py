"""Snapshots of rosbag2: on an alarm, its recorder writes the messages in its memory."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import SettingsError

if TYPE_CHECKING:
    from rclpy.node import Node

_PATIENCE_S = 10.0


class Snapshots:
    """Calls the snapshot service of a recorder that runs in snapshot mode."""

    def __init__(self, node: Node, service: str, pause_s: float) -> None:
        """Create the client.

        Args:
            node: Calls the service.
            service: Name of the service, such as `/rosbag2_recorder/snapshot`.
            pause_s: Least time between two calls, seconds.

        Raises:
            SettingsError: The service's type is not installed, or its name is not valid.
        """
        try:
            from rosbag2_interfaces.srv import Snapshot
        except ImportError as error:
            raise SettingsError(
                f"snapshot_service {service} needs rosbag2_interfaces; install "
                "ros-$ROS_DISTRO-rosbag2-interfaces, or remove it"
            ) from error
        try:
            self._client = node.create_client(Snapshot, service)
        except Exception as error:  # rclpy's exceptions here have no common base class
            said = " ".join(str(error).split())
            raise SettingsError(f"{service!r} is not a service name: {said}") from error
        self._request, self._name = Snapshot.Request, self._client.srv_name
        self._pause_s, self._free_at = pause_s, 0.0
        self._answer: Any = None
        self._late_at = 0.0
        self._is_asked_for = False

    def trigger(self) -> None:
        """Request a snapshot, unless the last request is too recent."""
        now = time.monotonic()
        if now >= self._free_at:
            self._free_at = now + self._pause_s
            self._is_asked_for = True

    def renew(self) -> tuple[str, bool] | None:
        """Call the service or check its response; return a sentence, and whether it warns."""
        if self._is_asked_for:
            self._is_asked_for = False
            if not self._client.service_is_ready():
                return (
                    f"no snapshot: no service {self._name}; start ros2 bag record with "
                    "--snapshot-mode",
                    True,
                )
            self._answer = self._client.call_async(self._request())
            self._late_at = time.monotonic() + _PATIENCE_S
        if self._answer is None:
            return None
        if self._answer.done():
            answer, self._answer = self._answer.result(), None
            if answer.success:
                return f"snapshot taken by {self._name}", False
            return f"no snapshot: {self._name} refused", True
        if time.monotonic() < self._late_at:
            return None
        self._client.remove_pending_request(self._answer)
        self._answer = None
        return f"no snapshot: no answer of {self._name} within {_PATIENCE_S:g} s", True
