"""Writing of trajectories to text files of other programs: TUM, KITTI, EuRoC/ASL.

Timestamps are exact to the nanosecond. Floats have the digits of `repr`, the smallest number of
digits that is read as the same float. Quantities without a column in the format are not written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.receive_times import ReceiveTimes
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.text.names import RECEIVED
from trajeval_ros.io.writing import write_whole

_BLOCK = 1 << 11  # rows that are converted at once; their objects fit into the cache
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
    """
    values = np.hstack([trajectory.positions, trajectory.known_quaternions])
    _write(path, _TUM_HEADER, trajectory, values, _seconds, " ")


def write_euroc(path: Path, trajectory: Trajectory) -> None:
    """Write CSV with the columns of EuRoC that the trajectory has.

    The columns are the timestamp in nanoseconds, position, quaternion (w first), velocity and
    biases; then the receive time in nanoseconds, a column of this package.
    """
    groups = {
        name: column for name in _EUROC_GROUPS if (column := getattr(trajectory, name)) is not None
    }
    header = ",".join(
        ["timestamp [ns]", *(title for name in groups for title in _EUROC_GROUPS[name])]
    )
    if "quaternions" in groups:
        groups["quaternions"] = groups["quaternions"][:, [3, 0, 1, 2]]
    values, receive_times = np.hstack(list(groups.values())), trajectory.reading.receive_times
    header += "" if receive_times is None else f",{RECEIVED} [ns]"
    _write(path, f"#{header}\n", trajectory, values, _integers, ",", receive_times)


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Write 3 x 4 matrices row by row, and the timestamps in seconds to STEM_times.txt.

    The axes of the trajectory are kept. They are not converted to the camera axes of KITTI.
    """
    matrices = trajectory.reading.matrices
    if matrices is None:
        matrices = lie.to_matrix(trajectory.known_quaternions)
    poses = np.concatenate([matrices, trajectory.positions[:, :, None]], axis=2)
    if trajectory.reading.stamped:
        no_values = np.empty((len(trajectory), 0))
        times = path.with_name(f"{path.stem}_times.txt")
        _write(times, "", trajectory, no_values, _seconds, " ")
    _write(path, "", trajectory, poses.reshape(-1, 12), None, " ")


def _write(
    path: Path,
    header: str,
    trajectory: Trajectory,
    values: Floats,
    stamp_texts: Callable[[Sequence[int]], list[str]] | None,
    separator: str,
    receive_times: ReceiveTimes | None = None,
) -> None:
    def lines() -> Iterator[str]:
        yield header
        for start in range(0, len(values), _BLOCK):
            rows = slice(start, start + _BLOCK)
            parts = []
            if stamp_texts is not None:
                parts.append(stamp_texts(trajectory.stamps[rows].tolist()))
            if values.shape[1]:
                parts.append(_rows_of_floats(values[rows], separator))
            if receive_times is not None:
                parts.append(_integers(receive_times.times[rows].tolist()))
            yield "\n".join(map(separator.join, zip(*parts, strict=True))) + "\n"

    def write(temporary: Path) -> None:
        with temporary.open("w", encoding="ascii", newline="\n") as file:
            file.writelines(lines())

    write_whole(path, write)


def _rows_of_floats(values: Floats, separator: str) -> list[str]:
    """Return the finite floats (N, M) of every row as text, as `repr` writes them."""
    # The text of a list has the same digits, and takes half the time of `repr` per float.
    return repr(values.tolist())[2:-2].replace(", ", separator).split(f"]{separator}[")


def _integers(stamps: Sequence[int]) -> list[str]:
    return list(map(str, stamps))


def _seconds(stamps: Sequence[int]) -> list[str]:
    """Return nanoseconds as seconds with nine decimals, exact."""
    return [
        f"{'-' * (stamp < 0)}{abs(stamp) // NANOSECONDS}.{abs(stamp) % NANOSECONDS:09d}"
        for stamp in stamps
    ]
