"""The rows of a run in the table of results: one per metric and length."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from trajeval_ros.batch.plan import PlannedRun
from trajeval_ros.batch.records import Record
from trajeval_ros.batch.results_table import (
    ATE,
    CALIBRATION,
    CONSISTENCY,
    FAILED,
    INTEGRITY,
    LIKELIHOOD,
    MISSING,
    OK,
    POOLED,
    RE,
)


def rows_of_run(run: PlannedRun, record: Record, own_coverage: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of an evaluated run.

    Args:
        run: The run.
        record: Its record.
        own_coverage: Share of the groundtruth's duration that the whole run covers, before a
            common time span cut it.
    """
    evaluated = record.run
    association, alignment = evaluated["association"], evaluated["alignment"]
    gap = association["longest_gap"] or {}
    inputs = record.result["provenance"]["inputs"]
    truth, estimate = (
        inputs[record.result["groundtruth"]["source"]],
        inputs[evaluated["estimate"]["source"]],
    )
    same = {
        **_names(run),
        "status": OK,
        "pairs": association["pairs"],
        "estimate_coverage": association["estimate_coverage"],
        "groundtruth_coverage": association["groundtruth_coverage"],
        "own_groundtruth_coverage": own_coverage,
        "span_s": (record.span_ns[1] - record.span_ns[0]) / 1e9,
        "groundtruth_span": association["groundtruth_span"],
        "longest_gap_s": gap.get("duration_s"),
        "longest_gap_m": gap.get("reach_m"),
        "longest_gap_deg": gap.get("turn_deg"),
        "scale": alignment["scale"],
        "states_used": alignment["states_used"],
        "poses": evaluated["estimate"]["poses"],
        "groundtruth": run.groundtruth,
        "estimate": run.estimate,
        "groundtruth_sha256": truth,
        "estimate_sha256": estimate,
        "key": record.key,
        "warnings": "\n".join(evaluated["warnings"]),
        "diagnosis": ",".join(each["cause"] for each in evaluated["diagnosis"]),
    }
    yield from _rows(evaluated["ate"], {**same, "kind": ATE})
    yield from _values(evaluated, same)
    relative = evaluated["re"]
    if relative is None:
        return
    for length, segment in zip(record.lengths, relative["segments"], strict=True):
        sizes = {name: segment.get(name) for name in ("length_m", "duration_s", "mean_length_m")}
        yield from _rows(segment, {**same, **sizes, "kind": RE, "length": length})
    yield from _rows(relative["pooled"], {**same, "kind": POOLED})


def _values(evaluated: dict[str, Any], same: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield rows of calibration, consistency, integrity and likelihood."""
    calibration, consistency, probabilistic = (
        evaluated[name] or {} for name in ("calibration", "consistency", "probabilistic")
    )
    offset, hand_eye = calibration.get("time_offset") or {}, calibration.get("hand_eye") or {}
    rotation, lever = hand_eye.get("rotation") or {}, hand_eye.get("lever_arm") or {}
    joint, per_pose = (consistency.get(name) or {} for name in ("joint", "per_pose"))
    ate = probabilistic.get("ate") or {}
    found = (
        (CALIBRATION, "time_offset_s", offset.get("value_s") if offset.get("applied") else None,
         offset.get("sigma_s")),
        (CALIBRATION, "rotation_deg", rotation.get("angle_deg") if rotation.get("applied") else
         None, None),
        (CALIBRATION, "lever_arm_m", math.hypot(*(each or 0.0 for each in lever["value_m"]))
         if lever.get("applied") else None, None),
        (CALIBRATION, "parameters_applied", calibration.get("parameters_applied"), None),
        (CONSISTENCY, "joint_nees_per_dof", joint.get("nees_per_dof"), None),
        (CONSISTENCY, "pose_nees_per_dof", per_pose.get("mean"), None),
        *_integrity(evaluated["integrity"] or {}),
        (LIKELIHOOD, "nll_per_pose", probabilistic.get("nll_per_pose"), None),
        (LIKELIHOOD, "weighted_m", ate.get("weighted_m"), None),
        (LIKELIHOOD, "supported_m", ate.get("supported_m"), None),
        (LIKELIHOOD, "supported_share", ate.get("supported_share"), None),
    )  # fmt: skip
    for kind, metric, value, sigma in found:
        if value is not None:
            yield {**same, "kind": kind, "metric": metric, "mean": value, "std": sigma}


def _integrity(found: dict[str, Any]) -> Iterator[tuple[str, str, float, None]]:
    """Yield kind, metric and value of the integrity, by part of the pose."""
    for part in found.get("parts", ()):
        name = part["part"]
        yield INTEGRITY, f"{name}_hazardous", part["areas"]["hazardous"], None
        yield INTEGRITY, f"{name}_available", part["availability"], None
        yield INTEGRITY, f"{name}_inflation", part["inflation_999"], None
        yield INTEGRITY, f"{name}_level_{part['unit']}", part["protection_level_median"], None


def row_of_failure(run: PlannedRun, reason: str) -> dict[str, Any]:
    """Return the row of a failed or missing run, which has no numbers."""
    return {
        **_names(run),
        "status": MISSING if run.missing else FAILED,
        "reason": reason,
        "groundtruth": run.groundtruth,
        "estimate": run.estimate,
    }


def _names(run: PlannedRun) -> dict[str, str]:
    return {"algorithm": run.algorithm, "sequence": run.sequence, "trial": run.trial}


def _rows(metrics: dict[str, Any], same: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for metric, statistics in metrics.items():
        if isinstance(statistics, dict):
            yield {**same, "metric": metric, **statistics}
