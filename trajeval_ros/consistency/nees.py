"""Normalised estimation error squared (NEES): errors relative to their covariance.

For a consistent estimator the joint NEES of a run has a chi-square distribution, with degrees of
freedom equal to the rank of the covariance, in any gauge (gauge paper; measured equal to 1e-3).
The NEES of single poses depends on the gauge. It is strongly correlated along a run, so that its
mean has few effective degrees of freedom.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray
from scipy.stats import chi2

from trajeval_ros.consistency.consistency_result import PartNees, PerPose, PoseNees
from trajeval_ros.consistency.s_transformation import STransformation
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import POSE_DOF

# Squared pivot of a correlation matrix below which a direction has no variance (rounding).
_ROUNDING = 1e-13
_SIGNIFICANCE = 0.05
_ALL = np.arange(POSE_DOF)


def joint_nees(errors: Floats, covariance: Floats, normals: Floats) -> float:
    """Return e' C^+ e of errors (N, d) of all states together, with C (N d, N d) in their gauge.

    The null space of the covariance is spanned by the conditions of the alignment, the `normals`
    (N, d, k) of the S-transformation. With variance added there, the matrix is definite, and a
    Cholesky factor replaces the pseudo-inverse.
    """
    size = errors.size
    conditions = np.linalg.qr(normals.reshape(size, -1))[0]
    # For finite errors the conditions hold to first order; the remainder is not noise.
    within = errors.ravel() - conditions @ (conditions.T @ errors.ravel())
    variances = np.diagonal(covariance)
    # A variance of exactly zero belongs to a direction that a condition fixes.
    units = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    null = np.linalg.qr(conditions * units[:, None])[0]
    filled = covariance / units / units[:, None] + null @ null.T
    try:
        factor = scipy.linalg.cholesky(filled, lower=True, overwrite_a=True)
        pivot = float(np.diagonal(factor).min()) ** 2
    except np.linalg.LinAlgError:
        pivot = 0.0
    if pivot < _ROUNDING:
        raise InputError(
            f"the covariance is not positive definite in the {size - null.shape[1]} directions "
            "that remain after alignment: its rank is too low, or it is not a covariance"
        )
    whitened = scipy.linalg.solve_triangular(factor, within / units, lower=True)
    return float(whitened @ whitened)


def joint_nees_by_information(
    errors: Floats,
    information: scipy.sparse.csr_matrix,
    extra: Floats,
    noise: Floats | None = None,
    seen: NDArray[np.int64] | None = None,
) -> float:
    """Return the same from a sparse information matrix (n, n), without inverting it.

    A quadratic form with a pseudo-inverse is a minimum: of d' Lambda d over all errors d of the
    estimator that are compatible with the aligned errors. Free are its velocities, states that
    were not compared, the directions that the alignment removes, and the groundtruth's errors.

    `extra` (N, 6, j) are directions of the alignment's gauge with non-zero information: two
    rotations for SE(3), also the scale for Sim(3); all directions of the gauge for an estimator
    with a prior. `noise` (N, 6, 6) has the covariances of groundtruth, None if it is exact. `seen`
    (6N,) are the rows of the information of the errors (N, 6); by default the first six of nine of
    every state.
    """
    size = information.shape[0]
    if seen is None:
        seen = np.arange(size).reshape(len(errors), -1)[:, :6].ravel()
    unseen = np.setdiff1d(np.arange(size), seen)
    columns = np.concatenate([errors[:, :, None], extra], axis=2).reshape(len(seen), -1)
    if noise is None:
        square = columns.T @ (information[seen][:, seen] @ columns)
        inner, pull = information[unseen][:, unseen], information[unseen][:, seen] @ columns
    else:
        weights = np.asarray(np.linalg.inv(noise), dtype=np.float64)
        weighted = (weights @ columns.reshape(len(errors), 6, -1)).reshape(columns.shape)
        square = columns.T @ weighted
        inner = information + _at_rows(weights, seen.reshape(-1, 6), size)
        pull = np.zeros((size, columns.shape[1]))
        pull[seen] = weighted
    if inner.shape[0]:
        # In order of time the matrix is banded; it is definite and needs no pivoting.
        factor = scipy.sparse.linalg.splu(
            inner.tocsc(), permc_spec="NATURAL", options={"SymmetricMode": True}
        )
        square = square - pull.T @ factor.solve(pull)
    of_error, of_extra = square[0, 1:], square[1:, 1:]
    return float(square[0, 0] - of_error @ np.linalg.solve(of_extra, of_error))


def _at_rows(blocks: Floats, rows: NDArray[np.int64], size: int) -> scipy.sparse.csr_matrix:
    """Return a matrix (size, size) that has blocks (N, 6, 6) at rows and columns (N, 6)."""
    across = np.broadcast_to(rows[:, None, :], blocks.shape)
    down = np.broadcast_to(rows[:, :, None], blocks.shape)
    entries = blocks.ravel(), (down.ravel(), across.ravel())
    matrix = scipy.sparse.csr_matrix(entries, shape=(size, size))
    matrix.eliminate_zeros()
    return matrix


def pose_nees(errors: Floats, covariances: Floats) -> Floats:
    """Return e_i' C_ii^-1 e_i (N,) from the states' own blocks (N, d, d)."""
    units = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    scaled = covariances / units[:, :, None] / units[:, None, :]
    normal = errors / units
    solved = np.linalg.solve(scaled, normal[:, :, None])[:, :, 0]
    squares: Floats = np.einsum("ni,ni->n", normal, solved)
    return squares


def nees_by_pose(
    errors: Floats, blocks: Floats, first: int, axes: NDArray[np.int64] = _ALL
) -> PoseNees:
    """Return the NEES of single poses from pose `first` on, NaN before, in all or some axes."""
    parts = (axes, axes[axes < 3], axes[axes >= 3])
    columns = np.full((len(parts), len(errors)), np.nan)
    try:
        for column, part in zip(columns, parts, strict=True):
            block = blocks[first:, part[:, None], part]
            column[first:] = pose_nees(errors[first:, part], block) / len(part)
    except np.linalg.LinAlgError:
        raise InputError("the covariance of a pose is singular, so it has no NEES") from None
    return PoseNees(*columns)


def diagonal_blocks(covariance: Floats, block: int) -> Floats:
    """Return the states' own blocks (N, d, d) of a joint covariance (N d, N d)."""
    count = len(covariance) // block
    states = np.arange(count)
    blocks: Floats = covariance.reshape(count, block, count, block)[states, :, states]
    return blocks


