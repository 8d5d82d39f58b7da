"""errors.npz: the errors of every pair and every sub-trajectory, as columns."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.io.npz_file import write_arrays
from trajeval_ros.io.results.probabilistic_json import probabilistic_columns
from trajeval_ros.pipeline import RunOutcome

if TYPE_CHECKING:  # it imports scipy.stats
    from trajeval_ros.consistency.result import Consistency

SCHEMA = "trajeval-errors/1"


def write_errors(path: Path, runs: Sequence[RunOutcome]) -> None:
    """Write stamps and errors of every pair and sub-trajectory, run by run, as an npz archive.

    Keys are `NAME.stamps` (int64 ns), `NAME.position_m`, ... for pairs, and
    `NAME.8m.starts`, `NAME.8m.ends` (indices of pairs), `NAME.8m.position_m`, ... by length.
    Where consistency was asked for, `NAME.consistency.errors` and `.sigmas` (N, 6), `.nees`,
    `.position_nees` and `.rotation_nees` (N,); where groundtruth was continuous,
    `NAME.probabilistic.residuals` and others. `schema` names this layout.
    """
    arrays: dict[str, Any] = {"schema": SCHEMA}
    for run in runs:
        name, evaluation = run.estimate.name, run.evaluation
        arrays[f"{name}.stamps"] = evaluation.association.estimate.stamps
        arrays |= _columns(name, evaluation.absolute)
        if run.consistency is not None:
            arrays |= {
                f"{name}.consistency.{column}": values
                for column, values in _consistency_columns(run.consistency).items()
            }
        if run.likelihood is not None:
            arrays |= {
                f"{name}.probabilistic.{column}": values
                for column, values in probabilistic_columns(run.likelihood).items()
            }
        for segment in evaluation.segments or ():
            arrays |= _columns(f"{name}.{segment.length}", segment.errors)
    write_arrays(path, arrays)


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


def _columns(prefix: str, errors: Any) -> dict[str, Any]:
    return {
        f"{prefix}.{field.name}": column
        for field in dataclasses.fields(errors)
        if (column := getattr(errors, field.name)) is not None
    }
