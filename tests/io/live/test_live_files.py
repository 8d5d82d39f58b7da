"""Files of a live run: what is written is read, and what is no state of a run is refused."""

from __future__ import annotations

import errno
import os
import struct
import zlib
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.fix_selection import fixes_of_rows
from trajeval_ros.io.live.chunk_file import ChunkWriter, read_chunks
from trajeval_ros.io.live.fix_file import FixWriter, read_fix_rows

KINDS = {
    b"ONE_": np.dtype([("stamp", "<i8"), ("value", "<f8", 2)]),
    b"TWO_": np.dtype([("stamp", "<i8")]),
}


@settings(max_examples=20)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5)), max_size=8))
def test_tables_of_all_kinds_are_read_as_written(
    tmp_path_factory: pytest.TempPathFactory, chunks: list[tuple[bool, int]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "tables"
    path.unlink(missing_ok=True)
    writer = ChunkWriter(path, KINDS, {"format": "tables/1"})
    one, two, count = [], [], 0
    for is_one, rows in chunks:
        stamps = np.arange(count, count + rows) - 3
        count += rows
        if is_one:
            one.append(stamps)
            writer.add(b"ONE_", stamps, np.column_stack([stamps / 2, -stamps]), text={"at": count})
        else:
            two.append(stamps)
            writer.add(b"TWO_", stamps)
    writer.close()
    result = read_chunks(path, KINDS, "tables/1", "table")
    tables = {magic: np.concatenate(result.rows_of(kind)) for magic, kind in KINDS.items()}
    expected = np.concatenate([np.zeros(0), *one])
    first, second = (tables[b"ONE_"][name].tolist() for name in KINDS[b"ONE_"].names or ())
    assert (first, second) == (
        expected.tolist(),
        np.column_stack([expected / 2, -expected]).tolist(),
    )
    [name] = KINDS[b"TWO_"].names or ()
    assert tables[b"TWO_"][name].tolist() == np.concatenate([np.zeros(0), *two]).tolist()
    assert (result.torn, result.description) == (0, {"format": "tables/1"})
    assert [len(rows) for rows in result.rows] == [rows for _, rows in chunks if rows]
    texts = [place for place, (is_one, _) in enumerate(chunks) if is_one]
    assert result.described == sum(rows > 0 for _, rows in chunks[: texts[-1] if texts else 0])
    with pytest.raises(InputError, match="tables has schema tables/1"):
        read_chunks(path, KINDS, "tables/2", "table")


def test_a_text_longer_than_that_of_any_run_ends_a_file(tmp_path: Path) -> None:
    """Its objects would take 20 times its length of memory."""
    path = tmp_path / "x"
    ChunkWriter(path, KINDS, {"format": "tables/1"}).close()
    text = b'{"a": "' + bytes(16 * 1024 * 1024) + b'"}'
    chunk = struct.pack("<4sIII", b"TWO_", 0, len(text), zlib.crc32(text)) + text
    with path.open("ab") as file:
        file.write(chunk)
    assert read_chunks(path, KINDS, "tables/1", "table").torn == len(chunk)


def test_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x")
    with pytest.raises(InputError, match="x can't be read: it is not a regular file"):
        read_chunks(tmp_path / "x", KINDS, "tables/1", "table")


def test_trouble_of_the_disk_at_the_end_is_told(tmp_path: Path) -> None:
    for place, fails in enumerate(("fsync", "write", "nothing")):
        writer = ChunkWriter(tmp_path / str(place), KINDS, {"format": "tables/1"})
        writer.add(b"TWO_", np.zeros(1, dtype=np.int64))
        error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if fails == "nothing":
            writer.close()
            assert writer.trouble == ""
            continue
        with (
            mock.patch.object(os, fails, side_effect=error),
            pytest.raises(InputError, match="can't be written completely: no space left"),
        ):
            writer.close()
    writer = ChunkWriter(tmp_path / "both", KINDS, {"format": "tables/1"})
    writer.add(b"TWO_", np.zeros(1, dtype=np.int64))
    other = OSError(errno.EIO, os.strerror(errno.EIO))
    with (
        mock.patch.object(os, "write", side_effect=error),
        mock.patch.object(os, "fsync", side_effect=other),
        pytest.raises(InputError, match="no space left"),  # the first of the two
    ):
        writer.close()


def test_fixes_are_read_as_written(tmp_path: Path) -> None:
    writer, rng = FixWriter(tmp_path), np.random.default_rng(0)
    rows = rng.normal(size=(7, 14))
    rows[:, 3:5] = rng.integers(-1, 3, size=(7, 2))
    for part in (slice(0, 3), slice(3, 7)):
        writer.append(np.arange(7)[part], fixes_of_rows(rows[part, :3], rows[part, 3:]))
    writer.close()
    stamps, result, remarks = read_fix_rows(tmp_path)
    assert (stamps.tolist(), remarks) == (list(range(7)), [])
    np.testing.assert_array_equal(result, rows)
