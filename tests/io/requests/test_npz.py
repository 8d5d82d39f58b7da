"""Joint covariances from strangers: a sentence for what is none, and no memory for bombs."""

from __future__ import annotations

import io
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.exceptions import InputError
from trajeval_ros.io import npz_file
from trajeval_ros.io.covariance_file import read_joint_covariance, write_joint_covariance

COUNT = 40
MIB = 1 << 20


@pytest.fixture
def path(tmp_path: Path) -> Path:
    random = np.random.default_rng(0)
    root = random.normal(size=(6 * COUNT, 6 * COUNT))
    joint = JointCovariance(
        stamps=np.arange(COUNT),
        positions=random.normal(size=(COUNT, 3)),
        quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)),
        block=6,
        covariance=root @ root.T,
    )
    write_joint_covariance(tmp_path / "x.npz", joint)
    return tmp_path / "x.npz"


def npy(array: Any) -> bytes:
    output = io.BytesIO()
    np.save(output, array, allow_pickle=True)
    return output.getvalue()


def replaced(path: Path, name: str, data: bytes) -> None:
    """Have another array in an archive."""
    with zipfile.ZipFile(path) as old:
        members = {item: old.read(item) for item in old.namelist()} | {f"{name}.npy": data}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for item, content in members.items():
            new.writestr(item, content)


def flip_in_the_covariance(path: Path) -> None:
    content = bytearray(path.read_bytes())
    place = content.find(b"cov.npy") + 3000
    content[place : place + 40] = bytes(40)
    path.write_bytes(content)


def unknown_compression(path: Path) -> None:
    content = bytearray(path.read_bytes())
    for place in range(len(content)):
        if content.startswith(b"PK\x01\x02", place):
            content[place + 10] = 99
    path.write_bytes(content)


def lying_about_its_size(path: Path) -> None:
    head = npy(np.zeros((2, 2))).replace(b"(2, 2)", b"(2000000, 2000000)")
    replaced(path, "cov", head)


def of_objects(path: Path) -> None:
    replaced(path, "cov", npy(np.array([{}] * COUNT)))


def too_long(path: Path) -> None:
    replaced(path, "cov", npy(np.eye(6 * COUNT)) + b"more")


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize(
    "damage",
    [
        flip_in_the_covariance,
        unknown_compression,
        lying_about_its_size,
        of_objects,
        too_long,
        empty,
    ],
)
def test_what_is_no_archive_of_arrays_is_one_sentence(
    damage: Callable[[Path], None], path: Path
) -> None:
    read_joint_covariance(path)
    damage(path)
    with pytest.raises(InputError, match=r"x\.npz") as raised:
        read_joint_covariance(path)
    assert "\n" not in str(raised.value)


def test_members_that_nobody_asks_for_are_not_loaded(path: Path) -> None:
    replaced(path, "more", npy(np.zeros(64 * MIB // 8)))
    assert path.stat().st_size < MIB
    tracemalloc.start()
    read_joint_covariance(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 16 * MIB


def test_an_array_that_becomes_much_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(npz_file, "_LARGEST", 32 * MIB)
    replaced(path, "cov", npy(np.zeros((2900, 2900))))
    assert path.stat().st_size < MIB
    with pytest.raises(InputError, match="cov has a compression ratio above 500"):
        read_joint_covariance(path)


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -1e30])
def test_timestamps_that_are_none_are_refused(stamp: float, path: Path) -> None:
    with np.load(path) as archive:
        stamps = archive["stamps_ns"].astype(np.float64)
    stamps[0] = stamp
    replaced(path, "stamps_ns", npy(stamps))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="stamps_ns are not all timestamps"):
            read_joint_covariance(path)
