"""The Schur complement: landmarks eliminated from the normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.motion_matrix import MotionMatrix
from trajeval_ros.visual_inertial.problem import NormalEquations
from trajeval_ros.visual_inertial.visibility import Visibility

# Pivots below this share of a landmark's largest pivot are rounding (one view, or no parallax).
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """The normal equations of the motion, and the factors for the landmarks' step.

    Attributes:
        matrix: (wN, wN), H_mm - W V^-1 W^T.
        gradient: (N, w), g_m - W V^-1 g_l.
        half: (6, 3, M), the blocks of W L^-T with V = L L^T, by observation; rows are position and
            rotation of its keyframe.
        inverse: (3, 3, K), L^-1.
        pull: (3, K), L^-1 g_l.
        visibility: Keyframes and landmarks of the observations.
    """

    matrix: MotionMatrix
    gradient: Floats
    half: Floats
    inverse: Floats
    pull: Floats
    visibility: Visibility

    def landmarks_after(self, motion_step: Floats) -> Floats:
        """Return the landmarks' step V^-1 (-g_l - W^T dm) (3K,) for the motion's step dm (wN,)."""
        pose_steps = motion_step.reshape(self.visibility.keyframes, -1)[:, :6]
        return self.by_inverse(-self.pull - self.to_landmarks(pose_steps.T)).T.ravel()

    def to_keyframes(self, values: Floats) -> Floats:
        """Return W L^-T (6N, 3K) times values (3, ..., K) of landmarks, (6, ..., N)."""
        observed = values.take(self.visibility.landmark_of, axis=-1)
        return self.visibility.by_keyframe(np.einsum("ijm,j...m->i...m", self.half, observed))

    def to_landmarks(self, values: Floats) -> Floats:
        """Return L^-1 W^T (3K, 6N) times values (6, ..., N) of keyframes, (3, ..., K)."""
        observed = values.take(self.visibility.keyframe_of, axis=-1)
        return self.visibility.by_landmark(np.einsum("ijm,i...m->j...m", self.half, observed))

    def by_inverse(self, values: Floats) -> Floats:
        """Return L^-T times values (3, ..., K) of landmarks."""
        product: Floats = np.einsum("jik,j...k->i...k", self.inverse, values)
        return product


def motion_matrix(normal: NormalEquations) -> MotionMatrix:
    """Return H_mm (wN, wN), the motion's block of the normal equations."""
    matrix = MotionMatrix(normal.visibility, normal.diagonal.shape[1])
    matrix.blocks(0)[:] = normal.diagonal
    matrix.blocks(1)[:] = np.swapaxes(normal.coupling, 1, 2)
    return matrix


def reduce_landmarks(
    normal: NormalEquations, motion_damping: Floats, landmark_damping: Floats
) -> ReducedSystem:
    """Eliminate the landmarks.

    Args:
        normal: The normal equations.
        motion_damping: (wN,) added to the motion's diagonal.
        landmark_damping: (K, 3) added to the landmarks' diagonal.

    Raises:
        numpy.linalg.LinAlgError: The position of a landmark is not determined.
    """
    inverse = inverse_landmark_factors(normal, landmark_damping)
    half = half_blocks(normal, inverse)
    matrix = motion_matrix(normal)
    matrix.diagonal[:] += motion_damping
    for window in normal.visibility.windows:
        dense = window.dense(half)
        product = (dense @ dense.T).reshape(window.keyframes, 6, window.keyframes, 6)
        matrix.window(window.first, window.last)[:, :6, :, :6] -= product
    pull = np.einsum("ijk,kj->ik", inverse, normal.landmark_gradient)
    reduced = ReducedSystem(
        matrix, normal.motion_gradient.copy(), half, inverse, pull, normal.visibility
    )
    reduced.gradient[:, :6] -= reduced.to_keyframes(pull).T
    return reduced


def half_blocks(normal: NormalEquations, inverse: Floats) -> Floats:
    """Return the blocks (6, 3, M) of W L^-T, from the landmarks' L^-1 (3, 3, K)."""
    observed = inverse.take(normal.visibility.landmark_of, axis=-1)
    blocks: Floats = np.einsum("ijm,kjm->ikm", normal.cross, observed)
    return blocks


def inverse_landmark_factors(normal: NormalEquations, damping: Floats | float) -> Floats:
    """Return the landmarks' L^-1 (3, 3, K) of the damped V = L L^T.

    Raises:
        numpy.linalg.LinAlgError: A V is not positive definite.
    """
    blocks = normal.landmark.copy()
    blocks[:, [0, 1, 2], [0, 1, 2]] += damping
    factors = np.linalg.inv(np.linalg.cholesky(blocks))
    return np.ascontiguousarray(factors.transpose(1, 2, 0))


def require_seen_landmarks(normal: NormalEquations) -> None:
    """Raise DegenerateGeometryError if the position of a landmark is not determined."""
    eigenvalues = np.linalg.eigvalsh(normal.landmark)
    open_ = np.flatnonzero(eigenvalues[:, 0] <= _ROUNDING * eigenvalues[:, 2])
    if len(open_):
        raise DegenerateGeometryError(
            f"{counted(len(open_), 'landmark')} without parallax or with one observation, the "
            f"first is {open_[0]}; remove them"
        )
