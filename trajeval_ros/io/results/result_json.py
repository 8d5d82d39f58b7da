"""Content of result.json, the result of an evaluation for other programs.

The schema is `trajeval/1`. docs/result.md describes all fields. Two evaluations of the same input
give the same bytes.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from trajeval_ros import __version__
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.upright import between_own_axes
from trajeval_ros.io.results.calibration_json import calibration_json
from trajeval_ros.io.results.diagnosis_json import diagnosis_json, mended_json
from trajeval_ros.io.results.integrity_json import integrity_json
from trajeval_ros.io.results.probabilistic_json import probabilistic_json
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.pipeline.outcome import Outcome, RunOutcome

if TYPE_CHECKING:
    from trajeval_ros.consistency.result import Consistency

SCHEMA = "trajeval/1"


def result_of(outcome: Outcome) -> dict[str, Any]:
    """Return the content of result.json for one or more estimates and one groundtruth."""
    groundtruth, runs = outcome.groundtruth, outcome.runs
    protocol, time_span = runs[0].evaluation.protocol, outcome.request.time_span
    mends = outcome.request.mends
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
            "up": dataclasses.asdict(groundtruth.up),
            "kind": groundtruth.kind,
            "fixes": groundtruth.fixes and dataclasses.asdict(groundtruth.fixes),
            "notes": list(groundtruth.notes),
        },
        "runs": [_run(run, groundtruth.up) for run in runs],
        "failed": [dataclasses.asdict(each) for each in outcome.failed],
        "provenance": {
            "version": __version__,
            "protocol": protocol.name,
            "settings": {
                "align_with": protocol.align_with,
                "apply": protocol.apply,
                "align_weights": protocol.align_weights,
                "in_order": protocol.in_order,
                "lengths": [str(length) for length in protocol.lengths],
                "selection": dataclasses.asdict(protocol.selection),
                "lever_m": None if protocol.lever_m is None else list(protocol.lever_m),
                "time_span": None if time_span is None else dataclasses.asdict(time_span),
                "mends": dataclasses.asdict(mends) if mends.anything else None,
                "fix": outcome.request.fix or None,
            },
            "inputs": inputs,
        },
    }


def _run(run: RunOutcome, truth_up: UpAxis) -> dict[str, Any]:
    evaluation, estimate = run.evaluation, run.estimate
    protocol, pairs = evaluation.protocol, evaluation.association
    similarity, coverage = evaluation.alignment.similarity, pairs.coverage
    if protocol.is_upright:  # then the alignment is between frames turned to z up
        similarity = between_own_axes(similarity, truth_up, estimate.up)
    return {
        "estimate": {
            "source": estimate.source,
            "name": estimate.name,
            "poses": estimate.poses,
            "duration_s": estimate.duration_s,
            "frame": estimate.frame,
            "child_frame": estimate.child_frame,
            "up": dataclasses.asdict(estimate.up),
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
            "groundtruth_coverage": coverage.covered,
            "groundtruth_span": coverage.span,
            "keyframes": coverage.keyframes,
            "longest_gap": coverage.longest_gap and dataclasses.asdict(coverage.longest_gap),
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
        "by_states": [
            {
                "states": each.states,
                "states_used": each.states_used,
                "position_m": statistics_json(each.position_m),
                "rotation_deg": statistics_json(each.rotation_deg),
                "reason": each.reason,
            }
            for each in run.by_states
        ]
        or None,
        "ate": {
            "form": protocol.ate_form,
            **{metric: statistics_json(value) for metric, value in evaluation.ate.items()},
        },
        "own_error": run.own_error and dataclasses.asdict(run.own_error),
        "re": None
        if evaluation.segments is None
        else {
            "form": protocol.re_form,
            "segments": [_segment(each) for each in evaluation.segments],
            "pooled": {name: statistics_json(value) for name, value in evaluation.pooled.items()},
        },
        "score": None if evaluation.score is None else dataclasses.asdict(evaluation.score),
        "recall": evaluation.recall and dataclasses.asdict(evaluation.recall),
        "calibration": None if run.calibrated is None else calibration_json(run.calibrated),
        "consistency": None if run.consistency is None else _consistency(run.consistency),
        "integrity": None if run.integrity is None else integrity_json(run.integrity),
        "probabilistic": None if run.likelihood is None else probabilistic_json(run.likelihood),
        "diagnosis": diagnosis_json(run.diagnosis),
        "mended": mended_json(run.mended),
        "live": run.live,
        "warnings": list(evaluation.warnings),
    }


def _segment(segment: SubTrajectoryErrors) -> dict[str, Any]:
    sizes = {
        name: getattr(segment, name) for name in ("length_m", "duration_s", "frames", "turn_deg")
    }
    return {
        **{name: size for name, size in sizes.items() if size is not None},
        "pairs": segment.count,
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
    """Return the object STATS of the schema; None without statistics."""
    return None if statistics is None else dataclasses.asdict(statistics)
