"""Messages of an alignment and of the aligned paths, for the node and for recordings of errors."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.io.bags.encode_messages import encode_transform_stamped
from trajeval_ros.io.bags.pose_messages import encode_path
from trajeval_ros.online.error_topics import ALIGNED_PATH, GROUNDTRUTH_PATH
from trajeval_ros.online.state_rows import POSITION, QUATERNION
from trajeval_ros.online.trail import Trail


def encode_alignment(alignment: Similarity, stamps: Stamps, frames: tuple[str, str]) -> bytes:
    """Return geometry_msgs/TransformStamped, which can't hold the alignment's scale.

    Args:
        alignment: From the estimate's frame to the groundtruth's.
        stamps: (1,) of the newest pair.
        frames: The groundtruth's and the estimate's.
    """
    pose = np.concatenate([alignment.translation, alignment.rotation_xyzw])
    return bytes(encode_transform_stamped(stamps, pose[None], frames)[0])


def encode_paths(trail: Trail, alignment: Similarity, frame: str) -> dict[str, bytes]:
    """Return by topic the nav_msgs/Path of the aligned estimate and of the groundtruth.

    Args:
        trail: What is left of the pairs.
        alignment: From the estimate's frame to the groundtruth's.
        frame: The groundtruth's.
    """
    stamps, truth, estimate = trail.columns()
    positions, turned = alignment.positions(estimate[:, POSITION]), _turned(estimate)
    aligned = encode_path(stamps, positions, alignment.quaternions(turned), frame)
    of_truth = encode_path(stamps, truth[:, POSITION], _turned(truth), frame)
    return {ALIGNED_PATH: aligned, GROUNDTRUTH_PATH: of_truth}


def _turned(rows: Floats) -> Floats:
    """Return the quaternions (N, 4) of states (N, 10), identities of positions alone."""
    quaternions = np.nan_to_num(rows[:, QUATERNION])
    quaternions[~quaternions.any(axis=1), 3] = 1.0
    return quaternions
