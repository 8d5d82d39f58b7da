"""Bags in object storage: a real server on loopback, and the bytes that came from it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damaged_bags import COUNT, among_images, mcap_file, rows_of, split
from made_bags import simple, the_file
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags.byte_source import RemoteFile, counting_fetched_bytes
from trajeval_ros.io.sources import read_trajectory

upath = pytest.importorskip("upath", reason="universal_pathlib is missing")


@pytest.fixture(scope="module")
def wire() -> Iterator[Any]:
    """Return the wire to a server with a bucket of bags."""
    pytest.importorskip("moto.server", reason="moto's server is missing")
    pytest.importorskip("s3fs", reason="s3fs is missing")
    from object_store import bucket

    with bucket(STORE) as wire:
        yield wire


STORE = "s3://flights"


def upload(file: Path) -> int:
    """Put a file into the bucket, and return its size."""
    (upath.UPath(STORE) / file.name).write_bytes(file.read_bytes())
    return file.stat().st_size


def upload_text(name: str, text: str) -> None:
    (upath.UPath(STORE) / name).write_text(text)


@pytest.mark.slow
def test_only_ranges_are_transferred(wire: Any, tmp_path: Path) -> None:
    size = upload(among_images(tmp_path / "x.mcap"))
    before = wire.carried
    assert rows_of(read_trajectory(f"{STORE}/x.mcap:/pose")) == list(range(COUNT))
    assert wire.carried - before < 0.05 * size


@pytest.mark.slow
@pytest.mark.usefixtures("wire")
def test_what_is_compressed_or_cut_is_read_as_well(tmp_path: Path) -> None:
    upload(mcap_file(tmp_path / "zstd.mcap", compression=CompressionType.ZSTD))
    assert rows_of(read_trajectory(f"{STORE}/zstd.mcap")) == list(range(COUNT))
    cut = among_images(tmp_path / "cut.mcap")
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    upload(cut)
    read = read_trajectory(f"{STORE}/cut.mcap:/pose")
    assert rows_of(read) == list(range(len(read)))
    assert len(read) > 0.4 * COUNT
    assert read.reading.messages(Level.ERROR)


@pytest.mark.usefixtures("wire")
def test_a_directory_in_a_store(tmp_path: Path) -> None:
    folder = split(tmp_path, StoragePlugin.MCAP)
    for file in folder.iterdir():
        (upath.UPath(STORE) / "both" / file.name).write_bytes(file.read_bytes())
    read = read_trajectory(f"{STORE}/both:/pose")
    assert rows_of(read) == list(range(200))
    assert not read.reading.messages(Level.ERROR)


@pytest.mark.usefixtures("wire")
def test_text_in_a_store(tmp_path: Path) -> None:
    text = tmp_path / "text.txt"
    text.write_text("".join(f"{row} {row} 2 3 0 0 0.6 0.8\n" for row in range(1, 9)))
    upload(text)
    assert rows_of(read_trajectory(f"{STORE}/text.txt")) == list(range(1, 9))
    with pytest.raises(InputError, match="is not a bag"):
        read_trajectory(f"{STORE}/text.txt:/pose")


def test_a_text_is_transferred_once(wire: Any, tmp_path: Path) -> None:
    text = tmp_path / "long.txt"
    rows = (f"{row}.000000 {row} 2 3 0 0 0.600000 0.800000\n" for row in range(1, 20_001))
    text.write_text("".join(rows))
    size = upload(text)
    before = wire.carried
    with counting_fetched_bytes() as fetched:
        assert len(read_trajectory(f"{STORE}/long.txt")) == 20_000
    assert fetched.total == size + 16  # the first bytes tell what it is
    assert size < wire.carried - before < 1.05 * size


@pytest.mark.usefixtures("wire")
def test_frames_in_a_store_have_the_times_beside_them(tmp_path: Path) -> None:
    poses, times = tmp_path / "07.txt", tmp_path / "times.txt"
    poses.write_text("".join(f"1 0 0 {row} 0 1 0 0 0 0 1 0\n" for row in range(5)))
    times.write_text("".join(f"{row}.5\n" for row in range(5)))
    for file in (poses, times):
        upload(file)
    read = read_trajectory(f"{STORE}/07.txt")
    assert read.name == "07"
    assert (read.stamps == [500_000_000 + row * 10**9 for row in range(5)]).all()
    upload_text("bad.txt", "1 0 0 0 0 0 0 1\nx\n")
    with pytest.raises(InputError, match=f"^{STORE}/bad.txt, line 2"):
        read_trajectory(f"{STORE}/bad.txt")


@pytest.mark.usefixtures("wire")
def test_an_object_that_vanishes_is_an_error_and_no_data(tmp_path: Path) -> None:
    upload(mcap_file(tmp_path / "gone.mcap"))
    path = upath.UPath(f"{STORE}/gone.mcap")
    file = RemoteFile(path)
    path.unlink()
    with pytest.raises(FileNotFoundError):
        file.read_all([(0, 4), (4, 4)])
    with pytest.raises(FileNotFoundError):
        file.read(0, 4)


@pytest.mark.usefixtures("wire")
def test_what_is_not_there_is_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_trajectory(f"{STORE}/y.mcap:/pose")
    other = the_file(simple(tmp_path / "bag", storage=StoragePlugin.SQLITE3))
    upload(other)
    with pytest.raises(InputError, match="copy it to this machine first"):
        read_trajectory(f"{STORE}/{other.name}")


@pytest.mark.parametrize("scheme", ["memory", "file"])
def test_other_stores(scheme: str, tmp_path: Path) -> None:
    content = among_images(tmp_path / "x.mcap").read_bytes()
    url = f"{scheme}://{tmp_path}/y.mcap"
    path = upath.UPath(url)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    read = read_trajectory(f"{url}:/pose")
    np.testing.assert_array_equal(read.positions[:, 0], np.arange(COUNT))


def test_who_asks_is_never_taken_for_a_host(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    class Nowhere:
        def __init__(self, url: str) -> None:
            asked.append(url)

        def exists(self) -> bool:
            return False

    monkeypatch.setattr(upath, "UPath", Nowhere)
    with pytest.raises(InputError, match="does not exist; check the URL"):
        read_trajectory("sftp://me@host.net:81/x.mcap:/odom")
    assert asked == [f"sftp://me@host.net{rest}" for rest in (
        ":81/x.mcap:/odom", ":81/x.mcap", "",
    )]  # fmt: skip
