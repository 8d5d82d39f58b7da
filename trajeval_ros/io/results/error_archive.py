"""The errors of every pair as files: errors.npz, and errors.parquet where pyarrow is."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.io.npz_file import write_arrays
from trajeval_ros.io.results.pair_columns import columns_of, component_columns, pair_columns
from trajeval_ros.metrics.columns import have_pyarrow, write_parquet
from trajeval_ros.pipeline.outcome import Outcome

SCHEMA = "trajeval-errors/1"
TABLE_SCHEMA = "trajeval-error-table/1"
ARCHIVE, TABLE = "errors.npz", "errors.parquet"


def error_files(outcome: Outcome) -> dict[str, Callable[[Path], None]]:
    """Return what writes each file of errors, by the file's name; no table without pyarrow."""
    files = {ARCHIVE: write_errors}
    if have_pyarrow():
        files[TABLE] = write_error_table
    return {name: partial(write, outcome=outcome) for name, write in files.items()}


def write_errors(path: Path, outcome: Outcome) -> None:
    """Write what is known of every pair and sub-trajectory, run by run, as an npz archive.

    Keys are `NAME.stamps` (int64 ns), `NAME.position_m`, ... for pairs (`pair_columns`), and
    `NAME.8m.starts`, `NAME.8m.ends` (indices of pairs), `NAME.8m.position_m`, ... by length.
    `NAME.probabilistic.edges` are between two pairs. `schema` names this layout.
    """
    arrays: dict[str, Any] = {"schema": SCHEMA}
    for run in outcome.runs:
        name = run.estimate.name
        columns = pair_columns(run, outcome.groundtruth.up)
        arrays |= {f"{name}.{column}": values for column, values in columns.items()}
        if run.likelihood is not None and run.likelihood.edges is not None:
            arrays[f"{name}.probabilistic.edges"] = run.likelihood.edges.edges
        for segment in run.evaluation.segments or ():
            errors = columns_of(segment.errors)
            arrays |= {f"{name}.{segment.length}.{key}": each for key, each in errors.items()}
    # Digits of errors hardly compress: it would take half of a long run's time, to save a fifth.
    write_arrays(path, arrays, compressed=False)


def write_error_table(path: Path, outcome: Outcome) -> None:
    """Write a Parquet table with a row for each pair of each run.

    Columns are `estimate`, the run's name, and `pair_columns` component by component; null where
    a run has no such column. `trajeval.schema` in the metadata names this layout.

    Raises:
        InputError: pyarrow can't be used.
    """
    tables = []
    for run in outcome.runs:
        columns = component_columns(pair_columns(run, outcome.groundtruth.up))
        names = np.full(len(columns["stamps"]), run.estimate.name)
        tables.append({"estimate": names, **columns})
    write_parquet(path, tables, {"trajeval.schema": TABLE_SCHEMA})
