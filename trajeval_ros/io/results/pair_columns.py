"""Columns with one row per pair of a run: errors, error vectors, aligned poses, consistency."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trajeval_ros.io.results.probabilistic_json import probabilistic_columns
from trajeval_ros.metrics.columns import ArrayColumns
from trajeval_ros.pipeline.outcome import RunOutcome

if TYPE_CHECKING:  # the module imports scipy.stats, a slow import
    from trajeval_ros.consistency.consistency_result import Consistency


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
