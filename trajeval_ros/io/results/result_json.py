"""result.json and errors.npz: what an evaluation leaves behind for other programs.

The schema is `trajeval/1`; docs/result.md describes every field. Two evaluations of the same
input give the same bytes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros import __version__
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.results.calibration_json import calibration_json
from trajeval_ros.io.results.probabilistic_json import probabilistic_columns, probabilistic_json
from trajeval_ros.metrics.evaluation import Evaluation, SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.consistency.result import Consistency
    from trajeval_ros.likelihood.assessment import Assessment

SCHEMA = "trajeval/1"


@dataclass(frozen=True)
class Input:
    """One side of a comparison, as it was read.

    Attributes:
        source: The SOURCE that the user named.
        name: A short one.
        poses: Number of poses, repeated stamps included.
        duration_s: From the earliest to the latest.
        path_length_m: Of the path through the poses that were used.
        frame: The frame that poses are in.
        child_frame: The body that they are of.
        notes: What the reader recognised or repaired.
        fingerprint: sha256 of the pose columns.
    """

    source: str
    name: str
    poses: int
    duration_s: float
    path_length_m: float
    frame: str
    child_frame: str
    notes: tuple[str, ...]
    fingerprint: str

    @classmethod
    def of(cls, source: str, read: Trajectory, used: Trajectory) -> Input:
        """Describe a trajectory from a source, before and after it was put in order."""
        return cls(
            source=source,
            name=read.name,
            poses=len(read),
            duration_s=read.duration_s,
            path_length_m=used.path_length_m,
            frame=read.frame,
            child_frame=read.child_frame,
            notes=used.notes,
            fingerprint=fingerprint(read),
        )


@dataclass(frozen=True, eq=False)
class Run:
    """One evaluated estimate and where it came from.

    Attributes:
        estimate: Where it came from.
        evaluation: Its evaluation.
        live: What only a live run can tell; None of a recorded one.
        consistency: Whether the estimate is as sure as it should be; None if nobody asked.
        probabilistic: How likely it is; None unless groundtruth was continuous.
        calibrated: What of clocks and bodies was calibrated; None if nobody asked.
    """

    estimate: Input
    evaluation: Evaluation
    live: dict[str, Any] | None = None
    consistency: Consistency | None = None
    probabilistic: Assessment | None = None
    calibrated: Calibrated | None = None


def result_of(
    groundtruth: Input, runs: Sequence[Run], failed: Sequence[dict[str, str]] = ()
) -> dict[str, Any]:
    """Return the result of evaluating one or more estimates against one groundtruth.

    Args:
        groundtruth: What they were compared with.
        runs: One for each estimate, evaluated by the same protocol.
        failed: Name, source and reason of each estimate that could not be evaluated.
    """
    protocol = runs[0].evaluation.protocol
    inputs = {
        each.source: each.fingerprint for each in (groundtruth, *(run.estimate for run in runs))
    }
    return {
        "schema": SCHEMA,
        "groundtruth": {
            "source": groundtruth.source,
            "poses": groundtruth.poses,
            "duration_s": groundtruth.duration_s,
            "path_length_m": groundtruth.path_length_m,
            "frame": groundtruth.frame,
            "child_frame": groundtruth.child_frame,
            "notes": list(groundtruth.notes),
        },
        "runs": [_run(run) for run in runs],
        "failed": list(failed),
        "provenance": {
            "version": __version__,
            "protocol": protocol.name,
            "settings": {
                "align_weights": protocol.align_weights,
                "in_order": protocol.in_order,
                "lengths": [str(length) for length in protocol.lengths],
                "selection": dataclasses.asdict(protocol.selection),
                "lever_m": None if protocol.lever_m is None else list(protocol.lever_m),
            },
            "inputs": inputs,
        },
    }


def _run(run: Run) -> dict[str, Any]:
    evaluation, estimate = run.evaluation, run.estimate
    protocol, pairs = evaluation.protocol, evaluation.association
    similarity = evaluation.alignment.similarity
    return {
        "estimate": {
            "source": estimate.source,
            "name": estimate.name,
            "poses": estimate.poses,
            "duration_s": estimate.duration_s,
            "frame": estimate.frame,
            "child_frame": estimate.child_frame,
            "notes": list(estimate.notes),
        },
        "association": {
            "method": pairs.rule.method,
            "model": pairs.rule.model if pairs.rule.method == "continuous" else None,
            "max_time_difference_s": pairs.rule.max_time_difference_s,
            "max_gap_s": pairs.rule.max_gap_s,
            "time_offset_s": pairs.rule.time_offset_s,
            "pairs": len(pairs),
            "estimate_coverage": pairs.estimate_coverage,
            "groundtruth_coverage": pairs.groundtruth_coverage,
            "dropped": pairs.dropped,
        },
        "alignment": {
            "gauge": protocol.gauge.value,
            "modality": protocol.modality,
            "states": "all" if protocol.align_states is None else protocol.align_states,
            "states_used": evaluation.alignment.states_used,
            "scale": similarity.scale,
            "rotation_xyzw": similarity.rotation_xyzw.tolist(),
            "translation_m": similarity.translation.tolist(),
        },
        "ate": {
            "form": protocol.ate_form,
            **{metric: statistics_json(value) for metric, value in evaluation.ate.items()},
        },
        "re": None
        if evaluation.segments is None
        else {
            "form": protocol.re_form,
            "segments": [_segment(each) for each in evaluation.segments],
            "pooled": {name: statistics_json(value) for name, value in evaluation.pooled.items()},
        },
        "score": None if evaluation.score is None else dataclasses.asdict(evaluation.score),
        "calibration": None if run.calibrated is None else calibration_json(run.calibrated),
        "consistency": None if run.consistency is None else _consistency(run.consistency),
        "probabilistic": None
        if run.probabilistic is None
        else probabilistic_json(run.probabilistic),
        "live": run.live,
        "warnings": list(evaluation.warnings),
    }


def _segment(segment: SubTrajectoryErrors) -> dict[str, Any]:
    size = (
        {"duration_s": segment.duration_s}
        if segment.length_m is None
        else {"length_m": segment.length_m}
    )
    return {
        **size,
        "pairs": len(segment.errors.ends),
        "mean_length_m": segment.mean_length_m,
        **{metric: statistics_json(value) for metric, value in segment.statistics.items()},
    }


def _consistency(consistency: Consistency) -> dict[str, Any]:
    joint, per_pose = consistency.joint, consistency.per_pose
    return {
        "gauge": consistency.gauge.value,
        "covariance_source": consistency.covariance_source,
        "exactness": consistency.exactness,
        "statement": consistency.statement,
        "verdict": consistency.verdict,
        "joint": None
        if joint is None
        else {**dataclasses.asdict(joint), "nees_per_dof": joint.nees / joint.dof},
        "per_pose": None if per_pose is None else dataclasses.asdict(per_pose),
    }


def statistics_json(statistics: Statistics | None) -> dict[str, float | int] | None:
    """Return STATS of the schema."""
    return None if statistics is None else dataclasses.asdict(statistics)


def fingerprint(trajectory: Trajectory) -> str:
    """Return the sha256 of the pose columns: stamps, positions, xyzw, little-endian."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(trajectory.stamps, dtype="<i8").data)
    digest.update(np.ascontiguousarray(trajectory.positions, dtype="<f8").data)
    if trajectory.quaternions is not None:
        digest.update(np.ascontiguousarray(trajectory.quaternions, dtype="<f8").data)
    return digest.hexdigest()


