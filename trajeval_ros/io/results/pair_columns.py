"""Columns with one row per pair of a run: errors, error vectors, aligned poses."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.results.probabilistic_json import probabilistic_columns
from trajeval_ros.pipeline.outcome import RunOutcome

if TYPE_CHECKING:  # the module imports scipy.stats, a slow import
    from trajeval_ros.consistency.consistency_result import Consistency

Columns = dict[str, NDArray[Any]]

_XYZ, _TURNS = ("x", "y", "z"), ("roll", "pitch", "yaw")
_COMPONENTS = {3: _XYZ, 4: (*_XYZ, "w"), 6: (*_XYZ, *_TURNS)}


def pair_columns(run: RunOutcome, up: UpAxis) -> Columns:
    """Return the columns of a run with N pairs, by name.

    Args:
        run: Result for one estimate.
        up: Up axis of the groundtruth, as read. Vectors and poses are in the original axes of
            the groundtruth's frame, also if the run was evaluated with z up.

    Returns:
        `stamps` (N,), int64, nanoseconds; the errors of `AbsoluteErrors` (N,); the vectors of
        `ErrorVectors` (N, 3); `aligned_positions` (N, 3), metres; `aligned_quaternions` (N, 4),
        xyzw. Quantities that are not available are left out. With a consistency test also
        `consistency.errors`, `.sigmas` (N, 6), `.nees`, `.position_nees`, `.rotation_nees` (N,).
        With a continuous groundtruth also `probabilistic.` columns (`probabilistic_columns`).
    """
    evaluation = run.evaluation
    aligned, vectors = evaluation.aligned, evaluation.error_vectors
    if evaluation.protocol.is_upright and up.name != "z":
        back = Similarity(up.matrix.T, np.zeros(3))
        aligned = back.trajectory(aligned)
        turn = vectors.rotation_world_deg
        vectors = dataclasses.replace(
            vectors,
            position_world_m=back.vectors(vectors.position_world_m),
            rotation_world_deg=None if turn is None else back.vectors(turn),
        )
    columns = {
        "stamps": evaluation.association.estimate.stamps,
        **columns_of(evaluation.absolute),
        **columns_of(vectors),
        "aligned_positions": aligned.positions,
    }
    if aligned.quaternions is not None:
        columns["aligned_quaternions"] = aligned.quaternions
    groups: dict[str, Any] = {}
    if run.consistency is not None:
        groups["consistency"] = _consistency_columns(run.consistency)
    if run.likelihood is not None:
        groups["probabilistic"] = probabilistic_columns(run.likelihood)
    return columns | {
        f"{kind}.{name}": column
        for kind, group in groups.items()
        for name, column in group.items()
    }


def columns_of(errors: Any) -> Columns:
    """Return the fields of a dataclass of arrays that are not None, by name."""
    return {
        field.name: column
        for field in dataclasses.fields(errors)
        if (column := getattr(errors, field.name)) is not None
    }


def component_columns(columns: Columns) -> Columns:
    """Return columns of shape (N,): a column of vectors is split into its components.

    `aligned_positions` (N, 3) becomes `aligned_positions_x`, `_y` and `_z`. Components of
    rotations are `_roll`, `_pitch` and `_yaw`. Points in names become underscores.
    """
    components = {}
    for name, column in columns.items():
        plain = name.replace(".", "_")
        if column.ndim == 1:
            components[plain] = column
            continue
        width = column.shape[1]
        names = _TURNS if width == 3 and name.startswith("rotation") else _COMPONENTS[width]
        components |= {f"{plain}_{item}": column[:, at] for at, item in enumerate(names)}
    return components


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
