"""Files with the errors of all pairs: errors.npz, and errors.parquet if pyarrow is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.io.npz_file import write_arrays
from trajeval_ros.io.results.requested_json import probabilistic_columns
from trajeval_ros.metrics.columns import (
    ArrayColumns,
    columns_of,
    component_columns,
    have_pyarrow,
    write_parquet,
)
from trajeval_ros.pipeline.outcome import Outcome, RunOutcome

if TYPE_CHECKING:  # the module imports scipy.stats, a slow import
    from trajeval_ros.consistency.consistency_result import Consistency

SCHEMA = "trajeval-errors/1"
TABLE_SCHEMA = "trajeval-error-table/1"
ARCHIVE, TABLE = "errors.npz", "errors.parquet"


def error_files(outcome: Outcome) -> dict[str, Callable[[Path], None]]:
    """Return the functions that write the files with errors, by the name of the file.

    Without pyarrow, errors.parquet is not among them.
    """
    columns = [pair_columns(run) for run in outcome.runs]
    files = {ARCHIVE: write_errors}
    if have_pyarrow():
        files[TABLE] = write_error_table
    return {
        name: partial(write, outcome=outcome, columns=columns) for name, write in files.items()
    }


def write_errors(path: Path, outcome: Outcome, columns: Sequence[ArrayColumns]) -> None:
    """Write the errors of all pairs and sub-trajectories of all runs as an npz archive.

    `columns` are the `pair_columns` of the runs.

    Keys of pairs are `NAME.stamps` (int64, nanoseconds), `NAME.position_m`, ... (`pair_columns`).
    Keys of sub-trajectories contain their length: `NAME.8m.starts` and `NAME.8m.ends` (indices of
    pairs), `NAME.8m.position_m`, ... As-available errors: `NAME.available.stamps`, `row` (of the
    message in use), `age_ns`, `error_m` (N, 3), `parts_m` (4, N, 3). `NAME.probabilistic.edges`
    (N - 1,) are log densities of the relative poses of consecutive pairs, nats. `schema` is the
    version of this layout.

    Raises:
        OSError: The file can't be written.
    """
    arrays: dict[str, Any] = {"schema": SCHEMA}
    for run, of_pairs in zip(outcome.runs, columns, strict=True):
        name = run.estimate.name
        arrays |= {f"{name}.{column}": values for column, values in of_pairs.items()}
        if run.available is not None and run.available.samples is not None:
            samples = run.available.samples
            available: ArrayColumns = {
                "stamps": samples.stamps,
                "row": samples.rows,
                "age_ns": samples.age,
            }
            available |= {"error_m": samples.position.sum(axis=0), "parts_m": samples.position}
            arrays |= {f"{name}.available.{key}": item for key, item in available.items()}
        if run.likelihood is not None and run.likelihood.edges is not None:
            arrays[f"{name}.probabilistic.edges"] = run.likelihood.edges.edges
        for segment in run.evaluation.relative or ():
            errors = columns_of(segment.errors)
            arrays |= {f"{name}.{segment.length}.{key}": error for key, error in errors.items()}
    # Not compressed: on long runs, compression takes half of the time and saves a fifth in size.
    write_arrays(path, arrays, compressed=False)


def write_error_table(path: Path, outcome: Outcome, columns: Sequence[ArrayColumns]) -> None:
    """Write a Parquet table with one row per pair, of all runs.

    `columns` are the `pair_columns` of the runs. Those of the table are `estimate`, the name of
    the run, and their components (`component_columns`). A column that a run does not have is
    null. `trajeval.schema` in the metadata is the version of this layout.

    Raises:
        InputError: pyarrow can't be used.
    """
    tables = [
        (run.estimate.name, component_columns(of_pairs))
        for run, of_pairs in zip(outcome.runs, columns, strict=True)
    ]
    write_parquet(path, "estimate", tables, {"trajeval.schema": TABLE_SCHEMA})


def pair_columns(run: RunOutcome) -> ArrayColumns:
    """Return the columns of a run with N pairs, by name.

    Returns:
        The columns of `Evaluation.to_columns`. With a consistency test also `consistency.errors`,
        `.sigmas` (N, 6), `.nees`, `.position_nees`, `.rotation_nees` (N,). With a continuous
        groundtruth also `probabilistic.` columns (`probabilistic_columns`).
    """
    groups: dict[str, Any] = {}
    if run.consistency is not None:
        groups["consistency"] = _consistency_columns(run.consistency)
    if run.likelihood is not None:
        groups["probabilistic"] = probabilistic_columns(run.likelihood)
    return run.evaluation.to_columns() | {
        f"{kind}.{name}": column
        for kind, group in groups.items()
        for name, column in group.items()
    }


def _consistency_columns(consistency: Consistency) -> dict[str, Any]:
    columns: dict[str, Any] = {"errors": consistency.errors}
    if consistency.pose_nees is not None:
        columns |= {
            "sigmas": consistency.sigmas,
            "nees": consistency.pose_nees.pose,
            "position_nees": consistency.pose_nees.position,
            "rotation_nees": consistency.pose_nees.rotation,
        }
    return columns
