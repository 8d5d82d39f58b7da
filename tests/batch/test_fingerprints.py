"""Hashes of inputs: they change with every file that a source reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from trajeval_ros.batch import fingerprints
from trajeval_ros.batch.fingerprints import Fingerprints


def hashed(folder: Path, source: Path) -> str:
    """Hash with what an earlier start stored."""
    memory = Fingerprints(folder / "inputs.json")
    result = memory.of(str(source))
    memory.save()
    return result


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


def test_hashes_of_old_files_are_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.txt"
    path.write_text("1 0 0 0 0 0 0 1\n")
    hashed(tmp_path, path)
    assert not (tmp_path / "inputs.json").exists()  # it can change within the same tick
    monkeypatch.setattr(fingerprints, "_SETTLED_NS", -(10**18))
    hashed(tmp_path, path)
    assert list(json.loads((tmp_path / "inputs.json").read_text())) == [str(path)]


def test_the_times_of_an_array_are_a_part_of_it(tmp_path: Path) -> None:
    import numpy as np

    array, times = tmp_path / "poses_hall.npy", tmp_path / "tstamps_hall.npy"
    np.save(array, np.zeros((3, 7)))
    np.save(times, np.arange(3.0))
    before = Fingerprints(tmp_path / "memory.json").of(str(array))
    np.save(times, np.arange(3.0) + 1.0)
    assert Fingerprints(tmp_path / "memory.json").of(str(array)) != before


@pytest.mark.parametrize(("every_s", "is_saved"), [(-1.0, True), (1e6, False)])
def test_hashes_are_saved_from_time_to_time(
    every_s: float, is_saved: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fingerprints, "_SAVED_EVERY_S", every_s)
    source, memory = tmp_path / "x.txt", tmp_path / "memory.json"
    source.write_text("1 2 3\n")
    monkeypatch.setattr(fingerprints, "_SETTLED_NS", -1)  # a recent file may change again
    Fingerprints(memory).of(str(source))
    assert memory.exists() == is_saved
