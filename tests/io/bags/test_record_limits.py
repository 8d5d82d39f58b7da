"""Limits of records, chunks and definitions: at them, below and above."""

from __future__ import annotations

import struct
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from memory_file import Memory, chunk
from refusals import is_refused

from trajeval_ros.io.bags import mcap_chunk_reading, message_definitions
from trajeval_ros.io.bags.bag_folder import FilePath
from trajeval_ros.io.bags.byte_source import GAP, DamagedError
from trajeval_ros.io.bags.mcap_chunks import chunk_at, walked
from trajeval_ros.io.bags.mcap_records import (
    CHUNK,
    MESSAGE,
    MessageIndex,
    MessageIndexBuilder,
    head_of,
    records,
)
from trajeval_ros.io.bags.message_definitions import (
    LARGEST_MESSAGE,
    Connection,
    Repeated,
    UnplannedError,
    fields_of,
    full_name,
    recorded_fields,
    types_in,
)

is_damaged = partial(is_refused, error=DamagedError)


def head(kind: str, first: int = 7, last: int = 9, size: int = 1000) -> bytes:
    """Return the header of a chunk's record."""
    times = struct.pack("<BQQQQI", CHUNK, 500, first, last, size, 0)
    return times + struct.pack("<I", len(kind)) + kind.encode() + struct.pack("<Q", 400)


@pytest.mark.parametrize("kind", ["", "zstd", "x" * 32])
def test_a_chunk_is_described_by_its_header(kind: str) -> None:
    content = b"before" + head(kind)
    found = chunk_at(Memory(content), 6, 509)  # type: ignore[arg-type]
    assert (found.offset, found.length, found.first, found.last) == (6, 509, 7, 9)
    assert (found.compression, found.size, found.is_cut) == (kind, 1000, False)
    assert found.data_offset == len(content)
    assert found.may_hold({1})
    found.channels = frozenset({2, 3})
    assert [found.may_hold(item) for item in ({1}, {1, 3}, set())] == [False, True, False]


def test_a_chunk_without_a_whole_header_is_damaged() -> None:
    for content in (head("x" * 33), head("zstd")[:40], head("")[:36], b"\xff" * 200):
        assert is_damaged(chunk_at, Memory(content), 0, 509)


def message(channel: int, time: int, payload: bytes) -> bytes:
    content = struct.pack("<HIQQ", channel, 5, time, time + 1) + payload
    return struct.pack("<BQ", MESSAGE, len(content)) + content


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 99), st.binary(max_size=20))))
def test_records_are_walked_up_to_the_first_incomplete_one(rows: Any) -> None:
    content = b"".join(message(*item) for item in rows)
    found, is_whole = walked(content)
    assert is_whole
    assert found.channels.tolist() == [channel for channel, *_ in rows]
    assert found.log_times.tolist() == [time for _, time, _ in rows]
    assert found.sizes.tolist() == [len(payload) for *_, payload in rows]
    for row, (channel, time, payload) in enumerate(rows):
        begin = int(found.offsets[row])
        whole = message(channel, time, payload)
        assert content[begin : begin + len(whole)] == whole
        assert head_of(content, begin) == (MESSAGE, len(whole) - 9)
    for cut in (1, 8, 9, 30):
        if cut < len(content):
            part, is_whole = walked(content[:-cut])
            ends = np.cumsum([31 + len(payload) for *_, payload in rows])
            kept = int(np.count_nonzero(ends <= len(content) - cut))
            assert len(part) == kept
            assert is_whole == (kept > 0 and ends[kept - 1] == len(content) - cut)
    padded = content + bytes(9)  # an opcode of zero is none
    assert len(list(records(padded))) == len(rows)
    short = content + struct.pack("<BQ", MESSAGE, 21) + bytes(21)  # less than a message's head
    part, is_whole = walked(short)
    assert (len(part), is_whole) == (len(rows), False)


def index(*offsets: int) -> MessageIndex:
    found = MessageIndexBuilder().done()
    found = MessageIndex(*(np.zeros(len(offsets), dtype=np.int64) for _ in range(4)))
    found.offsets = np.array(offsets, dtype=np.int64)
    return found


FAR = GAP + 1
SIZE = 40 * GAP


@pytest.mark.parametrize(
    ("offsets", "runs"),
    [
        ((), None),
        ((0,), [(0, 4096)]),
        ((SIZE - 10,), [(SIZE - 10, SIZE)]),
        ((5, 5 + GAP), [(5, 5 + GAP + 4096)]),
        ((5, 5 + FAR), [(5, 4101), (5 + FAR, 5 + FAR + 4096)]),
        ((5, 9, 9 + FAR, 20 + FAR, 20 + 3 * FAR), [(5, 4105), (9 + FAR, 4116 + FAR),
            (20 + 3 * FAR, 4116 + 3 * FAR)]),
        (tuple(range(0, 19 * GAP + 1, GAP)), [(0, 19 * GAP + 4096)]),
        (tuple(range(0, 20 * GAP - 4095, GAP)) + (20 * GAP - 4096,), [(0, 20 * GAP)]),
        (tuple(range(0, 20 * GAP - 4095, GAP)) + (20 * GAP - 4095,), None),
        (tuple(range(0, 20 * GAP + 1, GAP)), None),
    ],
)  # fmt: skip
def test_parts_of_a_chunk_are_read_if_they_are_at_most_half_of_it(offsets: Any, runs: Any) -> None:
    assert (GAP, mcap_chunk_reading._TAIL) == (1 << 16, 4096)
    plain = chunk(SIZE, SIZE, "")
    assert mcap_chunk_reading._runs_of(plain, index(*offsets)) == runs
    assert mcap_chunk_reading._runs_of(chunk(SIZE, SIZE), index(*offsets)) is None
    plain.is_cut = True
    assert mcap_chunk_reading._runs_of(plain, index(*offsets)) is None