def effective_dof(covariance: Floats, block: int) -> float:
    """Return Satterthwaite's degrees of freedom of the mean NEES of a run's states.

    n^2 / sum_ij |S_ii^-1/2 S_ij S_jj^-1/2|^2. It is n for independent states and d for identical
    ones. All blocks on the diagonal must be definite.
    """
    count = len(covariance) // block
    factors = np.linalg.inv(np.linalg.cholesky(diagonal_blocks(covariance, block)))
    rows = factors @ covariance.reshape(count, block, -1)
    whitened = factors @ rows.reshape(len(covariance), count, block).transpose(1, 2, 0)
    return float(len(covariance) ** 2 / np.sum(np.square(whitened)))


def chi_square_band(dof: float) -> tuple[float, float]:
    """Return the interval of NEES / dof that contains 95 % of consistent runs.

    For the mean over M independent runs, dof is M times that of one run.
    """
    low, high = chi2.ppf([0.025, 0.975], dof) / dof
    return float(low), float(high)


def summary_of(
    nees: PoseNees, dof: float | None = None, *, in_gauge: bool = True, pose_dof: int = POSE_DOF
) -> PerPose:
    """Summarise the NEES of poses with `pose_dof` degrees of freedom each.

    `dof` are those of the mean; None if unknown. `in_gauge` states that covariances and errors
    are in the same gauge.
    """
    count = int(np.count_nonzero(np.isfinite(nees.pose)))
    # Bonferroni bound: valid for any correlation, and for upper bounds of covariances.
    limit = float(chi2.ppf(1.0 - _SIGNIFICANCE / count, pose_dof)) / pose_dof
    position, rotation = (
        PartNees(float(np.nanmean(values)), float(np.nanmax(values)))
        for values in (nees.position, nees.rotation)
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


def extra_directions(transformation: STransformation) -> Floats:
    """Return the directions (N, 6, j) that an alignment removes beyond yaw and translation."""
    names = {0: [], 4: [], 6: [0, 1], 7: [0, 1, 6]}[transformation.orbit.shape[2]]
    return transformation.orbit[:, :, names]
