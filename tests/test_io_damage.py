"""Bags as robots leave them behind: what can be had is read, and what can't is said."""

from __future__ import annotations

import functools
import json
import random
import re
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from test_io_bags import STORE, TYPES, header, pose, pose_stamped, refusal, simple, the_file, write

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
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
    return tuple(bytes(STORE.serialize_cdr(each, POSE_STAMPED)) for each in poses)


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
    return [int(each) for each in read.positions[:, 0]]


def assert_whole(source: Path | str, count: int = COUNT) -> Trajectory:
    read = read_trajectory(str(source))
    assert rows_of(read) == list(range(count))
    assert not read.damage
    assert rows_of(read_trajectory(str(source), strict=True)) == list(range(count))
    return read


def assert_damaged(source: Path | str, *words: str) -> Trajectory:
    """Check that part of it is read, that the damage is told, and that --strict refuses it."""
    read = read_trajectory(str(source))
    said = "; ".join(read.damage)
    assert said
    for word in words:
        assert word in said
    assert set(rows_of(read)) <= set(range(COUNT))
    with pytest.raises(InputError):
        read_trajectory(str(source), strict=True)
    return read


COMPRESSIONS = [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]


# MCAP.


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("chunked", [True, False])
def test_a_file_cut_short_gives_what_is_left(
    compression: Any, chunked: bool, tmp_path: Path
) -> None:
    path = mcap_file(tmp_path / "x.mcap", compression=compression, use_chunking=chunked)
    content = path.read_bytes()
    data = content.rfind(b"\x0f\x04\0\0\0\0\0\0\0")  # where the data end
    for share, least in ((0.5, 0.45), (0.999, 0.97)):
        path.write_bytes(content[: int(data * share)])
        read = assert_damaged(path, "it is truncated", "no footer")
        assert rows_of(read) == list(range(len(read)))
        assert len(read) >= least * COUNT


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_that_is_cut_off_gives_its_first_messages(
    compression: Any, tmp_path: Path
) -> None:
    noise = np.random.default_rng(0)
    given = []
    for payload in payloads():
        message: Any = STORE.deserialize_cdr(payload, POSE_STAMPED)
        message.header.frame_id = noise.bytes(300).hex()
        given.append(bytes(STORE.serialize_cdr(message, POSE_STAMPED)))
    path = tmp_path / "x.mcap"
    mcap_file(path, messages=given, compression=compression, chunk_size=1 << 24)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    read = read_trajectory(str(path))
    assert 0.3 * COUNT < len(read) < COUNT
    assert rows_of(read) == list(range(len(read)))
    assert read.damage


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_that_is_not_what_its_checksum_is_of_is_left_out(
    compression: Any, tmp_path: Path
) -> None:
    path = mcap_file(tmp_path / "x.mcap", compression=compression)
    content = bytearray(path.read_bytes())
    for place in range(chunks_of(path)[3] + 70, chunks_of(path)[3] + 110):
        content[place] ^= 0xFF
    path.write_bytes(content)
    read = assert_damaged(path, "a chunk", f"declares {COUNT} messages on /pose, but")
    assert 0.8 * COUNT < len(read) < COUNT


@pytest.mark.parametrize(
    "options",
    [
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.MESSAGE},
        {"index_types": IndexType.NONE},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"use_statistics": False},
        {"use_summary_offsets": False},
        {"use_chunking": False},
        {"use_chunking": False, "repeat_channels": False, "use_statistics": False},
        {"enable_crcs": False},
    ],
)
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_whatever_index_is_missing(
    options: dict[str, Any], compression: Any, tmp_path: Path
) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", compression=compression, **options))


@pytest.mark.parametrize("chunked", [True, False])
def test_log_times_out_of_order_are_sorted(chunked: bool, tmp_path: Path) -> None:
    order = list(range(COUNT))
    random.Random(0).shuffle(order)
    given = payloads()
    path = mcap_file(
        tmp_path / "x.mcap",
        messages=[given[row] for row in order],
        log_times=[row * SECOND for row in order],
        use_chunking=chunked,
    )
    assert_whole(path)


@pytest.mark.parametrize("profile", ["", "ros1", "x"])
def test_any_profile(profile: str, tmp_path: Path) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", profile=profile))


