"""Laws of the table of results."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pyarrow", reason="pyarrow is missing; `make install` has it")

from paths import ROOT

from trajeval_ros.batch.results_table import ResultsTable, write_pooled, write_table

_RUNS = st.lists(
    st.tuples(st.sampled_from("abcdefgh"), st.sampled_from("xyz"), st.floats(0, 9) | st.none()),
    max_size=300,
)


@given(runs=_RUNS, unique=st.integers(0, 400))
def test_distinct_rows_are_in_the_order_of_their_first_occurrence(
    runs: list[tuple[str, str, float | None]], unique: int
) -> None:
    runs = [*runs, *(("long", f"name{place % 97}", float(place % 7)) for place in range(unique))]
    columns = ("algorithm", "trial", "mean")
    rows = [dict(zip(columns, run, strict=True)) for run in runs]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "runs.parquet"
        write_table(path, rows, "t", {"gauge": "se3", "protocol": "default"}, "state")
        result = ResultsTable(path).distinct(columns)
    assert [tuple(item.values()) for item in result] == list(dict.fromkeys(runs))


def test_rows_are_filtered_by_texts_and_by_missing_values(tmp_path: Path) -> None:
    lengths = ["8m", None, "", "4m"]
    rows = [{"algorithm": str(place), "length": length} for place, length in enumerate(lengths)]
    write_table(tmp_path / "t", rows, "t", {"gauge": "se3", "protocol": "default"}, "state")
    table = ResultsTable(tmp_path / "t")

    def outcome(*allowed: str | None) -> str:
        return "".join(row["algorithm"] for row in table.rows(["algorithm"], length=allowed))

    assert [outcome("8m"), outcome(None), outcome(""), outcome("4m", None), outcome()] == [
        "0", "1", "2", "13", "",
    ]  # fmt: skip
    assert table.select(["algorithm"], length="4m") == [{"algorithm": "3"}]


def test_reading_tables_does_not_import_pandas(tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="pandas is missing: nothing can import it")
    settings = {"gauge": "se3", "protocol": "default"}
    write_table(tmp_path / "runs", [{"algorithm": "a"}], "t", settings, "state")
    write_pooled(tmp_path / "pooled", [{"algorithm": "a"}], "t", settings, "state")
    code = (
        "import pathlib, sys; folder = pathlib.Path(sys.argv[1]);"
        "from trajeval_ros.batch.results_table import read_pooled;"
        "from trajeval_ros.batch.results_table import ResultsTable;"
        "table = ResultsTable(folder / 'runs'); table.distinct(['algorithm']);"
        "assert table.select(['trial'], algorithm='a'); assert read_pooled(folder / 'pooled');"
        "sys.exit('pandas' in sys.modules)"
    )
    root = ROOT
    assert subprocess.run([sys.executable, "-c", code, tmp_path], cwd=root).returncode == 0