def to_json(result: dict[str, Any]) -> str:
    """Return the result as text; a NaN in it is a defect and raises ValueError."""
    return json.dumps(result, indent=2, allow_nan=False) + "\n"


def write_errors(path: Path, runs: Sequence[Run]) -> None:
    """Write stamps and errors of every pair and sub-trajectory, run by run, as an npz archive.

    Keys are `NAME.stamps` (int64 ns), `NAME.position_m`, ... for pairs, and
    `NAME.8m.starts`, `NAME.8m.ends` (indices of pairs), `NAME.8m.position_m`, ... by length.
    Where consistency was asked for, `NAME.consistency.errors` and `.sigmas` (N, 6), `.nees` (N,);
    where groundtruth was continuous, `NAME.probabilistic.residuals` and others.
    """
    arrays: dict[str, Any] = {}
    for run in runs:
        name, evaluation = run.estimate.name, run.evaluation
        arrays[f"{name}.stamps"] = evaluation.association.estimate.stamps
        arrays |= _columns(name, evaluation.absolute)
        if run.consistency is not None:
            arrays |= {
                f"{name}.consistency.{column}": values
                for column in ("errors", "sigmas", "nees")
                if (values := getattr(run.consistency, column)) is not None
            }
        if run.probabilistic is not None:
            arrays |= {
                f"{name}.probabilistic.{column}": values
                for column, values in probabilistic_columns(run.probabilistic).items()
            }
        for segment in evaluation.segments or ():
            arrays |= _columns(f"{name}.{segment.length}", segment.errors)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _columns(prefix: str, errors: Any) -> dict[str, Any]:
    return {
        f"{prefix}.{field.name}": column
        for field in dataclasses.fields(errors)
        if (column := getattr(errors, field.name)) is not None
    }


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all: under a temporary name, then renamed."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def temporary_name(name: str, process: int) -> str:
    """Return what a file is called while a process, by its number, writes it."""
    return f".{name}.{process}.part"


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file under a temporary name beside `path`, then give it that name.

    A link stays one: what it leads to is replaced. A pipe or a device is written to as it is.

    Raises:
        InputError: The file can't be written.
    """
    if path.is_dir():
        raise InputError(f"{path} can't be written: is a directory; name a file")
    if path.exists() and not path.is_file():
        with refused_by_disk(str(path)):
            write(path)
        return
    if path.is_symlink():
        path = path.resolve()
    temporary = path.with_name(temporary_name(path.name, os.getpid()))
    try:
        with refused_by_disk(str(path)):
            write(temporary)
            temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextlib.contextmanager
def refused_by_disk(what: str) -> Iterator[None]:
    """Say in one sentence that something can't be written in the block.

    Raises:
        InputError: It can't.
    """
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{what} can't be written: {reason}") from error
