"""metadata.yaml of rosbag2 as Foxy to Rolling write it, and as nobody should."""

from __future__ import annotations

import io
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from made_bags import pose_stamped, the_file, write
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from ruamel.yaml import YAML

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

COUNT = 30  # in each of two files
MCAP, SQLITE3 = StoragePlugin.MCAP, StoragePlugin.SQLITE3
VERSIONS = range(1, 11)  # 10 isn't there yet
QOS = {
    "history": 3,
    "depth": 0,
    "reliability": 1,
    "durability": 2,
    "deadline": {"sec": 9223372036, "nsec": 854775807},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": 1,
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
QOS_BY_NAME = QOS | {
    "history": "unknown",
    "reliability": "reliable",
    "durability": "volatile",
    "liveliness": "automatic",
}


def dumped(value: Any) -> str:
    stream = io.StringIO()
    YAML(typ="safe").dump(value, stream)
    return stream.getvalue()


def information(version: int, paths: list[str], compression: str = "") -> dict[str, Any]:
    """Return what a recorder of that version writes about both files."""
    topic: dict[str, Any] = {"name": "/pose", "type": POSE_STAMPED, "serialization_format": "cdr"}
    duration = {"nanoseconds": COUNT * NANOSECONDS}
    start = {"nanoseconds_since_epoch": 0}
    result: dict[str, Any] = {
        "version": version,
        "storage_identifier": "mcap" if ".mcap" in paths[0] else "sqlite3",
        "relative_file_paths": paths,
        "duration": {"nanoseconds": 2 * COUNT * NANOSECONDS},
        "starting_time": start,
        "message_count": 2 * COUNT,
        "topics_with_message_count": [{"topic_metadata": topic, "message_count": 2 * COUNT}],
    }
    if version >= 3:
        result["compression_format"] = "zstd" if compression else ""
        result["compression_mode"] = compression
    if version >= 4:
        topic["offered_qos_profiles"] = dumped([QOS]) if version < 9 else [QOS_BY_NAME]
    if version >= 5:
        result["files"] = [
            {"path": path, "starting_time": start, "duration": duration, "message_count": COUNT}
            for path in paths
        ]
    if version >= 6:
        result["custom_data"] = None if version == 6 else {"robot": "r2"}
    if version >= 7:
        topic["type_description_hash"] = f"RIHS01_{0:064x}"
    if version >= 8:
        result["ros_distro"] = "rolling"
    return {"rosbag2_bagfile_information": result}


def rewrite(bag: Path, content: Any) -> None:
    (bag / "metadata.yaml").write_text(dumped(content))


def names_in(bag: Path) -> list[str]:
    return sorted(path.name for path in bag.iterdir() if path.name.startswith("split_"))


def split(folder: Path, storage: Any, compression: CompressionMode) -> Path:
    """Write a bag of two files, one after the other."""
    bag = folder / "split"
    bag.mkdir(parents=True)
    for number in range(2):
        stamps = [row * NANOSECONDS for row in range(number * COUNT, (number + 1) * COUNT)]
        messages = [
            ("/pose", POSE_STAMPED, stamp, pose_stamped(stamp, stamp / 1e9)) for stamp in stamps
        ]
        part = folder / f"part_{number}"
        write(part, messages, storage=storage, compression=compression)
        file = the_file(part)
        file.rename(bag / f"split_{number}{file.name.removeprefix(part.name)}")
    rewrite(bag, information(9, names_in(bag)))
    return bag


def make_older(file: Path, version: int) -> None:
    """Take from an sqlite3 file what recorders of a version didn't write yet."""
    database = sqlite3.connect(file)
    if version < 7:
        database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
        database.execute("DROP TABLE message_definitions")
    if version < 5:
        database.execute("DROP TABLE schema")
        database.execute("DROP TABLE metadata")
    if version < 4:
        database.execute("ALTER TABLE topics DROP COLUMN offered_qos_profiles")
    database.commit()
    database.close()


def assert_whole(bag: Path) -> list[str]:
    """Read a bag, and return the notes about its folder."""
    read = read_trajectory(str(bag), strict=True)
    assert read.positions[:, 0].tolist() == list(range(2 * COUNT))
    assert not read.reading.messages(Level.ERROR)
    assert not read.reading.dropped
    return [sentence for sentence in read.reading.messages(Level.NOTE) if str(bag) in sentence]


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[Any, Path]:
    folder = tmp_path_factory.mktemp("bags")
    return {
        (storage, mode): split(folder / f"{storage.name}_{mode.name}", storage, mode)
        for storage in (MCAP, SQLITE3)
        for mode in (CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE)
    }


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("mode", list(CompressionMode)[:3])
@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
def test_every_version(
    storage: Any, mode: Any, version: int, bags: dict[Any, Path], tmp_path: Path
) -> None:
    bag = tmp_path / "renamed"
    shutil.copytree(bags[storage, mode], bag)
    names = names_in(bag)
    if storage == SQLITE3 and mode != CompressionMode.FILE:
        for name in names:
            make_older(bag / name, version)
    paths = [f"split/{item}" for item in names] if version < 4 else names
    word = {CompressionMode.FILE: "FILE", CompressionMode.MESSAGE: "MESSAGE"}.get(mode, "")
    content = information(version, paths, word)
    rewrite(bag, content)
    assert not assert_whole(bag)
    # What is missing is counted, and told whatever the version.
    topics = content["rosbag2_bagfile_information"]["topics_with_message_count"]
    topics[0]["message_count"] += 7
    rewrite(bag, content)
    [text] = read_trajectory(str(bag)).reading.messages(Level.ERROR)
    assert text == f"{bag} declares 67 messages on /pose, but 60 were read"
    (bag / "metadata.yaml").unlink()
    assert not assert_whole(bag)


@pytest.mark.parametrize(
    "path",
    [
        "/elsewhere/NAME", "../other/NAME", "../split/NAME", "a/../../NAME", "C:\\bags\\NAME",
        "..\\NAME", "\\\\host\\share\\NAME", "s3://bucket/NAME", "/dev/NAME",
    ],
)  # fmt: skip
def test_nothing_outside_of_the_folder_is_read(
    path: str, bags: dict[Any, Path], tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(bags[MCAP, CompressionMode.NONE], bag)
    names = names_in(bag)
    # Where the paths lead to there are files, which hold nothing that a bag does.
    for other in (tmp_path / "other", tmp_path / "split", tmp_path):
        other.mkdir(exist_ok=True)
        for name in names:
            (other / name).write_text("mine")
    written = [path.replace("NAME", item) for item in names]
    rewrite(bag, information(9, written))
    [note] = assert_whole(bag)
    assert note == (
        f"{bag}/metadata.yaml lists {written[0]}, which is outside the bag's folder; move it "
        "into the folder"
    )
    (bag / names[1]).unlink()
    read = read_trajectory(str(bag))
    assert len(read) == COUNT
    assert f"{bag}/metadata.yaml lists {written[1]}, which is missing" in read.reading.messages(
        Level.ERROR
    )
    with pytest.raises(InputError, match="which is missing"):
        read_trajectory(str(bag), strict=True)


@pytest.mark.parametrize("path", ["..", ".", "", "/", "../..", "metadata.yaml/..", "x" * 5000])
def test_what_names_no_file_is_missing(path: str, bags: dict[Any, Path], tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(bags[MCAP, CompressionMode.NONE], bag)
    rewrite(bag, information(9, [*names_in(bag), path]))
    read = read_trajectory(str(bag))
    assert len(read) == 2 * COUNT
    assert read.reading.messages(Level.ERROR) == (
        f"{bag}/metadata.yaml lists {path}, which is missing",
    )


def test_files_of_the_recording_are_read_also_if_they_are_not_listed(
    bags: dict[Any, Path], tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(bags[MCAP, CompressionMode.NONE], bag)
    first, _ = names_in(bag)
    rewrite(bag, information(9, [first]))
    assert len(read_trajectory(str(bag))) == 2 * COUNT
    rewrite(bag, information(9, ["other.mcap"]))
    assert len(read_trajectory(str(bag))) == 2 * COUNT


@pytest.mark.parametrize(
    "change",
    [
        {"relative_file_paths": "split_0.mcap"},
        {"relative_file_paths": [1, 2]},
        {"relative_file_paths": [["split_0.mcap"]]},
        {"relative_file_paths": {"split_0.mcap": 1}},
        {"topics_with_message_count": 5},
        {"topics_with_message_count": [{"topic_metadata": {"name": [], "type": ""}}]},
        {
            "topics_with_message_count": [
                {"topic_metadata": {"name": "", "type": ""}, "message_count": float("inf")}
            ]
        },
    ],
)
def test_odd_metadata_is_not_used(
    change: dict[str, Any], bags: dict[Any, Path], tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(bags[MCAP, CompressionMode.NONE], bag)
    content = information(9, names_in(bag))
    content["rosbag2_bagfile_information"] |= change
    rewrite(bag, content)
    [note] = assert_whole(bag)
    text = f"{bag}/metadata.yaml has no bag information; metadata.yaml ignored"
    assert note == text


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
def test_a_decompressed_copy_is_not_read_twice(
    storage: Any, bags: dict[Any, Path], tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(bags[storage, CompressionMode.FILE], bag)
    compressed = names_in(bag)
    plain = bags[storage, CompressionMode.NONE]
    for name in names_in(plain):
        shutil.copy(plain / name, bag / name)
    rewrite(bag, information(9, compressed, "FILE"))
    assert not assert_whole(bag)
    (bag / "metadata.yaml").unlink()
    names = names_in(plain)
    assert assert_whole(bag) == [
        f"{bag / item} skipped, since {item}.zstd has the same data" for item in names
    ]
    # Decompressed by hand, and the compressed ones removed.
    for name in compressed:
        (bag / name).unlink()
    rewrite(bag, information(9, compressed, "FILE"))
    assert not assert_whole(bag)


def test_a_remote_path_in_the_metadata_is_not_fetched(
    bags: dict[Any, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upath = pytest.importorskip("upath", reason="universal-pathlib is missing")

    def fetch(*_: object, **__: object) -> None:
        raise AssertionError("a URL was looked at")

    monkeypatch.setattr(upath, "UPath", fetch)
    bag = tmp_path / "bag"
    shutil.copytree(bags[MCAP, CompressionMode.NONE], bag)
    rewrite(bag, information(9, [f"https://host.net/{name}" for name in names_in(bag)]))
    assert_whole(bag)
