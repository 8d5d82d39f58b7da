"""The commands in the table of docs/coming_from.md do what the table says."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fix_runs import fixes_of
from paths import ROOT, TESTS

import trajeval_ros
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.io.bags.write_bag import write_bag
from trajeval_ros.io.save_trajectories import save_trajectories
from trajeval_ros.io.sources import read_trajectory

DOCUMENT = ROOT / "docs" / "coming_from.md"
PAIR = TESTS / "data/parity/pairs/drone_loop"
_ROW = re.compile(r"\| (\d+) \| ([^|]+) \|[^|]*\| `([^`]+)` \|")
TASKS = {
    int(number): (task, command)
    for number, task, command in _ROW.findall(DOCUMENT.read_text(encoding="utf-8"))
}


def result_of(command: str, folder: Path) -> dict[str, object]:
    """Run a command that evaluates, and return its only run."""
    file = folder / "result of the command.json"
    assert main([*shlex.split(command)[1:], "--quiet", "--json", str(file)]) == 0
    result: dict[str, object] = json.loads(file.read_text())["runs"][0]
    return result


def has(*paths: str) -> Callable[[Path], None]:
    def check(folder: Path) -> None:
        for path in paths:
            assert list(folder.glob(path)), path

    return check


def saved_topics(folder: Path) -> None:
    names = {path.stem: len(read_trajectory(path)) for path in (folder / "texts").iterdir()}
    assert names == {"gt": 4000, "vio": 780}


def saved_pairs(folder: Path) -> None:
    estimate, reference = (
        read_trajectory(folder / "aligned" / f"{name}.txt") for name in ("vio", "vio_reference")
    )
    np.testing.assert_array_equal(estimate.stamps, reference.stamps)
    result = trajeval_ros.evaluate(reference, estimate, trajeval_ros.Protocol(gauge="none"))
    expected = trajeval_ros.evaluate(
        read_trajectory(folder / "gt.txt"), read_trajectory(folder / "vio.txt")
    )
    actual, theirs = result.ate["position_m"], expected.ate["position_m"]
    assert actual is not None
    assert theirs is not None
    assert actual.rmse == pytest.approx(theirs.rmse, rel=1e-9)


def merged(folder: Path) -> None:
    (path,) = (folder / "less").iterdir()
    assert len(read_trajectory(path)) == 300


def by_axis(folder: Path) -> None:
    result = json.loads((folder / "axes/result.json").read_text())["runs"][0]["ate"]["position_m"]
    with np.load(folder / "axes/errors.npz") as errors:
        squares = errors["vio.position_world_m"] ** 2
        assert errors["vio.rotation_body_deg"].shape == squares.shape
    assert squares.mean(axis=0).sum() == pytest.approx(result["rmse"] ** 2, rel=1e-12)


def latex(folder: Path) -> None:
    assert r"\toprule" in (folder / "comparison/tables.tex").read_text()


# What a command leaves behind, beyond its exit status of 0.
LEFT: dict[int, Callable[[Path], None]] = {
    3: has("paths/path_xy.png", "paths/path_3d.png"),
    6: has("boxes/relative_error.png"),
    7: saved_topics,
    8: saved_pairs,
    9: has("angles/*"),
    10: has("speeds/*"),
    11: has("coloured/*"),
    12: merged,
    15: latex,
    16: has("both/trajectory_top.png"),
    20: by_axis,
    21: has("errors.mcap"),
}
SLOW = (6, 15, 16, 20)
NEEDS = {**dict.fromkeys((3, 6, 9, 10, 11, 16), "matplotlib"), 15: "pyarrow", 17: "pyarrow"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the files that the table names."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(PAIR / "gt.txt", folder / "gt.txt")
    shutil.copy(PAIR / "est.txt", folder / "vio.txt")
    truth, estimate = read_trajectory(folder / "gt.txt"), read_trajectory(folder / "vio.txt")
    later = dataclasses.replace(estimate, stamps=estimate.stamps + 13_000_000, name="slam")
    save_trajectories(folder, [later], "tum")
    variances = np.linspace(1.0, 1.1, len(estimate))[:, None, None] * np.diag(
        [0.05**2] * 3 + [0.01**2] * 3
    )
    topics = [
        dataclasses.replace(truth, name="gt", reading=SourceInfo()),
        dataclasses.replace(estimate, name="vio", reading=SourceInfo(), covariances=variances),
    ]
    (bag,) = save_trajectories(folder, topics, "mcap", "Odometry")
    bag.rename(folder / "flight.mcap")
    fixes = fixes_of(truth.stamps[::20], truth.positions[::20])
    write_bag(folder / "rover", {"/fix": (fixes, "sensor_msgs/msg/NavSatFix")})
    (recorded,) = (folder / "rover").glob("*.mcap")
    recorded.rename(folder / "rover.mcap")
    for name in ("gt", "vio", "slam"):
        (folder / name).mkdir()
        shutil.copy(folder / f"{name}.txt", folder / name / "hall.txt")
    runs = "".join(f"  {name}: {name}/{{sequence}}.txt\n" for name in ("vio", "slam"))
    (folder / "runs.yaml").write_text(f"groundtruth: gt/{{sequence}}.txt\nruns:\n{runs}")
    return folder


def test_the_table_has_all_tasks() -> None:
    assert list(TASKS) == list(range(1, 23))


@pytest.mark.slow
@pytest.mark.parametrize(
    "number",
    [
        pytest.param(number, marks=[pytest.mark.slow] if number in SLOW else [])
        for number in sorted(TASKS)
    ],
)
def test_the_command_does_the_task(
    number: int,
    files: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if number in NEEDS:
        pytest.importorskip(NEEDS[number], reason=f"{NEEDS[number]} is missing")
    for file in files.iterdir():
        (tmp_path / file.name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    command = TASKS[number][1]
    if command.startswith("trajeval_ros."):
        names = {"trajeval_ros": trajeval_ros}
        names |= {name: read_trajectory(f"{name}.txt") for name in ("gt", "vio")}
        assert len(eval(command, names)) == 780
        return
    verb = shlex.split(command)[0]
    assert verb == "trajeval"
    assert main(shlex.split(command)[1:]) == 0
    LEFT.get(number, lambda folder: None)(tmp_path)


def ate_of(run: dict[str, object]) -> float:
    rmse: float = run["ate"]["position_m"]["rmse"]  # type: ignore[index]
    return rmse


@pytest.mark.slow
def test_what_the_commands_say_differs(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    runs = {number: result_of(TASKS[number][1], tmp_path) for number in (1, 2, 4, 5, 13, 14, 22)}
    assert len({ate_of(runs[number]) for number in (1, 2, 13, 14)}) == 4
    gauges = [runs[number]["alignment"]["gauge"] for number in (1, 2)]  # type: ignore[index]
    assert gauges == ["se3", "yaw"]
    every, few = (runs[number]["re"]["segments"] for number in (4, 5))  # type: ignore[index]
    assert [item.get("length_m") for item in every] == [1.0]
    assert [(item.get("frames"), item.get("turn_deg")) for item in few] == [(1, None), (None, 5.0)]
    assert runs[22]["consistency"]["per_pose"]["poses"] > 700  # type: ignore[index]
