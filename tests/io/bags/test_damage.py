"""Damaged MCAP files: what is left is read, and what is lost is told."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damaged_bags import (
    COMPRESSIONS,
    COUNT,
    among_images,
    assert_damaged,
    assert_whole,
    chunks_of,
    mcap_file,
    payloads,
    rows_of,
)
from made_bags import STORE, refusal
from mcap.writer import CompressionType, IndexType

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory


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
        read = assert_damaged(path, "it is truncated; it has no footer; read to ")
        assert (
            f" {len(read) - 1}.0 s after its first message"
            in read.reading.messages(Level.ERROR)[0]
        )
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
    [text] = read.reading.messages(Level.ERROR)
    assert f"read to {len(read) - 1}.0 s after its first message" in text


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
                assert read_trajectory(str(path)).reading.messages(Level.ERROR)


@pytest.mark.parametrize("size", [0, 21])
def test_a_message_shorter_than_its_head_is_damage(size: int, tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "x.mcap", use_chunking=False)
    content = path.read_bytes()
    data = content.rfind(b"\x0f\x04\0\0\0\0\0\0\0")  # where the data end
    short = b"\x05" + size.to_bytes(8, "little") + bytes(size)
    path.write_bytes(content[:data] + short)
    read = assert_damaged(path, f"a message is too short at byte {data}")
    assert rows_of(read) == list(range(COUNT))


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
        remarks = json.loads(result.read_text())["runs"][0]["estimate"]["remarks"]
        return [remark["text"] for remark in remarks]

    assert main(given) == 0
    assert any(re.match(r"\d+ of \d+ chunks were read in part", note) for note in notes())
    assert main([*given, "--strict"]) == 0
    assert not any("in part" in note for note in notes())
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
    assert any(
        "a chunk does not match its checksum" in sentence
        for sentence in read.reading.messages(Level.ERROR)
    ), name
    assert 0.9 * COUNT < len(read) < COUNT


# Damage anywhere.


@pytest.mark.slow
@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_hundred_places_to_cut(compression: Any, chunked: bool, tmp_path: Path) -> None:
    path = mcap_file(
        tmp_path / "x.mcap", messages=payloads(200), compression=compression, use_chunking=chunked
    )
    content = path.read_bytes()
    refused = 0
    for place in np.random.default_rng(1).integers(0, len(content), 100).tolist():
        path.write_bytes(content[:place])
        if text := refusal(path):
            assert "\n" not in text
            refused += 1
            continue
        read = read_trajectory(str(path))
        assert rows_of(read) == list(range(len(read)))
        assert read.reading.messages(Level.ERROR)
    assert refused < 50


@pytest.mark.slow
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("chunked", [True, False])
def test_a_hundred_places_to_flip_a_byte(compression: Any, chunked: bool, tmp_path: Path) -> None:
    given = payloads(200)
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
    for place in generator.integers(0, len(content), 100).tolist():
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
        warnings = json.loads(result.read_text())["runs"][0]["remarks"]
        assert any(
            "truncated" in warning["text"] for warning in warnings if warning["level"] == "error"
        )
    assert main([*given, "--strict"]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert "truncated" in text
