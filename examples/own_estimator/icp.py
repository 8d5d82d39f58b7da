"""An estimator of one's own instead of KISS-ICP: iterative closest points.

    make demo-real ESTIMATORS="small_gicp examples/own_estimator/icp.py"

The class must be called `Estimator`, and `register` must return the pose at the end of the sweep.
The demo does the rest: it runs the file as a ROS 2 node, evaluates it live and recorded, and draws
it. Copy the file, and put your own estimator into the class.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from examples.lidar_odometry.odometry import undistorted
from trajeval_ros.geometry.arrays import Floats

VOXEL_M, NEIGHBOURS, FARTHEST_M = 0.4, 8, 1.0
ITERATIONS, SWEEPS = 5, 15


class Estimator:
    """Aligns every sweep with the last ones by distances to planes, at constant velocity."""

    def __init__(self) -> None:
        self._pose, self._step = np.eye(4), np.eye(4)
        self._sweeps: list[Floats] = []  # the newest ones, in the frame of the first

    def register(self, points: Floats, after: Floats) -> Floats:
        """Return the pose (4, 4) of the body at the end of the sweep.

        `points` (N, 3) are in the frame of the body at their times, `after` (N,), in seconds after
        the beginning of the sweep.
        """
        cloud = undistorted(points, after, self._step)
        # One point per voxel: the rings of a lidar are lines otherwise, which fit many planes.
        voxels = np.floor(cloud / VOXEL_M).astype(np.int64)
        cloud = cloud[np.unique(voxels, axis=0, return_index=True)[1]]
        pose = self._pose @ self._step
        if self._sweeps:
            known = np.concatenate(self._sweeps)
            pose = aligned(cloud, known, pose)
            self._step = np.linalg.inv(self._pose) @ pose
            self._pose = pose
        self._sweeps = [*self._sweeps[1 - SWEEPS :], moved(cloud, pose)]
        return pose


def aligned(cloud: Floats, known: Floats, pose: Floats) -> Floats:
    """Return the pose of a cloud (N, 3) that fits planes through known points (M, 3)."""
    tree = cKDTree(known)
    for _ in range(ITERATIONS):
        there = moved(cloud, pose)
        groups = known[tree.query(there, NEIGHBOURS)[1]]
        centres = groups.mean(axis=1)
        spread = groups - centres[:, None]
        # The normal of a plane is the direction of the smallest variance.
        normals = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]
        distances = np.einsum("ni,ni->n", normals, there - centres)
        weights = 1.0 / (1.0 + (distances / 0.05) ** 2)
        weights[np.linalg.norm(there - centres, axis=1) > FARTHEST_M] = 0.0
        jacobian = np.hstack([np.cross(there, normals), normals])
        normal_matrix = jacobian.T @ (weights[:, None] * jacobian)
        change = -np.linalg.solve(normal_matrix, jacobian.T @ (weights * distances))
        update = np.eye(4)
        update[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix()
        update[:3, 3] = change[3:]
        pose = update @ pose
    return pose


def moved(points: Floats, pose: Floats) -> Floats:
    """Return points (N, 3), transformed by a pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])
