"""Hashes of inputs: they change with every file that a source reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from trajeval_ros.batch.fingerprints import Fingerprints


def hashed(folder: Path, source: Path) -> str:
    """Hash with what an earlier start stored."""
    fingerprints = Fingerprints(folder / "inputs.json")
    found = fingerprints.of(str(source))
    fingerprints.save()
    return found


@pytest.mark.parametrize("name", ["times.txt", "07_times.txt", "07.txt-wal"])
def test_a_file_beside_is_a_part_of_the_input(tmp_path: Path, name: str) -> None:
    poses = tmp_path / "07.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (tmp_path / "notes.txt").write_text("another file\n")
    alone = hashed(tmp_path, poses)
    assert hashed(tmp_path, poses) == alone
    (tmp_path / name).write_text("0.5\n")
    first = hashed(tmp_path, poses)
    assert first != alone
    (tmp_path / name).write_text("1.25\n")
    assert hashed(tmp_path, poses) not in (alone, first)
    (tmp_path / name).unlink()
    assert hashed(tmp_path, poses) == alone


def test_all_files_of_a_bag_are_its_input(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "0.mcap").write_bytes(b"\x89MCAP0\r\n")
    alone = hashed(tmp_path, bag)
    (bag / "metadata.yaml").write_text("x: 1\n")
    assert hashed(tmp_path, bag) != alone