@pytest.mark.parametrize(("size", "is_worthwhile"), [(8192, True), (8191, False)])
def test_one_message_of_a_small_chunk(size: int, *, is_worthwhile: bool) -> None:
    found = mcap_chunk_reading._runs_of(chunk(size, size, ""), index(0))
    assert found == ([(0, 4096)] if is_worthwhile else None)


def definition(fields: int, levels: int = 1, kind: str = "int8") -> str:
    """Return a type of such levels, whose innermost one has such fields."""
    text, parts = "", []
    for level in range(levels - 1):
        parts.append(f"{text}a/L{level + 1} inner\n")
        text = f"{'=' * 80}\nMSG: a/L{level + 1}\n"
    parts.append(text + "".join(f"{kind} f{row}\n" for row in range(fields)))
    return "".join(parts)


def has_fields(text: str) -> bool:
    return recorded_fields(Connection(0, "/x", "a/msg/T", "MSG", text, 0, "cdr", None)) is not None


@pytest.mark.parametrize(
    ("text", "is_accepted"),
    [
        (definition(1000), True),
        (definition(1001), False),
        (definition(1, 49), True),
        (definition(1, 50), True),
        (definition(1, 51), False),
        (definition(1, 1, f"int8[{LARGEST_MESSAGE}]"), True),
        (definition(1, 1, f"int8[{LARGEST_MESSAGE + 1}]"), False),
        (definition(2, 1, f"float64[{LARGEST_MESSAGE // 16}]"), True),
        (definition(1) + "#" * ((1 << 18) - len(definition(1))), True),
        (definition(1) + "#" * ((1 << 18) + 1 - len(definition(1))), False),
    ],
)
def test_definitions_have_limits(text: str, *, is_accepted: bool) -> None:
    assert has_fields(text) == is_accepted


def test_the_fields_of_a_definition() -> None:
    text = "a/In[2] two\nstring[] words\nbuiltin_interfaces/Time at\nbool[3] flags\n"
    text += f"{'=' * 80}\nMSG: a/In\nfloat32 x\nuint16[] many\n"
    inner = (("x", "f4"), ("many", Repeated("u2")))
    assert fields_of(types_in("MSG", text, "a/msg/T"), "a/msg/T") == (
        ("two", Repeated(inner, 2)),
        ("words", Repeated("text")),
        ("at", (("sec", "i4"), ("nanosec", "u4"))),
        ("flags", Repeated("?", 3)),
    )
    with pytest.raises(UnplannedError, match="b/msg/No is not defined"):
        fields_of(types_in("MSG", "b/No x\n", "a/msg/T"), "a/msg/T")
    with pytest.raises(UnplannedError, match="contains itself"):
        fields_of(types_in("MSG", "a/T[] x\n", "a/msg/T"), "a/msg/T")


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("a/B", "a/msg/B"),
        ("a/msg/B", "a/msg/B"),
        ("foxglove.PoseInFrame", "foxglove.PoseInFrame"),
        ("a/action/B", "a/action/B"),
    ],
)
def test_full_names_of_types(name: str, full: str) -> None:
    assert full_name(name) == full
    assert message_definitions.LARGEST_MESSAGE == 1 << 28


@pytest.mark.parametrize(
    ("written", "name", "leads_out"),
    [
        ("run_0.mcap", "run_0.mcap", False),
        ("old/run_0.mcap", "run_0.mcap", False),
        ("old\\run_0.mcap", "run_0.mcap", False),
        ("../run_0.mcap", "run_0.mcap", True),
        ("a/../run_0.mcap", "run_0.mcap", True),
        ("/data/run_0.mcap", "run_0.mcap", True),
        ("C:\\data\\run_0.mcap", "run_0.mcap", True),
        ("a:b/run_0.mcap", "run_0.mcap", False),
        ("a/c:/run_0.mcap", "run_0.mcap", False),
        ("", "", True),
        ("folder/", "", False),
    ],
)
def test_paths_in_the_metadata(written: str, name: str, *, leads_out: bool) -> None:
    path = FilePath(written)
    assert (path.name, path.leads_out) == (name, leads_out)


def test_a_definition_without_text_has_no_language() -> None:
    from trajeval_ros.io.bags.mcap_records import _connection

    channel: Any = SimpleNamespace(
        id=3, topic="/a", message_encoding="cdr", metadata={"offered_qos_profiles": "qos"}
    )
    for encoding, data, language, text in (
        ("ros2msg", b"int8 x", "MSG", "int8 x"),
        ("ros1msg", b"int8 x", "MSG", "int8 x"),
        ("ros2idl", b"module", "IDL", "module"),
        ("ros2msg", b" \n", "", " \n"),
        ("protobuf", b"\x0a", "", ""),
        ("ros2msg", b"\xff", "MSG", "\ufffd"),
    ):
        schema: Any = SimpleNamespace(name="a/B", encoding=encoding, data=data)
        found = _connection(channel, schema, {3: 5}, None)
        assert (found.language, found.definition) == (language, text)
        assert (found.id, found.topic, found.type, found.count) == (3, "/a", "a/msg/B", 5)
        assert (found.encoding, found.qos) == ("cdr", "qos")
    bare = _connection(channel, None, {}, None)
    assert (bare.type, bare.language, bare.definition, bare.count) == ("", "", "", 0)
