"""The folder of results: which files are replaced, which stay, and what a failure leaves."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from strategies import make_groundtruth

from trajeval_ros.cli import evaluation_folder
from trajeval_ros.cli.evaluation_folder import contents, write_folder
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.results import error_archive
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.outcome import Outcome
from trajeval_ros.pipeline.pipeline import run
from trajeval_ros.pipeline.request import Request
from trajeval_ros.report.figure_style import FigureStyle

OURS = [
    "trajectory_top.png", "trajectory_side.pdf", "absolute_error.svg", "relative_error.pgf",
    "groundtruth_uncertainty.png", "mahalanobis.png", "likelihood_by_edge.png", "consistency.png",
    "consistency_12.pdf", "uncertainty_top_1.svg", "stanford_2.png", "stanford.pgf",
    "trajectory_top-img0.png", "consistency_3-img12.png", "errors.parquet", "run.rrd",
    "report.html",
]  # fmt: skip
OTHERS = [
    "notes.txt", "trajectory_top.jpg", "trajectory_top.png.bak", "my_absolute_error.png",
    "consistency_x.png", "consistency_.png", "trajectory_top_1.png", "trajectory_top-img.png",
    "trajectory.png", "mahalanobis", "stanford_1.npz", "errors.csv",
]  # fmt: skip


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    truth = make_groundtruth(3, 40)
    return run(truth, [truth], Request(Protocol()))


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation_folder, "_HAVE_FIGURES", False)
    monkeypatch.setattr(evaluation_folder, "_HAVE_PAGES", False)


def write(folder: Path, outcome: Outcome) -> None:
    write_folder(folder, result_of(outcome), outcome, FigureStyle())


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_files_of_an_earlier_evaluation_are_replaced_and_others_stay(
    outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(error_archive, "have_pyarrow", lambda: False)
    folder = tmp_path / "a" / "b"
    write(folder, outcome)
    assert names(folder) == {"result.json", "errors.npz"}
    for name in (*OURS, *OTHERS):
        (folder / name).write_text("old")
    (folder / "errors.npz").write_text("old")
    (folder / "result.json").write_text('{"schema": "trajeval/1"}')
    write(folder, outcome)
    assert names(folder) == {"result.json", "errors.npz", *OTHERS}
    assert all((folder / other).read_text() == "old" for other in OTHERS)
    assert json.loads((folder / "result.json").read_text()) == result_of(outcome)
    assert (folder / "errors.npz").read_bytes().startswith(b"PK")
    assert names(tmp_path / "a") == {"b"}


def test_the_picture_of_a_live_run_stays(outcome: Outcome, tmp_path: Path) -> None:
    (tmp_path / "run.rrd").write_text("live")
    (tmp_path / "vio.states").write_text("live")
    write(tmp_path, outcome)
    assert names(tmp_path) >= {"run.rrd", "vio.states", "result.json"}


@pytest.mark.parametrize("exists", [False, True])
def test_files_that_cannot_be_computed_leave_everything_as_it_was(
    exists: bool, outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    if exists:
        folder.mkdir()
        (folder / "result.json").write_text('{"schema": "trajeval/3"}')
        (folder / "stanford.png").write_text("old")
    before = names(folder) if exists else set()

    def full(path: Path, outcome: Outcome, columns: object) -> None:  # noqa: ARG001
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(error_archive, "write_errors", full)
    with pytest.raises(InputError, match=r"the folder .*out can't be written: no space left"):
        write(folder, outcome)
    assert folder.exists() == exists
    assert names(tmp_path) == ({"out"} if exists else set())
    assert (names(folder) if exists else set()) == before


def test_without_a_result_the_files_may_be_of_two_evaluations(
    outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """result.json goes first and comes last."""
    write(tmp_path, outcome)
    replace = Path.replace
    order = []

    def fails_late(self: Path, target: Path) -> Path:
        order.append(target.name)
        if target.name == "result.json":
            raise OSError(5, "Input/output error")
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fails_late)
        with pytest.raises(InputError, match="can't be written: input/output error"):
            write(tmp_path, outcome)
    assert order[-1] == "result.json"
    assert "errors.npz" in order
    assert "result.json" not in names(tmp_path)
    write(tmp_path, outcome)
    assert "result.json" in names(tmp_path)
    assert not any(name.startswith(".") for name in names(tmp_path))


def test_what_is_in_the_folder_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert contents(tmp_path).startswith(
        f"result.json and errors.npz are in {tmp_path}; report.html needs Jinja2, install it: "
    )
    assert "; errors.parquet needs pyarrow, install it: " in contents(tmp_path)
    assert "; figures need matplotlib, install it: " in contents(tmp_path)
    (tmp_path / "errors.parquet").write_text("")
    monkeypatch.setattr(evaluation_folder, "_HAVE_FIGURES", True)
    monkeypatch.setattr(evaluation_folder, "_HAVE_PAGES", True)
    assert contents(tmp_path) == (
        f"report.html, result.json, errors.npz, errors.parquet and figures are in {tmp_path}"
    )


def test_figures_are_of_what_was_computed_and_numbered_if_there_are_several_runs(
    outcome: Outcome,
) -> None:
    from trajeval_ros.report.figures import outcome_drawings

    usual = {"trajectory_top", "trajectory_side", "absolute_error", "relative_error"}
    shown = SimpleNamespace(covariances=object())
    (plain,) = outcome.runs
    tested = dataclasses.replace(plain, consistency=shown)  # type: ignore[arg-type]
    judged = dataclasses.replace(tested, integrity=object())  # type: ignore[arg-type]
    bands = {"consistency", "uncertainty_top"}
    for runs, expected in (
        ([plain], set()),
        ([judged], {*bands, "stanford"}),
        ([plain, judged], {*(f"{name}_2" for name in bands), "stanford_2"}),
        ([tested, judged], {*(f"{name}_{at}" for name in bands for at in (1, 2)), "stanford_2"}),
    ):
        several = dataclasses.replace(outcome, runs=tuple(runs))
        assert set(outcome_drawings(several)) == usual | expected
