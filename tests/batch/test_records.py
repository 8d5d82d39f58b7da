"""Records of evaluated runs: what isn't whole is evaluated anew, and costs no other record."""

from __future__ import annotations

import dataclasses
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trajeval_ros.batch.records import (
    HEAD_BYTES,
    OWN,
    Record,
    RecordStore,
    decode,
    encode,
    entry_head,
)
from trajeval_ros.exceptions import InputError

in_one_folder = settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)


def record_of(number: int) -> Record:
    columns = {"8m.position_m": np.arange(5.0) + number, "path": np.full((4, 3), float(number))}
    return Record(f"{number:032d}", {"runs": [{"n": number}]}, ("8m",), (0, number), columns)


def decoded(entry: bytes, changed: dict[str, Any]) -> Record | None:
    """Return the record of an entry whose head says something else, with a right checksum."""
    head = entry_head(entry)
    assert head is not None
    end = HEAD_BYTES + head.drawn_bytes
    line, _, values = entry[HEAD_BYTES:end].partition(b"\n")
    drawn = json.dumps({**json.loads(line), **changed}).encode() + b"\n" + values
    return decode(head._replace(drawn_sum=zlib.crc32(drawn)), drawn, entry[end:])


def test_a_record_comes_back_with_and_without_its_large_columns(tmp_path: Path) -> None:
    store = RecordStore(tmp_path)
    store.add(encode(record_of(1)))
    store.add(encode(record_of(2)))
    for result in (store, RecordStore(tmp_path)):
        whole = result.read(record_of(2).key)
        assert whole is not None
        assert whole.result == {"runs": [{"n": 2}]}
        assert (whole.lengths, whole.span_ns) == (("8m",), (0, 2))
        np.testing.assert_array_equal(whole.columns["8m.position_m"], np.arange(5.0) + 2)
        brief = result.read(record_of(2).key, with_pooled=False)
        assert brief is not None
        assert list(brief.columns) == ["path"]
        assert result.read("none") is None
        assert len(result) == 2


@pytest.mark.parametrize(
    "changed",
    [
        {"schema": "trajeval-run/0"},
        {"drawn": 0.5},
        {"drawn": {"path": [0.5]}},
        {"drawn": {"path": 4}},
        {"pooled": {}},
        {"span_ns": 3},
        {"span_ns": [1]},
        {"span_ns": ["a", "b"]},
        {"lengths": None},
        {"result": []},
        {"result": {"runs": []}},
        {"result": {"runs": "none"}},
    ],
)
def test_a_record_of_another_structure_is_none(changed: dict[str, Any]) -> None:
    entry = encode(record_of(1))
    assert decoded(entry, {}) is not None
    assert decoded(entry, changed) is None


@in_one_folder
@given(st.data())
def test_a_file_that_was_cut_off_loses_what_was_in_flight(tmp_path: Path, data: Any) -> None:
    path = tmp_path / OWN
    path.unlink(missing_ok=True)
    store = RecordStore(tmp_path)
    ends = []
    for number in range(3):
        store.add(encode(record_of(number)))
        ends.append(path.stat().st_size)
    size = data.draw(st.integers(0, ends[-1]))
    with path.open("r+b") as file:
        file.truncate(size)
    left = RecordStore(tmp_path)
    whole = sum(end <= size for end in ends)
    assert len(left) == whole
    left.add(encode(record_of(7)))
    again = RecordStore(tmp_path)
    assert len(again) == whole + 1
    for number in (*range(whole), 7):
        assert again.read(record_of(number).key) is not None


@in_one_folder
@given(st.data())
def test_a_flipped_bit_is_never_read_as_a_number(tmp_path: Path, data: Any) -> None:
    entries = [encode(record_of(number)) for number in range(3)]
    text = bytearray(b"".join(entries))
    place = data.draw(st.integers(0, len(text) - 1))
    text[place] ^= 1 << data.draw(st.integers(0, 7))
    (tmp_path / OWN).write_bytes(text)
    store = RecordStore(tmp_path)
    damaged = place // len(entries[0])
    for number in range(3):
        result = store.read(record_of(number).key)
        if number == damaged:
            assert result is None
        elif number < damaged:
            assert result is not None
        if result is not None:
            expected = record_of(number).columns
            assert result.columns.keys() == expected.keys()
            for name, column in expected.items():
                np.testing.assert_array_equal(result.columns[name], column)


def test_of_two_records_of_a_run_the_later_one_counts(tmp_path: Path) -> None:
    store = RecordStore(tmp_path)
    first = record_of(1)
    store.add(encode(first))
    store.add(encode(dataclasses.replace(record_of(2), key=first.key)))
    result = RecordStore(tmp_path).read(first.key)
    assert result is not None
    assert result.span_ns == (0, 2)


def test_a_link_in_the_place_of_the_file_is_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"precious")
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / OWN).symlink_to(other)
    with pytest.raises(InputError, match="can't be written"):
        RecordStore(folder).add(encode(record_of(1)))
    assert other.read_bytes() == b"precious"
