"""Motion between two knots with white noise on the m-th derivative, m = 1, 2, 3.

Transition and covariance of (g, g', ...) over a time; they are the same for all axes.
"""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats


def transition(order: int, time: Floats) -> Floats:
    """Return Phi (..., m, m) over times (...), seconds."""
    matrix = np.zeros((*time.shape, order, order))
    for row in range(order):
        for column in range(row, order):
            matrix[..., row, column] = time ** (column - row) / factorial(column - row)
    return matrix


def covariance(order: int, time: Floats) -> Floats:
    """Return Q (..., m, m) of unit density over times (...), seconds."""
    matrix = np.zeros((*time.shape, order, order))
    for row in range(order):
        for column in range(order):
            a, b = order - 1 - row, order - 1 - column
            power = a + b + 1
            matrix[..., row, column] = time**power / (power * factorial(a) * factorial(b))
    return matrix


def information(order: int, time: Floats) -> Floats:
    """Return Q^-1 (..., m, m) over times (...), by scaling the inverse at unit time."""
    scale = time[..., None] ** (np.arange(order) - order + 0.5)
    unit = np.linalg.inv(covariance(order, np.ones(())))
    inverse: Floats = scale[..., :, None] * unit * scale[..., None, :]
    return inverse


def interpolation(order: int, step: Floats, since: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the interpolation between two knots, and its variance given both.

    From the time (Q,) between the knots and the time (Q,) since the first one follow rows Lambda
    and Psi (Q, m), with g = Lambda z_0 + Psi z_1, and the variance (Q,) of g for unit density.
    """
    remaining = transition(order, step - since)
    before = covariance(order, since)
    psi: Floats = before @ remaining.swapaxes(1, 2) @ information(order, step)
    spread = (before - psi @ remaining @ before)[:, 0, 0]
    weights = transition(order, since) - psi @ transition(order, step)
    return weights[:, 0], psi[:, 0], np.maximum(spread, 0.0)


def spread_over_axes(matrices: NDArray[Any], axes: Floats) -> Floats:
    """Return the Kronecker products (..., m d, m d) of (..., m, m) with a diagonal (d,)."""
    order, dimension = matrices.shape[-1], len(axes)
    product = np.zeros((*matrices.shape[:-2], order, dimension, order, dimension))
    for axis, factor in enumerate(axes):
        product[..., :, axis, :, axis] = factor * matrices
    return product.reshape(*matrices.shape[:-2], order * dimension, order * dimension)
