"""The work of a worker: evaluating one run, like `trajeval evaluate`."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from dataclasses import dataclass

import numpy as np

from trajeval_ros.batch.plan import PlannedRun
from trajeval_ros.batch.records import Record, encode
from trajeval_ros.batch.source_hash import hash_of_numbers
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Floats, Stamps, extents
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.bags.byte_source import counting_fetched_bytes
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import TextHints
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.pipeline.pipeline import run as run_pipeline
from trajeval_ros.pipeline.request import Request
from trajeval_ros.report.line_thinning import simplified, thinned

_POINTS = 900  # of errors over time in a report
# A path keeps a tenth of a pixel of the widest figure, which is 650 pixels wide on a page.
_RESOLUTION = 1.0 / 6500.0


@dataclass(frozen=True)
class Task:
    """A run to evaluate."""

    run: PlannedRun
    request: Request
    inputs: tuple[str, str]  # fingerprints of groundtruth and estimate

    @functools.cached_property
    def key(self) -> str:
        """Hash of everything that its numbers depend on, including the program."""
        hints = tuple(map(dataclasses.astuple, self.run.hints))
        parts = (hash_of_numbers(), self.request.fingerprint, self.run.name, self.inputs, hints)
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


@dataclass(frozen=True)
class WorkerResult:
    """The result of evaluating a run."""

    entry: bytes | None  # its encoded record; None if it failed
    reason: str = ""  # why it failed, in one sentence; "" if it did not
    fetched_bytes: int = 0  # bytes read from remote stores, also of a failed run


def work(task: Task) -> WorkerResult:
    """Evaluate a run. No failure of a run ends the others, not even a defect of this package."""
    entry, reason = None, ""
    with counting_fetched_bytes() as fetched:
        try:
            entry = encode(_evaluate(task))
        except TrajevalError as error:
            reason = str(error)
        except MemoryError:
            reason = "out of memory; use fewer workers"
        except Exception as error:
            reason = f"internal error, please report it: {type(error).__name__}: {error}"
    return WorkerResult(entry, reason, fetched.total)


def _evaluate(task: Task) -> Record:
    run, request = task.run, task.request
    groundtruth = _groundtruth(run.groundtruth, task.inputs[0], run.hints.groundtruth)
    read = read_trajectory(
        run.estimate,
        covariances=request.reads_covariances,
        hints=run.hints.estimate,
        received=request.received,
    )
    estimate = dataclasses.replace(read, name=run.name)
    outcome = run_pipeline(groundtruth, [estimate], request)
    evaluation = outcome.runs[0].evaluation
    stamps = evaluation.association.groundtruth.stamps
    asked = request.protocol.lengths
    lengths = tuple(map(str, asked)) if evaluation.relative is not None else ()
    return Record(
        key=task.key,
        result=result_of(outcome),
        lengths=lengths,
        span_ns=(int(stamps.min()), int(stamps.max())),
        columns=_columns(evaluation, lengths),
    )


@functools.lru_cache(maxsize=2)
def _groundtruth(
    source: str,
    fingerprint: str,  # noqa: ARG001 - a part of the key
    hints: TextHints,
) -> Trajectory:
    """Read a groundtruth; trials of a sequence share it."""
    groundtruth = read_trajectory(source, covariances=False, hints=hints)
    return dataclasses.replace(groundtruth, name="groundtruth")


def _columns(evaluation: Evaluation, lengths: tuple[str, ...]) -> dict[str, Floats]:
    """Return the columns for statistics over trials and for figures."""
    columns = {}
    for length, segment in zip(lengths, evaluation.relative or (), strict=True):
        columns[f"{length}.position_m"] = segment.errors.position_m
        if segment.errors.rotation_deg is not None:
            columns[f"{length}.rotation_deg"] = segment.errors.rotation_deg
    pairs, groundtruth = evaluation.association, evaluation.groundtruth
    return columns | columns_to_draw(
        pairs.groundtruth.stamps,
        evaluation.absolute.position_m,
        evaluation.absolute.rotation_deg,
        groundtruth.up.to_z_up(evaluation.aligned.positions),
        (groundtruth.stamps, groundtruth.up.to_z_up(groundtruth.positions)),
        evaluation.protocol.association,
    )


def columns_to_draw(
    stamps: Stamps,
    position_m: Floats,
    rotation_deg: Floats | None,
    path: Floats,
    groundtruth: tuple[Stamps, Floats],
    rule: AssociationRule,
) -> dict[str, Floats]:
    """Return the columns of a record that figures draw, without invisible details.

    Args:
        stamps: Of the N pairs, nanoseconds.
        position_m: Position errors (N,), metres.
        rotation_deg: Rotation errors (N,), degrees; None where withheld.
        path: Aligned positions (N, 3), metres, height last.
        groundtruth: Timestamps (M,) and positions (M, 3) of the groundtruth, height last.
        rule: The association's, whose gaps interrupt lines.
    """
    if rotation_deg is None:
        rotation_deg = np.full(len(position_m), np.nan)
    seconds = (stamps - stamps[0]) / NANOSECONDS
    times, whole = groundtruth
    tolerance_m = _RESOLUTION * float(extents(whole[:, :2]).max())
    errors = np.stack([seconds, position_m, rotation_deg], axis=1)
    return {
        "errors": thinned(errors, stamps, rule.is_gap, _POINTS),
        "path": simplified(path, stamps, rule.is_gap, tolerance_m),
        "groundtruth": simplified(whole, times, rule.is_gap, tolerance_m),
    }
