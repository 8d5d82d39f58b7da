"""The file of a revised trajectory: the last message of an estimate that is a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.valid_poses import judge_poses
from trajeval_ros.io.npz_file import read_arrays, write_arrays

REVISED_SUFFIX = ".revised.npz"


def write_revised(path: Path, stamps: Stamps, positions: Floats, quaternions: Floats) -> None:
    """Write the poses of a path, stamps (N,), positions (N, 3), quaternions (N, 4), to a file."""
    columns = {"stamps": stamps, "positions": positions, "quaternions": quaternions}
    write_arrays(path, columns, compressed=False)


def read_revised(path: Path) -> Trajectory:
    """Return the trajectory in a file of `write_revised`."""
    arrays = read_arrays(path, ("stamps", "positions", "quaternions"))
    kinds = [(name, array.dtype.kind, array.shape) for name, array in arrays.items()]
    count = len(arrays["stamps"]) if arrays.get("stamps", np.zeros(())).ndim else 0
    if not count or kinds != [
        ("stamps", "i", (count,)),
        ("positions", "f", (count, 3)),
        ("quaternions", "f", (count, 4)),
    ]:
        raise InputError(
            f"{path} must have equal numbers of timestamps, positions and quaternions"
        )
    if not np.logical_and(*judge_poses(arrays["positions"], arrays["quaternions"])).all():
        raise InputError(f"{path} has poses that are not finite")
    return Trajectory(arrays["stamps"], arrays["positions"], lie.normalized(arrays["quaternions"]))
