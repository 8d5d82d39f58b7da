"""Runs with known covariance, and how the tests of consistency align them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from trajeval_ros.consistency.s_transformation import STransformation, carried, errors_of
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import align, align_first
from trajeval_ros.papers.scene import Scene
from trajeval_ros.papers.solver import GAUGE_INDICES
from trajeval_ros.papers.state import State

ALIGNMENTS = [
    (Gauge.YAW, 1),
    (Gauge.YAW, None),
    (Gauge.SE3, 1),
    (Gauge.SE3, None),
    (Gauge.SIM3, None),
]


class Aligned(NamedTuple):
    """An aligned run: errors (N, 6), their covariance (6N, 6N), and the alignment."""

    errors: np.ndarray
    covariance: np.ndarray
    transformation: STransformation
    similarity: Similarity


def trajectory_of(scene: Scene, state: State) -> Trajectory:
    """Return the keyframes of a state."""
    return Trajectory(
        np.rint(scene.times_s * 1e9).astype(np.int64),
        state.positions,
        Rotation.from_matrix(state.rotations).as_quat(),
        state.velocities,
    )


def with_growing_covariances(estimate: Trajectory) -> Trajectory:
    """Return an estimate whose standard deviations grow tenfold over the run."""
    growing = np.linspace(0.01, 0.1, len(estimate))[:, None, None] ** 2
    covariances = growing * np.diag([1.0, 1.5, 2.0, 0.1, 0.1, 0.3])
    return dataclasses.replace(estimate, covariances=covariances)


def alignment_of(
    gauge: Gauge, states: int | None, truth: Trajectory, estimate: Trajectory
) -> Similarity:
    """Align as `evaluation` does."""
    if states == 1:
        return align_first(
            gauge,
            truth.positions[0],
            truth.quaternions[0],
            estimate.positions[0],
            estimate.quaternions[0],
        ).similarity
    part = slice(states)
    return align(gauge, truth.positions[part], estimate.positions[part]).similarity


def aligned_run(
    gauge: Gauge,
    states: int | None,
    truth: Trajectory,
    estimate: Trajectory,
    covariance: np.ndarray,
) -> Aligned:
    """Align a run and bring its poses' part of a covariance (9N, 9N) along."""
    similarity = alignment_of(gauge, states, truth, estimate)
    moved = similarity.trajectory(estimate)
    transformation = STransformation.of_alignment(gauge, states, truth, moved)
    rotated = carried(poses_of(covariance), similarity)
    return Aligned(
        errors_of(truth, moved),
        transformation.covariance(rotated),
        transformation,
        similarity,
    )


def poses_of(covariance: np.ndarray) -> np.ndarray:
    """Return the part (6N, 6N) of position and rotation of a covariance (9N, 9N)."""
    index = (np.arange(0, len(covariance), 9)[:, None] + np.arange(6)).ravel()
    return covariance[np.ix_(index, index)]


def band_of_mean(dof: float, runs: int) -> tuple[float, float]:
    """Return between what the mean NEES / dof of honest runs falls, 999 times of 1000."""
    low, high = chi2.interval(0.999, dof * runs)
    return low / dof / runs, high / dof / runs


def some_covariance(information: np.ndarray) -> np.ndarray:
    """Return a generalised inverse of an information matrix of rank 9N - 4: with a prior."""
    held = information.copy()
    held[GAUGE_INDICES, GAUGE_INDICES] *= 2.0
    return np.linalg.inv(held)
