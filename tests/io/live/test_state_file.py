"""Files of states: whatever happens to a disk, what was written whole is read, no more."""

from __future__ import annotations

import errno
import json
import os
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from state_rows import trajectory
from strategies import seeds

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.live import chunk_file
from trajeval_ros.io.live.state_file import RecordedStates, StateWriter, read_states
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.state_buffer import joined

DESCRIPTION = {"source": "/vio", "name": "vio", "place": 0}


def chunk(seed: int, count: int) -> Trajectory:
    random = np.random.default_rng(seed)
    rows = random.normal(size=(count, 10))
    rows[:, 7:] = np.nan
    stamps, arrived = random.integers(-(2**62), 2**62, size=(2, count))
    return trajectory(stamps, rows, arrived=arrived)


def write(path: Path, counts: list[int], seed: int = 0) -> list[Trajectory]:
    """Write chunks of states, every other one followed by counts; returns them."""
    path.unlink(missing_ok=True)
    writer = StateWriter(path, DESCRIPTION)
    chunks = [chunk(seed + place, count) for place, count in enumerate(counts)]
    for place, item in enumerate(chunks):
        writer.append(item)
        if place % 2:
            writer.describe({"number": place})
    writer.close()
    return chunks


def assert_prefix(read: RecordedStates, chunks: list[Trajectory]) -> int:
    """Assert that a file holds the first chunks, complete; returns their number."""
    ends, states = np.cumsum([0, *map(len, chunks)]), read.states
    held = int(np.searchsorted(ends, len(states), side="left"))
    assert ends[held] == len(states)
    assert states.velocities is None
    if held:
        expected = chunks[0]
        for following in chunks[1:held]:
            expected = joined(expected, following)
        for name in ("stamps", "positions", "quaternions"):
            np.testing.assert_array_equal(getattr(states, name), getattr(expected, name))
        np.testing.assert_array_equal(times_of(states), times_of(expected))
    return held


def times_of(states: Trajectory) -> NDArray[np.int64]:
    assert states.reading.receive_times is not None
    return states.reading.receive_times.times


