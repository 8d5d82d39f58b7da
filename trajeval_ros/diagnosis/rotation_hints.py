"""What may be wrong with rotations: a free alignment, or a groundtruth of another body."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.thinning import every_nth
from trajeval_ros.metrics.moments import Moments

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

LARGE_BODY_DEG = 5.0
_ENOUGH = 20_000  # states, to recognise something by
# By how much orientations in the alignment may let the position ATE grow before that is said.
_WORSE = 1.25


class BodyRotation(NamedTuple):
    """One constant rotation in the body's axes that explains the rotation errors.

    Attributes:
        turned_deg: Its angle.
        left_deg: Root mean square of what it leaves.
    """

    turned_deg: float
    left_deg: float


def about_freedom(evaluation: Evaluation) -> list[str]:
    """Return the warning of rotation errors that are a turn of the alignment, if they are."""
    freedom, withheld = evaluation.alignment.freedom, evaluation.withheld
    if freedom is None or not _is_turned(evaluation):
        return []
    why = withheld or freedom.undetermined or freedom.misleading
    if not why:
        return []
    advice = "align by the first state, or by a gauge that turns less" if withheld else ""
    if freedom.disagrees:
        advice = (
            "is the groundtruth of another body, such as a marker (--hand-eye auto), or do the "
            "axes of the two differ?"
        )
    elif freedom.orientations is not None and evaluation.protocol.align_with == "positions":
        advice = "--align-with poses lets them help" + (f"; or {advice}" if advice else "")
    start = "rotation and velocity errors are withheld: " if withheld else ""
    return [start + "; ".join(part for part in (why, advice) if part)]


def about_bodies(evaluation: Evaluation) -> list[str]:
    """Return the warning of a groundtruth of another body, if it seems to be."""
    found = _body_rotation(evaluation)
    if found is None:
        return []
    return [
        f"one constant rotation of {found.turned_deg:.0f} deg in the body's axes explains the "
        f"rotation error but for {found.left_deg:.1f} deg: the groundtruth seems to be of another "
        "body, such as a marker; --hand-eye auto tests it, --hand-eye FILE takes what is known"
    ]


def about_poses(evaluation: Evaluation) -> list[str]:
    """Return the warning of orientations that spoil the alignment of positions, if they do."""
    alignment, pairs = evaluation.alignment, evaluation.association
    if alignment.by_positions is None:
        return []
    moments = Moments.of_pairs(pairs.groundtruth.positions, pairs.estimate.positions)
    before, after = moments.rmse(alignment.by_positions), moments.rmse(alignment.similarity)
    if after <= _WORSE * before:
        return []
    return [
        f"aligned with orientations, the position ATE grows from {before:.4g} m to "
        f"{after:.4g} m: positions and orientations disagree; is the groundtruth of "
        "another body, such as a marker (--hand-eye auto)?"
    ]


def require_same_body(evaluation: Evaluation) -> None:
    """Refuse an alignment by the orientations of another body.

    Raises:
        InputError: The groundtruth seems to be of another body.
    """
    if evaluation.protocol.align_with != "poses":
        return
    found = _body_rotation(evaluation)
    if found is not None:
        raise InputError(
            "the groundtruth seems to be of another body, turned by "
            f"{found.turned_deg:.0f} deg in its axes, so its orientations would spoil the "
            "alignment; give --hand-eye auto or FILE, or align with positions"
        )


def _is_turned(evaluation: Evaluation) -> bool:
    """Return whether there is anything that depends on the alignment's rotation."""
    truth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    oriented = truth.quaternions is not None and estimate.quaternions is not None
    return oriented or (truth.velocities is not None and estimate.velocities is not None)


def _body_rotation(evaluation: Evaluation) -> BodyRotation | None:
    """Return the rotation of another body if one explains all errors under positions alone."""
    alignment, pairs = evaluation.alignment, evaluation.association
    some = every_nth(len(pairs), _ENOUGH)
    truth, estimate = pairs.groundtruth[some].quaternions, pairs.estimate[some].quaternions
    if truth is None or estimate is None or alignment.undetermined:
        return None
    aligned = (alignment.by_positions or alignment.similarity).quaternions(estimate)
    found = _constant_rotation(lie.multiply(lie.conjugate(aligned), truth))
    if found.turned_deg <= LARGE_BODY_DEG or 3.0 * found.left_deg >= found.turned_deg:
        return None
    # Worlds that are turned against each other look alike, unless the body itself turns.
    worlds = _constant_rotation(lie.multiply(truth, lie.conjugate(aligned)))
    return None if found.left_deg > 0.5 * worlds.left_deg else found


def _constant_rotation(quaternions: Floats) -> BodyRotation:
    """Return the mean of N rotations, and what it leaves."""
    mean = np.linalg.eigh(quaternions.T @ quaternions)[1][:, -1]
    apart = lie.angle(lie.multiply(lie.conjugate(mean), quaternions))
    return BodyRotation(
        float(np.degrees(lie.angle(mean))), float(np.degrees(np.sqrt(np.mean(apart**2))))
    )
