"""NEES: do the errors fit the covariances of the estimate?"""

from dataclasses import replace

import numpy as np

from trajeval_ros import (
    CovarianceRequest,
    JointCovariance,
    Protocol,
    Trajectory,
    assess_consistency,
    evaluate,
)

random = np.random.default_rng(1)
seconds = np.arange(200) * 0.1
circle = np.column_stack([np.cos(seconds), np.sin(seconds), 0.1 * seconds]) * 5.0
upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(seconds), 1))
groundtruth = Trajectory.from_columns((seconds * 1e9).astype(np.int64), circle, upright)

# A consistent estimate: independent errors of 5 cm and 0.01 rad per axis, as its covariances say.
turns = np.column_stack([0.005 * random.normal(size=(200, 3)), np.ones(200)])
noisy = circle + 0.05 * random.normal(size=circle.shape)
estimate = Trajectory.from_columns(groundtruth.stamps, noisy, turns, name="consistent")
block = np.diag([0.05**2] * 3 + [0.01**2] * 3)
protocol = Protocol(gauge="se3", lengths=())

# The covariances of single poses, as messages have them, give a bound under an alignment.
single = replace(estimate, covariances=np.linspace(1.0, 1.1, 200)[:, None, None] * block)
evaluation = evaluate(groundtruth, single, protocol)
print(assess_consistency(evaluation, CovarianceRequest("message")).statement)

# The joint covariance of all poses gives an exact verdict.
joint = JointCovariance(
    estimate.stamps, estimate.positions, estimate.quaternions, 6, np.kron(np.eye(200), block)
)
evaluation = evaluate(groundtruth, estimate, protocol)
consistency = assess_consistency(evaluation, CovarianceRequest("joint", joint))
print(consistency.verdict, consistency.joint, consistency.per_pose.mean)
