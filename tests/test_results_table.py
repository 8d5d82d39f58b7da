"""Laws of the table of results."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pyarrow", reason="pyarrow is missing; `make install` has it")

from trajeval_ros.batch.results_table import ResultsTable, write_table

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
    rows = [dict(zip(columns, each, strict=True)) for each in runs]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "runs.parquet"
        write_table(path, rows, "t", {"gauge": "se3", "protocol": "default"}, "state")
        found = ResultsTable(path).distinct(columns)
    assert [tuple(each.values()) for each in found] == list(dict.fromkeys(runs))
