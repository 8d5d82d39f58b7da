"""Scenes and dense forms that the tests of the visual-inertial estimator share."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.papers.gauge_trials import fixed_covariance
from trajeval_ros.papers.problem import NormalEquations, Problem
from trajeval_ros.papers.reduction import motion_matrix
from trajeval_ros.papers.reprojection_errors import ReprojectionErrors
from trajeval_ros.papers.scene import PROFILES, Scene, make_scene
from trajeval_ros.papers.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.papers.state import State
from trajeval_ros.simulation.motion import shape

CONFIGURATIONS = [
    (name, layout) for layout in ("plane", "random") for name in ("sine", "arc", "rec")
]


def scene_of(name: str = "sine", layout: str = "random", profile: str = "paper") -> Scene:
    """Return one of the paper's six configurations."""
    return make_scene(shape(name), layout, PROFILES[profile], 0)


def solved(scene: Scene, seed: int, tolerance: float = 1e-9) -> tuple[Problem, State]:
    """Return the problem and free-gauge estimate of a noise draw."""
    problem = scene.measured(np.random.default_rng([77, seed]))
    start = scene.disturbed(np.random.default_rng([78, seed]))
    return problem, solve(problem, start, GaugeHandling.FREE, function_tolerance=tolerance).state


def visual_errors(problem: Problem, state: State) -> ReprojectionErrors:
    """Return the reprojection errors with observations first: (M, r), (M, r, 3) and (M, 3)."""
    return ReprojectionErrors(*(np.moveaxis(part, -1, 0) for part in problem.visual(state)))


def dense_hessian(normal: NormalEquations) -> np.ndarray:
    """Return J^T J (wN + 3K, wN + 3K)."""
    motion, (count, width, _) = motion_matrix(normal).dense(), normal.diagonal.shape
    landmarks = len(normal.landmark)
    cross = np.zeros((count, width, landmarks, 3))
    cross[normal.visibility.keyframe_of, :6, normal.visibility.landmark_of] = np.moveaxis(
        normal.cross, -1, 0
    )
    cross = cross.reshape(width * count, 3 * landmarks)
    own = np.zeros((landmarks, 3, landmarks, 3))
    own[np.arange(landmarks), :, np.arange(landmarks)] = normal.landmark
    return np.block([[motion, cross], [cross.T, own.reshape(3 * landmarks, -1)]])


def gradient(normal: NormalEquations) -> np.ndarray:
    """Return J^T r (wN + 3K,)."""
    return np.concatenate([normal.motion_gradient.ravel(), normal.landmark_gradient.ravel()])


def stacked_residuals(problem: Problem, state: State) -> np.ndarray:
    """Return all residuals in one column."""
    parts = problem.residuals(state)
    return np.concatenate([part.ravel() for part in parts])


def numeric_jacobian(problem: Problem, state: State, step: float = 1e-6) -> np.ndarray:
    """Return the Jacobian of all residuals by central differences."""
    size = 9 * problem.keyframes + 3 * problem.landmarks
    columns = []
    for unit in np.eye(size) * step:
        ahead = stacked_residuals(problem, state.moved(unit))
        behind = stacked_residuals(problem, state.moved(-unit))
        columns.append((ahead - behind) / (2.0 * step))
    return np.stack(columns, axis=1)


def relative(value: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference as a share of the largest entry."""
    return float(np.abs(value - expected).max() / np.abs(expected).max())


def frobenius(value: np.ndarray, expected: np.ndarray) -> float:
    """Return the difference's Frobenius norm as a share of what is expected."""
    return float(np.linalg.norm(value - expected) / np.linalg.norm(expected))


def to_left(covariance: np.ndarray, state: State) -> np.ndarray:
    """Return the covariance with the first rotation perturbed on the left as all others."""
    rotation = np.eye(len(covariance))
    rotation[3:6, 3:6] = so3.left_jacobian(state.first_turn)
    return rotation @ covariance @ rotation.T


def prior_covariance(problem: Problem, state: State, weight: float) -> Floats:
    """Return the covariance with the gauge prior of eq. (11).

    The prior adds its variance 1/w along the gauge's directions to the covariance C of gauge
    fixation, independently of the measurements: C + V V^T / w. The columns of V are the state's
    perturbations by one metre or radian of the prior's four parameters.
    """
    fixed = fixed_covariance(problem, state)
    basis = state.gauge_basis[: len(fixed)]
    along = basis @ np.linalg.inv(basis[GAUGE_INDICES])
    covariance: Floats = fixed + along @ along.T / weight
    return covariance
