"""The uncertainty that an estimate's message states about its position."""

from __future__ import annotations

import numpy as np

from trajeval_ros.consistency.marginal_covariances import unknown_covariances
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.valid_poses import judge_poses
from trajeval_ros.io.bags.pose_messages import COVARIANCE_TYPES, decode_poses
from trajeval_ros.online.state_rows import COVARIANCE, POSITION, states
from trajeval_ros.ros.marker_body import MarkerBody


def position_uncertainty(
    message_type: str, payload: bytes, body: MarkerBody
) -> tuple[int, Floats, Floats] | None:
    """Return timestamp, position (3,) and its covariance (3, 3) of a message.

    Args:
        message_type: Type of the message.
        payload: The message as bytes.
        body: The body that position and covariance refer to.

    Returns:
        None if the covariance is unknown.
    """
    if message_type not in COVARIANCE_TYPES:
        return None
    pose = decode_poses([payload], message_type, covariance=True)
    if not len(pose.stamps) or pose.covariances is None or pose.stamps[0] == 0:
        return None
    # `unknown_covariances` accepts zeros in the first covariance, so it is passed twice.
    if not judge_poses(pose.positions)[0][0] or unknown_covariances(pose.covariances.repeat(2, 0)):
        return None
    row = np.hstack([states(pose.positions, pose.quaternions), pose.covariances.reshape(1, 36)])
    [moved] = body.estimated(row)
    if not np.isfinite(moved[POSITION]).all():
        return None
    return int(pose.stamps[0]), moved[POSITION], moved[COVARIANCE].reshape(6, 6)[:3, :3]
