"""Writes bags to measure readers with: python -m benchmarks.bag_files FOLDER SCALE.

`poses`: an odometry and a pose topic. `images`: fewer poses among images of 1 MB. Both as plain
MCAP and sqlite3; half as many poses as a ROS 1 bag; images also unchunked, and compressed by zstd
and lz4. SCALE 1 is 200k + 200k poses, and 20k + 20k among 1.25 GB of images.
"""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_typestore

ODOMETRY, POSE, IMAGE = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/Image",
)
TOPICS = {"/odom": ODOMETRY, "/pose": POSE, "/image": IMAGE}
POSES, POSES_AMONG_IMAGES, IMAGES = 200_000, 20_000, 1200
IMAGE_BYTES = 1 << 20
BEGIN = 1_700_000_000 * 10**9
STEP = 5_000_000  # ns
_HEADER = [("cdr", "S4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4")]
_LAYOUTS = {
    ODOMETRY: np.dtype(
        [
            *_HEADER,
            ("frame", "S5"),
            ("_", "S3"),
            ("child_length", "<u4"),
            ("child", "S10"),
            ("__", "S6"),
            ("pose", "<f8", 7),
            ("covariance", "<f8", 36),
            ("twist", "<f8", 6),
            ("twist_covariance", "<f8", 36),
        ]
    ),
    POSE: np.dtype([*_HEADER, ("frame", "S4"), ("pose", "<f8", 7)]),
}


def payloads(kind: str, count: int) -> NDArray[np.void]:
    """Return serialised messages (N,) of a type."""
    random = np.random.default_rng(count)
    rows = np.zeros(count, dtype=_LAYOUTS[kind])
    stamps = BEGIN + np.arange(count) * STEP
    rows["cdr"] = b"\0\1\0\0"
    rows["sec"], rows["nanosec"] = np.divmod(stamps, 10**9)
    rows["frame"], rows["length"] = (b"odom", 5) if kind == ODOMETRY else (b"map", 4)
    rows["pose"] = np.cumsum(random.normal(0.0, 0.01, (count, 7)), axis=0)
    rows["pose"][:, 3:] = [0.0, 0.0, 0.6, 0.8]
    if kind == ODOMETRY:
        rows["child"], rows["child_length"] = b"base_link", 10
        rows["covariance"] = random.normal(size=(count, 36))
    return rows


def messages(poses: int, images: int) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, log time and payload; images are spread evenly and compress by about half."""
    odometry, pose = payloads(ODOMETRY, poses), payloads(POSE, poses)
    noise = np.random.default_rng(0).integers(0, 256, IMAGE_BYTES // 2, dtype=np.uint8)
    image = b"\0\1\0\0" + bytes(24) + noise.tobytes() + bytes(IMAGE_BYTES // 2)
    every = max(1, poses // images) if images else poses + 1
    for row in range(poses):
        stamp = BEGIN + row * STEP
        yield "/odom", stamp, odometry[row].tobytes()
        yield "/pose", stamp + 1, pose[row].tobytes()
        if row % every == 0 and row // every < images:
            yield "/image", stamp + 2, image


def write_mcap(
    path: Path, poses: int, images: int, *, compression: CompressionType, chunked: bool = True
) -> None:
    """Write an MCAP file."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2")
        channels = {}
        for topic, kind in TOPICS.items():
            text = store.generate_msgdef(kind, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(kind, "ros2msg", text)
            )
        for topic, stamp, payload in messages(poses, images):
            writer.add_message(channels[topic], stamp, payload, stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def write_sqlite(path: Path, poses: int, images: int) -> None:
    """Write a file as rosbag2 does in sqlite3."""
    store = get_typestore(Stores.ROS2_JAZZY)
    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as database:
        database.executescript(Sqlite3Writer.SQLITE_SCHEMA)
        ids = {}
        for number, (topic, kind) in enumerate(TOPICS.items(), 1):
            text = store.generate_msgdef(kind, ros_version=2)[0]
            database.execute(
                "INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (number, topic, kind)
            )
            database.execute(
                "INSERT INTO message_definitions VALUES (?, ?, 'ros2msg', ?, '')",
                (number, kind, text),
            )
            ids[topic] = number
        database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            ((ids[topic], *rest) for topic, *rest in messages(poses, images)),
        )
    database.close()


def write_ros1(path: Path, poses: int) -> None:
    """Write a bag of ROS 1."""
    store, ros1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    path.unlink(missing_ok=True)
    with Ros1Writer(path) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=ros1)
            for topic, kind in TOPICS.items()
            if kind != IMAGE
        }
        for topic, stamp, payload in messages(poses, 0):
            writer.write(connections[topic], stamp, store.cdr_to_ros1(payload, TOPICS[topic]))


def main() -> None:
    """Write all bags that aren't there yet."""
    folder, scale = Path(sys.argv[1]), float(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    none = CompressionType.NONE
    poses, among, images = (round(scale * each) for each in (POSES, POSES_AMONG_IMAGES, IMAGES))
    jobs: dict[str, Callable[[Path], None]] = {
        "poses.mcap": lambda path: write_mcap(path, poses, 0, compression=none),
        "poses.db3": lambda path: write_sqlite(path, poses, 0),
        "poses.bag": lambda path: write_ros1(path, poses // 2),
        "images.mcap": lambda path: write_mcap(path, among, images, compression=none),
        "images_unchunked.mcap": lambda path: write_mcap(
            path, among, images, compression=none, chunked=False
        ),
        "images_zstd.mcap": lambda path: write_mcap(
            path, among, images, compression=CompressionType.ZSTD
        ),
        "images_lz4.mcap": lambda path: write_mcap(
            path, among, images, compression=CompressionType.LZ4
        ),
        "images.db3": lambda path: write_sqlite(path, among, images),
    }
    for name, write in jobs.items():
        if not (folder / name).exists():
            unfinished = folder / f"{name}.part"
            write(unfinished)
            unfinished.rename(folder / name)


if __name__ == "__main__":
    main()
