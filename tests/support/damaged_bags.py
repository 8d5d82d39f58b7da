"""Bags with numbered poses, and what is left of them after damage."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from made_bags import STORE, pose_stamped, simple, the_file, write
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

COUNT = 600
SECOND = 10**9
IMAGE = bytes(1 << 20)
EVERY = 20  # poses there is an image
Register = Callable[[Any], object]


def definition(kind: str, store: Any = STORE) -> bytes:
    version = 1 if store is not STORE else 2
    return bytes(store.generate_msgdef(kind, ros_version=version)[0].encode())


@functools.cache
def _all_payloads() -> tuple[bytes, ...]:
    poses = (pose_stamped((row + 1) * SECOND, float(row)) for row in range(COUNT))
    return tuple(bytes(STORE.serialize_cdr(pose, POSE_STAMPED)) for pose in poses)


def payloads(count: int = COUNT) -> list[bytes]:
    """Return poses whose x is their number."""
    return list(_all_payloads()[:count])


def chunks_of(path: Path) -> list[int]:
    """Return where the chunks of a file begin."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [chunk.chunk_start_offset for chunk in summary.chunk_indexes]


def mcap_file(
    path: Path,
    *,
    messages: Sequence[bytes] | None = None,
    log_times: Sequence[int] | None = None,
    profile: str = "ros2",
    schema: tuple[str, str, bytes] | None = None,
    encoding: str = "cdr",
    others: Register = lambda writer: None,
    **options: Any,
) -> Path:
    """Write poses whose x is their number, on /pose."""
    options = {"compression": CompressionType.NONE, "chunk_size": 1 << 12, **options}
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile=profile)
        name, kind, text = schema or (POSE_STAMPED, "ros2msg", definition(POSE_STAMPED))
        registered = writer.register_schema(name, kind, text)
        topic = writer.register_channel("/pose", encoding, registered)
        others(writer)
        for row, payload in enumerate(messages or payloads()):
            log_time = row * SECOND if log_times is None else log_times[row]
            writer.add_message(topic, log_time, payload, log_time)
        writer.finish()
    return path


def among_images(path: Path) -> Path:
    """Write poses among images that make up all but a thousandth of the file."""

    def images(writer: Any) -> None:
        channel = writer.register_channel("/image", "x", 0)
        add = writer.add_message

        def with_image(topic: int, log_time: int, payload: bytes, published: int) -> None:
            add(topic, log_time, payload, published)
            if (log_time // 10**9) % EVERY == 0:
                add(channel, log_time, IMAGE, published)

        writer.add_message = with_image

    return mcap_file(path, others=images, chunk_size=1 << 20)


def rows_of(read: Trajectory) -> list[int]:
    return [int(position) for position in read.positions[:, 0]]


def assert_whole(source: Path | str, count: int = COUNT) -> Trajectory:
    read = read_trajectory(str(source))
    assert rows_of(read) == list(range(count))
    assert not read.reading.messages(Level.ERROR)
    assert rows_of(read_trajectory(str(source), strict=True)) == list(range(count))
    return read


def assert_damaged(source: Path | str, *words: str) -> Trajectory:
    """Check that part of it is read, that the damage is told, and that --strict refuses it."""
    read = read_trajectory(str(source))
    text = "; ".join(read.reading.messages(Level.ERROR))
    assert text
    for word in words:
        assert word in text
    assert set(rows_of(read)) <= set(range(COUNT))
    with pytest.raises(InputError):
        read_trajectory(str(source), strict=True)
    return read


COMPRESSIONS = [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]


def sqlite_file(tmp_path: Path) -> Path:
    return the_file(simple(tmp_path / "bag", COUNT, storage=StoragePlugin.SQLITE3))


def split(tmp_path: Path, storage: Any, names: Sequence[str] = ("a_9", "a_10")) -> Path:
    """Write a bag of two files, the second 100 s later, listed the other way round."""
    both = tmp_path / "both"
    both.mkdir()
    for number, name in enumerate(names):
        messages = [
            ("/pose", POSE_STAMPED, row * SECOND, pose_stamped((row + 1) * SECOND, float(row)))
            for row in range(100 * number, 100 * number + 100)
        ]
        bag = write(tmp_path / name, messages, storage=storage)
        the_file(bag).rename(both / f"{name}{ending(storage)}")
        text = (bag / "metadata.yaml").read_text()
    listed = "\n".join(f"  - {name}{ending(storage)}" for name in reversed(names))
    text = text.replace(f"- {names[1]}{ending(storage)}", listed.strip(), 1)
    text = text.replace("message_count: 100", "message_count: 200")
    (both / "metadata.yaml").write_text(text)
    return both


def ending(storage: Any) -> str:
    return ".mcap" if storage == StoragePlugin.MCAP else ".db3"
