"""What a worker does: evaluate one run, just as `trajeval evaluate` would."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros import __version__
from trajeval_ros.batch.plan import PlannedRun
from trajeval_ros.batch.records import Record, encode
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.results.result_json import Input, result_of
from trajeval_ros.io.results.result_json import Run as EvaluatedRun
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.evaluation import Evaluation, evaluate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.report.canvas import thinned

Array = NDArray[np.float64]
Span = tuple[int, int]

_FORMAT = 2  # of records: what is older is evaluated again
_POINTS = 900  # of a line in a report


@dataclass(frozen=True)
class Task:
    """A run to be evaluated.

    Attributes:
        run: Which one.
        protocol: How.
        inputs: Fingerprints of groundtruth and estimate.
        span: Stamps, in the groundtruth's clock, that the estimate is cut to; None for all.
    """

    run: PlannedRun
    protocol: Protocol
    inputs: tuple[str, str]
    span: Span | None = None

    @functools.cached_property
    def key(self) -> str:
        """Hash of all that its numbers depend on."""
        parts = (_settings(self.protocol), self.run.name, self.inputs, self.span)
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


@functools.lru_cache(maxsize=8)
def _settings(protocol: Protocol) -> str:
    parts = (_FORMAT, __version__, dataclasses.asdict(protocol))
    return json.dumps(parts, default=str)


def work(task: Task) -> bytes | str:
    """Evaluate a run and return its encoded record; or why not, in one sentence.

    Nothing that one run does wrong may end the others, so defects of ours are told as well.
    """
    try:
        return encode(_evaluate(task))
    except TrajevalError as error:
        return str(error)
    except MemoryError:
        return "out of memory; use fewer workers"
    except Exception as error:
        return f"a defect of trajeval, please report it: {type(error).__name__}: {error}"


def _evaluate(task: Task) -> Record:
    run, protocol = task.run, task.protocol
    groundtruth = _groundtruth(run.groundtruth, task.inputs[0])
    read = read_trajectory(run.estimate, covariances=protocol.align_weights != "none")
    estimate = dataclasses.replace(read, name=run.name)
    if task.span is not None:
        estimate = _cut(estimate, task.span, protocol)
    same = _with_lengths_of(groundtruth, protocol)
    evaluation = evaluate(groundtruth, estimate, same)
    result = result_of(
        Input.of(run.groundtruth, groundtruth, evaluation.groundtruth),
        [EvaluatedRun(Input.of(run.estimate, read, evaluation.estimate), evaluation)],
    )
    stamps = evaluation.association.groundtruth.stamps
    lengths = tuple(map(str, protocol.lengths)) if evaluation.segments is not None else ()
    return Record(
        key=task.key,
        result=result,
        lengths=lengths,
        span_ns=(int(stamps.min()), int(stamps.max())),
        columns=_columns(evaluation, lengths),
    )


@functools.lru_cache(maxsize=2)
def _groundtruth(source: str, fingerprint: str) -> Trajectory:  # noqa: ARG001 - a part of the key
    """Read what the trials of a sequence share once."""
    groundtruth = read_trajectory(source, covariances=False)
    return dataclasses.replace(groundtruth, name="groundtruth")


def _cut(estimate: Trajectory, span: Span, protocol: Protocol) -> Trajectory:
    """Return the states of the estimate that lie within the span."""
    if not estimate.stamped or protocol.association.method == "index":
        raise InputError("it is paired row by row, so it can't be cut to a common time span")
    offset = round(protocol.association.time_offset_s * NANOSECONDS)
    stamps = estimate.stamps + offset
    inside = (stamps >= span[0]) & (stamps <= span[1])
    if not inside.any():
        raise InputError("it has no pose in the time that all runs of the sequence have")
    return estimate[inside]


def _with_lengths_of(groundtruth: Trajectory, protocol: Protocol) -> Protocol:
    """Return the protocol with shares of the whole groundtruth's path instead of the matched.

    A share of the matched path would be another length for each algorithm. The toolbox's rule
    has lengths of all groundtruth anyway.
    """
    if protocol.selection.rule == "toolbox":
        return protocol
    whole = groundtruth.in_order() if protocol.in_order else groundtruth
    lengths = tuple(
        Length(each.value / 100.0 * whole.path_length_m, "m") if each.unit == "%" else each
        for each in protocol.lengths
    )
    return dataclasses.replace(protocol, lengths=lengths)


def _columns(evaluation: Evaluation, lengths: tuple[str, ...]) -> dict[str, Array]:
    """Return what is pooled over trials, and what is drawn."""
    columns = {}
    for length, segment in zip(lengths, evaluation.segments or (), strict=True):
        columns[f"{length}.position_m"] = segment.errors.position_m
        columns[f"{length}.rotation_deg"] = segment.errors.rotation_deg
    pairs, rotation = evaluation.association, evaluation.absolute.rotation_deg
    truth, max_gap_s = evaluation.groundtruth, evaluation.protocol.association.max_gap_s
    position = evaluation.absolute.position_m
    if rotation is None:
        rotation = np.full(len(position), np.nan)
    stamps = pairs.groundtruth.stamps
    errors = np.stack([pairs.groundtruth.seconds, position, rotation], axis=1)
    columns["errors"] = thinned(errors, stamps, max_gap_s, _POINTS)
    columns["path"] = thinned(evaluation.aligned.positions, stamps, max_gap_s, _POINTS)
    columns["truth"] = thinned(truth.positions, truth.stamps, max_gap_s, _POINTS)
    return columns
