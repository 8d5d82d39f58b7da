"""Other ways to integrate over the alignment, eq. (19), to compare with."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from trajeval_ros.likelihood.marginal import AbsoluteErrorDensity, laplace


def by_laplace(error: AbsoluteErrorDensity) -> float:
    """Return the log integral by Laplace's approximation, however the error was integrated."""
    return laplace(error.mode, error.information)


def by_quadrature(error: AbsoluteErrorDensity, nodes: int) -> float:
    """Return the log integral by a tensor of Gauss-Hermite nodes about the mode, nodes^d."""
    residuals, chart = error.residuals, error.residuals.chart
    points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    grid = np.indices((nodes,) * chart.dimension).reshape(chart.dimension, -1).T
    white = points[grid]
    variances, vectors = np.linalg.eigh(error.information)
    deltas = white @ (vectors / np.sqrt(variances)).T
    values = residuals.log_density(chart.elements(deltas) @ error.mode.element)
    values += chart.log_measure(deltas)
    values[~chart.within(deltas)] = -np.inf
    values += np.log(weights)[grid].sum(axis=1) + 0.5 * np.square(white).sum(axis=1)
    return float(logsumexp(values) - 0.5 * np.log(variances).sum())
