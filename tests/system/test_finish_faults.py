"""Folders of live runs in which something is damaged: each estimate fails alone, in a sentence."""

from __future__ import annotations

import copy
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pair_file_contents import COUNT, DESCRIPTION, STATE, columns

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.pair_file import PairWriter, write_revised
from trajeval_ros.io.results.result_json import result_of


def write_run(path: Path, description: Any, state: Any) -> None:
    """Write a pair file as the node does, with texts that it might never write."""
    writer = PairWriter(path, DESCRIPTION)
    writer.append(*columns())
    writer.close()
    path.write_bytes(
        chunk(json.dumps(description)) + path.read_bytes()[first_chunk(path) :]
        + chunk(json.dumps(state) if not isinstance(state, str) else state)
    )  # fmt: skip


def chunk(text: str) -> bytes:
    body = text.encode()
    return struct.pack("<4sIII", b"TEPC", 0, len(body), zlib.crc32(body)) + body


def first_chunk(path: Path) -> int:
    """Return where the first chunk ends."""
    (length,) = struct.unpack_from("<I", path.read_bytes(), 8)
    return 16 + int(length)


def with_value(value: Any, *keys: str, of: Any = STATE) -> Any:
    """Return a state in which one value is another."""
    changed = copy.deepcopy(of)
    inner = changed
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return changed


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with an estimate that is well."""
    write_run(tmp_path / "good.pairs", {**DESCRIPTION, "place": 1}, STATE)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "is_written"),
    [
        ([], True),
        (["--json", "-"], False),
        (["--json", "{}/other.json"], False),
        (["--output", "{}/other"], False),
    ],
    ids=["alone", "json to stdout", "json", "output"],
)
def test_results_are_written_into_the_folder_of_the_run(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, options: list[str], is_written: bool
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    options = [each.format(elsewhere) for each in options]
    assert main(["finish", str(folder), "--quiet", *options]) == 0
    names = {path.name for path in folder.iterdir()}
    assert ({"result.json", "errors.npz"} <= names) == is_written
    assert is_written or names == {"good.pairs"}


ODD_STATES = [
    with_value(value, *keys)
    for keys in (
        ("groundtruth", "poses"),
        ("groundtruth", "states"),
        ("groundtruth", "duration_s"),
        ("groundtruth", "path_length_m"),
        ("groundtruth", "time_without_gaps_ns"),
        ("groundtruth", "frame"),
        ("groundtruth", "dropped"),
        ("groundtruth", "notes"),
        ("estimate", "states"),
        ("estimate", "child_frame"),
        ("estimate", "notes"),
        ("dropped",),
        ("warnings",),
        ("live",),
        ("aligned_by",),
        ("settings",),
        ("settings", "gauge"),
        ("settings", "lengths"),
    )
    for value in ({"a": 1}, [{}], "x", -1, 0.5, 10**40, float("nan"), 1e300, True)
    if (keys[-1], value) not in (("frame", "x"), ("child_frame", "x"))
]
ODD_RESETS = (
    {"a": 1},
    [{}],
    "x",
    True,
    [["1", 2.0, 3.0]],
    [[1.5, 2.0, 3.0]],
    [[1, 2.0]],
    [[1, True, 0.0]],
    [[1, -1.0, 0.0]],
)
ODD_DESCRIPTIONS = [
    with_value(value, key, of=DESCRIPTION)
    for key in ("groundtruth", "estimate", "place")
    for value in ({"a": 1}, [1], None, 10**400, float("nan"))
]


def assert_fails_alone(folder: Path, *words: str) -> None:
    """Check that one estimate fails in a sentence, and the other is evaluated."""
    result = folder / "result.json"
    status = main(["finish", str(folder), "--quiet", "--json", str(result)])
    if status == 0:
        runs = json.loads(result.read_text(), parse_constant=lambda text: pytest.fail(text))[
            "runs"
        ]
        names = [run["estimate"]["name"] for run in runs]
        assert "good" in names
        if "odd" in names:  # then it was as good as the other
            return
    outcome = evaluate_folder(folder)
    assert [run.estimate.name for run in outcome.runs] == ["good"]
    (failed,) = outcome.failed
    assert failed.name == "odd"
    assert "\n" not in failed.reason
    for word in words:
        assert word in failed.reason
    assert status in (0, 2)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(ODD_STATES)))
def test_a_state_that_the_node_never_writes(number: int, folder: Path) -> None:
    write_run(folder / "odd.pairs", DESCRIPTION, ODD_STATES[number])
    assert_fails_alone(folder)


@pytest.mark.parametrize("resets", ODD_RESETS, ids=str)
def test_resets_that_the_node_never_writes(resets: Any, folder: Path) -> None:
    write_run(folder / "odd.pairs", DESCRIPTION, with_value(resets, "estimate", "resets"))
    (failed,) = evaluate_folder(folder).failed
    assert "estimate.resets can't be" in failed.reason


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(ODD_DESCRIPTIONS)))
def test_a_description_that_the_node_never_writes(number: int, folder: Path) -> None:
    write_run(folder / "odd.pairs", ODD_DESCRIPTIONS[number], STATE)
    assert_fails_alone(folder)
    write_run(folder / "other.pairs", with_value("text", "place", of=DESCRIPTION), STATE)
    evaluate_folder(folder)


def test_what_cannot_be_read_in_the_middle_is_told(folder: Path) -> None:
    path = folder / "odd.pairs"
    write_run(path, DESCRIPTION, STATE)
    whole = path.read_bytes()
    path.write_bytes(whole + chunk("[no object]") + whole[first_chunk(path) :])
    outcome = evaluate_folder(folder)
    (run,) = [each for each in outcome.runs if each.estimate.name == "odd"]
    lost = 16 + 11 + len(whole) - first_chunk(path)
    assert any(f"the last {lost} bytes can't be read" in each for each in run.evaluation.warnings)


def test_rows_that_are_no_states_are_counted(folder: Path) -> None:
    stamps, truth, estimate = columns()
    truth[3, 0], estimate[5, 2], estimate[7, 1] = np.nan, np.inf, 1e308
    truth[9, 3:7] = 0.0
    writer = PairWriter(folder / "odd.pairs", DESCRIPTION)
    writer.append(stamps, truth, estimate, STATE)
    writer.close()
    runs = result_of(evaluate_folder(folder))["runs"]
    (association,) = [run["association"] for run in runs if run["estimate"]["name"] == "odd"]
    assert association["pairs"] == COUNT - 4
    assert association["dropped"] == {"not_finite": 4}
    json_text({"runs": runs})  # which refuses what is no number


# NAME.revised.npz


def revised(path: Path) -> bytes:
    """Write an estimate that its estimator has revised; returns the file."""
    stamps, _, states = columns()
    write_revised(path, stamps, states[:, :3], states[:, 3:7])
    return path.read_bytes()


def with_member(content: bytes, name: str, data: bytes | None) -> bytes:
    """Return an archive in which a member is another, or is missing."""
    output = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(content)) as old,
        zipfile.ZipFile(output, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for each in old.namelist():
            if each != name:
                new.writestr(each, old.read(each))
        if data is not None:
            new.writestr(name, data)
    return output.getvalue()


def unknown_compression(content: bytes) -> bytes:
    data = bytearray(content)
    data[data.find(b"PK\x01\x02") + 10] = 99
    return bytes(data)


def flipped(content: bytes) -> bytes:
    place = len(content) // 4  # in the positions
    return content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :]


def npy(array: Any) -> bytes:
    output = io.BytesIO()
    np.save(output, array, allow_pickle=True)
    return output.getvalue()


def lying(content: bytes) -> bytes:
    """Return an archive with an array that says it has terabytes."""
    head = npy(np.zeros((COUNT, 3)))
    return with_member(
        content, "positions.npy", head.replace(b"(200, 3)", b"(2000000000000, 3)")[:-20]
    )


DAMAGES: list[Callable[[bytes], bytes]] = [
    lambda content: b"",
    lambda content: b"no archive at all",
    lambda content: content[: len(content) // 2],
    flipped,
    unknown_compression,
    lying,
    lambda content: with_member(content, "positions.npy", None),
    lambda content: with_member(content, "positions.npy", b""),
    lambda content: with_member(content, "positions.npy", npy(np.zeros((7, 3)))),
    lambda content: with_member(content, "positions.npy", npy(np.zeros((COUNT, 3), complex))),
    lambda content: with_member(content, "stamps.npy", npy(np.array([{}] * COUNT))),
    lambda content: with_member(content, "stamps.npy", npy(np.array(["x"] * COUNT))),
    lambda content: with_member(content, "quaternions.npy", npy(np.zeros((0, 4)))),
]


def test_a_revision_has_its_own_poses_and_duration(folder: Path) -> None:
    write_run(folder / "odd.pairs", DESCRIPTION, STATE)
    stamps, _, states = (each[10:60] for each in columns())
    write_revised(folder / "odd.revised.npz", stamps, states[:, :3], states[:, 3:7])
    runs = result_of(evaluate_folder(folder))["runs"]
    (estimate,) = [run["estimate"] for run in runs if run["estimate"]["name"] == "odd"]
    assert estimate["poses"] == 50
    assert estimate["duration_s"] == pytest.approx(1e-9 * (stamps[-1] - stamps[0]), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_revision_fails_alone(damage: Callable[[bytes], bytes], folder: Path) -> None:
    write_run(folder / "odd.pairs", DESCRIPTION, STATE)
    path = folder / "odd.revised.npz"
    path.write_bytes(damage(revised(path)))
    assert_fails_alone(folder, "odd.revised.npz")


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_revision_alone_is_refused(
    damage: Callable[[bytes], bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / "odd.pairs", DESCRIPTION, STATE)
    path = tmp_path / "odd.revised.npz"
    path.write_bytes(damage(revised(path)))
    assert main(["finish", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "odd.revised.npz" in said
    with pytest.raises(InputError):
        evaluate_folder(tmp_path)
