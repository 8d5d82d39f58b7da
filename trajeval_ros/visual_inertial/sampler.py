"""Honest runs for the price of a matrix product: the estimator's own Gaussian, sampled.

The normal equations are evaluated at the truth. Their solution is linear in the noise, so truth
plus a sample of it is what an estimator would return, to first order, and its covariance is
exactly the one that goes with it. On top comes an arbitrary gauge, as of any estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from trajeval_ros import lie
from trajeval_ros.visual_inertial.chain import Chain
from trajeval_ros.visual_inertial.information import information_of
from trajeval_ros.visual_inertial.scene import Scene
from trajeval_ros.visual_inertial.solver import GAUGE_INDICES
from trajeval_ros.visual_inertial.state import State

Array = NDArray[np.float64]

_FARTHEST_OFFSET_M = 5.0


@dataclass(frozen=True, eq=False)
class Run:
    """An estimate in a frame of its own, and how sure it is.

    Attributes:
        state: Keyframes as estimated; the landmarks are the true ones, moved into the frame.
        information: (9N, 9N), rank 9N - 4, of left perturbations in the estimate's frame.
        marginals: (N, 9, 9), covariance of each keyframe in the gauge of the first one.
    """

    state: State
    information: scipy.sparse.csr_matrix
    marginals: Array


class Sampler:
    """Draws runs of a scene."""

    def __init__(self, scene: Scene) -> None:
        """Linearise at the truth.

        Raises:
            DegenerateGeometryError: More than the gauge's four directions are open.
        """
        self._truth = scene.truth
        self._information = information_of(scene.noise_free(), scene.truth)
        size = self._information.shape[0]
        self._kept = np.setdiff1d(np.arange(size), GAUGE_INDICES)
        chain = Chain(self._information[self._kept][:, self._kept].tocsr())
        self._chain = chain
        # The first keyframe is held but for roll, pitch and velocity.
        first = chain.marginals(np.array([0]), 5)[0]
        rest = chain.marginals(np.arange(5, len(self._kept), 9), 9)
        held = np.zeros((1, 9, 9))
        held[0][np.ix_(self._kept[:5], self._kept[:5])] = first
        self._marginals = np.concatenate([held, rest])

    def draw(self, generator: np.random.Generator) -> Run:
        """Return one run, in a frame that is turned about gravity and shifted at will."""
        truth = self._truth
        step = np.zeros(self._information.shape[0] + truth.landmarks.size)
        step[self._kept] = self._chain.sampled(generator.standard_normal(len(self._kept)))
        yaw = generator.uniform(-np.pi, np.pi)
        turn = lie.exp(yaw * np.array([0.0, 0.0, 1.0]))
        shift = generator.uniform(-_FARTHEST_OFFSET_M, _FARTHEST_OFFSET_M, 3)
        state = truth.moved(step).transformed(turn, shift)
        blocks = scipy.sparse.kron(scipy.sparse.eye(self._information.shape[0] // 3), turn)
        wide = np.kron(np.eye(3), turn)
        return Run(
            state,
            (blocks @ self._information @ blocks.T).tocsr(),
            wide @ self._marginals @ wide.T,
        )
