"""Bags with few poses, and messages for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import CompressionFormat, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES: Any = STORE.types
Make = Callable[..., Path]


def header(stamp: int, frame: str = "map") -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    return TYPES["std_msgs/msg/Header"](time, frame)


def pose(x: float = 1.0, w: float = 1.0, yaw: float = 0.5) -> Any:
    return TYPES["geometry_msgs/msg/Pose"](
        TYPES["geometry_msgs/msg/Point"](x, 2.0, 3.0),
        TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, yaw, w),
    )


def pose_stamped(stamp: int, x: float = 1.0, frame: str = "map") -> Any:
    return TYPES[POSE_STAMPED](header(stamp, frame), pose(x))


def write(path: Path, messages: list[tuple[str, str, int, Any]], **options: Any) -> Path:
    """Write (topic, type, log time, message or bytes) to a bag."""
    plugin = options.pop("storage", StoragePlugin.MCAP)
    writer = Writer(path, version=9, storage_plugin=plugin)
    if "compression" in options:
        writer.set_compression(options["compression"], CompressionFormat.ZSTD)
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for topic, kind, stamp, message in messages:
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=STORE)
            data = message if isinstance(message, bytes) else STORE.serialize_cdr(message, kind)
            writer.write(connections[topic, kind], stamp, data)
    return path


def simple(path: Path, count: int = 20, **options: Any) -> Path:
    return write(
        path,
        [
            ("/pose", POSE_STAMPED, row * 10**8, pose_stamped(10**18 + row * 10**8, float(row)))
            for row in range(count)
        ],
        **options,
    )


def the_file(bag: Path) -> Path:
    return next(file for file in bag.iterdir() if file.suffix in (".mcap", ".db3", ".zstd"))


def transform(stamp: int, parent: str, child: str, x: float = 0.0) -> Any:
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header(stamp, parent),
        child,
        TYPES["geometry_msgs/msg/Transform"](
            TYPES["geometry_msgs/msg/Vector3"](x, 2.0, 3.0),
            TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
        ),
    )


def refusal(path: Path) -> str:
    """Return why the path is refused, "" if it is read."""
    try:
        read_trajectory(str(path))
    except InputError as error:
        return str(error)
    return ""
