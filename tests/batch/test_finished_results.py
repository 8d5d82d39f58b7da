"""`trajeval compare` of finished results, and of files without a configuration."""

from __future__ import annotations

import csv
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import compare, write_run

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")

from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.finished_results import FinishedResults
from trajeval_ros.batch.records import RECORDS, RecordStore
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError

SCALES = {"vio": 1.02, "slam": 1.01}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with results of two estimators on two sequences, without the inputs."""
    folder = tmp_path_factory.mktemp("results")
    for name, scale in SCALES.items():
        for sequence in ("hall", "yard"):
            truth = write_run(folder / "in" / "truth" / f"{sequence}.txt")
            estimate = write_run(folder / "in" / name / f"{sequence}.txt", scale)
            evaluate(truth, estimate, folder / f"{name}_{sequence}")
    shutil.rmtree(folder / "in")
    return folder


def evaluate(truth: Path, estimate: Path, output: Path, *more: str) -> None:
    sources = [str(truth), str(estimate), "--lengths", "4,8", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:  # figures take most of the time
        patch.setattr("trajeval_ros.report.figures.outcome_drawings", lambda _: {})
        assert main(["evaluate", *sources, "--output", str(output), *more]) == 0


def results(folder: Path) -> list[str]:
    return [str(path.parent) for path in sorted(folder.glob("*/result.json"))]


@pytest.mark.slow
def test_finished_results_have_their_own_numbers(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert compare(*results(folder), "--quiet", output=out) == 0
    with (out / "ate_position_m.csv").open() as file:
        rows = {row["algorithm"]: row for row in csv.DictReader(file)}
    assert sorted(rows) == ["slam", "vio"]
    for name in SCALES:
        for sequence in ("hall", "yard"):
            result = json.loads((folder / f"{name}_{sequence}" / "result.json").read_text())
            assert float(rows[name][sequence]) == result["runs"][0]["ate"]["position_m"]["rmse"]
    page = (out / "report.html").read_text()
    assert "hall" in page
    assert "slam" in page


@pytest.mark.slow
def test_paths_and_errors_are_those_of_the_evaluation(folder: Path, tmp_path: Path) -> None:
    (tmp_path / RECORDS).mkdir()
    FinishedResults([str(folder / "vio_hall")]).write_tables(tmp_path)
    (trial,) = summary_of(tmp_path).trials
    record = RecordStore(tmp_path / RECORDS).read(trial.key)
    assert record is not None
    path, truth = record.columns["path"], record.columns["groundtruth"]
    # The flight is a circle of 4 m, and the estimate one of 4 * 1.02 m about the same centre.
    radius = np.hypot(*(path[:, :2] - path[:, :2].mean(axis=0)).T).max()
    assert radius == pytest.approx(4.0 * 1.02, rel=0.02)
    assert np.hypot(*truth[:, :2].T).max() == pytest.approx(4.0, rel=1e-6)
    assert {"4m.position_m", "8m.position_m"} <= record.columns.keys()


@pytest.mark.slow
def test_other_settings_are_refused(folder: Path, tmp_path: Path) -> None:
    truth = write_run(tmp_path / "truth.txt")
    evaluate(truth, write_run(tmp_path / "a.txt", 1.01), tmp_path / "a", "--gauge", "sim3")
    with pytest.raises(InputError, match=r"with gauge se3, and .* with gauge sim3"):
        FinishedResults([str(folder / "vio_hall"), str(tmp_path / "a")])


@pytest.mark.slow
def test_split_and_whole_errors_are_not_mixed(folder: Path, tmp_path: Path) -> None:
    truth = write_run(tmp_path / "truth.txt")
    evaluate(truth, write_run(tmp_path / "a.txt", 1.01), tmp_path / "a", "--on-restart", "split")
    with pytest.raises(InputError, match=r"on_restart whole, and .* with on_restart split"):
        FinishedResults([str(folder / "vio_hall"), str(tmp_path / "a")])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--gauge", "yaw"], "so --gauge has no effect"),
        (["--common-time-span"], "so --common-time-span has no effect"),
        (["nothing.txt"], "nothing.txt has none"),
    ],
)
def test_what_finished_results_cannot_have_is_refused(
    more: list[str],
    message: str,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [*results(folder), *more, "--output", str(tmp_path / "out")]
    assert main(["compare", "--figures", "0", *given]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_equal_names_are_told_apart_by_folders(folder: Path, tmp_path: Path) -> None:
    again, other = tmp_path / "again", tmp_path / "other"
    shutil.copytree(folder / "vio_hall", again)
    (tmp_path / RECORDS).mkdir()
    FinishedResults([str(folder / "vio_hall"), str(again)]).write_tables(tmp_path)
    assert summary_of(tmp_path).algorithms == ["vio_hall vio", "again vio"]
    # Another groundtruth of the same name, as the topic of another live run.
    shutil.copytree(folder / "vio_hall", other)
    content = json.loads((other / "result.json").read_text())
    content["provenance"]["inputs"][content["groundtruth"]["source"]] = "0" * 64
    (other / "result.json").write_text(json.dumps(content))
    FinishedResults([str(folder / "vio_hall"), str(other)]).write_tables(tmp_path)
    assert sorted(summary_of(tmp_path).sequences) == ["other", "vio_hall"]
    with pytest.raises(InputError, match="is given twice"):
        FinishedResults([str(other), str(other)])


@pytest.mark.slow
def test_results_are_named_as_estimates_are(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robots = [str(folder / "vio_hall"), str(folder / "slam_yard")]
    assert "NAME=RESULT" in FinishedResults(robots).advice
    given = [f"Team={robot}" for robot in robots]
    assert compare(*given, output=tmp_path / "out") == 0
    summary = summary_of(tmp_path / "out")
    assert (summary.algorithms, summary.sequences) == (["Team"], ["hall", "yard"])
    assert [trial.status for trial in summary.trials] == ["ok", "ok"]
    assert "warning" not in capsys.readouterr().err
    assert not FinishedResults(results(folder)).advice
    assert compare(*robots, output=tmp_path / "apart") == 0
    assert capsys.readouterr().err.count("give results of one algorithm one name") == 1


@pytest.mark.slow
def test_a_comparison_is_not_written_into_a_result(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder / "vio_hall", copy)
    before = sorted(copy.iterdir())
    given = [str(folder / "slam_hall"), str(copy), "--output", str(copy)]
    assert main(["compare", "--figures", "0", *given]) == 2
    assert sorted(copy.iterdir()) == before


@pytest.mark.slow
def test_damaged_results_are_one_sentence(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder / "vio_hall", copy)
    (copy / "errors.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match="is damaged"):
        FinishedResults([str(copy)]).write_tables(tmp_path)
    (copy / "errors.npz").unlink()
    with pytest.raises(InputError, match=r"has no errors.npz"):
        FinishedResults([str(copy)])
    (copy / "result.json").write_text('{"schema": "trajeval/3"}')
    (copy / "errors.npz").touch()
    with pytest.raises(InputError, match="is damaged"):
        FinishedResults([str(copy)])
    (copy / "result.json").write_text("{")
    for _ in range(2):
        with pytest.raises(InputError, match="is not a result of an evaluation"):
            FinishedResults([str(copy)])
        os.truncate(copy / "result.json", 10 << 30)  # as after a crash; its memory is bounded


@pytest.mark.slow
@pytest.mark.parametrize("change", ["rmse", "estimate", "errors"])
def test_changed_values_are_refused_before_anything_is_written(
    change: str, folder: Path, tmp_path: Path
) -> None:
    copy, output = tmp_path / "copy", tmp_path / "new" / "output"
    shutil.copytree(folder / "vio_hall", copy)
    if change == "errors":
        arrays = dict(np.load(copy / "errors.npz"))
        name = next(name for name in arrays if name.endswith(".position_m"))
        np.savez(copy / "errors.npz", **{**arrays, name: arrays[name].astype(str)})
    else:
        content = json.loads((copy / "result.json").read_text())
        if change == "rmse":
            content["runs"][0]["ate"]["position_m"]["rmse"] = "small"
        else:
            content["runs"][0]["estimate"] = [1]
        (copy / "result.json").write_text(json.dumps(content))
    assert compare(folder / "slam_hall", copy, output=output) == 2
    assert not output.parent.exists()
    output.mkdir(parents=True)
    assert compare(folder / "slam_hall", copy, output=output) == 2
    assert not list(output.iterdir())


def test_files_need_no_configuration(tmp_path: Path) -> None:
    truth = write_run(tmp_path / "truth.txt")
    first, second = (write_run(tmp_path / name, 1.01) for name in ("a.txt", "b.txt"))
    out = tmp_path / "out"
    given = [str(truth), str(first), f"Ours={second}", "--quiet"]
    assert compare(*given, output=out) == 0
    summary = summary_of(out)
    assert (summary.algorithms, summary.sequences) == (["a", "Ours"], ["truth"])


@pytest.mark.parametrize("package", ["jinja2", "pyarrow"])
def test_a_missing_package_is_reported_before_the_evaluation(
    package: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    truth = write_run(tmp_path / "truth.txt")
    out = tmp_path / "out"
    assert compare(truth, truth, output=out) == 2
    text = capsys.readouterr().err
    assert package in text.lower()
    assert "pip install" in text
    assert not out.exists()
