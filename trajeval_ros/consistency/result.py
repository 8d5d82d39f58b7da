"""What can be said of an estimate's consistency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from trajeval_ros.consistency.nees import chi_square_band
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import POSE_DOF, Gauge

_SIGNIFICANCE = 0.05

JOINT_STATEMENT = "exact: the joint covariance was brought into the gauge of the alignment"
OWN_GAUGE_STATEMENT = "per-pose NEES exact in the estimator's own gauge"
STRIPPED_STATEMENT = (
    "per-pose NEES exact in the estimator's own gauge, if what the first pose's covariance holds "
    "is a prior of position and yaw, as it looks; it was taken off all poses"
)
COMMON_FRAME_STATEMENT = "per-pose NEES exact: nothing was aligned, the frames are the same"
AS_PUBLISHED_STATEMENT = (
    "covariances as published, in whatever gauge the estimator has, errors in that of the "
    "alignment: NEES as ov_eval computes it, which need not be 1 for an honest estimator"
)
BOUND_STATEMENT = (
    "bound only (cross-covariances not in the message); can show over-confidence, cannot confirm "
    "consistency"
)


@dataclass(frozen=True)
class Joint:
    """NEES of all poses together: chi-square with `dof` degrees of freedom if honest.

    Attributes:
        nees: e' C^+ e.
        dof: Rank of C.
        band_95: In which nees / dof falls for 95 % of honest runs.
    """

    nees: float
    dof: int
    band_95: tuple[float, float]


@dataclass(frozen=True, eq=False)
class PoseNees:
    """NEES of N poses by their degrees of freedom, NaN where a pose has none.

    Attributes:
        pose: (N,), NEES / 6.
        position: (N,), NEES / 3.
        rotation: (N,), NEES / 3.
    """

    pose: Floats
    position: Floats
    rotation: Floats


@dataclass(frozen=True)
class PartNees:
    """NEES of single poses by their positions or rotations alone, divided by three.

    Attributes:
        mean: Over the poses.
        max: Over the poses.
    """

    mean: float
    max: float


@dataclass(frozen=True)
class PerPose:
    """NEES of single poses, divided by their six degrees of freedom.

    Attributes:
        poses: How many have one; an alignment by the first pose leaves that one none.
        mean: Over the poses.
        max: Over the poses.
        limit_95: Which the largest stays under in 95 % of honest runs, however poses correlate;
            None where covariances are in another gauge than the errors.
        position: Of positions, by their own block of the covariance.
        rotation: Of rotations, likewise.
        effective_dof: Of the mean, out of 6 times the poses; None where it can't be known.
        band_95: In which the mean falls for 95 % of honest runs; None where it can't be known.
    """

    poses: int
    mean: float
    max: float
    limit_95: float | None
    position: PartNees
    rotation: PartNees
    effective_dof: float | None = None
    band_95: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Consistency:
    """Whether an estimate is as sure as it should be.

    Attributes:
        gauge: Of the alignment, and so of errors and covariances.
        covariance_source: `message`, or the joint covariance's file.
        exactness: `exact`, `bound` where correlations are unknown, or `as published` where
            covariances were not brought into the gauge.
        statement: What may be claimed, in a sentence.
        verdict: `consistent`, `over-confident`, `under-confident` or `undecided`.
        joint: NEES of all poses together; None without a joint covariance.
        per_pose: NEES of single poses; None where a run is long and its information not banded.
        pose_nees: Of each pair; None as `per_pose`.
        errors: (N, 6), p' - p (m) and Log(R' R^T) (rad).
        covariances: (N, 6, 6), of the errors of each pose; None as `per_pose`.

    Example:
        >>> import numpy as np
        >>> from dataclasses import replace
        >>> from trajeval_ros import CovarianceRequest, Protocol, evaluate, judge, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> block = np.diag([0.1**2] * 3 + [0.01**2] * 3)
        >>> blocks = np.broadcast_to(block, (len(flight.estimate), 6, 6))
        >>> estimate = replace(flight.estimate, covariances=blocks)
        >>> found = evaluate(flight.groundtruth, estimate, Protocol(gauge="yaw"))
        >>> request = CovarianceRequest("message", groundtruth_noise=(0.002, 0.1))
        >>> consistency = judge(found, request)
        >>> consistency.errors.shape == consistency.sigmas.shape
        True
    """

    gauge: Gauge
    covariance_source: str
    exactness: str
    statement: str
    verdict: str
    joint: Joint | None
    per_pose: PerPose | None
    pose_nees: PoseNees | None
    errors: Floats
    covariances: Floats | None

    @property
    def nees(self) -> Floats | None:
        """NEES / 6 of each pair (N,), NaN where it has none; None as `per_pose`."""
        return None if self.pose_nees is None else self.pose_nees.pose

    @property
    def sigmas(self) -> Floats | None:
        """Standard deviations of the errors, (N, 6); None as `per_pose`."""
        return None if self.covariances is None else sigmas_of(self.covariances)


def sigmas_of(blocks: Floats) -> Floats:
    """Return the standard deviations (N, d) that blocks (N, d, d) hold."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(blocks, axis1=1, axis2=2), 0.0)))


def summary_of(nees: PoseNees, dof: float | None = None, *, in_gauge: bool = True) -> PerPose:
    """Summarise the NEES of poses.

    Args:
        nees: Of all poses.
        dof: Of the mean of NEES / 6, where it is known.
        in_gauge: Whether covariances and errors are in one gauge.
    """
    count = int(np.count_nonzero(np.isfinite(nees.pose)))
    # Bonferroni: holds whatever the correlations are, and for a bound as well.
    limit = float(chi2.ppf(1.0 - _SIGNIFICANCE / count, POSE_DOF)) / POSE_DOF
    position, rotation = (
        PartNees(float(np.nanmean(each)), float(np.nanmax(each)))
        for each in (nees.position, nees.rotation)
    )
    return PerPose(
        poses=count,
        mean=float(np.nanmean(nees.pose)),
        max=float(np.nanmax(nees.pose)),
        limit_95=limit if in_gauge else None,
        position=position,
        rotation=rotation,
        effective_dof=dof,
        band_95=None if dof is None else chi_square_band(dof),
    )


def verdict_of(joint: Joint) -> str:
    """Return what the NEES of all poses together says."""
    low, high = joint.band_95
    share = joint.nees / joint.dof
    if share > high:
        return "over-confident"
    return "under-confident" if share < low else "consistent"
