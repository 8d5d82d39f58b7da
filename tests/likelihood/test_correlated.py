"""Likelihoods against groundtruth with correlated errors, by dense matrices."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal
from strategies import random_poses

from trajeval_ros.continuous_time.continuous_trajectory import MarkovPoses
from trajeval_ros.continuous_time.samples import Noise, Samples
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood import correlated_groundtruth
from trajeval_ros.likelihood.alignment_chart import Chart, act
from trajeval_ros.likelihood.correlated_groundtruth import (
    CorrelatedGroundtruth,
    joint_log_likelihood,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dense:
    """A covariance of errors (Q, 3) as one matrix."""

    covariance: Array

    def solve(self, errors: Array) -> Array:
        count, axes, width = errors.shape
        result = np.linalg.solve(self.covariance, errors.reshape(count * axes, width))
        return np.asarray(result.reshape(errors.shape))

    def log_density(self, errors: Array) -> float:
        return float(multivariate_normal.logpdf(errors.ravel(), cov=self.covariance))


@pytest.mark.parametrize("gauge", [Gauge.TRANSLATION, Gauge.YAW, Gauge.SE3, Gauge.SIM3])
def test_correlated_groundtruth_has_exact_normal_equations(gauge: Gauge) -> None:
    generator = np.random.default_rng(4)
    poses = random_poses(1, 6)
    roots = 0.1 * generator.normal(size=(2, 18, 20))
    positions, rotations = (Dense(root @ root.T) for root in roots)
    groundtruth = CorrelatedGroundtruth(poses, positions, rotations)  # type: ignore[arg-type]
    estimate = poses @ se3.exp(0.1 * generator.normal(size=(6, 6)))
    chart = Chart(gauge, poses[:, :3, 3].mean(axis=0))

    def errors(delta: Array) -> tuple[Array, Array]:
        moved = act(chart.elements(delta[None])[0], estimate)
        rotation_list = so3.log(se3.transposed(poses[:, :3, :3]) @ moved[:, :3, :3])
        return moved[:, :3, 3] - poses[:, :3, 3], rotation_list

    size = chart.dimension
    information, gradient = correlated_groundtruth._normal_equations(groundtruth, estimate, chart)
    expected, slope = np.zeros((size, size)), np.zeros(size)
    for part, dense in enumerate((positions, rotations)):
        jacobian = np.stack(
            [
                (errors(step)[part] - errors(-step)[part]).ravel() / 2e-6
                for step in 1e-6 * np.eye(size)
            ],
            axis=1,
        )
        inverse = np.linalg.inv(dense.covariance)
        expected += jacobian.T @ inverse @ jacobian
        slope -= jacobian.T @ inverse @ errors(np.zeros(size))[part].ravel()
    np.testing.assert_allclose(information, expected, rtol=1e-6, atol=1e-6 * expected.max())
    np.testing.assert_allclose(gradient, slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())
    np.testing.assert_array_equal(information, information.T)


def test_joint_likelihoods_without_a_gauge_are_gaussian() -> None:
    times = np.arange(12.0)
    line = np.outer(times, [1.0, 0.3, 0.1])
    rotations = np.outer(times, [0.0, 0.0, 0.1])
    samples = Samples(0, times, se3.poses(so3.exp(rotations), line), True, Noise(0.01, 0.01))
    model, asked = MarkovPoses.fit(samples, 2), np.array([2.2, 4.5, 4.9, 8.3])
    groundtruth = CorrelatedGroundtruth.of(model, asked, Noise(0.05, 0.02))
    generator = np.random.default_rng(0)
    estimate = groundtruth.poses @ se3.exp(0.02 * generator.normal(size=(4, 6)))
    result = joint_log_likelihood(groundtruth, estimate, Gauge.NONE, np.eye(4))
    apart = estimate[:, :3, 3] - groundtruth.poses[:, :3, 3]
    rotated = so3.log(se3.transposed(groundtruth.poses[:, :3, :3]) @ estimate[:, :3, :3])
    assert groundtruth.rotations is not None
    expected = groundtruth.positions.log_density(apart) + groundtruth.rotations.log_density(
        rotated
    )
    # Densities are by the volume of the group of rotations.
    expected -= sum(np.linalg.slogdet(so3.left_jacobian(item))[1] for item in rotated)
    assert result == pytest.approx(expected, rel=1e-10)
    # Positions: over all translations, the sum of which has a Gaussian integral.
    bare = dataclasses.replace(groundtruth, rotations=None)
    moved = joint_log_likelihood(bare, estimate, Gauge.TRANSLATION, np.eye(4))
    columns = np.tile(np.eye(3), (4, 1, 1))
    weighted = bare.positions.solve(columns)
    information = np.einsum("qij,qik->jk", columns, weighted)
    shift = np.linalg.solve(information, -np.einsum("qij,qi->j", weighted, apart))
    value = bare.positions.log_density(apart + shift)
    value += 1.5 * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(information)[1]
    assert moved == pytest.approx(value, rel=1e-9)
