"""Runs with known covariance: solved, or sampled from the estimator's Gaussian.

For sampling, the normal equations are linearised at the truth. Their solution is linear in the
noise. Truth plus a sample of the solution's Gaussian is, to first order, the result of an
estimator, and its covariance is exact. A sample costs a matrix product, with a time proportional
to the length of the run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.banded_gaussian import BandedGaussian
from trajeval_ros.visual_inertial.information import information_of
from trajeval_ros.visual_inertial.scene import Scene
from trajeval_ros.visual_inertial.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.visual_inertial.state import State

_FARTHEST_OFFSET_M = 5.0
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class SampledEstimate:
    """An estimate in its own frame, with its information.

    Attributes:
        state: Estimated keyframes.
        information: (9N, 9N), rank 9N - 4, of left perturbations in the estimate's frame.
        marginals: (N, 9, 9), covariances of the keyframes in the gauge of the first one.
    """

    state: State
    information: scipy.sparse.csr_matrix
    marginals: Floats

    def elsewhere(self, generator: np.random.Generator) -> SampledEstimate:
        """Return the run in a frame with random yaw and translation."""
        yaw = generator.uniform(-np.pi, np.pi)
        turn = so3.exp(yaw * np.array([0.0, 0.0, 1.0]))
        shift = generator.uniform(-_FARTHEST_OFFSET_M, _FARTHEST_OFFSET_M, 3)
        blocks = scipy.sparse.kron(scipy.sparse.eye(self.information.shape[0] // 3), turn)
        wide = np.kron(np.eye(3), turn)
        return SampledEstimate(
            self.state.transformed(turn, shift),
            (blocks @ self.information @ blocks.T).tocsr(),
            wide @ self.marginals @ wide.T,
        )


def solved(scene: Scene, generator: np.random.Generator) -> SampledEstimate:
    """Return the estimate from one set of noisy measurements, in the free gauge.

    Raises:
        DegenerateGeometryError: More than the gauge's four directions are undetermined.
    """
    problem, start = scene.measured(generator), scene.disturbed(generator)
    state = solve(problem, start, GaugeHandling.FREE, function_tolerance=_TOLERANCE).state
    # With the state as its own reference, the first rotation is perturbed on the left like all
    # others.
    state = state.referred_to(state.rotations[0], state.positions[0])
    information = information_of(problem, state)
    run = SampledEstimate(state, information, _FixedGaugeGaussian(information).marginals())
    return run.elsewhere(generator)


class Sampler:
    """Draws runs of a scene."""

    def __init__(self, scene: Scene) -> None:
        """Linearise at the truth.

        Raises:
            DegenerateGeometryError: More than the gauge's four directions are undetermined.
        """
        self._truth = scene.truth
        self._information = information_of(scene.noise_free(), scene.truth)
        self._held = _FixedGaugeGaussian(self._information)
        self._marginals = self._held.marginals()

    def draw(self, generator: np.random.Generator) -> SampledEstimate:
        """Return one run; its landmarks are the true ones in its frame."""
        step = np.concatenate(
            [self._held.sampled(generator), np.zeros(self._truth.landmarks.size)]
        )
        run = SampledEstimate(self._truth.moved(step), self._information, self._marginals)
        return run.elsewhere(generator)


class _FixedGaugeGaussian:
    """The motion's Gaussian with position and yaw of the first keyframe fixed: eq. (10)."""

    def __init__(self, information: scipy.sparse.csr_matrix) -> None:
        self._size = information.shape[0]
        self._kept = np.setdiff1d(np.arange(self._size), GAUGE_INDICES)
        self._gaussian = BandedGaussian(information[self._kept][:, self._kept].tocsr())

    def sampled(self, generator: np.random.Generator) -> Floats:
        """Return a perturbation (9N,)."""
        step = np.zeros(self._size)
        step[self._kept] = self._gaussian.sampled(generator.standard_normal(len(self._kept)))
        return step

    def marginals(self) -> Floats:
        """Return the covariances of single keyframes, (N, 9, 9)."""
        blocks = np.zeros((self._size // 9, 9, 9))
        # Roll, pitch and velocity of the first keyframe are not fixed.
        first = self._kept[:5]
        blocks[0][np.ix_(first, first)] = self._gaussian.marginals(np.array([0]), 5)[0]
        blocks[1:] = self._gaussian.marginals(np.arange(5, len(self._kept), 9), 9)
        return blocks
