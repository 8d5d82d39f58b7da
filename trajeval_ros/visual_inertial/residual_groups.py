"""Tests of the assumed noise by residuals: chi-square by group, and correlation along tracks.

The total chi-square does not test the IMU, whose residuals are only a few percent of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.gauge_covariance import fixed_covariance
from trajeval_ros.visual_inertial.problem import Problem
from trajeval_ros.visual_inertial.state import State


@dataclass(frozen=True)
class ResidualGroup:
    """Residuals of one kind.

    Attributes:
        name: Name of the group.
        count: Number of residuals.
        redundancy: Degrees of freedom: the count minus the group's trace of the hat matrix.
        chi2: Sum of the squared whitened residuals.
    """

    name: str
    count: int
    redundancy: float
    chi2: float

    @property
    def ratio(self) -> float:
        """chi2 / redundancy; its expectation is 1 if the noise is as assumed."""
        return self.chi2 / self.redundancy


def residual_groups(problem: Problem, state: State) -> list[ResidualGroup]:
    """Return the groups camera, IMU rotation, velocity and position, and biases, at a minimum.

    The biases' group has their changes between keyframes and their prior at the first one.

    Raises:
        DegenerateGeometryError: More than the gauge's four directions are undetermined.
    """
    visual, _ = problem.residuals(state)
    errors, before, after = problem.inertial(state)
    first_errors, first_weights = problem.first_biases(state)
    count, width = problem.keyframes, problem.width
    covariance = fixed_covariance(problem, state).reshape(count, width, count, width)
    each, next_ = np.arange(count - 1), np.arange(1, count)
    shared = np.concatenate([before, after], axis=2)
    joint = np.block(
        [
            [covariance[each, :, each], covariance[each, :, next_]],
            [covariance[next_, :, each], covariance[next_, :, next_]],
        ]
    )
    used = np.einsum("nij,njk,nik->ni", shared, joint, shared)
    first_used = np.diagonal(covariance[0, 9:, 0, 9:]) * np.square(first_weights)
    # The hat matrix's trace is the number of parameters, without the gauge's four.
    parameters = width * count + 3 * problem.landmarks - 4
    by_camera = visual.size - (parameters - float(used.sum() + first_used.sum()))
    groups = [ResidualGroup("pixels", visual.size, by_camera, float(np.vdot(visual, visual)))]
    for place, name in enumerate(("IMU rotation", "IMU velocity", "IMU position")):
        rows = slice(3 * place, 3 * place + 3)
        of_kind = errors[:, rows]
        redundancy = of_kind.size - float(used[:, rows].sum())
        chi2 = float(np.vdot(of_kind, of_kind))
        groups.append(ResidualGroup(name, of_kind.size, redundancy, chi2))
    if first_errors.size:
        changes = errors[:, 9:]
        number = changes.size + first_errors.size
        redundancy = number - float(used[:, 9:].sum() + first_used.sum())
        chi2 = float(np.vdot(changes, changes) + first_errors @ first_errors)
        groups.append(ResidualGroup("IMU biases", number, redundancy, chi2))
    return groups


def track_correlation(problem: Problem, state: State, lags: Sequence[int]) -> Floats:
    """Return the autocorrelation (lags,) of reprojection errors along tracks, lags in keyframes.

    It is about zero for white errors, and NaN at lags longer than all tracks.
    """
    visual, _ = problem.residuals(state)
    errors = np.zeros((problem.landmarks, problem.keyframes, visual.shape[1]))
    seen = np.zeros(errors.shape[:2], dtype=bool)
    errors[problem.visibility.landmark_of, problem.visibility.keyframe_of] = visual
    seen[problem.visibility.landmark_of, problem.visibility.keyframe_of] = True
    correlations = []
    for lag in lags:
        both = seen[:, :-lag] & seen[:, lag:]
        earlier, later = errors[:, :-lag][both], errors[:, lag:][both]
        lengths = np.linalg.norm(earlier) * np.linalg.norm(later)
        correlations.append(np.vdot(earlier, later) / lengths if len(earlier) else np.nan)
    return np.array(correlations)