@given(seed=seeds, counts=st.lists(st.integers(1, 4), min_size=1, max_size=5), data=st.data())
def test_a_file_torn_at_any_byte_holds_the_chunks_before(
    tmp_path_factory: pytest.TempPathFactory, seed: int, counts: list[int], data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "torn.states"
    chunks = write(path, counts, seed % 2**31)
    content = path.read_bytes()
    beginning = len(content) - sum(16 + 96 * count for count in counts) - 29 * (len(counts) // 2)
    cut = data.draw(st.integers(0, len(content)))
    path.write_bytes(content[:cut])
    if cut < beginning:
        with pytest.raises(InputError, match="is not a file of states"):
            read_states(path)
        return
    read = read_states(path)
    assert_prefix(read, chunks)
    assert read.torn < 16 + 96 * 4
    assert read.description["source"] == "/vio"
    end, state = beginning, {}
    for place, count in enumerate(counts):
        end += 16 + 96 * count + 29 * (place % 2)
        if place % 2 and end <= cut:
            state = {"number": place}
    assert read.state == state


@given(place=st.integers(0, 10_000), value=st.integers(0, 255))
def test_a_changed_byte_ends_a_file_before_its_chunk(
    tmp_path_factory: pytest.TempPathFactory, place: int, value: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "changed.states"
    chunks = write(path, [3, 2, 4])
    content = bytearray(path.read_bytes())
    beginning = len(content) - 4 * 16 - 9 * 96 - 13
    if content[place % len(content)] == value or place % len(content) >= beginning:
        content[place % len(content)] = value
        path.write_bytes(content)
        assert_prefix(read_states(path), chunks)
        return
    content[place % len(content)] = value
    path.write_bytes(content)
    with pytest.raises(InputError, match="is not a file of states"):
        read_states(path)


@pytest.mark.parametrize("count", [1, 2**20, 2**32 - 1])
@pytest.mark.parametrize("length", [0, 2**31, 2**32 - 1])
def test_a_head_that_lies_about_sizes_takes_no_memory(
    tmp_path: Path, count: int, length: int
) -> None:
    path = tmp_path / "hostile.states"
    chunks = write(path, [2])
    with path.open("ab") as file:
        file.write(struct.pack("<4sIII", b"TESN", count, length, 0) + b"rest")
    read = read_states(path)
    assert assert_prefix(read, chunks) == 1
    assert read.torn == 20


def test_ten_sparse_gigabytes_take_no_memory(tmp_path: Path) -> None:
    """As a file system leaves a file after a crash; zeros are no chunk."""
    path = tmp_path / "vio.states"
    chunks = write(path, [3, 2])
    size = path.stat().st_size
    os.truncate(path, 10 << 30)
    tracemalloc.start()
    recorded = read_states(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20
    assert assert_prefix(recorded, chunks) == 2
    assert recorded.torn == (10 << 30) - size


@pytest.mark.parametrize("text", [b"[1]", b"nonsense", b"\xff\xfe", b'"text"'])
def test_a_chunk_whose_text_is_no_object_is_damage(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "odd.states"
    chunks = write(path, [2])
    with path.open("ab") as file:
        file.write(struct.pack("<4sIII", b"TESN", 0, len(text), zlib.crc32(text)) + text)
    assert assert_prefix(read_states(path), chunks) == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"stamps,x,y,z\n1,2,3,4\n"),
        lambda path: path.mkdir(),
        lambda path: None,
    ],
    ids=["empty", "text", "folder", "missing"],
)
def test_what_is_no_file_of_states_is_one_sentence(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    path = tmp_path / "x.states"
    make(path)
    with pytest.raises(InputError, match=r"x\.states"):
        read_states(path)


def test_another_format_is_named(tmp_path: Path) -> None:
    path = tmp_path / "later.states"
    text = json.dumps({"format": "trajeval-states/9"}).encode()
    path.write_bytes(struct.pack("<4sIII", b"TESN", 0, len(text), zlib.crc32(text)) + text)
    with pytest.raises(InputError, match="trajeval-states/1"):
        read_states(path)


def test_a_file_that_exists_is_not_written_over(tmp_path: Path) -> None:
    path = tmp_path / "mine.states"
    path.write_text("mine")
    with pytest.raises(InputError, match="file exists"):
        StateWriter(path, DESCRIPTION)
    assert path.read_text() == "mine"


class Disk:
    """A disk that takes so many bytes more, and then fails as a full one does."""

    def __init__(self, room: int) -> None:
        self.room = room
        self._write = os.write

    def __call__(self, file: int, data: Any) -> int:
        if not self.room and len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = self._write(file, bytes(data[: self.room]))
        self.room -= taken
        return taken


@given(room=st.integers(0, 2500))
def test_a_full_disk_is_written_to_again(
    tmp_path_factory: pytest.TempPathFactory, room: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "full.states"
    path.unlink(missing_ok=True)
    chunks = [chunk(place, 3) for place in range(5)]
    writer = StateWriter(path, DESCRIPTION)
    disk = Disk(room)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "write", disk)
        for item in chunks[:4]:
            writer.append(item)
        is_full = room < 4 * (16 + 3 * 96)
        assert (writer.trouble == "no space left on device") == is_full
        assert assert_prefix(read_states(path), chunks) <= 4  # never half a chunk
        assert read_states(path).torn == 0
        disk.room = 10**6
        writer.append(chunks[4])
        assert writer.trouble == ""
        writer.close()
    assert assert_prefix(read_states(path), chunks) == 5
    assert writer.lost == 0


@pytest.fixture
def on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[StateWriter, Disk]:
    """A writer with four chunks, of which there is room for two to wait."""
    monkeypatch.setattr(chunk_file, "_MOST_WAITING", 700)
    writer = StateWriter(tmp_path / "lost.states", DESCRIPTION)
    disk = Disk(0)
    monkeypatch.setattr(os, "write", disk)
    for place in range(4):
        writer.append(chunk(place, 3))
    return writer, disk


def test_what_waits_for_a_disk_is_bounded_and_the_rest_counted(
    on_a_full_disk: tuple[StateWriter, Disk],
) -> None:
    writer, _ = on_a_full_disk
    assert writer.lost == 6
    with pytest.raises(InputError, match=r"can't be written completely: no space left"):
        writer.close()


def test_why_states_were_lost_is_known_when_the_disk_is_well_again(
    on_a_full_disk: tuple[StateWriter, Disk],
) -> None:
    writer, disk = on_a_full_disk
    disk.room = 10**6
    writer.write()
    assert (writer.trouble, writer.lost) == ("", 6)
    assert writer.why_lost == "no space left on device"
    writer.close()


def test_a_disk_that_is_full_from_the_start_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "write", Disk(3))
    with pytest.raises(InputError, match="no space left on device"):
        StateWriter(tmp_path / "never.states", DESCRIPTION)


def test_covariances_and_receptions_are_kept_in_order(tmp_path: Path) -> None:
    writer = StateWriter(tmp_path / "x.states", DESCRIPTION)
    random = np.random.default_rng(1)
    narrow, wide = random.normal(size=(3, 10)), random.normal(size=(2, 46))
    writer.append(trajectory(np.arange(3), narrow))
    writer.append(trajectory(np.arange(3, 5), wide, arrived=np.array([7, 9])))
    writer.append(trajectory(np.arange(5, 8), narrow))
    writer.close()
    read = read_states(tmp_path / "x.states").states
    np.testing.assert_array_equal(read.stamps, np.arange(8))
    rows = np.vstack([narrow, wide[:, :10], narrow])
    np.testing.assert_array_equal(read.positions, rows[:, :3])
    np.testing.assert_array_equal(read.velocities, rows[:, 7:])
    assert read.covariances is not None
    np.testing.assert_array_equal(read.covariances[3:5].reshape(2, 36), wide[:, 10:])
    assert not read.covariances[[0, 1, 2, 5, 6, 7]].any()
    assert times_of(read).tolist() == [UNKNOWN] * 3 + [7, 9] + [UNKNOWN] * 3
