"""Every command states how many poses a reader drops, and --strict refuses them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import here
from damaged_bags import mcap_file, payloads, split
from paths import SHARED
from rosbags.rosbag2 import StoragePlugin

from trajeval_ros import read_trajectory
from trajeval_ros.batch import executors
from trajeval_ros.cli.app import main

COUNT, LOST = 600, 200
ATTACK = SHARED / "data" / "field_cases" / "attack"


def _columns() -> np.ndarray:
    """Return times and poses (COUNT, 8) of a curve; every third position is not finite."""
    time = np.arange(COUNT) * 0.1
    angle = 0.2 * time
    zero = np.zeros(COUNT)
    return np.column_stack([
        1.6e9 + time, 3.0 * np.cos(angle), 3.0 * np.sin(angle), 0.1 * time,
        zero, zero, np.sin(angle / 2.0), np.cos(angle / 2.0),
    ])  # fmt: skip


def _damaged() -> np.ndarray:
    columns = _columns()
    columns[::3, 1] = np.nan
    return columns


def _rows(columns: np.ndarray) -> list[list[str]]:
    return [[f"{row[0]:.9f}", *map(repr, row[1:].tolist())] for row in columns]


def tum(folder: Path) -> Path:
    path = folder / "run.txt"
    path.write_text("".join(" ".join(row) + "\n" for row in _rows(_damaged())))
    return path


def named_csv(folder: Path) -> Path:
    path = folder / "run.csv"
    lines = ["t,x,y,z,qx,qy,qz,qw", *(",".join(row) for row in _rows(_damaged()))]
    path.write_text("\n".join(lines) + "\n")
    return path


def json_lines(folder: Path) -> Path:
    path = folder / "run.jsonl"
    names = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
    path.write_text("".join(
        "{" + ", ".join(f'"{name}": {"NaN" if value == "nan" else value}'
                        for name, value in zip(names, row, strict=True)) + "}\n"
        for row in _rows(_damaged())
    ))  # fmt: skip
    return path


def mcap(folder: Path) -> Path:
    whole = payloads(COUNT)
    messages = [payload if row % 3 else payload[:9] for row, payload in enumerate(whole)]
    return mcap_file(folder / "run.mcap", messages=messages)


FORMATS = [tum, named_csv, json_lines, mcap]


@pytest.fixture
def groundtruth(tmp_path: Path) -> str:
    path = tmp_path / "groundtruth.txt"
    path.write_text("".join(" ".join(row) + "\n" for row in _rows(_columns())))
    return str(path)


@pytest.mark.parametrize("make", FORMATS)
def test_trajectory_states_what_it_does_not_save(
    make: Callable[[Path], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = str(make(tmp_path))
    output = tmp_path / "saved"
    options = ["--save-as", "tum", "--output", str(output), "--quiet"]
    assert main(["trajectory", source, *options, "--strict"]) == 2
    assert f"{LOST} of {COUNT} poses dropped" in capsys.readouterr().err
    assert not output.exists()
    assert main(["trajectory", source, *options]) == 0
    assert f"{LOST} of {COUNT} poses dropped" in capsys.readouterr().err
    (saved,) = output.iterdir()
    assert len(read_trajectory(saved)) == COUNT - LOST


def _groundtruth_of_messages(folder: Path) -> str:
    whole = read_trajectory(mcap_file(folder / "whole.mcap", messages=payloads(COUNT)))
    assert whole.quaternions is not None
    rows = np.column_stack([whole.stamps / 1e9, whole.positions, whole.quaternions])
    np.savetxt(folder / "truth.txt", rows, fmt="%.9f")
    return str(folder / "truth.txt")


@pytest.mark.parametrize(
    ("verb", "stated"),
    [
        ("evaluate GROUNDTRUTH SOURCE", f"dropped: {LOST} not finite"),
        ("evaluate SOURCE GROUNDTRUTH", f"poses were dropped: {LOST} not finite"),
        ("info SOURCE", f"{LOST} dropped: not finite"),
        ("explain GROUNDTRUTH SOURCE 0.1m", f"{LOST} of {COUNT} poses dropped"),
        ("groundtruth SOURCE", f"{LOST} of {COUNT} poses dropped"),
        ("watch SOURCE", f"{LOST} of {COUNT} poses dropped"),
        pytest.param(
            "compare --figures 0 GROUNDTRUTH SOURCE",
            f"{LOST} of {COUNT} poses dropped",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "compare --figures 0 SOURCE GROUNDTRUTH",
            f"poses were dropped: {LOST} not finite",
            marks=pytest.mark.slow,
        ),
    ],
)
@pytest.mark.parametrize("make", [tum, mcap])
def test_every_command_states_dropped_poses(
    verb: str,
    stated: str,
    make: Callable[[Path], Path],
    groundtruth: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rows that are not finite, and messages that cannot be decoded."""
    if verb.startswith("compare"):
        pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(executors, "local_pool", lambda _: here())
    texts = {stated}
    if make is mcap:
        groundtruth = _groundtruth_of_messages(tmp_path)
        texts = {f"{LOST} that can't be decoded", f"{LOST} dropped: undecodable"}
    names = {"GROUNDTRUTH": groundtruth, "SOURCE": str(make(tmp_path))}
    main([names.get(word, word) for word in verb.split()])
    captured = capsys.readouterr()
    assert any(text in captured.out + captured.err for text in texts)


def test_evaluate_refuses_damaged_text_with_strict(
    groundtruth: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", groundtruth, str(tum(tmp_path)), "--strict"]) == 2
    assert f"{LOST} of {COUNT} poses dropped: {LOST} not finite" in capsys.readouterr().err
    assert main(["evaluate", groundtruth, groundtruth, "--strict"]) == 0


@pytest.mark.skipif(not ATTACK.is_dir(), reason="there are no field cases")
@pytest.mark.parametrize(
    ("name", "lost"),
    [("unreadable_85_of_100.mcap", "85 of 100"), ("two_thirds_nan.txt", "40 of 60")],
)
def test_damaged_field_cases_are_stated(
    name: str, lost: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--save-as", "tum", "--output", str(tmp_path / "saved")]
    assert main(["trajectory", str(ATTACK / name), *options]) == 0
    assert f"{lost} poses dropped" in capsys.readouterr().err
    assert main(["trajectory", str(ATTACK / name), *options, "--strict"]) == 2


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_files_that_the_metadata_does_not_list_are_read_and_named(
    storage: StoragePlugin, tmp_path: Path
) -> None:
    names = ("run_0", "run_1")
    bag = split(tmp_path, storage, names)
    metadata = bag / "metadata.yaml"
    ending = next(bag.glob("run_0.*")).suffix
    lines = metadata.read_text().replace("message_count: 200", "message_count: 100").splitlines()
    metadata.write_text("\n".join(line for line in lines if line.strip() != f"- run_1{ending}"))
    for strict in False, True:
        read = read_trajectory(bag, strict=strict)
        assert len(read) == 200
        notes = [remark.text for remark in read.reading.remarks]
        assert any(f"does not list run_1{ending}" in note for note in notes)
    # A file of another recording is named, and is no part of the bag.
    (bag / f"run_1{ending}").rename(bag / f"other{ending}")
    read = read_trajectory(bag)
    assert len(read) == 100
    notes = [remark.text for remark in read.reading.remarks]
    assert any(f"other{ending}, which is not read" in note for note in notes)
