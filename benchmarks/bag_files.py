"""Writes bags to measure readers with: python -m benchmarks.bag_files FOLDER SCALE.

`poses`: an odometry and a pose topic. `images`: fewer poses among images of 1 MB. Both as plain
MCAP and sqlite3; half as many poses as a ROS 1 bag; images also unchunked, and compressed by zstd
and lz4. SCALE 1 is 200k + 200k poses, and 20k + 20k among 1.25 GB of images.

`flight` and `flight_alone`: groundtruth at 200 Hz, odometry and TF at 100 Hz and a path at 1 Hz,
with and without images, each as plain MCAP, zstd, sqlite3 and ROS 1. SCALE 1 is 60 s with 315 MB
of images, and 500 s without.
"""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.io.bags.encode_messages import encode_path

Message = tuple[str, int, bytes]  # topic, log time in ns, payload
ODOMETRY, POSE, IMAGE = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/Image",
)
TF, PATH = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Path"
TOPICS = {"/odom": ODOMETRY, "/pose": POSE, "/image": IMAGE}
FLIGHT_TOPICS = {"/pose": POSE, "/odom": ODOMETRY, "/tf": TF, "/path": PATH, "/image": IMAGE}
POSES, POSES_AMONG_IMAGES, IMAGES = 200_000, 20_000, 1200
FLIGHT, FLIGHT_ALONE, FLIGHT_IMAGES = 12_000, 100_000, 300
PATH_EVERY, PATH_POSES = 200, 500
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
    TF: np.dtype(
        [
            ("cdr", "S4"),
            ("count", "<u4"),
            *_HEADER[1:],
            ("frame", "S4"),
            ("child_length", "<u4"),
            ("child", "S5"),
            ("_", "S3"),
            ("pose", "<f8", 7),
        ]
    ),
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
    if kind == TF:
        rows["count"], rows["child"], rows["child_length"] = 1, b"base", 5
    return rows


