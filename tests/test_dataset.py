"""The dataset of many comparisons, read as its page says."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")

from trajeval_ros.batch.comparison_summary import ComparisonSummary, summary_of
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.cli.app import main

PAGE = Path(__file__).resolve().parent.parent / "docs" / "dataset.md"
OLD, NEW = "main", "4f2a1c"


def append(folder: Path, label: str, dataset: str = "results") -> ComparisonSummary:
    out = folder / "out"
    command = ["compare", str(folder / "runs.yaml"), "--workers", "1", "-q", "--output", str(out)]
    assert main([*command, "--dataset", str(folder / dataset), "--label", label]) == 0
    return summary_of(out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two comparisons: in the second one a number is worse, and one is lost."""
    folder = tmp_path_factory.mktemp("dataset")
    write_runs(folder, trials=3)
    (folder / "bad" / "yard_trial2.txt").write_text("no trajectory\n")
    append(folder, OLD)
    for trial in range(3):
        write_run(folder / "good" / f"hall_trial{trial}.txt", 1.02)
        write_run(folder / "good" / f"yard_trial{trial}.txt", 1.0102)
    (folder / "bad" / "yard_trial1.txt").write_text("no trajectory\n")
    append(folder, NEW)
    return folder


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)


def expected(summary: ComparisonSummary) -> dict[tuple[str, str], float | None]:
    table = matrices(summary)[0]
    return {
        (name, sequence): None if cell.value in (None, float("inf")) else cell.value
        for name, cells in table.rows
        for sequence, cell in zip(table.columns, cells, strict=True)
    }


def test_the_sql_of_the_page_gives_tables_and_gates(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    duckdb: Any = pytest.importorskip("duckdb", reason="duckdb is missing; pip install duckdb")
    monkeypatch.chdir(folder)
    with duckdb.connect() as database:
        *_, table, gate, reasons = (database.execute(each).fetchall() for each in blocks("sql"))
    found = {row[:2]: row[2] for row in table}
    assert found == pytest.approx(expected(summary_of(folder / "out")))
    assert {row[:2]: row[3:] for row in table}["bad", "yard"] == (1, 3)
    assert [row[:2] for row in gate] == [("bad", "yard"), ("good", "hall")]
    assert gate[0][3] is None
    assert gate[1][3] > 1.05 * gate[1][2]
    assert sum(row[1] for row in reasons) == 3
    assert "bad yard" in reasons[0][2]


def test_the_script_of_the_page_reads_all_rows(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    (script,) = blocks("python")
    exec(script, {})
    assert sum(map(int, capsys.readouterr().out.split())) == 11 + 10


def test_a_label_that_comes_again_replaces_what_it_had(folder: Path) -> None:
    files = sorted((folder / "results").rglob("*.parquet"))
    assert len(files) == 4
    before = [each.read_bytes() for each in files]
    append(folder, NEW)
    assert [each.read_bytes() for each in files] == before
    assert sorted((folder / "results").rglob("*.parquet")) == files
    place = Path("runs", "schema=1", "title=runs", f"label={NEW}", "runs.parquet")
    assert (folder / "results" / place).read_bytes() == (folder / "out/runs.parquet").read_bytes()


def test_labels_are_no_paths(folder: Path) -> None:
    from pyarrow import dataset

    append(folder, "../../a b/ü=1", "odd")
    files = [each.relative_to(folder / "odd") for each in (folder / "odd").rglob("*.parquet")]
    assert {len(each.parts) for each in files} == {5}
    runs = dataset.dataset(folder / "odd" / "runs" / "schema=1", partitioning="hive")
    assert set(runs.to_table(["label"]).column("label").to_pylist()) == {"../../a b/ü=1"}


def test_a_dataset_needs_a_label(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--dataset", os.devnull], ["--label", "x"], ["--dataset", "d", "--label", ""]):
        assert main(["compare", str(folder / "runs.yaml"), *option]) == 2
        assert "give both" in capsys.readouterr().err