def test_ros1_in_mcap(tmp_path: Path) -> None:
    store: Any = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    messages = []
    for row in range(COUNT):
        time = types["builtin_interfaces/msg/Time"](row + 1, 0)
        message = types[POSE_STAMPED](
            types["std_msgs/msg/Header"](row, time, "map"),
            types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](float(row), 0.0, 0.0),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
            ),
        )
        messages.append(bytes(store.serialize_ros1(message, POSE_STAMPED)))
    for text in (definition(POSE_STAMPED, store), b""):
        schema = ("geometry_msgs/PoseStamped", "ros1msg", text)
        path = tmp_path / "x.mcap"
        mcap_file(path, messages=messages, profile="ros1", schema=schema, encoding="ros1")
        assert_whole(path)


OTHERS: list[Register] = [
    lambda w: w.register_channel("/j", "json", w.register_schema("J", "jsonschema", b"{}")),
    lambda w: w.register_channel("/p", "protobuf", w.register_schema("P", "protobuf", b"xx")),
    lambda w: w.register_channel("/f", "flatbuffer", w.register_schema("F", "flatbuffer", b"x")),
    lambda w: w.register_channel("/r", "ros1", w.register_schema("a/B", "ros1msg", b"int8 a")),
    lambda w: w.register_channel("/n", "json", 0),
    lambda w: w.register_channel("/b", "cdr", w.register_schema("a/msg/B", "ros2msg", b"! no")),
    lambda w: w.register_channel("/m", "cdr", w.register_schema("a/msg/B", "ros2msg", b"c/D d")),
    lambda w: w.register_channel("/e", "cdr", w.register_schema("\xff", "ros2msg", b"\xff\xfe")),
]


@pytest.mark.parametrize("others", OTHERS)
def test_odd_topics_beside_the_poses(others: Register, tmp_path: Path) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", others=others))


def test_service_events_beside_the_topics(shared_data: Path) -> None:
    folder = shared_data / "bags" / "rosbag2_fixtures"
    bags = [each for each in folder.rglob("*.mcap") if "service" in each.name]
    assert bags
    for bag in bags:
        assert "no topic with poses, only" in refusal(bag)


@pytest.mark.parametrize("text", [b"", b" ", b"this is no definition !", b"int8 a", b"a/B pose"])
def test_a_definition_that_is_no_help(text: bytes, tmp_path: Path) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", schema=(POSE_STAMPED, "ros2msg", text)))
    assert_whole(mcap_file(tmp_path / "y.mcap", schema=(POSE_STAMPED, "", text)))


@pytest.mark.parametrize(
    ("beginning", "good"),
    [
        (b"\0\1\0\3", True),
        (b"\0\7\0\0", True),
        (b"\0\2\0\0", False),
        (b"\0\3\0\0", False),
        (b"\0\x0a\0\0", False),
    ],
)
def test_encapsulations(beginning: bytes, good: bool, tmp_path: Path) -> None:
    messages = [beginning + each[4:] for each in payloads()]
    path = mcap_file(tmp_path / "x.mcap", messages=messages)
    if good:
        assert_whole(path)
    else:
        with pytest.raises(InputError, match=f"none of its {COUNT} messages can be decoded"):
            read_trajectory(str(path))


def test_payloads_that_are_no_messages_are_counted(tmp_path: Path) -> None:
    good = payloads()
    bad = [b"", b"\0", b"\0\1\0\0", good[0][:40], good[0] + bytes(8)]
    read = read_trajectory(str(mcap_file(tmp_path / "x.mcap", messages=good + bad)))
    assert rows_of(read) == list(range(COUNT))
    assert read.dropped == {"undecodable": len(bad)}


def test_messages_that_are_no_poses_are_counted(tmp_path: Path) -> None:
    given = payloads(100)
    for row, x, w in ((5, np.nan, 0.8), (7, 1.0, np.inf), (9, 1.0, np.nan)):
        message = pose_stamped(SECOND, x)
        message.pose.orientation.w = w
        given[row] = bytes(STORE.serialize_cdr(message, POSE_STAMPED))
    nothing = pose(1.0, w=0.0, yaw=0.0)
    zero = TYPES[POSE_STAMPED](header(SECOND), nothing)
    given[11] = bytes(STORE.serialize_cdr(zero, POSE_STAMPED))
    read = read_trajectory(str(mcap_file(tmp_path / "x.mcap", messages=given)))
    assert len(read) == 96
    assert read.dropped == {"not_finite": 3, "zero_quaternion": 1}


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("size", [2**62, 2**64 - 1])
def test_hostile_sizes_take_no_memory(
    strict: bool, compression: Any, size: int, tmp_path: Path
) -> None:
    path = mcap_file(tmp_path / "x.mcap", compression=compression)
    content = bytearray(path.read_bytes())
    chunk = chunks_of(path)[2]
    for place in (chunk + 1, chunk + 25):  # the record's length, the chunk's size
        damaged = bytearray(content)
        damaged[place : place + 8] = size.to_bytes(8, "little")
        for ending in (damaged, damaged[: len(damaged) - 40]):
            path.write_bytes(ending)
            if strict:
                with pytest.raises(InputError):
                    read_trajectory(str(path), strict=True)
            else:
                assert read_trajectory(str(path)).damage


