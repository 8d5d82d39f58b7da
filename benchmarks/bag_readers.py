"""Reads topics of a bag by one of several ways and prints what that cost as JSON.

Usage: python -m benchmarks.bag_readers READER FILE reads two topics of poses, with a number as
READER so many sources of a flight, by us. The clock starts after imports.
"""

from __future__ import annotations

import importlib
import json
import resource
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

TOPICS = ("/odom", "/pose")
FLIGHT_SOURCES = ("/pose", "/odom", "/tf:map.base", "/path")
_IMPORTED_WHEN_USED = (
    "concurrent.futures.thread",
    "lz4.frame",
    "mcap.records",
    "rosbags.typesys",
    "sqlite3",
    "trajeval_ros.io.bags.mcap_bag",
    "trajeval_ros.io.bags.sqlite_bag",
    "trajeval_ros.io.bags.topics",
    "zstandard",
)


def actual(path: Path) -> tuple[int, float]:
    """Read by column."""
    return read_sources([f"{path}:{topic}" for topic in TOPICS])


def read_sources(sources: Sequence[str]) -> tuple[int, float]:
    """Read several sources of a bag."""
    for name in _IMPORTED_WHEN_USED:
        importlib.import_module(name)
    from trajeval_ros.formatting.remarks import Level
    from trajeval_ros.io.sources import read_many

    def read() -> tuple[int, float]:
        trajectories = read_many(sources, covariances=False)
        assert not any(trajectory.reading.messages(Level.ERROR) for trajectory in trajectories)
        count = sum(len(trajectory) for trajectory in trajectories)
        total = sum(float(trajectory.positions[:, 0].sum()) for trajectory in trajectories)
        return count, total

    return timed(read)


def any_reader(path: Path) -> tuple[int, float]:
    """Read by rosbags' AnyReader, a message object at a time."""
    importlib.import_module("numpy")  # which its messages import when the first is made
    from rosbags.highlevel import AnyReader

    def read() -> tuple[int, float]:
        rows = []
        with AnyReader([path]) as reader:
            expected = [item for item in reader.connections if item.topic in TOPICS]
            for connection, _, payload in reader.messages(expected):
                message: Any = reader.deserialize(payload, connection.msgtype)
                rows.append(row_of(message))
        return len(rows), sum(row[1] for row in rows)

    return timed(read)


def mcap_ros2(path: Path) -> tuple[int, float]:
    """Read by mcap and mcap-ros2-support, a message object at a time."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    def read() -> tuple[int, float]:
        rows = []
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, _, _, message in reader.iter_decoded_messages(topics=list(TOPICS)):
                rows.append(row_of(message))
        return len(rows), sum(row[1] for row in rows)

    return timed(read)


def row_of(message: Any) -> tuple[float, ...]:
    """Return what a pose is made of."""
    pose = message.pose.pose if hasattr(message, "twist") else message.pose
    stamp, p, q = message.header.stamp, pose.position, pose.orientation
    return stamp.sec * 10**9 + stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w


def timed(read: Callable[[], tuple[int, float]]) -> tuple[int, float]:
    """Print what reading costs: CPU seconds of all threads, bytes asked for, peak memory."""
    before, start = bytes_read(), time.process_time()
    count, total = read()
    figures = {
        "cpu_s": time.process_time() - start,
        "read_mb": (bytes_read() - before) / 1e6,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
        "poses": count,
        "sum_x": total,
    }
    print(json.dumps(figures))
    return count, total


def bytes_read() -> int:
    """Return the bytes that this process has asked the kernel for."""
    return int(Path("/proc/self/io").read_text().split("rchar: ")[1].split()[0])


OURS = "trajeval_ros"
READERS = {OURS: actual, "rosbags AnyReader": any_reader, "mcap-ros2-support": mcap_ros2}

if __name__ == "__main__":
    reader, file = sys.argv[1:]
    if reader.isdigit():
        read_sources(
            [f"{file}:{flight_source}" for flight_source in FLIGHT_SOURCES[: int(reader)]]
        )
    else:
        READERS[reader](Path(file))
