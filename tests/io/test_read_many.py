"""Several sources of one bag: read in one pass, with the poses that each has if read alone."""

from __future__ import annotations

import functools
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damaged_bags import definition
from hypothesis import given
from made_bags import STORE, TYPES, header, pose, pose_stamped, the_file, transform, write
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from strategies import seeds

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags import byte_source, containers, mcap_chunks
from trajeval_ros.io.bags.blocks import block_of, merged
from trajeval_ros.io.bags.write_bag import ODOMETRY, POSE_STAMPED
from trajeval_ros.io.sources import read_many, read_trajectory

COUNT = 300  # poses of the most frequent topic
STEP = 5_000_000
BEGIN = 1_700_000_000 * 10**9
PATH, TF, IMAGE = "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
WANTED = ("/truth", "/odom", "/path", "/tf:map.base", "/tf:odom.lidar", "/tf_static:base.lidar")
READABLE = WANTED[:-1]  # what is static alone is no trajectory
Message = tuple[str, str, int, bytes]
Make = Callable[[Path], Path]


@functools.cache
def messages() -> tuple[Message, ...]:
    """Return topic, type, log time and payload of a short flight."""
    result: list[tuple[str, str, int, Any]] = []
    covariance = TYPES["geometry_msgs/msg/PoseWithCovariance"]
    twist = TYPES["geometry_msgs/msg/TwistWithCovariance"](
        TYPES["geometry_msgs/msg/Twist"](
            TYPES["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0),
            TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0),
        ),
        np.zeros(36),
    )
    static = TYPES[TF]([transform(BEGIN, "base", "lidar", 0.5)])
    result.append(("/tf_static", TF, BEGIN, static))
    path = []
    for row in range(COUNT):
        stamp = BEGIN + row * STEP
        result.append(("/truth", POSE_STAMPED, stamp, pose_stamped(stamp, float(row))))
        if row % 2 == 0:
            own = covariance(pose(row + 0.5), np.eye(6).ravel() * (row + 1))
            message = TYPES[ODOMETRY](header(stamp, "odom"), "base", own, twist)
            result.append(("/odom", ODOMETRY, stamp + 1, message))
        if row % 3 == 0:
            edges = [transform(stamp, "map", "odom", row), transform(stamp, "odom", "base", -row)]
            result.append(("/tf", TF, stamp + 2, TYPES[TF](edges)))
        if row % 50 == 0:
            path += [pose_stamped(stamp + index, row + 0.1 * index) for index in range(20)]
            result.append(("/path", PATH, stamp + 3, TYPES[PATH](header(stamp), list(path))))
    return tuple(
        (topic, kind, stamp, bytes(STORE.serialize_cdr(message, kind)))
        for topic, kind, stamp, message in result
    )


def flight(images: int = 0) -> list[Message]:
    """Return the messages of the flight among random bytes, that many images of 100 kB."""
    noise = np.random.default_rng(0)
    every = COUNT // images if images else 0
    result: list[Message] = []
    for number, message in enumerate(messages()):
        result.append(message)
        if every and number % every == 0:
            result.append(("/image", IMAGE, message[2], noise.bytes(100_000)))
    return result


def mcap(path: Path, flown: Sequence[Message], **options: Any) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for topic, kind, stamp, payload in flown:
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", definition(kind))
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamp, payload, stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def ros1(path: Path, flown: Sequence[Message], compression: str | None = None) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register({TF: STORE.fielddefs[TF]})
    writer = Ros1Writer(path)
    if compression is not None:
        writer.set_compression(Ros1Writer.CompressionFormat[compression])
    writer.chunk_threshold = 1 << 14
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp, payload in flown:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            content = payload if kind == IMAGE else STORE.cdr_to_ros1(payload, kind)
            writer.write(connections[topic], stamp, content)
    return path


def split(path: Path) -> Path:
    """Write a directory of two files; only the second has the path."""
    flown = flight()
    half = len(flown) // 2
    path.mkdir()
    mcap(path / "x_0.mcap", [item for item in flown[:half] if item[0] != "/path"])
    mcap(path / "x_1.mcap", flown[half:], compression=CompressionType.ZSTD)
    return path


