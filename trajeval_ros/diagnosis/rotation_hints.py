"""Warnings about the rotation of an alignment: undetermined, or wrong orientations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.exceptions import InputError
from trajeval_ros.metrics.moments import Moments

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

# Largest factor on the position ATE by orientations in the alignment, without a warning.
_WORSE = 1.25


def about_freedom(evaluation: Evaluation) -> list[str]:
    """Return the warning about rotation errors that the alignment causes, if any."""
    freedom, withheld = evaluation.alignment.freedom, evaluation.withheld
    if freedom is None or not _is_turned(evaluation):
        return []
    why = withheld or freedom.undetermined or freedom.misleading
    if not why:
        return []
    advice = (
        ("align by the first state, or use a gauge with fewer degrees of freedom")
        if withheld
        else ""
    )
    if freedom.disagrees:
        advice = "check for a marker frame (--hand-eye auto) and for different axes"
    elif freedom.orientations is not None and evaluation.protocol.align_with == "positions":
        advice = "include them with --align-with poses" + (f"; or {advice}" if advice else "")
    start = "rotation and velocity errors are withheld: " if withheld else ""
    return [start + "; ".join(part for part in (why, advice) if part)]


def about_poses(evaluation: Evaluation) -> list[str]:
    """Return the warning about orientations that contradict the positions, if any."""
    alignment, pairs = evaluation.alignment, evaluation.association
    if alignment.by_positions is None:
        return []
    moments = Moments.of_pairs(pairs.groundtruth.positions, pairs.estimate.positions)
    before, after = moments.rmse(alignment.by_positions), moments.rmse(alignment.similarity)
    if after <= _WORSE * before:
        return []
    return [
        f"the alignment with orientations increases the position ATE from {before:.4g} m to "
        f"{after:.4g} m: positions and orientations disagree; check for a marker frame "
        "(--hand-eye auto)"
    ]


def require_same_body(evaluation: Evaluation, diagnosis: Diagnosis) -> None:
    """Refuse an alignment by the orientations of another body.

    Raises:
        InputError: The groundtruth is probably of another body.
    """
    found = diagnosis.named("body")
    if evaluation.protocol.align_with == "poses" and found is not None:
        raise InputError(
            "the groundtruth is probably of another body frame, rotated by "
            f"{found.evidence['angle_deg']:.0f} deg, so its orientations can't be used for the "
            "alignment; give --hand-eye auto or FILE, or use --align-with positions"
        )


def _is_turned(evaluation: Evaluation) -> bool:
    """Return whether any error depends on the rotation of the alignment."""
    truth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    oriented = truth.quaternions is not None and estimate.quaternions is not None
    return oriented or (truth.velocities is not None and estimate.velocities is not None)
