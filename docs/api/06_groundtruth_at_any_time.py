"""A slow groundtruth at any time, with its uncertainty."""

import math

import numpy as np

from trajeval_ros import Noise, fit_trajectory, simulate

fast = simulate(seed=1, duration_s=60.0).groundtruth
slow = fast[::100]  # a total station at 2 Hz
print(slow)

continuous = fit_trajectory(
    slow, "matern", Noise(position_m=0.002, rotation_rad=math.radians(0.1))
)
inside = fast[continuous.covers(fast.stamps)]
belief = continuous.at(inside.stamps)

errors = np.linalg.norm(belief.poses[:, :3, 3] - inside.positions, axis=1)
sigmas = np.sqrt(np.trace(belief.covariances[:, :3, :3], axis1=1, axis2=2))
print(f"between samples: off by {errors.mean():.4f} m in the mean, {errors.max():.4f} m at most")
print(f"and said to be off by {np.sqrt(np.mean(sigmas**2)):.4f} m (root mean square)")
print("remarks:", continuous.statements or "none")
