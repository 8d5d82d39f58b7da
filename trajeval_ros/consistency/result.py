"""What can be said of an estimate's consistency."""

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


def verdict_of(joint: Joint) -> str:
    """Return what the NEES of all poses together says."""
    low, high = joint.band_95
    share = joint.nees / joint.dof
    if share > high:
        return "over-confident"
    return "under-confident" if share < low else "consistent"
