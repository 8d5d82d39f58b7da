"""Bags whose structure is hostile: SQL, nested definitions, summaries that lie, pipes."""

from __future__ import annotations

import itertools
import os
import sqlite3
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from damaged_bags import (
    COUNT,
    SECOND,
    assert_damaged,
    assert_whole,
    chunks_of,
    definition,
    mcap_file,
    payloads,
    rows_of,
    sqlite_file,
)
from hypothesis import given
from hypothesis import strategies as st
from made_bags import refusal
from mcap.records import Channel, Schema
from mcap.writer import CompressionType
from mcap_layouts import Layout, Part

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.bags.bag_folder import BagFolder, read_metadata
from trajeval_ros.io.bags.blocks import TopicSelection
from trajeval_ros.io.bags.compression import decompress
from trajeval_ros.io.bags.message_definitions import STANDARD, Connection, recorded_fields
from trajeval_ros.io.bags.sqlite_bag import SqliteReader
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

TOPICS = """
    CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format,
                        offered_qos_profiles);
    INSERT INTO topics VALUES(1, '/pose', 'geometry_msgs/msg/PoseStamped', 'cdr', '');
"""
MESSAGES = """
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);
    INSERT INTO messages VALUES(1, 1, 1, x'00');
"""
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"


@pytest.mark.parametrize(
    "script",
    [
        f"{TOPICS} CREATE VIEW messages(id, topic_id, timestamp, data) AS {ENDLESS} "
        "SELECT x, 1, x, x'00' FROM c;",
        f"{TOPICS} CREATE VIEW Messages(id, topic_id, timestamp, data) AS {ENDLESS} "
        "SELECT x, 1, x, x'00' FROM c;",
        f"{TOPICS} CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, "
        "data BLOB AS (zeroblob(500000000)) VIRTUAL); "
        "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2);",
        f"{MESSAGES} CREATE VIEW topics(id, name, type, serialization_format) AS {ENDLESS} "
        "SELECT x, '/pose', 'geometry_msgs/msg/PoseStamped', 'cdr' FROM c;",
        f"{TOPICS} {MESSAGES} CREATE VIEW message_definitions(topic_type, encoding, "
        f"encoded_message_definition) AS {ENDLESS} SELECT x, 'ros2msg', 'x' FROM c;",
        f"{TOPICS} CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data);",
    ],
    ids=["endless", "capitals", "computed", "topics", "definitions", "virtual"],
)
def test_sql_of_a_file_is_not_executed(script: str, tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    with sqlite3.connect(path) as database:
        database.executescript(script)
    database.close()
    assert "is a view or has computed columns; export the recording" in refusal(path)


def test_ids_that_are_no_integers_are_no_number_of_rows(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    with sqlite3.connect(path) as database:
        database.executescript(TOPICS)
        database.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
        rows = [(f"m{row}", 1, row, payload) for row, payload in enumerate(payloads(20))]
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    database.close()
    assert sorted(rows_of(read_trajectory(str(path)))) == list(range(20))


@pytest.mark.parametrize("topic", [None, 7, "x"])
@pytest.mark.parametrize("count", [1, COUNT])
def test_messages_of_unknown_topics_are_damage(count: int, topic: object, tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE changed(id, topic_id, timestamp, data)")
        database.execute("INSERT INTO changed SELECT * FROM messages")
        database.execute("UPDATE changed SET topic_id = ? WHERE id <= ?", (topic, count))
        database.executescript("DROP TABLE messages; ALTER TABLE changed RENAME TO messages")
    database.close()
    text = f"{counted(count, 'message')} of unknown topics"
    if count == COUNT:
        assert text in refusal(path)
    else:
        assert len(assert_damaged(path, text)) == COUNT - count


def shared_pages(path: Path, interior: int, *, is_deep: bool = False) -> None:
    """Write a table whose interior pages have one child, which they list hundreds of times.

    `is_deep`: the child of each is the next one, so that n pages have 450^n rows.
    """
    with sqlite3.connect(path) as database:
        database.executescript(TOPICS + MESSAGES)
        rows = ((1, row, bytes(1900)) for row in range(600 * interior))
        database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
        ((root,),) = database.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ).fetchall()
    database.close()
    pages = np.frombuffer(path.read_bytes(), dtype=np.uint8).reshape(-1, 4096).copy()
    leaf = int(np.flatnonzero(pages[:, 0] == 13)[-2]) + 1
    for number in np.flatnonzero(pages[:, 0] == 5):
        page = pages[number]
        begins = page[12 : 12 + 2 * (256 * int(page[3]) + int(page[4]))].view(">u2").astype(int)
        others = [item + 1 for item in np.flatnonzero(pages[:, 0] == 5) if item + 1 != root]
        after = [other for other in others if other > number + 1] if is_deep else []
        child = (others[0] if is_deep else others[-1]) if number + 1 == root else [*after, leaf][0]
        for begin in (8, *begins):
            page[begin : begin + 4] = list(int(child).to_bytes(4, "big"))
    path.write_bytes(pages.tobytes())


@pytest.mark.parametrize("in_order", [False, True])
def test_pages_that_are_linked_many_times_end_with_the_size_of_the_file(
    in_order: bool, tmp_path: Path
) -> None:
    path = tmp_path / "x.db3"
    shared_pages(path, 3)
    reader = SqliteReader(path, path.name)
    selection = TopicSelection(frozenset({1}))
    read = sum(int(block.sizes.sum()) for block in reader.blocks([selection], in_order=in_order))
    assert read <= path.stat().st_size
    assert any("damaged" in item for item in selection.damage)
    assert reader.count(1) >= 0
    reader.close()


@pytest.mark.slow
def test_a_query_of_more_rows_than_the_file_can_have_is_given_up(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    shared_pages(path, 4, is_deep=True)
    reader = SqliteReader(path, path.name)
    assert reader.count(1) == 0
    reader.close()


@pytest.mark.slow
def test_rows_of_different_length_are_read_in_bounded_groups(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = zeroblob(3000000) WHERE id > 500")
    database.close()
    reader = SqliteReader(path, path.name)
    tracemalloc.start()
    blocks = reader.blocks([TopicSelection(frozenset({1}))])
    total = sum(len(block) for block in blocks)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    reader.close()
    assert total == COUNT
    assert peak < 15e6


POSE = definition(POSE_STAMPED).decode()
RULE = "\n" + "=" * 80 + "\n"


def nested(levels: int, fields: int, last: str = "float64 x") -> str:
    """Return a definition of nested types that expands to fields^levels fields."""
    sections = [
        (f"MSG: a/A{level}\n" if level else "")
        + "\n".join(f"a/A{level + 1} f{number}" for number in range(fields))
        for level in range(levels)
    ]
    return RULE.join([*sections, f"MSG: a/A{levels}\n{last}"])


HOSTILE = {
    "wide": nested(7, 10),
    "deep": nested(400, 1),
    "huge array": f"float64[4611686018427387904] x\n{POSE}",
    "nested arrays": f"a/A0[1000000] x\n{POSE}{RULE}MSG: a/A0\n"
    + nested(3, 1, "float64[1000000] x").replace(" f0", "[1000000] f0"),
    "negative": "float64[-1] x",
    "itself": "geometry_msgs/PoseStamped x",
    "many": "\n".join(f"float64 x{number}" for number in range(5000)),
    "long": "# " + "x" * 300_000 + "\nfloat64 x",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_definitions_are_not_expanded(name: str, tmp_path: Path) -> None:
    path = mcap_file(
        tmp_path / "x.mcap",
        messages=payloads(20),
        schema=(POSE_STAMPED, "ros2msg", HOSTILE[name].encode()),
    )
    tracemalloc.start()
    read = read_trajectory(str(path))  # the standard layout is used instead
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows_of(read) == list(range(20))
    assert peak < 30e6


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["float64", "string", "a/A", "a/B", "b/A", "uint8", "Header"]),
            st.sampled_from(["", "[]", "[3]", "[0]", "[-1]", "[<=5]", f"[{2**62}]", "[x]"]),
            st.sampled_from(["x", "y", "z = 3", "=", "'"]),
        ),
        max_size=6,
    ),
    st.lists(st.sampled_from(["MSG: a/A", "MSG: a/B", "MSG: std_msgs/Header"]), max_size=3),
    st.sampled_from(["MSG", "IDL"]),
)
def test_any_definition_has_fields_or_none(
    lines: list[tuple[str, str, str]], heads: list[str], language: str
) -> None:
    body = "\n".join(f"{kind}{size} {name}" for kind, size, name in lines)
    text = RULE.join([body, *(f"{head}\n{body}" for head in heads)])
    connection = Connection(1, "/p", POSE_STAMPED, language, text, 1, "cdr", None)
    fields = recorded_fields(connection)
    assert fields is None or isinstance(fields, tuple)


def test_a_standard_definition_is_not_refused() -> None:
    text = definition(POSE_STAMPED).decode().replace("float64 x", "float64 x # metres")
    text = f"{text}\nint32 A=1\n"
    connection = Connection(1, "/p", POSE_STAMPED, "MSG", text, 1, "cdr", None)
    assert recorded_fields(connection) == STANDARD[POSE_STAMPED]


def layout(**options: object) -> Layout:
    rows = [(1, time * SECOND, payload) for time, payload in enumerate(payloads(COUNT))]
    cuts = range(0, COUNT + 1, 100)
    parts = [Part(rows[begin:end], **options) for begin, end in itertools.pairwise(cuts)]  # type: ignore[arg-type]
    return Layout(
        [Schema(1, definition(POSE_STAMPED), "ros2msg", POSE_STAMPED)],
        [Channel(1, "/pose", "cdr", {}, 1)],
        parts,
    )


@pytest.mark.parametrize("is_chunked", [True, False])
def test_a_record_that_is_missing_before_the_summary_is_damage(
    is_chunked: bool, tmp_path: Path
) -> None:
    content = bytes(layout(is_chunk=is_chunked))
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    assert_whole(path)
    opcode = 6 if is_chunked else 5
    records = []
    place = 8
    while place < len(content) - 8:
        size = 9 + int.from_bytes(content[place + 1 : place + 9], "little")
        records.append((content[place], place, size))
        place += size
    _, begin, size = [record for record in records if record[0] == opcode][3]
    # Without a checksum of the summary, as rosbag2's fastest preset writes it.
    changed = content[:begin] + content[begin + size :]
    path.write_bytes(changed[:-12] + bytes(4) + changed[-8:])
    read = assert_damaged(path, "summary")
    assert len(read) in (COUNT - 1, COUNT - 100)
    with pytest.raises(InputError):
        read_trajectory(str(path), strict=True)


def test_a_listed_chunk_that_is_none_is_damage(tmp_path: Path) -> None:
    made = layout()
    made.has_statistics = False
    path = tmp_path / "x.mcap"
    path.write_bytes(bytes(made))
    assert_whole(path)
    content = bytearray(bytes(made))
    content[chunks_of(path)[2]] = 0x90  # a private record
    path.write_bytes(content)
    read = assert_damaged(path, "1 chunk of the summary not found")
    assert len(read) == COUNT - 100
    with pytest.raises(InputError, match="not found"):
        read_trajectory(str(path), strict=True)


def test_statistics_without_counts_by_channel_are_compared(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    made = layout(is_chunk=False)
    content = bytearray(bytes(made))
    path.write_bytes(content)
    whole = content.index(b"\x0b" + (46 + 10).to_bytes(8, "little"))
    total = whole + 9
    assert int.from_bytes(content[total : total + 8], "little") == COUNT
    content[total : total + 8] = (COUNT + 5).to_bytes(8, "little")
    content[whole + 1 : whole + 9] = (46).to_bytes(8, "little")
    content[total + 42 : total + 46] = bytes(4)
    del content[total + 46 : total + 56]
    content[-12:-8] = bytes(4)
    path.write_bytes(content)
    read = assert_damaged(path, f"5 of {COUNT + 5} messages not found")
    assert len(read) == COUNT


@pytest.mark.parametrize("kind", ["lz4", "zstd"])
def test_decompressed_data_is_in_memory_once(kind: str) -> None:
    size = 200 << 20
    if kind == "lz4":
        packed = lz4.frame.compress(bytes(size))
    else:
        zstandard = pytest.importorskip("zstandard", reason="zstandard is missing")
        packed = zstandard.ZstdCompressor().compress(bytes(size))
    tracemalloc.start()
    data = decompress(kind, packed, size)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(data) == size
    assert peak < 1.2 * size


def make_a_pipe(path: Path) -> None:
    os.mkfifo(path)


@pytest.mark.parametrize("name", ["y.db3", "y.mcap", "y.db3.zstd", "metadata.yaml"])
@pytest.mark.parametrize("make", [make_a_pipe, Path.mkdir])
def test_a_pipe_in_a_bag_is_skipped(
    name: str, make: Callable[[Path], None], tmp_path: Path
) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    mcap_file(folder / "x.mcap", compression=CompressionType.NONE)
    make(folder / name)
    result = BagFolder.of(folder)
    assert [file.name for file in result.files] == ["x.mcap"]
    assert ("skipped: not a file" in " ".join(result.notes)) == (name != "metadata.yaml")
    assert len(read_trajectory(str(folder))) == COUNT


def test_a_pipe_that_the_metadata_lists_is_missing(tmp_path: Path) -> None:
    from made_bags import simple

    bag = simple(tmp_path / "bag")
    (file,) = (path for path in bag.iterdir() if path.suffix in (".db3", ".mcap"))
    file.unlink()
    os.mkfifo(file)
    assert f"lists {file.name}, which is missing" in refusal(bag)


METADATA = """rosbag2_bagfile_information:
  relative_file_paths: []
  topics_with_message_count:
  - topic_metadata: {{name: /a, type: b}}
    message_count: {}
"""


@pytest.mark.parametrize("number", ["0x" + "f" * 6000, "-1", "9223372036854775808", "1:" * 3000])
def test_a_number_of_messages_that_is_none_is_refused(number: str, tmp_path: Path) -> None:
    path = tmp_path / "metadata.yaml"
    path.write_text(METADATA.format(number))
    with pytest.raises(InputError, match=r"no bag information|64 bits|not valid YAML"):
        read_metadata(path)


def test_names_with_digits_that_are_no_numbers_are_sorted(tmp_path: Path) -> None:
    for name in ("x1²2.mcap", "x10.mcap", "x9.mcap", "x٣.mcap"):
        mcap_file(tmp_path / name)
    names = [file.name for file in BagFolder.of(tmp_path).files]
    assert names == ["x1²2.mcap", "x9.mcap", "x10.mcap", "x٣.mcap"]
