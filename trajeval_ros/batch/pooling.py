"""Statistics over the trials of an algorithm on a sequence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.batch.pyarrow_package import load_pyarrow
from trajeval_ros.batch.records import Record
from trajeval_ros.batch.results_table import ATE, RE, STATISTICS, schema_of
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.drift import PER_LENGTH
from trajeval_ros.metrics.statistics import quantile, statistics_of

SCHEMA = "trajeval-pooled/1"
QUANTILES = {"p5": 0.05, "p25": 0.25, "p75": 0.75}
_ABSOLUTE = ("position_m", "rotation_deg", "yaw_deg", "tilt_deg")
_COLUMNS = {
    **dict.fromkeys(("algorithm", "sequence", "kind", "metric", "length"), "string"),
    **dict.fromkeys(("length_m", *STATISTICS, *QUANTILES), "float64"),
    **dict.fromkeys(("count", "trials", "evaluated"), "int64"),
}


def pooled_rows(
    algorithm: str, sequence: str, trials: int, records: Sequence[Record]
) -> Iterator[dict[str, Any]]:
    """Yield the statistics over trials.

    Absolute errors: statistics of the RMSE of the trials. Relative errors: statistics over the
    sub-trajectories of all trials. Rows have the number of evaluated and of expected trials.

    Args:
        algorithm: Name of the algorithm.
        sequence: Name of the sequence.
        trials: Number of expected trials.
        records: Records of the evaluated trials.
    """
    same = {
        "algorithm": algorithm,
        "sequence": sequence,
        "trials": trials,
        "evaluated": len(records),
    }
    for metric in _ABSOLUTE:
        each = [record.run["ate"][metric] for record in records]
        values = np.array([one["rmse"] for one in each if one is not None])
        yield from _rows(values, {**same, "kind": ATE, "metric": metric})
    for length in dict.fromkeys(length for record in records for length in record.lengths):
        yield from _relative(length, records, same)


def _relative(
    length: str, records: Sequence[Record], same: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    having = [record for record in records if length in record.lengths]
    segments = [record.run["re"]["segments"][record.lengths.index(length)] for record in having]
    sizes = [segment.get("length_m") for segment in segments]
    row = {**same, "kind": RE, "length": length, "length_m": sizes[0]}
    # Errors in percent refer to the length of each trial, which may differ between trials.
    for metric, (share, unit) in PER_LENGTH.items():
        name = f"{length}.{metric}"
        errors = [record.columns[name] for record in having if name in record.columns]
        if len(errors) < len(having):  # without orientations there are no rotation errors
            continue
        absolute = list(_rows(np.concatenate(errors), {**row, "metric": metric}))
        yield from absolute
        if None in sizes:
            continue
        if len(set(sizes)) == 1:
            yield from (_scaled(each, share, unit / sizes[0]) for each in absolute)
        else:
            shares = [unit / size * each for size, each in zip(sizes, errors, strict=True)]
            yield from _rows(np.concatenate(shares), {**row, "metric": share})


def _scaled(row: dict[str, Any], metric: str, factor: float) -> dict[str, Any]:
    """Return the row of the same errors in another unit."""
    in_unit = {name: row[name] * factor for name in (*STATISTICS, *QUANTILES)}
    return {**row, "metric": metric, **in_unit}


def _rows(values: Floats, row: dict[str, Any]) -> Iterator[dict[str, Any]]:
    ordered = np.sort(values)
    statistics = statistics_of(ordered)
    if statistics is not None:
        quantiles = {name: quantile(ordered, share) for name, share in QUANTILES.items()}
        yield {**row, **vars(statistics), **quantiles}


def write_pooled(
    path: Path, rows: list[dict[str, Any]], title: str, settings: dict[str, Any], state: str
) -> None:
    """Write the statistics over trials as Parquet, with the hash of their inputs.

    Raises:
        InputError: It can't be written, or pyarrow is not installed.
    """
    arrow, parquet = load_pyarrow()
    schema = schema_of(_COLUMNS, SCHEMA, title, settings, state)
    table = arrow.Table.from_pylist(rows, schema=schema)
    write_whole(path, lambda temporary: parquet.write_table(table, temporary))


def read_pooled(path: Path) -> list[dict[str, Any]]:
    """Return the rows that `write_pooled` wrote."""
    _, parquet = load_pyarrow()
    with parquet.ParquetFile(path) as file:  # `read_table` imports pandas, if installed
        rows: list[dict[str, Any]] = file.read(use_threads=False).to_pylist()
    return rows
