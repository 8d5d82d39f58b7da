"""The message classes of this machine's ROS 2, found by the names of their types."""

from __future__ import annotations

import importlib
import sys
from typing import Any

from trajeval_ros.exceptions import InputError, SettingsError


def require_ros() -> None:
    """Raise InputError, with what to install, if rclpy can't be imported."""
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"ROS 2 is required, but {sys.executable} can't import rclpy ({error}); source a ROS "
            "2 installation for this Python, as in `source /opt/ros/jazzy/setup.bash`, or run "
            "`make ros-environment` in the checkout and use .venv-ros/bin/trajeval"
        ) from error


def message_class(message_type: str) -> Any | None:
    """Return the class of a type such as `nav_msgs/msg/Odometry`, None if it isn't installed."""
    package, _, name = message_type.partition("/msg/")
    if not (package.isidentifier() and name.isidentifier()):
        return None
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name, None)
    except ImportError:
        return None


def is_installed(message_type: str) -> bool:
    """Return whether messages of a type can be published and received."""
    return message_class(message_type) is not None


def require_installed(message_type: str, user: str, otherwise: str) -> None:
    """Raise SettingsError, with what to install or to do `otherwise`, if a type is missing."""
    if not is_installed(message_type):
        raise SettingsError(
            f"{user} needs {message_type.partition('/')[0]}; {how_to_install(message_type)}, or "
            f"{otherwise}"
        )


def how_to_install(message_type: str) -> str:
    """Return how to install the package of a type; px4_msgs has no package and is built."""
    package = message_type.partition("/")[0]
    if package == "px4_msgs":
        return "build PX4/px4_msgs (branch release/1.16 for PX4 1.16) in this workspace"
    return f"install ros-$ROS_DISTRO-{package.replace('_', '-')}"
