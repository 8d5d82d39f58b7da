"""Folders of rosbag2: compressed, split, empty, and with wrong metadata."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from damaged_bags import SECOND, assert_whole, ending, rows_of, split
from made_bags import TYPES, header, pose_stamped, refusal, simple, the_file, write
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory


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
        text = "; ".join(read_trajectory(str(path)).reading.messages(Level.ERROR))
    except InputError as error:
        text = str(error)
    assert str(path) in text
    assert "trajeval-" not in text  # the folder of its copy


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_split_bags_are_ordered_by_time(storage: Any, tmp_path: Path) -> None:
    bag = split(tmp_path, storage)
    assert_whole(bag, 200)
    (bag / f"a_9{ending(storage)}").unlink()
    read = read_trajectory(str(bag))
    assert rows_of(read) == list(range(100, 200))
    text = "; ".join(read.reading.messages(Level.ERROR))
    assert "metadata.yaml lists a_9" in text
    assert "declares 200 messages on /pose, but 100 were read" in text


def test_one_file_of_several_that_is_no_bag(tmp_path: Path) -> None:
    bag = split(tmp_path, StoragePlugin.MCAP)
    (bag / "a_10.mcap").write_bytes(b"no bag at all")
    read = read_trajectory(str(bag))
    assert rows_of(read) == list(range(100))
    assert any("a_10.mcap skipped" in sentence for sentence in read.reading.messages(Level.ERROR))


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


def test_a_wrong_count_in_the_metadata(tmp_path: Path) -> None:
    bag = simple(tmp_path / "bag", 50)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 50", "message_count: 60"))
    read = read_trajectory(str(bag))
    assert len(read) == 50
    assert any(
        "declares 60 messages on /pose, but 50 were read" in sentence
        for sentence in read.reading.messages(Level.ERROR)
    )
