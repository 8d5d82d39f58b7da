"""Residuals judged by the covariance of the calibration that they depend on."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, lengths


def judged(residuals: Floats, jacobians: Floats, covariance: Floats, floor: float) -> Floats:
    """Return the lengths (N,) of residuals (N, 3), reduced where the calibration is uncertain.

    A residual r has the derivatives H (N, 3, k) by the calibration, whose covariance is P (k, k).
    Along u = r / |r|, its variance is s^2 = u' H P H' u. With the floor f, in the unit of r, the
    result is |r| f / sqrt(f^2 + s^2): |r| if the calibration is known, and else f times r in
    standard deviations.
    """
    sizes = lengths(residuals)
    along = residuals / np.maximum(sizes, 1e-12)[:, None]
    reach = np.einsum("nk,nki->ni", along, jacobians)
    variance = np.maximum(np.einsum("ni,ij,nj->n", reach, covariance, reach), 0.0)
    reduced: Floats = sizes * floor / np.sqrt(floor**2 + variance)
    return reduced
