"""Properties of a recording, by which a catalogue of recordings can be filtered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.viewer.sdk import sdk
from trajeval_ros.viewer.text_panel import longest_drift, rmse_of

if TYPE_CHECKING:
    from trajeval_ros.online.reports import Snapshot

_PROPERTY = "evaluation"


def send_of_evaluations(
    recording: Any,
    label: str,
    evaluations: Sequence[Evaluation],
    consistencies: Sequence[Consistency | None],
    names: Sequence[str],
) -> None:
    """Log the numbers of recorded runs, one value per estimate."""
    protocol = evaluations[0].protocol
    drifts = [evaluation.drift for evaluation in evaluations]
    lengths_m = [None if drift is None else drift.length_m for drift in drifts]
    _send(
        recording,
        label,
        (protocol.gauge, protocol.modality),
        estimate=list(names),
        ate_position_m=[rmse_of(evaluation.ate, "position_m") for evaluation in evaluations],
        ate_rotation_deg=[rmse_of(evaluation.ate, "rotation_deg") for evaluation in evaluations],
        re_percent=[None if drift is None else drift.percent.mean for drift in drifts],
        re_length_m=lengths_m,
        coverage=[evaluation.association.groundtruth_coverage for evaluation in evaluations],
        verdict=[
            "" if consistency is None else consistency.verdict for consistency in consistencies
        ],
    )


def send_of_snapshots(
    recording: Any,
    label: str,
    aligned_by: tuple[Gauge, str | None],
    snapshots: Sequence[Snapshot],
    names: Sequence[str],
) -> None:
    """Log the numbers of live runs so far, one value per estimate.

    `aligned_by` are gauge and modality.
    """
    drifts = [longest_drift(snapshot) for snapshot in snapshots]
    lengths_m = [item[0].value if item and item[0].unit == "m" else None for item in drifts]
    _send(
        recording,
        label,
        aligned_by,
        estimate=list(names),
        ate_position_m=[snapshot.position_rmse_m for snapshot in snapshots],
        re_percent=[
            100.0 * drift[1] / length_m if drift and length_m else None
            for drift, length_m in zip(drifts, lengths_m, strict=True)
        ],
        re_length_m=lengths_m,
        coverage=[
            snapshot.coverage.covered if snapshot.coverage is not None else None
            for snapshot in snapshots
        ],
        verdict=[
            snapshot.consistency.verdict if snapshot.consistency else "" for snapshot in snapshots
        ],
    )


def _send(
    recording: Any, label: str, aligned_by: tuple[Gauge, str | None], **columns: Sequence[Any]
) -> None:
    """Log values of estimates; numbers that are not available are NaN."""
    rerun, _ = sdk()
    values = {
        name: [float("nan") if item is None else item for item in column]
        for name, column in columns.items()
    }
    gauge, modality = aligned_by
    stated = {"label": label, "gauge": gauge.value, "modality": modality or ""}
    recording.send_property(_PROPERTY, rerun.AnyValues(**stated, **values))
