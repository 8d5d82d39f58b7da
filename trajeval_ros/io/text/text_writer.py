"""Writing of trajectories to text files of other programs: TUM, KITTI, EuRoC/ASL.

Timestamps are exact to the nanosecond, and floats to the last bit. Quantities without a column in
the format are not written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.text.number_characters import (
    Characters,
    lines_of,
    lines_of_floats,
    of_integers,
    of_seconds,
)
from trajeval_ros.io.writing import write_whole

_BLOCK = 1 << 11  # rows that are converted at once; their characters fit into the cache
_TUM_HEADER = "# timestamp [s] tx ty tz qx qy qz qw\n"
_EUROC_GROUPS = {
    "positions": [f"p_RS_R_{axis} [m]" for axis in "xyz"],
    "quaternions": [f"q_RS_{element} []" for element in "wxyz"],
    "velocities": [f"v_RS_R_{axis} [m s^-1]" for axis in "xyz"],
    "gyroscope_biases": [f"b_w_RS_S_{axis} [rad s^-1]" for axis in "xyz"],
    "accelerometer_biases": [f"b_a_RS_S_{axis} [m s^-2]" for axis in "xyz"],
}


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write `t x y z qx qy qz qw` in seconds and metres.

    If the trajectory has no orientations, identity quaternions are written.

    Raises:
        InputError: The file can't be written.
    """
    values = np.hstack([trajectory.positions, _quaternions(trajectory)])
    _write(path, _TUM_HEADER, trajectory, values, of_seconds, b" ")


def write_euroc(path: Path, trajectory: Trajectory) -> None:
    """Write CSV with the columns of EuRoC that the trajectory has.

    The columns are the timestamp in nanoseconds, position, quaternion (w first), velocity and
    biases.

    Raises:
        InputError: The file can't be written.
    """
    groups = {
        name: column for name in _EUROC_GROUPS if (column := getattr(trajectory, name)) is not None
    }
    header = ",".join(
        ["timestamp [ns]", *(each for name in groups for each in _EUROC_GROUPS[name])]
    )
    if "quaternions" in groups:
        groups["quaternions"] = groups["quaternions"][:, [3, 0, 1, 2]]
    values = np.hstack(list(groups.values()))
    _write(path, f"#{header}\n", trajectory, values, of_integers, b",")


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Write 3 x 4 matrices row by row, and the timestamps in seconds to STEM_times.txt.

    The axes of the trajectory are kept. They are not converted to the camera axes of KITTI.

    Raises:
        InputError: A file can't be written.
    """
    matrices = trajectory.matrices
    if matrices is None:
        matrices = lie.to_matrix(_quaternions(trajectory))
    poses = np.concatenate([matrices, trajectory.positions[:, :, None]], axis=2)
    if trajectory.stamped:
        no_values = np.empty((len(trajectory), 0))
        times = path.with_name(f"{path.stem}_times.txt")
        _write(times, "", trajectory, no_values, of_seconds, b" ")
    _write(path, "", trajectory, poses.reshape(-1, 12), None, b" ")


def _quaternions(trajectory: Trajectory) -> Floats:
    if trajectory.quaternions is not None:
        return trajectory.quaternions
    return np.tile([0.0, 0.0, 0.0, 1.0], (len(trajectory), 1))


def _write(
    path: Path,
    header: str,
    trajectory: Trajectory,
    values: Floats,
    stamp_characters: Callable[[np.ndarray[tuple[int], np.dtype[np.int64]]], Characters] | None,
    separator: bytes,
) -> None:
    def lines() -> Iterator[bytes]:
        yield header.encode()
        for start in range(0, len(values), _BLOCK):
            rows = slice(start, start + _BLOCK)
            parts = []
            if stamp_characters is not None:
                parts.append(lines_of([stamp_characters(trajectory.stamps[rows])]))
            if values.shape[1]:
                parts.append(lines_of_floats(values[rows], separator))
            yield b"\n".join(map(separator.join, zip(*parts, strict=True))) + b"\n"

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.writelines(lines())

    write_whole(path, write)
