"""Records of MCAP files, and definitions of messages."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.io.bags.mcap_chunks import walked
from trajeval_ros.io.bags.mcap_records import (
    MESSAGE,
    head_of,
    records,
)
from trajeval_ros.io.bags.message_definitions import (
    LARGEST_MESSAGE,
    Connection,
    Repeated,
    UnplannedError,
    fields_of,
    recorded_fields,
    types_in,
)


def message(channel: int, time: int, payload: bytes) -> bytes:
    content = struct.pack("<HIQQ", channel, 5, time, time + 1) + payload
    return struct.pack("<BQ", MESSAGE, len(content)) + content


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 99), st.binary(max_size=20))))
def test_records_are_walked_up_to_the_first_incomplete_one(rows: Any) -> None:
    content = b"".join(message(*item) for item in rows)
    result, is_whole = walked(content)
    assert is_whole
    assert result.channels.tolist() == [channel for channel, *_ in rows]
    assert result.log_times.tolist() == [time for _, time, _ in rows]
    assert result.sizes.tolist() == [len(payload) for *_, payload in rows]
    for row, (channel, time, payload) in enumerate(rows):
        begin = int(result.offsets[row])
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
