"""Rows of fixes that a reader has found, as a trajectory in the frame of the first usable one."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes, fix_trajectory
from trajeval_ros.geometry.trajectory import Trajectory


def fixes_of_rows(places: Floats, quality: Floats) -> Fixes:
    """Return fixes by their rows, as `trajectory_of_rows` has them."""
    return Fixes(
        places=places,
        status=quality[:, 0].astype(np.int64),
        covariance_types=quality[:, 1].astype(np.int64),
        covariances=quality[:, 2:].reshape(-1, 3, 3),
    )


def trajectory_of_rows(
    where: str, stamps: Stamps, places: Floats, quality: Floats, **attributes: Any
) -> Trajectory:
    """Return the trajectory of fixes; those that are none are dropped and counted.

    Args:
        where: What an error is about.
        stamps: (N,), nanoseconds.
        places: (N, 3), latitude and longitude in degrees, height in metres.
        quality: (N, 11), status, type of covariance, and the covariance about east, north and up.
        **attributes: Others of `Trajectory`.

    Raises:
        InputError: None of them can be used, or all are the same.
    """
    try:
        return fix_trajectory(stamps, fixes_of_rows(places, quality), **attributes)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
