"""Conversion of rows of GNSS fixes to a trajectory in the local frame of the first usable fix."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fix_selection import fix_trajectory
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.trajectory import Trajectory


def fixes_of_rows(places: Floats, quality: Floats) -> Fixes:
    """Return the fixes of `places` (N, 3) and `quality` (N, 11), as in `trajectory_of_rows`."""
    return Fixes(
        places=places,
        status=quality[:, 0].astype(np.int64),
        covariance_types=quality[:, 1].astype(np.int64),
        covariances=quality[:, 2:].reshape(-1, 3, 3),
    )


def trajectory_of_rows(
    where: str, stamps: Stamps, places: Floats, quality: Floats, **attributes: Any
) -> Trajectory:
    """Return the trajectory of GNSS fixes; invalid fixes are dropped and counted.

    Args:
        where: File or topic, for messages.
        stamps: (N,), nanoseconds.
        places: (N, 3), latitude and longitude in degrees, height in metres.
        quality: (N, 11), status and covariance type as in sensor_msgs/NavSatFix, then the
            covariance (3 x 3, row by row) along east, north and up, m^2.
        **attributes: Further attributes of `Trajectory`.

    Raises:
        InputError: No fix can be used, or all are equal.
    """
    try:
        return fix_trajectory(stamps, fixes_of_rows(places, quality), **attributes)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