NONE, ZSTD, LZ4 = CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4
SMALL = 1 << 14  # bytes of a chunk, so that there are many
MAKE: dict[str, Make] = {
    "mcap": lambda path: mcap(path, flight(), compression=NONE, chunk_size=SMALL),
    "zstd": lambda path: mcap(path, flight(), compression=ZSTD, chunk_size=SMALL),
    "lz4": lambda path: mcap(path, flight(20), compression=LZ4, chunk_size=1 << 18),
    "images": lambda path: mcap(path, flight(60), compression=NONE, chunk_size=1 << 19),
    "unchunked": lambda path: mcap(path, flight(20), use_chunking=False),
    "sqlite3": lambda path: the_file(write(path, flight(20), storage=StoragePlugin.SQLITE3)),
    "messages": lambda path: write(path, flight(), compression=CompressionMode.MESSAGE),
    "ros1": lambda path: ros1(path, flight(20)),
    "ros1, bz2": lambda path: ros1(path, flight(), "BZ2"),
    "directory": split,
}


def assert_same(one: Trajectory, other: Trajectory) -> None:
    for name in ("stamps", "positions", "quaternions", "velocities", "covariances"):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            np.testing.assert_array_equal(mine, theirs)
    for name in ("frame", "child_frame", "name"):
        assert getattr(one, name) == getattr(other, name), name
    assert one.reading.dropped == other.reading.dropped
    assert one.reading.messages(Level.ERROR) == other.reading.messages(Level.ERROR)
    assert one.reading.stamped == other.reading.stamped
    notes = [
        [note for note in read.reading.messages(Level.NOTE) if "read in part" not in note]
        for read in (one, other)
    ]
    assert notes[0] == notes[1]


def alone(source: str, *, strict: bool = False, covariances: bool = True) -> Trajectory | str:
    """Return what a source holds, or why it can't be read."""
    try:
        return read_trajectory(source, strict=strict, covariances=covariances)
    except InputError as error:
        return str(error)


def assert_as_alone(sources: Sequence[str], *, strict: bool = False) -> list[Trajectory | str]:
    """Check that sources read together give what each gives alone, errors included."""
    item = [alone(source, strict=strict) for source in sources]
    refused = [result for result in item if isinstance(result, str)]
    if refused:
        with pytest.raises(InputError) as raised:
            read_many(sources, strict=strict)
        assert str(raised.value) in refused
    kept = [source for source, result in zip(sources, item, strict=True) if result not in refused]
    together = read_many(kept, strict=strict)
    for one, other in zip(together, (e for e in item if not isinstance(e, str)), strict=True):
        assert_same(one, other)
    return item


def assert_no_silent_loss(sources: Sequence[str]) -> list[Trajectory | str]:
    """Check that of two readings, alone and together, the one with fewer poses lists damage."""
    item = [alone(source) for source in sources]
    kept = [
        source
        for source, result in zip(sources, item, strict=True)
        if isinstance(result, Trajectory)
    ]
    read = [result for result in item if isinstance(result, Trajectory)]
    for one, other in zip(read_many(kept), read, strict=True):
        assert len(one) >= len(other) or one.reading.messages(Level.ERROR)
        assert len(other) >= len(one) or other.reading.messages(Level.ERROR)
        if not one.reading.messages(Level.ERROR) and not other.reading.messages(Level.ERROR):
            assert_same(one, other)
    return item


# The law.


