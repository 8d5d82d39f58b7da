"""MCAP files of odd layouts: all of their poses are read, or it is said that some aren't."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from damaged_bags import SECOND, assert_damaged, assert_whole, definition, payloads, rows_of
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from mcap_layouts import MAGIC, Layout, Part, record

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

POSE, OTHER = 1, 2
PARTS, EACH = 4, 50
COUNT = PARTS * EACH
COMPRESSIONS = ["", "zstd", "lz4"]


def parts(compression: str = "") -> list[Part]:
    """Return poses in chunks, among messages of another channel."""
    given = payloads(COUNT)
    return [
        Part(
            [
                row
                for number in range(first, first + EACH)
                for row in (
                    (POSE, number * SECOND, given[number]),
                    (OTHER, number * SECOND, b"other"),
                )
            ],
            compression=compression,
        )
        for first in range(0, COUNT, EACH)
    ]


def layout(several: Sequence[Part]) -> Layout:
    return Layout(
        [Schema(1, definition(POSE_STAMPED), "ros2msg", POSE_STAMPED)],
        [Channel(POSE, "/pose", "cdr", {}, 1), Channel(OTHER, "/other", "x", {}, 0)],
        several,
    )


def written(tmp_path: Path, given: Layout) -> Path:
    path = tmp_path / "x.mcap"
    path.write_bytes(bytes(given))
    return path


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_missing_message_index_hides_no_pose(compression: str, tmp_path: Path) -> None:
    several = parts(compression)
    several[1] = dataclasses.replace(several[1], unindexed=frozenset([POSE]))
    assert_whole(written(tmp_path, dataclasses.replace(layout(several), has_summary=False)), COUNT)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_recorder_killed_between_the_indexes_of_its_last_chunk(
    compression: str, tmp_path: Path
) -> None:
    (whole,) = [Part([row for part in parts() for row in part.rows], compression=compression)]
    for unindexed in (POSE, OTHER):
        part = dataclasses.replace(whole, unindexed=frozenset([unindexed]))
        path = written(tmp_path, dataclasses.replace(layout([part]), has_summary=False))
        content = path.read_bytes()
        path.write_bytes(content[: content.rfind(record(0x0F, bytes(4)))])
        read = assert_damaged(path, "it is truncated")
        assert rows_of(read) == list(range(COUNT))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_strict_opens_chunks_that_their_index_says_hold_nothing(
    compression: str, tmp_path: Path
) -> None:
    several = parts(compression)
    several[1] = dataclasses.replace(several[1], unindexed=frozenset([POSE]))
    path = written(tmp_path, layout(several))
    assert rows_of(read_trajectory(str(path), strict=True)) == list(range(COUNT))
    read = read_trajectory(str(path))
    assert len(read) == COUNT - EACH
    assert (
        f"declares {COUNT} messages on /pose, but {COUNT - EACH} were read"
        in read.reading.messages(Level.ERROR)[0]
    )


@pytest.mark.parametrize("repeats", [True, False])
def test_what_the_statistics_count_must_be_there(repeats: bool, tmp_path: Path) -> None:
    given = layout(parts())
    counts = {POSE: COUNT + 1, OTHER: COUNT}
    path = written(tmp_path, dataclasses.replace(given, counts=counts, repeats=repeats))
    read = assert_damaged(path, f"declares {COUNT + 1} messages on /pose, but {COUNT} were read")
    assert rows_of(read) == list(range(COUNT))


def loose(number: int) -> Callable[[list[Part]], None]:
    def change(several: list[Part]) -> None:
        several[number] = dataclasses.replace(several[number], is_chunk=False)

    return change


def reserved(several: list[Part]) -> None:
    for part, opcode in zip(several, (0x10, 0x42, 0x7F, 0x80), strict=True):
        part.behind = record(opcode, b"what comes later")


def unlisted(several: list[Part]) -> None:
    several[2].is_listed = False


@pytest.mark.parametrize("has_statistics", [True, False])
@pytest.mark.parametrize("has_summary", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("change", [loose(0), loose(2), loose(3), reserved, unlisted])
def test_layouts_that_the_format_allows(
    change: Callable[[list[Part]], None],
    compression: str,
    has_summary: bool,
    has_statistics: bool,
    tmp_path: Path,
) -> None:
    several = parts(compression)
    change(several)
    given = dataclasses.replace(
        layout(several), has_summary=has_summary, has_statistics=has_statistics
    )
    path = written(tmp_path, given)
    assert_whole(path, COUNT)
    with Bag(path) as bag:
        played = [log_time for _, log_time, _ in bag.messages(bag.topics)]
    assert played == sorted(played)
    assert len(played) == 2 * COUNT


def test_records_between_chunks_that_cannot_be_followed_lose_no_other(tmp_path: Path) -> None:
    several = parts()
    several[1].behind = record(0x42, b"what comes later")
    path = written(tmp_path, layout(several))
    content = path.read_bytes()
    path.write_bytes(content.replace(b"\x42\x10\0\0", b"\x42\xff\xff\xff"))
    read = read_trajectory(str(path))
    assert rows_of(read) == list(range(COUNT))
    assert "are not readable" in read.reading.messages(Level.ERROR)[0]
    with pytest.raises(InputError, match="are not readable"):
        read_trajectory(str(path), strict=True)


@pytest.mark.parametrize("inside", [record(5, bytes(40))[:-1], bytes(20), record(5, bytes(9))])
def test_records_in_a_chunk_that_cannot_be_followed_are_told(
    inside: bytes, tmp_path: Path
) -> None:
    several = parts("zstd")
    several[1].inside = inside
    given = dataclasses.replace(layout(several), has_summary=False)
    read = assert_damaged(written(tmp_path, given), "has incomplete records")
    assert rows_of(read) == list(range(COUNT))


def test_messages_of_channels_that_nothing_describes_are_told(tmp_path: Path) -> None:
    several = [*parts(), Part([(7, SECOND, b"?")] * 3), Part([(8, SECOND, b"?")], is_chunk=False)]
    given = dataclasses.replace(layout(several), has_summary=False)
    read = assert_damaged(written(tmp_path, given), "4 messages of undefined channels")
    assert rows_of(read) == list(range(COUNT))


def test_a_summary_that_contradicts_itself_is_not_used(tmp_path: Path) -> None:
    path = written(tmp_path, layout(parts()))
    content = path.read_bytes()
    twice = struct.pack("<Q", 2 * COUNT)  # how many there are of both channels
    for wrong in (twice, struct.pack("<Q", 2 * COUNT + 1)):
        place = content.rfind(record(0x0B)[:1] + struct.pack("<Q", 42 + 4 + 20)) + 9
        assert content[place : place + 8] == twice
        path.write_bytes(content[:place] + wrong + content[place + 8 : -12] + bytes(4) + MAGIC)
        read = read_trajectory(str(path))
        assert rows_of(read) == list(range(COUNT))
        assert any(
            "is inconsistent" in sentence for sentence in read.reading.messages(Level.ERROR)
        ) == (wrong != twice)


def test_strict_has_a_sentence_for_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = dataclasses.replace(layout(parts()), counts={POSE: COUNT + 50, OTHER: COUNT})
    path = written(tmp_path, given)
    arguments = ["evaluate", "-g", f"{path}:/pose", "-e", f"{path}:/pose", "--lengths", "none"]
    assert main([*arguments, "--strict"]) == 2
    assert f"declares {COUNT + 50} messages on /pose, but {COUNT} were read" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize("place", ["in the chunk", "above the chunk"])
@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_summary_with_another_topic_than_the_data_is_reported(
    place: str, compression: str, tmp_path: Path
) -> None:
    """The poses of another topic could be taken for the requested ones."""
    rows = [(1, time * SECOND, payload) for time, payload in enumerate(payloads(60))]
    inside = RecordBuilder()
    Channel(1, "/pose", "cdr", {}, 1).write(inside)
    part = Part(rows, compression=compression)
    if place == "in the chunk":
        part = dataclasses.replace(part, before=inside.end())
    layout = Layout(
        [Schema(1, definition(POSE_STAMPED), "ros2msg", POSE_STAMPED)],
        [Channel(1, "/pose" if place == "above the chunk" else "/poze", "cdr", {}, 1)],
        [part],
    )
    content = bytes(layout)
    if place == "above the chunk":
        at = content.rindex(b"/pose")
        content = content[:at] + b"/poze" + content[at + 5 :]
        content = content[:-12] + bytes(4) + content[-8:]  # no checksum of the summary
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    sentence = "/poze is named '/pose' in another record"
    read = read_trajectory(path)
    assert len(read) == 60
    assert any(sentence in remark.text for remark in read.reading.remarks)
    with pytest.raises(InputError, match=sentence):
        read_trajectory(path, strict=True)
