"""The density of an estimate given an alignment: eq. (18) and (20) of the probabilistic paper."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import Chart, act
from trajeval_ros.likelihood.relative_density import LOG_2_PI

# Rows that fit into a core's cache, and largest number of poses times alignments in memory.
_ROWS, _MOST_AT_ONCE = 8192, 1 << 18


@dataclass(frozen=True, eq=False)
class Slope:
    """Derivatives of the log density at an alignment.

    Attributes:
        gradient: (d,), by the chart's coordinates.
        information: (d, d), of Gauss-Newton.
        whitened: (M, k), residuals of unit variance.
    """

    gradient: Floats
    information: Floats
    whitened: Floats


@dataclass(frozen=True, eq=False)
class Residuals:
    """Groundtruth, estimate and gauge, which determine the likelihood.

    Densities are with respect to the volume of the group, for which marginals are exact and
    invariant. The paper's are Gaussian in logarithms.

    Attributes:
        belief: M independent groundtruth poses.
        estimate: (M, 4, 4), in its own frame.
        gauge: Gauge of the alignment.
        oriented: False to compare positions only; residuals then have 3 axes instead of 6.
    """

    belief: Belief
    estimate: Floats
    gauge: Gauge
    oriented: bool = True

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.estimate)

    @property
    def axes(self) -> int:
        """Dimension of a residual, 6 or 3."""
        return 6 if self.oriented else 3

    @cached_property
    def chart(self) -> Chart:
        """The chart about the groundtruth's centre."""
        return Chart(self.gauge, self.belief.poses[:, :3, 3].mean(axis=0))

    @cached_property
    def covariances(self) -> Floats:
        """Covariances of the residuals, (M, k, k)."""
        return self.belief.covariances[:, : self.axes, : self.axes]

    @cached_property
    def root(self) -> Floats:
        """W (M, k, k) with W S W^T = 1.

        Raises:
            DegenerateGeometryError: A groundtruth pose has no variance.
        """
        try:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariances)))
        except np.linalg.LinAlgError as error:
            raise DegenerateGeometryError(
                "a groundtruth pose has zero variance in some direction; set groundtruth noise "
                "greater than zero in all directions"
            ) from error

    @cached_property
    def _constant(self) -> float:
        """The normalisation of the log density."""
        roots = np.einsum("nii->ni", self.root)
        return float(np.log(roots).sum()) - 0.5 * self.axes * len(self) * LOG_2_PI

    @cached_property
    def _inverse(self) -> Floats:
        """Inverse groundtruth poses, (M, 4, 4)."""
        return se3.inverse(self.belief.poses)

    @cached_property
    def _carried(self) -> Floats:
        """Adjoints of the inverse groundtruth poses, (M, 6, 6)."""
        return se3.adjoint(self._inverse)

    def at(self, elements: Floats) -> Floats:
        """Return eps_i (..., M, k), eq. (20), for alignments (..., 4, 4).

        Without orientations, positions are compared along the body's axes of the covariances.
        """
        missed = self._inverse @ act(elements[..., None, :, :], self.estimate)
        return se3.log(missed) if self.oriented else missed[..., :3, 3]

    def log_density(self, elements: Floats) -> Floats:
        """Return log p(X | X_gt, g) (K,), eq. (18), for alignments (K, 4, 4)."""
        values = np.empty(len(elements))
        block = max(1, _MOST_AT_ONCE // len(self))
        for begin in range(0, len(elements), block):
            chunk = slice(begin, begin + block)
            residuals = self.at(elements[chunk])
            squared = np.square(se3.times(self.root, residuals)).sum(axis=(1, 2))
            values[chunk] = self._constant - 0.5 * squared
            if self.curved:
                values[chunk] -= 2.0 * se3.log_determinant(residuals[..., 3:]).sum(axis=1)
        return values

    def slope(self, element: Floats) -> Slope:
        """Return gradient and information at one alignment (4, 4).

        d eps_i / d delta = J_l^-1(eps_i) Ad(T_i)^-1 G_i, exactly.
        """
        gradient = np.zeros(self.chart.dimension)
        information = np.zeros((len(gradient), len(gradient)))
        whitened = np.empty((len(self), self.axes))
        moved = act(element, self.estimate)
        for begin in range(0, len(self), _ROWS):
            chunk = slice(begin, begin + _ROWS)
            missed = self._inverse[chunk] @ moved[chunk]
            by_delta = self._carried[chunk] @ self.chart.twists(moved[chunk, :3, 3])
            if self.oriented:
                residuals = se3.log(missed)
                by_delta = se3.inverse_left_jacobian(residuals) @ by_delta
            else:
                # Of a point, not of a body: a rotation of the body moves it, too.
                residuals = missed[..., :3, 3]
                by_delta = by_delta[:, :3] - so3.skew(residuals) @ by_delta[:, 3:]
            root = self.root[chunk]
            whitened[chunk] = se3.times(root, residuals)
            jacobian = (root @ by_delta).reshape(self.axes * len(root), len(gradient))
            gradient -= jacobian.T @ whitened[chunk].ravel()
            information += jacobian.T @ jacobian
            if self.curved:
                volume = se3.log_determinant_gradient(residuals[:, 3:])
                gradient -= 2.0 * np.einsum("nid,ni->d", by_delta[:, 3:], volume)
        return Slope(gradient, information, whitened)

    @property
    def curved(self) -> bool:
        """Whether the volume of the group differs from that of logarithms."""
        return self.oriented
