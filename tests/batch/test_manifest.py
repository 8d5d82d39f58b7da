"""Comparisons of the runs that a CSV or Parquet file lists."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import pytest
from comparison_runs import compare, here, write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")

import pyarrow
import pyarrow.parquet

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.finished_comparison import RUNS
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.io.text.hints import SideHints

HEADER = ["algorithm", "sequence", "trial", "groundtruth", "estimate"]
ROWS = [
    [algorithm, sequence, trial, f"groundtruth/{sequence}.txt",
     f"{algorithm}/{sequence}_trial{trial}.txt"]
    for algorithm in ("good", "bad") for trial in "10" for sequence in ("yard", "hall")
]  # fmt: skip


def write_manifest(
    path: Path, rows: Sequence[Sequence[str]], header: Sequence[str] = HEADER
) -> Path:
    if path.suffix == ".csv":
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([header, *rows])
    else:
        columns = dict(zip(header, map(list, zip(*rows, strict=True)), strict=True))
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    return path


def refused(path: Path) -> str:
    with pytest.raises(InputError) as error:
        plan_of(path, {})
    message = str(error.value)
    assert "\n" not in message
    assert message.startswith(f"{path}")
    return message.removeprefix(f"{path}")


@pytest.mark.parametrize("name", ["runs.csv", "runs.parquet"])
def test_a_manifest_is_the_same_comparison_as_patterns(tmp_path: Path, name: str) -> None:
    patterns = plan_of(write_runs(tmp_path), {})
    listed = plan_of(write_manifest(tmp_path / name, ROWS), {"lengths": "4,8"})
    assert listed.runs == patterns.runs
    assert listed.settings == patterns.settings
    assert listed.title == "runs"


def test_numbers_in_parquet_are_names_and_trials_are_optional(tmp_path: Path) -> None:
    path = tmp_path / "runs.parquet"
    table = {
        "sequence": [10, 9],
        "algorithm": ["vio", "vio"],
        "estimate": ["/x/a.txt", "b.mcap:/odom"],
        "groundtruth": ["t.txt", "b.mcap:/mocap"],
    }
    pyarrow.parquet.write_table(pyarrow.table(table), path)
    runs = plan_of(path, {}).runs
    assert [run.name for run in runs] == ["vio 9", "vio 10"]
    assert (runs[0].groundtruth, runs[0].estimate) == (
        f"{tmp_path}/b.mcap:/mocap",
        f"{tmp_path}/b.mcap:/odom",
    )
    assert runs[1].estimate == "/x/a.txt"


def test_each_run_has_a_groundtruth_of_its_own(tmp_path: Path) -> None:
    for trial in "01":
        write_run(tmp_path / f"truth{trial}.txt", float(trial) + 1.0)
        write_run(tmp_path / f"estimate{trial}.txt", float(trial) + 1.0)
    rows = [["vio", "hall", trial, f"truth{trial}.txt", f"estimate{trial}.txt"] for trial in "01"]
    run_plan(plan_of(write_manifest(tmp_path / "runs.csv", rows), {}), tmp_path / "out", here)
    result = ResultsTable(tmp_path / "out" / RUNS).select(
        ["rmse"], kind="ate", metric="position_m"
    )
    assert [row["rmse"] for row in result] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_an_algorithm_without_a_sequence_of_others_is_missing_there(tmp_path: Path) -> None:
    rows = [row for row in ROWS if row[:2] != ["bad", "hall"]]
    rows = [row for row in rows if row[:3] != ["good", "yard", "0"]]  # is not expected
    path = write_manifest(tmp_path / "runs.csv", rows)
    runs = plan_of(path, {}).runs
    assert [run.name for run in runs if run.missing] == ["bad hall"]
    assert runs[3].missing == f"{path} lists no run of bad on hall"
    assert [run.name for run in runs] == [
        "good hall 0", "good hall 1", "good yard 1", "bad hall", "bad yard 0", "bad yard 1",
    ]  # fmt: skip


def test_a_configuration_names_a_manifest_and_has_the_settings(tmp_path: Path) -> None:
    (tmp_path / "lists").mkdir()
    write_manifest(tmp_path / "lists" / "runs.csv", ROWS)
    config = tmp_path / "c.yaml"
    config.write_text(
        "folder: lists\nmanifest: runs.csv\ngauge: yaw\ncolumns: {bad: t x y z qw qx qy qz}\n"
    )
    plan = plan_of(config, {})
    assert plan.request.protocol.gauge is Gauge.YAW
    assert plan.runs[0].estimate == f"{tmp_path}/lists/good/hall_trial0.txt"
    hints = {run.algorithm: run.hints for run in plan.runs}
    assert hints["bad"] == SideHints.of("t x y z qw qx qy qz", None) != hints["good"]


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("manifest: runs.csv\nruns: {vio: x}", "manifest and runs exclude each other"),
        ("manifest: runs.csv\ntrials: [0]", "manifest and trials exclude each other"),
        ("manifest: runs.txt", "runs.txt is not a manifest; give a .csv or .parquet file"),
        ("manifest: 3", "manifest must be a text"),
        ("manifest: s3://bucket/runs.csv", "add --allow-remote s3://bucket"),
        (
            "gauge: yaw",
            "has no 'groundtruth', which defines the files to compare; add it, or name",
        ),
    ],
)
def test_what_a_configuration_gets_wrong_is_told(tmp_path: Path, text: str, printed: str) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(text)
    assert printed in refused(config)


ONE = "vio,hall,0,t.txt,e.txt"


@pytest.mark.parametrize(
    ("lines", "printed"),
    [
        ([], " is empty; write a header line algorithm,sequence,trial,groundtruth,estimate and"),
        ([",".join(HEADER)], " lists no runs; write a header line"),
        (["algorithm,sequence,estimate", "vio,hall,e.txt"], " has no column groundtruth; write"),
        ([";".join(HEADER), ONE.replace(",", ";")],
         ", line 1: the columns are separated by semicolons; save the file with commas"),
        (['"{}"\r'.format('";"'.join(HEADER))], "separated by semicolons"),
        (["\t".join(HEADER), ONE.replace(",", "\t")], "are separated by tabs"),
        (["algorithm|sequence|estimate"], " has an unknown column 'algorithm|seq"),
        (["algorithm,sequence,trail,groundtruth,estimate", ONE], "did you mean trial?"),
        (["algorithm,sequence,trial,trial,groundtruth,estimate"], " has two columns trial"),
        ([",".join(HEADER), ONE, "", "vio,yard,0,t.txt,"],
         ", line 4: estimate is empty; fill it in or remove the row"),
        ([",".join(HEADER), "vio,,0,t.txt,e.txt"], ", line 2: sequence is empty"),
        ([",".join(HEADER), ONE, ONE],
         ", line 3: the run vio hall 0 is listed twice; remove one, or name every trial in"),
        ([",".join(HEADER), "vio,hall,0,t.txt"],
         ", line 2: 4 values for 5 columns; give one value per column"),
        ([",".join(HEADER), 'vio,hall,0,"t.txt'], " is not valid CSV: unexpected end of data"),
        ([",".join(HEADER), "vio,hall,0,t.txt,nosuch://x/e.txt"],
         ", line 2 has the remote URL nosuch://x/e.txt; if you trust the file, add"),
        ([",".join(HEADER), "vio,hall,0,t.txt,zip://e.txt::https://evil.org/x"],
         "is a chain of URLs"),
        ([",".join(HEADER), "vio,hall,0,t.txt,s3://me:secret@bucket/x"],
         "has a user name or password"),
    ],
)  # fmt: skip
def test_what_a_manifest_gets_wrong_is_told_in_one_sentence(
    tmp_path: Path, lines: list[str], printed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "runs.csv"
    path.write_text("\n".join(lines))
    out = tmp_path / "out"
    assert compare(path, output=out) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert printed in line
    assert "secret" not in line
    assert not out.exists()


def test_a_scheme_that_nobody_reads_is_told_before_any_host_is_asked(tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="fsspec is missing, the extra `remote`")
    path = write_manifest(tmp_path / "runs.csv", [["v", "s", "", "t.txt", "nosuch://x/e.txt"]])
    text = r"line 2: nosuch://x/e\.txt can't be read: the scheme nosuch is unknown; use one of "
    with pytest.raises(InputError, match=text):
        plan_of(path, {}, allow_remote=["nosuch://x"])


def test_other_bytes_are_no_manifest(tmp_path: Path) -> None:
    text = tmp_path / "runs.csv"
    text.write_bytes(b"algorithm,sequence,groundtruth,estimate\nvio,H\xf6he,t,e\n")
    assert refused(text) == ", line 2 is not UTF-8; save the file as UTF-8"
    text.write_bytes(b"\xef\xbb\xbfalgorithm,sequence,groundtruth,estimate\r\nvio, hall ,t,e\r\n")
    assert [run.name for run in plan_of(text, {}).runs] == ["vio hall"]
    table = tmp_path / "runs.parquet"
    table.write_bytes(b"PAR1 and no more")
    assert refused(table) == " is not a complete Parquet file; write it again"
    nested = pyarrow.table({**{name: ["x"] for name in HEADER}, "trial": [[1]]})
    pyarrow.parquet.write_table(nested, table)
    assert "column trial is list<" in refused(table)
    assert refused(tmp_path / "none.csv") == " does not exist; check the path"
    (tmp_path / "no.parquet").write_bytes(b"")
    assert "is not a complete Parquet file" in refused(tmp_path / "no.parquet")


@pytest.mark.slow
def test_a_file_that_is_listed_and_not_there_is_a_failed_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_runs(tmp_path)
    path = write_manifest(tmp_path / "runs.csv", [*ROWS, ["bad", "hall", "2", "x.txt", "y.txt"]])
    assert compare(path, output=tmp_path / "out") == 0
    text = capsys.readouterr()
    assert "8 runs evaluated, 1 failed or missing; report.html" in text.out
    assert f"warning: bad hall 2 failed: {tmp_path}/x.txt does not exist" in text.err


def test_a_comparison_without_any_number_is_an_error_with_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [["vio", "hall", trial, "x.txt", "y.txt"] for trial in "01"]
    path, out = write_manifest(tmp_path / "runs.csv", rows), tmp_path / "out"
    for _ in range(2):  # also if nothing has changed since
        assert compare(path, "-q", output=out) == 2
        (line,) = capsys.readouterr().err.splitlines()
        first = f"all runs failed or are missing, first vio hall 0 failed: {tmp_path}/x.txt does"
        assert line.startswith(f"trajeval: {first}")
        assert line.endswith(f"; see {out}/tables.md for the reasons")
    assert "vio hall 1 failed: " in (out / "tables.md").read_text()
    assert "failed or missing" in (out / "report.html").read_text()