def test_a_size_that_no_integer_holds(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "x.mcap", messages=payloads() * 3, chunk_size=1 << 17)
    content = bytearray(path.read_bytes())
    chunk = chunks_of(path)[1]
    content[chunk + 25 : chunk + 33] = b"\xff" * 8
    path.write_bytes(content[:-40])
    assert_damaged(path, "a chunk has an invalid size")


def test_an_unknown_compression_loses_its_chunk_only(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "x.mcap", compression=CompressionType.LZ4)
    content = bytearray(path.read_bytes())
    index = content.rfind(b"\x03\0\0\0lz4")
    content[index + 4 : index + 7] = b"lz0"
    footer = len(content) - 8 - 4
    content[footer : footer + 4] = bytes(4)
    path.write_bytes(content)
    assert len(assert_damaged(path, "unknown compression 'lz0'")) > 0.8 * COUNT


def test_chunks_that_were_not_verified_are_counted(tmp_path: Path) -> None:
    path = among_images(tmp_path / "x.mcap")
    content = bytearray(path.read_bytes())
    result = tmp_path / "result.json"
    given = ["evaluate", "-g", f"{path}:/pose", "-e", f"{path}:/pose", "--lengths", "none"]
    given += ["--quiet", "--json", str(result)]

    def notes() -> list[str]:
        return list(json.loads(result.read_text())["runs"][0]["estimate"]["notes"])

    assert main(given) == 0
    assert any(re.match(r"\d+ of \d+ chunks were read in part", each) for each in notes())
    assert main([*given, "--strict"]) == 0
    assert not any("in part" in each for each in notes())
    content[len(content) // 2] ^= 1  # in an image, which is none of our business
    path.write_bytes(content)
    assert main(given) == 0
    assert rows_of(read_trajectory(f"{path}:/pose")) == list(range(COUNT))
    assert main([*given, "--strict"]) == 2


@pytest.mark.parametrize(("place", "name"), [(0, "opcode"), (3, "length"), (9, "channel")])
def test_a_message_that_is_not_what_its_index_says(place: int, name: str, tmp_path: Path) -> None:
    path = among_images(tmp_path / "x.mcap")
    content = bytearray(path.read_bytes())
    record = content.find(payloads()[105]) - 22 - 9
    content[record + place] ^= 0x10
    path.write_bytes(content)
    read = read_trajectory(f"{path}:/pose")
    assert any("a chunk does not match its checksum" in each for each in read.damage), name
    assert 0.9 * COUNT < len(read) < COUNT


# sqlite3.


def sqlite_file(tmp_path: Path) -> Path:
    return the_file(simple(tmp_path / "bag", COUNT, storage=StoragePlugin.SQLITE3))


def test_garbage_in_the_middle_of_sqlite(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 8000] = np.random.default_rng(0).bytes(8000)
    path.write_bytes(content)
    read = assert_damaged(path, "is damaged")
    assert len(read) > 0.8 * COUNT
    assert (np.diff(read.positions[:, 0]) > 0).all()


@pytest.mark.parametrize("size", [0, 100, 4096, 20_000])
def test_the_beginning_of_sqlite_alone(size: int, tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    path.write_bytes(path.read_bytes()[:size])
    assert path.name in refusal(path)


def unfinished(folder: Path) -> Path:
    """Write a file whose last messages wait in the log beside it."""
    folder.mkdir()
    path = sqlite_file(folder)
    live = sqlite3.connect(path)
    live.execute("PRAGMA journal_mode=WAL")
    rows = live.execute("SELECT * FROM messages WHERE id > 300 ORDER BY id").fetchall()
    live.execute("DELETE FROM messages WHERE id > 300")
    live.commit()
    live.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    live.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    live.commit()
    for suffix in ("", "-wal"):
        shutil.copy(f"{path}{suffix}", folder / f"x.db3{suffix}")
    live.close()
    return folder / "x.db3"


def test_messages_that_wait_in_the_log_are_read(tmp_path: Path) -> None:
    assert_whole(unfinished(tmp_path / "x"))


def test_a_log_that_is_damaged_is_told(tmp_path: Path) -> None:
    path = unfinished(tmp_path / "x")
    log = Path(f"{path}-wal")
    content = log.read_bytes()
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    for damaged in (content[:middle], flipped, content[:20], b"no log", b"\0" + content[1:]):
        for file in tmp_path.glob("x/x.db3-shm"):
            file.unlink()
        log.write_bytes(damaged)
        read = assert_damaged(path, "x.db3-wal: ", "pages could", "messages are missing")
        assert rows_of(read) == list(range(300))


@pytest.mark.parametrize("version", [1, 2])
def test_old_files_without_definitions(version: int, tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "old.db3")
    qos = ", offered_qos_profiles TEXT NOT NULL" if version == 2 else ""
    database.execute(
        "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        f"serialization_format TEXT NOT NULL{qos})"
    )
    database.execute(
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    more = ", ''" if version == 2 else ""
    database.execute(f"INSERT INTO topics VALUES (1, '/pose', '{POSE_STAMPED}', 'cdr'{more})")
    database.execute(f"INSERT INTO topics VALUES (2, '/x', 'my_msgs/msg/Custom', 'cdr'{more})")
    rows = ((1, row, each) for row, each in enumerate(payloads()))
    database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    database.commit()
    database.close()
    assert_whole(tmp_path / "old.db3")


def changed_by(path: Path, *statements: str) -> Path:
    with sqlite3.connect(path) as database:
        for each in statements:
            database.execute(each)
    database.close()
    return path


def test_texts_that_are_stored_as_blobs(tmp_path: Path) -> None:
    path = changed_by(
        sqlite_file(tmp_path),
        "UPDATE topics SET type = CAST(type AS BLOB), name = CAST(name AS BLOB), "
        "serialization_format = CAST(serialization_format AS BLOB)",
        "UPDATE message_definitions SET topic_type = CAST(topic_type AS BLOB), "
        "encoding = CAST(encoding AS BLOB), "
        "encoded_message_definition = CAST(encoded_message_definition AS BLOB)",
    )
    assert_whole(path)


def test_texts_that_are_none(tmp_path: Path) -> None:
    path = changed_by(
        sqlite_file(tmp_path),
        "INSERT INTO topics SELECT 90, CAST(x'FF00' AS TEXT), x'FF', 5, 0.5, '' FROM topics",
        "INSERT INTO message_definitions VALUES (90, 5, x'FF', 0.5, '')",
    )
    assert_whole(path)


def test_rows_that_are_no_messages_are_counted(tmp_path: Path) -> None:
    path = changed_by(
        sqlite_file(tmp_path),
        "UPDATE messages SET data = 'text' WHERE id = 3",
        "UPDATE messages SET data = 5 WHERE id = 5",
        "UPDATE messages SET timestamp = 'never' WHERE id = 7",
        "UPDATE messages SET timestamp = x'FF' WHERE id = 9",
        "UPDATE messages SET timestamp = 1e300 WHERE id = 11",
    )
    read = read_trajectory(str(path))
    # What a bag has at the end of all times comes last, and alone.
    assert sorted(rows_of(read)) == [row for row in range(COUNT) if row not in (2, 4, 10)]
    assert read.dropped == {"undecodable": 2, "lone_stamp": 1}


def test_one_definition_is_missing(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    database = sqlite3.connect(path)
    database.execute("DELETE FROM message_definitions")
    database.execute("INSERT INTO message_definitions VALUES (9, 'a/msg/B', 'x', '', '')")
    database.commit()
    database.close()
    read = read_trajectory(str(path))
    assert rows_of(read) == list(range(COUNT))
    assert not read.damage


# Directories.


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_files_need_no_metadata(storage: Any, mode: Any, tmp_path: Path) -> None:
    bag = simple(tmp_path / "bag", 300, storage=storage, compression=mode)
    assert_whole(bag, 300)
    assert_whole(the_file(bag), 300)
    (bag / "metadata.yaml").unlink()
    assert_whole(bag, 300)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_compressed_file_is_called_by_its_own_name(
    storage: Any, share: float, tmp_path: Path
) -> None:
    bag = simple(tmp_path / "bag", 300, storage=storage, compression=CompressionMode.FILE)
    path = the_file(bag)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    try:
        said = "; ".join(read_trajectory(str(path)).damage)
    except InputError as error:
        said = str(error)
    assert str(path) in said
    assert "trajeval-" not in said  # the folder of its copy


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


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_split_bags_are_ordered_by_time(storage: Any, tmp_path: Path) -> None:
    bag = split(tmp_path, storage)
    assert_whole(bag, 200)
    (bag / f"a_9{ending(storage)}").unlink()
    read = read_trajectory(str(bag))
    assert rows_of(read) == list(range(100, 200))
    said = "; ".join(read.damage)
    assert "metadata.yaml lists a_9" in said
    assert "declares 200 messages on /pose, but 100 were read" in said


def test_one_file_of_several_that_is_no_bag(tmp_path: Path) -> None:
    bag = split(tmp_path, StoragePlugin.MCAP)
    (bag / "a_10.mcap").write_bytes(b"no bag at all")
    read = read_trajectory(str(bag))
    assert rows_of(read) == list(range(100))
    assert any("a_10.mcap skipped" in each for each in read.damage)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_empty_bags_are_mistakes(storage: Any, tmp_path: Path) -> None:
    assert "is an empty bag" in refusal(write(tmp_path / "no topics", [], storage=storage))


def test_one_topic_of_two_types(tmp_path: Path) -> None:
    point = "geometry_msgs/msg/PointStamped"
    other = TYPES[point](header(SECOND), TYPES["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
    messages = [("/p", POSE_STAMPED, 1, pose_stamped(SECOND)), ("/p", point, 2, other)]
    bag = write(tmp_path / "bag", messages)
    with pytest.raises(InputError, match="/p has several types of poses"):
        read_trajectory(f"{bag}:/p")


# Damage anywhere.


@pytest.mark.slow
@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_two_hundred_places_to_cut(compression: Any, chunked: bool, tmp_path: Path) -> None:
    path = mcap_file(
        tmp_path / "x.mcap", messages=payloads(400), compression=compression, use_chunking=chunked
    )
    content = path.read_bytes()
    for place in np.random.default_rng(1).integers(0, len(content), 200).tolist():
        path.write_bytes(content[:place])
        if said := refusal(path):
            assert "\n" not in said
            continue
        read = read_trajectory(str(path))
        assert rows_of(read) == list(range(len(read)))
        assert read.damage


@pytest.mark.slow
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("chunked", [True, False])
def test_two_hundred_places_to_flip_a_byte(
    compression: Any, chunked: bool, tmp_path: Path
) -> None:
    given = payloads(400)
    path = mcap_file(
        tmp_path / "x.mcap",
        messages=given,
        compression=compression,
        use_chunking=chunked,
        enable_data_crcs=True,
    )
    good = read_trajectory(str(path), strict=True)
    content = path.read_bytes()
    generator = np.random.default_rng(2)
    for place in generator.integers(0, len(content), 200).tolist():
        damaged = bytearray(content)
        damaged[place] ^= int(generator.integers(1, 256))
        path.write_bytes(damaged)
        assert "\n" not in refusal(path)
        try:
            read = read_trajectory(str(path), strict=True)
        except InputError:
            continue
        assert read.quaternions is not None
        np.testing.assert_array_equal(read.stamps, good.stamps)
        np.testing.assert_array_equal(read.positions, good.positions)
        np.testing.assert_array_equal(read.quaternions, good.quaternions)


# What the user is told.


def test_damage_is_told_and_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = mcap_file(tmp_path / "x.mcap")
    given = ["evaluate", "-g", f"{path}:/pose", "-e", f"{path}:/pose", "--lengths", "none"]
    result = tmp_path / "result.json"
    assert main([*given, "--strict", "--quiet"]) == 0
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    capsys.readouterr()
    for quiet in ([], ["--quiet"]):
        assert main([*given, *quiet, "--json", str(result)]) == 0
        assert "warning: " in capsys.readouterr().err
        warnings = json.loads(result.read_text())["runs"][0]["warnings"]
        assert any("truncated" in each for each in warnings)
    assert main([*given, "--strict"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "truncated" in said


def test_a_wrong_count_in_the_metadata(tmp_path: Path) -> None:
    bag = simple(tmp_path / "bag", 50)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 50", "message_count: 60"))
    read = read_trajectory(str(bag))
    assert len(read) == 50
    assert any("declares 60 messages on /pose, but 50 were read" in each for each in read.damage)
