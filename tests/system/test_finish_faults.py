"""Folders of live runs in which something is damaged: each estimate fails alone, in a sentence."""

from __future__ import annotations

import copy
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from state_file_contents import DESCRIPTION, STATE, columns, write_groundtruth
from state_rows import trajectory

from trajeval_ros.cli.app import main
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.state_file import FORMAT, StateWriter


def write_run(path: Path, description: Any, state: Any) -> None:
    """Write the files of a run as the node does, with texts that it might never write."""
    write_groundtruth(path.parent)
    stamps, _, estimate = columns()
    writer = StateWriter(path, DESCRIPTION)
    writer.append(trajectory(stamps, estimate))
    writer.close()
    path.write_bytes(
        chunk(json.dumps({"format": FORMAT, "name": path.stem, **description}))
        + path.read_bytes()[first_chunk(path) :]
        + chunk(json.dumps(state) if not isinstance(state, str) else state)
    )


def chunk(text: str) -> bytes:
    body = text.encode()
    return struct.pack("<4sIII", b"TESN", 0, len(body), zlib.crc32(body)) + body


def first_chunk(path: Path) -> int:
    """Return where the first chunk ends."""
    (length,) = struct.unpack_from("<I", path.read_bytes(), 8)
    return 16 + int(length)


def with_value(value: Any, *keys: str) -> Any:
    """Return a state in which one value is another."""
    changed = copy.deepcopy(STATE)
    inner = changed
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return changed


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with an estimate that is well."""
    write_run(tmp_path / "good.states", {**DESCRIPTION, "name": "good", "place": 1}, STATE)
    return tmp_path


@pytest.mark.slow
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
    options = [option.format(elsewhere) for option in options]
    assert main(["finish", str(folder), "--quiet", *options]) == 0
    names = {path.name for path in folder.iterdir()}
    assert ({"result.json", "errors.npz"} <= names) == is_written
    assert is_written or names == {"good.states", "groundtruth.states"}


ODD = {**DESCRIPTION, "name": "odd"}
ODD_KEYS = [
    ("groundtruth",),
    ("groundtruth", "dropped"),
    ("groundtruth", "notes"),
    ("groundtruth", "up"),
    ("estimate", "notes"),
    ("estimate", "up"),
    ("estimate", "resets"),
    ("warnings",),
    ("live",),
    ("aligned_by",),
    ("time_offset_s",),
    ("until_ns",),
    ("hand_eye",),
    ("fixes",),
    ("settings",),
    ("settings", "gauge"),
    ("settings", "lengths"),
]
ODD_VALUES = [
    {"a": 1}, [{}], "x", -1, 0.5, 10**40, float("nan"), 1e300, True,
    {"name": "up", "origin": "stated"},
]  # fmt: skip


def assert_fail_alone(folder: Path, *words: str) -> None:
    """Check that an estimate is evaluated, and others, too, or that they fail in a sentence."""
    file = folder / "result.json"
    assert main(["finish", str(folder), "--quiet", "--json", str(file)]) == 0
    result = json.loads(file.read_text(), parse_constant=lambda text: pytest.fail(text))
    names = {run["estimate"]["name"] for run in result["runs"]}
    reasons = {failed["name"]: failed["reason"] for failed in result["failed"]}
    assert "good" in names
    written = {path.stem for path in folder.glob("*.states")} - {"groundtruth"}
    assert names | reasons.keys() == written
    assert len(names) + len(reasons) == len(written)
    for reason in reasons.values():
        assert "\n" not in reason
        assert all(word in reason for word in words)


@pytest.mark.slow
@pytest.mark.parametrize("keys", ODD_KEYS, ids=".".join)
def test_states_that_the_node_never_writes(keys: tuple[str, ...], folder: Path) -> None:
    for number, value in enumerate(ODD_VALUES):
        path = folder / f"odd_{number}.states"
        write_run(path, {**DESCRIPTION, "name": path.stem}, with_value(value, *keys))
    assert_fail_alone(folder)


def test_descriptions_that_the_node_never_writes(folder: Path) -> None:
    for number, place in enumerate(({"a": 1}, [1], None, float("nan"))):
        path = folder / f"odd_{number}.states"
        write_run(path, {**DESCRIPTION, "name": path.stem, "place": place}, STATE)
    assert_fail_alone(folder)


def test_what_cannot_be_read_in_the_middle_is_told(folder: Path) -> None:
    path = folder / "odd.states"
    write_run(path, ODD, STATE)
    whole = path.read_bytes()
    path.write_bytes(whole + chunk("[no object]") + whole[first_chunk(path) :])
    outcome = evaluate_folder(folder)
    (run,) = [item for item in outcome.runs if item.estimate.name == "odd"]
    lost = 16 + 11 + len(whole) - first_chunk(path)
    assert any(
        f"the last {lost} bytes can't be read" in warning for warning in run.evaluation.warnings
    )


def revise(path: Path) -> bytes:
    """Write the last version of a path; returns the content of its file."""
    stamps, _, states = columns()
    writer = StateWriter(path, ODD)
    writer.append(trajectory(stamps, states))
    writer.close()
    return path.read_bytes()


DAMAGES: list[Callable[[bytes], bytes]] = [
    lambda content: b"",
    lambda content: b"no file of states",
    lambda content: content[:40],
    lambda content: content.replace(FORMAT.encode(), b"trajeval-states/9"),
]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_revision_fails_alone(damage: Callable[[bytes], bytes], folder: Path) -> None:
    write_run(folder / "odd.states", ODD, STATE)
    path = folder / "odd.revised"
    path.write_bytes(damage(revise(path)))
    assert_fail_alone(folder, "odd.revised")
