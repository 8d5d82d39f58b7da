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
    drifts = [each.drift for each in evaluations]
    lengths_m = [None if each is None else each.length_m for each in drifts]
    _send(
        recording,
        label,
        (protocol.gauge, protocol.modality),
        estimate=list(names),
        ate_position_m=[rmse_of(each.ate, "position_m") for each in evaluations],
        ate_rotation_deg=[rmse_of(each.ate, "rotation_deg") for each in evaluations],
        re_percent=[None if each is None else each.percent.mean for each in drifts],
        re_length_m=lengths_m,
        coverage=[each.association.groundtruth_coverage for each in evaluations],
        verdict=["" if each is None else each.verdict for each in consistencies],
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
    drifts = [longest_drift(each) for each in snapshots]
    lengths_m = [each[0].value if each and each[0].unit == "m" else None for each in drifts]
    _send(
        recording,
        label,
        aligned_by,
        estimate=list(names),
        ate_position_m=[each.position_rmse_m for each in snapshots],
        re_percent=[
            100.0 * drift[1] / length_m if drift and length_m else None
            for drift, length_m in zip(drifts, lengths_m, strict=True)
        ],
        re_length_m=lengths_m,
        coverage=[
            each.coverage.covered if each.coverage is not None else None for each in snapshots
        ],
        verdict=[each.consistency.verdict if each.consistency else "" for each in snapshots],
    )


def _send(
    recording: Any, label: str, aligned_by: tuple[Gauge, str | None], **columns: Sequence[Any]
) -> None:
    """Log values of estimates; numbers that are not available are NaN."""
    rerun, _ = sdk()
    values = {
        name: [float("nan") if each is None else each for each in column]
        for name, column in columns.items()
    }
    gauge, modality = aligned_by
    stated = {"label": label, "gauge": gauge.value, "modality": modality or ""}
    recording.send_property(_PROPERTY, rerun.AnyValues(**stated, **values))
