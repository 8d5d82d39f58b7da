"""Result of a consistency test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge

JOINT_STATEMENT = "exact: the joint covariance is transformed to the gauge of the alignment"
OWN_GAUGE_STATEMENT = "per-pose NEES exact in the estimator's own gauge"
STRIPPED_STATEMENT = (
    "per-pose NEES exact in the estimator's own gauge, provided that the first pose's "
    "covariance is a prior of position and yaw; this prior is removed from all poses"
)
COMMON_FRAME_STATEMENT = "per-pose NEES exact: no alignment, the frames are the same"
AS_PUBLISHED_STATEMENT = (
    "NEES as in ov_eval: covariances in the gauge of the estimator, errors in the gauge of the "
    "alignment; the expected value of a consistent estimator can differ from 1"
)
BOUND_STATEMENT = (
    "bound only (messages have no cross-covariances); can detect overconfidence, cannot confirm "
    "consistency"
)
IN_PLANE_STATEMENT = "; of x, y and yaw, 3 degrees of freedom per pose"


@dataclass(frozen=True)
class Joint:
    """NEES of all poses together; chi-square with `dof` degrees of freedom if consistent."""

    nees: float  # e' C^+ e
    dof: int  # rank of C
    band_95: tuple[float, float]  # interval of nees / dof with 95 % of consistent runs


@dataclass(frozen=True, eq=False)
class PoseNees:
    """NEES of N poses per degree of freedom; NaN if a pose has none."""

    pose: Floats  # (N,), NEES / 6; in a plane NEES / 3
    position: Floats  # (N,), NEES / 3; in a plane NEES / 2
    rotation: Floats  # (N,), NEES / 3; in a plane NEES of the yaw


@dataclass(frozen=True)
class PartNees:
    """NEES / 3 of the positions or rotations of single poses."""

    mean: float  # over the poses
    max: float  # over the poses


@dataclass(frozen=True)
class PerPose:
    """NEES / 6 of single poses."""

    poses: int  # number of poses with a NEES; an alignment by the first pose leaves it without one
    mean: float  # mean over the poses
    max: float  # maximum over the poses
    # Limit of the maximum for 95 % of consistent runs and any correlation; None if covariances and
    # errors are in different gauges.
    limit_95: float | None
    position: PartNees  # NEES of positions, from their block of the covariance
    rotation: PartNees  # NEES of rotations, likewise
    # Effective degrees of freedom of the mean, of 6 per pose; None if unknown.
    effective_dof: float | None = None
    # Interval of the mean with 95 % of consistent runs; None if unknown.
    band_95: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Consistency:
    """Result of a consistency test.

    Attributes:
        gauge: Gauge of the alignment, of the errors and of the covariances.
        covariance_source: `message`, or the joint covariance's file.
        exactness: `exact`, `bound` if correlations are unknown, or `as published` if covariances
            were not transformed to the gauge.
        statement: What the result proves, in one sentence.
        verdict: `consistent`, `overconfident`, `conservative` or `undecided`.
        joint: NEES of all poses together; None without a joint covariance.
        per_pose: NEES of single poses; None for a long run whose information is not banded.
        pose_nees: NEES of every pair; None as `per_pose`.
        errors: (N, 6), p' - p (m) and Log(R' R^T) (rad); zero along axes without variances.
        covariances: (N, 6, 6), of the errors of single poses; None as `per_pose`.

    Example:
        >>> import numpy as np
        >>> from dataclasses import replace
        >>> from trajeval_ros import CovarianceRequest, Protocol, assess_consistency
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> block = np.diag([0.1**2] * 3 + [0.01**2] * 3)
        >>> growth = np.linspace(1.0, 1.1, len(flight.estimate))
        >>> blocks = growth[:, None, None] * block
        >>> estimate = replace(flight.estimate, covariances=blocks)
        >>> result = evaluate(flight.groundtruth, estimate, Protocol(gauge="yaw"))
        >>> request = CovarianceRequest("message", groundtruth_noise=(0.002, 0.1))
        >>> consistency = assess_consistency(result, request)
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
        """NEES / 6 of every pair (N,), NaN if it has none; None as `per_pose`."""
        return None if self.pose_nees is None else self.pose_nees.pose

    @property
    def axes(self) -> tuple[int, int]:
        """Number of coordinates of positions and of rotations that have variances."""
        sigmas = np.ones((1, 6)) if self.covariances is None else sigmas_of(self.covariances)
        return int(sigmas[:, :3].any(axis=0).sum()), int(sigmas[:, 3:].any(axis=0).sum())

    @property
    def sigmas(self) -> Floats | None:
        """Standard deviations of the errors, (N, 6); None as `per_pose`."""
        return None if self.covariances is None else sigmas_of(self.covariances)


def sigmas_of(blocks: Floats) -> Floats:
    """Return the standard deviations (N, d) of blocks (N, d, d)."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(blocks, axis1=1, axis2=2), 0.0)))


def verdict_of(joint: Joint) -> str:
    """Return the verdict from the NEES of all poses together."""
    low, high = joint.band_95
    share = joint.nees / joint.dof
    if share > high:
        return "overconfident"
    return "conservative" if share < low else "consistent"
