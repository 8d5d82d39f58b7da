"""The joint covariance of a groundtruth at a few times, dense."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.likelihood.correlated_groundtruth import JointPosterior


def dense_covariance(joint: JointPosterior) -> NDArray[np.float64]:
    """Return the covariance (d Q, d Q) of all queries."""
    knots, width = joint.factor.scale.shape
    units = np.eye(knots * width).reshape(knots, width, -1)
    everything = joint.factor.solve(units).reshape(knots, width, knots, width)
    near = everything[joint.rows][:, :, joint.rows]
    covariance = np.einsum("adi,aibj,bej->adbe", joint.by_knot, near, joint.by_knot)
    item = np.arange(len(joint.rows))
    covariance[item, :, item] += joint.motion
    dimension = joint.motion.shape[-1]
    dense: NDArray[np.float64] = covariance.reshape(len(item) * dimension, -1)
    return dense
