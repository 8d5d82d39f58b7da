"""Content of result.json, the result of an evaluation for other programs.

The schema is `trajeval/3`. docs/result.md describes all fields. Two evaluations of the same input
give the same bytes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros import __version__
from trajeval_ros.formatting.remarks import remark_json
from trajeval_ros.geometry.frame_axes import between_own_axes
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.requests.settings_table import settings_of
from trajeval_ros.metrics.discontinuities.parts import together_m
from trajeval_ros.metrics.relative_evaluation import SubTrajectoryErrors
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.pipeline.outcome import Outcome, RunOutcome

if TYPE_CHECKING:
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.diagnosis.findings import Finding
    from trajeval_ros.metrics.scale_along_run import ScaleAlongRun

SCHEMA = "trajeval/3"


def result_of(outcome: Outcome) -> dict[str, Any]:
    """Return the content of result.json for one or more estimates and one groundtruth."""
    groundtruth, runs = outcome.groundtruth, outcome.runs
    # The protocol of a live run is in its own folder.
    request = dataclasses.replace(outcome.request, protocol=runs[0].evaluation.protocol)
    inputs = {
        item.source: item.fingerprint for item in (groundtruth, *(run.estimate for run in runs))
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
            "remarks": [remark_json(remark) for remark in groundtruth.remarks],
        },
        "runs": [_run(run, groundtruth.up) for run in runs],
        "failed": [dataclasses.asdict(item) for item in outcome.failed],
        "provenance": {
            "version": __version__,
            "protocol": request.protocol.name,
            "settings": outcome.settings or settings_of(request),
            "inputs": inputs,
        },
    }


def _run(run: RunOutcome, groundtruth_up: UpAxis) -> dict[str, Any]:
    evaluation, estimate = run.evaluation, run.estimate
    protocol, pairs = evaluation.protocol, evaluation.association
    similarity, coverage = evaluation.alignment.similarity, pairs.coverage
    if protocol.is_upright:  # then the alignment is between frames turned to z up
        similarity = between_own_axes(similarity, groundtruth_up, estimate.up)
    calibration = probabilistic = None
    if run.calibrated is not None:
        from trajeval_ros.io.results.requested_json import calibration_json

        calibration = calibration_json(run.calibrated)
    if run.likelihood is not None:
        from trajeval_ros.io.results.requested_json import probabilistic_json

        probabilistic = probabilistic_json(run.likelihood)
    return {
        "estimate": {
            "source": estimate.source,
            "name": estimate.name,
            "poses": estimate.poses,
            "duration_s": estimate.duration_s,
            "frame": estimate.frame,
            "child_frame": estimate.child_frame,
            "up": dataclasses.asdict(estimate.up),
            "remarks": [remark_json(remark) for remark in estimate.remarks],
            "resets": [reset._asdict() for reset in estimate.resets],
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
                "states": by_state.states,
                "states_used": by_state.states_used,
                "position_m": statistics_json(by_state.position_m),
                "rotation_deg": statistics_json(by_state.rotation_deg),
                "reason": by_state.reason,
            }
            for by_state in run.by_states
        ]
        or None,
        "ate": {
            "form": protocol.ate_form,
            **{metric: statistics_json(value) for metric, value in evaluation.ate.items()},
        },
        "noise_corrected_ate": run.noise_corrected_ate
        and dataclasses.asdict(run.noise_corrected_ate),
        "re": None
        if evaluation.relative is None
        else {
            "form": protocol.re_form,
            "segments": [_segment(item) for item in evaluation.relative],
            "pooled": {name: statistics_json(value) for name, value in evaluation.pooled.items()},
        },
        "scale_along_run": _scale(evaluation.scale_along_run),
        "score": None if evaluation.score is None else dataclasses.asdict(evaluation.score),
        "recall": evaluation.recall and dataclasses.asdict(evaluation.recall),
        "calibration": calibration,
        "consistency": None if run.consistency is None else _consistency(run.consistency),
        "integrity": None if run.integrity is None else integrity_json(run.integrity),
        "probabilistic": probabilistic,
        "stream": run.stream and dataclasses.asdict(run.stream),
        "as_available": run.available and dataclasses.asdict(run.available.numbers),
        "diagnosis": findings_json(run.diagnosis.findings),
        "corrected": findings_json(run.corrected),
        "events": [dataclasses.asdict(event) for event in evaluation.events],
        "segments": [dataclasses.asdict(part) for part in evaluation.parts],
        "ate_of_segments_m": together_m(evaluation.parts),
        "live": run.live,
        "remarks": [remark_json(remark) for remark in evaluation.remarks],
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


def _scale(scale: ScaleAlongRun | None) -> dict[str, Any] | None:
    if scale is None:
        return None
    return {
        "length_m": scale.length_m,
        "travelled_m": scale.travelled_m.tolist(),
        "ratios": scale.ratios.tolist(),
        "drift_percent_per_100m": scale.drift,
        "drift_std_percent_per_100m": scale.drift_std,
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


def findings_json(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the findings about an estimate, the most severe first."""
    return [_finding(finding) for finding in findings]


def _finding(finding: Finding) -> dict[str, Any]:
    tried, asdict = finding.tried, dataclasses.asdict
    return {
        "cause": finding.cause,
        "sentence": finding.sentence,
        "advice": finding.advice,
        "option": finding.option or None,
        "evidence": {
            name: value for name, value in finding.evidence.items() if math.isfinite(value)
        },
        "before": None if tried is None or tried.before is None else asdict(tried.before),
        "after": None if tried is None else asdict(tried.after),
    }


def integrity_json(integrity: Integrity) -> dict[str, Any]:
    """Return fractions, episodes and statistics for every part of the pose (docs/result.md)."""
    return {
        "risk": integrity.risk,
        "exactness": integrity.exactness,
        "parts": [
            {
                "part": part.part,
                "unit": part.unit,
                "alert_limit": part.alert_limit,
                "areas": part.areas,
                "episodes": part.episodes,
                "availability": part.availability,
                "bounded": part.bounded,
                "inflation_999": part.inflation,
                "effective_number": part.effective,
                "hazardous_95": list(part.hazardous_95),
                "time_to_alert": {
                    "median_s": part.time_to_alert.median,
                    "worst_s": part.time_to_alert.worst,
                    "episodes": len(part.time_to_alert.seconds) + part.time_to_alert.missed,
                    "missed": part.time_to_alert.missed,
                },
                "error_median": float(np.median(part.errors)),
                "protection_level_median": float(np.median(part.levels)),
            }
            for part in integrity.parts
        ],
    }