def image_payload() -> bytes:
    """Return an image that compresses by about half."""
    noise = np.random.default_rng(0).integers(0, 256, IMAGE_BYTES // 2, dtype=np.uint8)
    return b"\0\1\0\0" + bytes(24) + noise.tobytes() + bytes(IMAGE_BYTES // 2)


def messages(poses: int, images: int) -> Iterator[Message]:
    """Yield topic, log time and payload; images are spread evenly."""
    odometry, pose = payloads(ODOMETRY, poses), payloads(POSE, poses)
    image = image_payload()
    every = max(1, poses // images) if images else poses + 1
    for row in range(poses):
        stamp = BEGIN + row * STEP
        yield "/odom", stamp, odometry[row].tobytes()
        yield "/pose", stamp + 1, pose[row].tobytes()
        if row % every == 0 and row // every < images:
            yield "/image", stamp + 2, image


def flight_messages(poses: int, images: int) -> Iterator[Message]:
    """Yield topic, log time and payload of a flight with groundtruth and three estimates."""
    truth, odometry, tf = (payloads(kind, poses) for kind in (POSE, ODOMETRY, TF))
    image, every = image_payload(), max(1, poses // images) if images else poses + 1
    stamps = BEGIN + np.arange(poses) * STEP
    for row in range(poses):
        stamp = int(stamps[row])
        yield "/pose", stamp, truth[row].tobytes()
        if row % 2 == 0:
            yield "/odom", stamp + 1, odometry[row].tobytes()
            yield "/tf", stamp + 2, tf[row].tobytes()
        if row % PATH_EVERY == 0:
            own = slice(max(0, row + 1 - PATH_POSES), row + 1)
            pose = truth["pose"][own]
            yield "/path", stamp + 3, encode_path(stamps[own], pose[:, :3], pose[:, 3:], "map")
        if row % every == 0 and row // every < images:
            yield "/image", stamp + 4, image


def write_mcap(
    path: Path,
    given: Iterable[Message],
    *,
    compression: CompressionType,
    chunked: bool = True,
    topics: Mapping[str, str] = TOPICS,
) -> None:
    """Write an MCAP file."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2")
        channels = {}
        for topic, kind in topics.items():
            text = store.generate_msgdef(kind, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(kind, "ros2msg", text)
            )
        for topic, stamp, payload in given:
            writer.add_message(channels[topic], stamp, payload, stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def write_sqlite(path: Path, given: Iterable[Message], topics: Mapping[str, str] = TOPICS) -> None:
    """Write a file as rosbag2 does in sqlite3."""
    store = get_typestore(Stores.ROS2_JAZZY)
    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as database:
        database.executescript(Sqlite3Writer.SQLITE_SCHEMA)
        ids = {}
        for number, (topic, kind) in enumerate(topics.items(), 1):
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
            ((ids[topic], *rest) for topic, *rest in given),
        )
    database.close()


def write_ros1(path: Path, given: Iterable[Message], topics: Mapping[str, str] = TOPICS) -> None:
    """Write a bag of ROS 1."""
    store, ros1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    ros1.register({TF: store.fielddefs[TF]})
    path.unlink(missing_ok=True)
    with Ros1Writer(path) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=ros1)
            for topic, kind in topics.items()
        }
        for topic, stamp, payload in given:
            # What is in an image is none of a reader's business, and it isn't one of ROS 2 either.
            kind = topics[topic]
            content = payload if kind == IMAGE else store.cdr_to_ros1(payload, kind)
            writer.write(connections[topic], stamp, content)


def flight_jobs(name: str, poses: int, images: int) -> dict[str, Callable[[Path], None]]:
    """Return what writes the bags of a flight, by their names."""
    given = partial(flight_messages, poses, images)
    mcap = partial(write_mcap, topics=FLIGHT_TOPICS)
    return {
        f"{name}.mcap": lambda path: mcap(path, given(), compression=CompressionType.NONE),
        f"{name}_zstd.mcap": lambda path: mcap(path, given(), compression=CompressionType.ZSTD),
        f"{name}.db3": lambda path: write_sqlite(path, given(), FLIGHT_TOPICS),
        f"{name}.bag": lambda path: write_ros1(path, given(), FLIGHT_TOPICS),
    }


def main() -> None:
    """Write all bags that aren't there yet."""
    folder, scale = Path(sys.argv[1]), float(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    none, zstd = CompressionType.NONE, CompressionType.ZSTD
    poses, among, images = (round(scale * item) for item in (POSES, POSES_AMONG_IMAGES, IMAGES))
    jobs: dict[str, Callable[[Path], None]] = {
        "poses.mcap": lambda path: write_mcap(path, messages(poses, 0), compression=none),
        "poses.db3": lambda path: write_sqlite(path, messages(poses, 0)),
        "poses.bag": lambda path: write_ros1(path, messages(poses // 2, 0)),
        "images.mcap": lambda path: write_mcap(path, messages(among, images), compression=none),
        "images_unchunked.mcap": lambda path: write_mcap(
            path, messages(among, images), compression=none, chunked=False
        ),
        "images_zstd.mcap": lambda path: write_mcap(
            path, messages(among, images), compression=zstd
        ),
        "images_lz4.mcap": lambda path: write_mcap(
            path, messages(among, images), compression=CompressionType.LZ4
        ),
        "images.db3": lambda path: write_sqlite(path, messages(among, images)),
    }
    jobs |= flight_jobs("flight", round(scale * FLIGHT), round(scale * FLIGHT_IMAGES))
    jobs |= flight_jobs("flight_alone", round(scale * FLIGHT_ALONE), 0)
    for name, write in jobs.items():
        if not (folder / name).exists():
            unfinished = folder / f"{name}.part"
            write(unfinished)
            unfinished.rename(folder / name)


if __name__ == "__main__":
    main()