@pytest.mark.slow
@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("kind", MAKE)
def test_sources_read_together_are_as_read_alone(kind: str, strict: bool, tmp_path: Path) -> None:
    bag = MAKE[kind](tmp_path / "x")
    sources = [f"{bag}:{item}" for item in WANTED]
    result = assert_as_alone(sources, strict=strict)
    counts = [len(item) for item in result if isinstance(item, Trajectory)]
    assert counts == [COUNT, COUNT // 2, 120, COUNT // 3, COUNT // 3]
    assert "are static" in str(result[-1])


@pytest.mark.slow
@pytest.mark.parametrize("kind", MAKE)
def test_the_law_holds_for_damaged_bags(kind: str, tmp_path: Path) -> None:
    bag = MAKE[kind](tmp_path / "x")
    files = sorted(path for path in (bag.iterdir() if bag.is_dir() else [bag]))
    files = [item for item in files if item.name != "metadata.yaml"]
    contents = [item.read_bytes() for item in files]
    random = np.random.default_rng(len(kind))
    sources = [f"{bag}:{item}" for item in READABLE]
    damaged = 0
    for rotation in range(12):
        for file, content in zip(files, contents, strict=True):
            changed = bytearray(content)
            place = int(random.integers(0, len(content)))
            if rotation % 4 == 0:
                changed = changed[:place]
            else:
                noise = random.bytes(int(random.choice([1, 30, 5000])))
                changed[place : place + len(noise)] = noise
                changed = changed[: len(content)]
            file.write_bytes(changed)
        strict = rotation % 3 == 2
        if strict or kind.startswith("ros1"):
            result = assert_as_alone(sources, strict=strict)
        else:
            result = assert_no_silent_loss(sources)
        damaged += any(
            isinstance(item, str) or bool(item.reading.messages(Level.ERROR)) for item in result
        )
    assert damaged


def test_damage_is_told_of_the_sources_that_it_is_in(tmp_path: Path) -> None:
    flown = [item for item in flight() if item[0] in ("/truth", "/odom")]
    flown.sort(key=lambda message: message[0] == "/truth")  # each in chunks of its own
    bag = mcap(tmp_path / "x.mcap", flown, compression=ZSTD, chunk_size=SMALL)
    content = bytearray(bag.read_bytes())
    content[200:240] = bytes(40)  # within the first chunk, of odometry
    bag.write_bytes(content)
    truth, odometry = read_many([f"{bag}:/truth", f"{bag}:/odom"])
    assert not truth.reading.messages(Level.ERROR)
    assert len(truth) == COUNT
    assert any("on /odom, but" in sentence for sentence in odometry.reading.messages(Level.ERROR))
    assert not any("/truth" in sentence for sentence in odometry.reading.messages(Level.ERROR))
    assert_same(read_many([f"{bag}:/truth"], strict=True)[0], truth)
    with pytest.raises(InputError, match="messages on /odom"):
        read_many([f"{bag}:/truth", f"{bag}:/odom"], strict=True)


def test_a_damaged_page_of_one_topic_loses_no_message_of_the_others(tmp_path: Path) -> None:
    bag = MAKE["sqlite3"](tmp_path / "x")
    with sqlite3.connect(bag) as database:
        query = "SELECT max(length(data)), data FROM messages JOIN topics ON topics.id = topic_id"
        ((_, payload),) = database.execute(f"{query} WHERE name = '/path'").fetchall()
    content = bytearray(bag.read_bytes())
    page = content.rfind(payload[4000:4100]) // 4096 * 4096  # one that the row overflows to
    content[page : page + 4] = b"\xff" * 4
    bag.write_bytes(content)
    truth, path = read_many([f"{bag}:/truth", f"{bag}:/path"])
    assert len(truth) == COUNT
    assert (
        truth.reading.messages(Level.ERROR) == path.reading.messages(Level.ERROR) != ()
    )  # the scan of both ended there
    assert not read_trajectory(f"{bag}:/truth").reading.messages(Level.ERROR)


@given(seeds)
def test_merging_keeps_the_messages_in_order(seed: int) -> None:
    random = np.random.default_rng(seed)
    sent: list[int] = []
    given_blocks = []
    for _ in range(60):
        numbers = list(range(len(sent), len(sent) + int(random.integers(1, 400))))
        size = int(random.choice([4, 5, 300]))
        payloads = [number.to_bytes(4, "big").ljust(size, b"x") for number in numbers]
        block = block_of([1] * len(numbers), numbers, payloads)
        rows = np.flatnonzero(random.random(len(numbers)) < random.random())
        given_blocks.append(block[rows])
        sent += numbers
    kept = [int(log_time) for block in given_blocks for log_time in block.log_times]
    whole = list(merged(given_blocks))
    assert len(whole) < len(given_blocks)
    assert [int(log_time) for block in whole for log_time in block.log_times] == kept
    got = [bytes(payload[:4]) for block in whole for payload in block.payloads()]
    assert [int.from_bytes(item, "big") for item in got] == kept


# What is read, and how often.


class Counted:
    """A file of which every range that is read is kept."""

    is_far = False

    def __init__(self, path: Path) -> None:
        self._file = byte_source.LocalFile(path)
        self.name, self.size = self._file.name, self._file.size
        self.ranges: list[tuple[int, int]] = []

    def read(self, offset: int, size: int) -> bytes:
        data = self._file.read(offset, size)
        self.ranges.append((offset, len(data)))
        return data

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        return [self.read(*item) for item in ranges]

    def close(self) -> None:
        self._file.close()


def read_counted(
    sources: Sequence[str], monkeypatch: pytest.MonkeyPatch
) -> tuple[list[Trajectory], list[Counted], list[int]]:
    """Read, and return the files that were opened and the sizes of what was decompressed."""
    opened: list[Counted] = []
    sizes: list[int] = []

    def counting(path: Path) -> Counted:
        opened.append(Counted(path))
        return opened[-1]

    def decompress(kind: str, data: bytes, limit: int) -> bytes:
        sizes.append(limit)
        return real(kind, data, limit)

    real = mcap_chunks.decompress
    with monkeypatch.context() as patch:
        patch.setattr(containers, "source_of", counting)
        patch.setattr(mcap_chunks, "decompress", decompress)
        read = read_many(sources)
    return read, opened, sizes


@pytest.mark.parametrize("kind", ["mcap", "zstd", "lz4", "images", "unchunked"])
def test_no_byte_of_the_data_is_read_twice(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = MAKE[kind](tmp_path / "x")
    with bag.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    _, opened, sizes = read_counted([f"{bag}:{item}" for item in READABLE], monkeypatch)
    (counted,) = opened
    times = np.zeros(counted.size, dtype=int)
    for offset, size in counted.ranges:
        times[offset : offset + size] += 1
    for chunk in summary.chunk_indexes:
        first = chunk.chunk_start_offset
        assert times[first : first + chunk.chunk_length + chunk.message_index_length].max() == 1
    if kind in ("zstd", "lz4"):
        assert len(sizes) == len(summary.chunk_indexes) > 2
    if kind == "images":
        assert times.sum() < 0.3 * counted.size
    if kind == "unchunked":  # its records are walked through to find the messages, then read
        assert times.max() <= 3


def test_sqlite_scans_its_messages_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = MAKE["sqlite3"](tmp_path / "x")
    asked: list[str] = []
    connect = sqlite3.connect

    def traced(*given: Any, **options: Any) -> sqlite3.Connection:
        connection = connect(*given, **options)
        connection.set_trace_callback(asked.append)
        return connection

    monkeypatch.setattr(sqlite3, "connect", traced)
    read_many([f"{bag}:{item}" for item in READABLE])
    scans = [item for item in asked if "FROM messages" in item and "max(id)" not in item]
    assert len(scans) == 1


# Sources of all kinds.


def test_bags_and_texts_in_any_order(tmp_path: Path) -> None:
    bag, other = MAKE["mcap"](tmp_path / "x.mcap"), MAKE["ros1"](tmp_path / "y.bag")
    text = tmp_path / "z.txt"
    text.write_text("".join(f"{row} {row} 2 3 0 0 0.6 0.8\n" for row in range(1, 9)))
    only = mcap(tmp_path / "only.mcap", [item for item in flight() if item[0] == "/odom"])
    sources = [
        f"{other}:/odom",
        text,
        f"{bag}:truth",
        only,
        f"{other}:/tf:map.base",
        f"{bag}:/odom",
        f"{tmp_path}/../{tmp_path.name}/x.mcap:/odom",
    ]
    seen: list[tuple[int, int]] = []
    read = read_many(sources, advance=lambda done, total: seen.append((done, total)))
    for source, result in zip(sources, read, strict=True):
        assert_same(result, read_trajectory(source))
    assert read[5].positions is read[6].positions  # read once
    assert seen == sorted(seen)
    assert seen[-1][0] == seen[-1][1]
    assert len({total for _, total in seen}) == 1
    assert read_many([]) == []


def test_covariances_are_read_for_those_that_want_them(tmp_path: Path) -> None:
    bag = MAKE["zstd"](tmp_path / "x.mcap")
    sources = [f"{bag}:/odom", f"{bag}:/truth", f"{bag}:/odom"]
    without, truth, with_them = read_many(sources, covariances=[False, True, True])
    assert without.covariances is None
    assert truth.covariances is None
    assert with_them.covariances is not None
    for result, expected in ((without, False), (with_them, True)):
        same = alone(f"{bag}:/odom", covariances=expected)
        assert isinstance(same, Trajectory)
        assert_same(result, same)
    with pytest.raises(ValueError, match="2 values for 3 sources"):
        read_many(sources, covariances=[True, False])


def test_progress_counts_the_messages_of_all_sources_of_a_bag(tmp_path: Path) -> None:
    bag = MAKE["images"](tmp_path / "x.mcap")
    seen: list[tuple[int, int]] = []
    sources = [f"{bag}:{item}" for item in READABLE]
    read_many(sources, advance=lambda done, total: seen.append((done, total)))
    count = len(messages())
    assert seen[-1] == (count, count)
    assert seen == sorted(seen)


def test_an_error_says_which_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = MAKE["mcap"](tmp_path / "x.mcap")
    text = tmp_path / "z.txt"
    text.write_text("this is no trajectory\n")
    good = f"{bag}:/truth"
    for bad in (f"{bag}:/nothing", f"{bag}:/tf:map.nowhere", str(text), f"{tmp_path}/none.mcap"):
        with pytest.raises(InputError) as raised:
            read_many([good, bad])
        assert str(raised.value) == alone(bad)
        assert bad.split(":")[0] in str(raised.value)
    opened: list[Path] = []
    monkeypatch.setattr(containers, "source_of", opened.append)
    with pytest.raises(InputError, match="does not exist"):
        read_many([good, f"{tmp_path}/none.mcap"])
    assert not opened  # the name is wrong, so that nothing is read
