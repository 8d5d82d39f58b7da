"""Known layouts of tables without a header, as a list of rows.

A table has the layout whose columns and checks agree with its first rows, if there is exactly one.
Otherwise it is refused: a wrong guess is a wrong number. The message has the options to choose
from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.text.names import (
    BODY_TWISTS,
    CLOCK,
    FAST_LIO,
    GROUPS,
    IGNORED,
    ROTATIONS,
    TEXT,
    Layout,
)
from trajeval_ros.io.text.stamps import (
    are_whole,
    goes_back,
    is_clock,
    is_date,
    is_time_of_day,
    unit_of,
)
from trajeval_ros.io.text.states import ORTHONORMAL
from trajeval_ros.io.text.table import TextTable, number
from trajeval_ros.metrics.statistics import median

_MOST = 0.85  # part of the rows that must pass a check: some may be damaged
_LARGEST_ID = 1e8  # larger numbers are times since 1970
ORDERS = ("qx", "qy", "qz", "qw"), ("qw", "qx", "qy", "qz")  # of the elements of a quaternion
_ROTATION_FIRST = tuple(sorted(GROUPS["matrix"], key=lambda name: name[2] == "4"))
CAMERA = UpAxis("-y", "KITTI's camera axes")
_NED = UpAxis("-z", "axes north, east and down")
_POSE, _POSE_W, _V = "t x y z qx qy qz qw", "t x y z qw qx qy qz", "vx vy vz"
_MATRIX = " ".join(GROUPS["matrix"])
MATRIX_4X4 = f"{_MATRIX} _ _ _ _"
_BIASES = "bwx bwy bwz bax bay baz"
_ROS_POSE, _STAMP = "x y z qx qy qz qw", "t_s nanosec text"
_COVARIANCE = " ".join(GROUPS["covariance"])
_TWIST = "body_vx body_vy body_vz _ _ _"
_LOWER = " ".join(GROUPS["covariance_lower"])
_MARGINALS = " ".join([*GROUPS["rotation_covariance"], *GROUPS["position_covariance"]])
_ROS2 = "https://docs.ros.org: ros2 topic echo --csv"
_VINS = "vins_estimator/utility/visualization.cpp"
_NO_ORDER = "no header with the order of the quaternion: assumed"
_ORDER = f"{_NO_ORDER} qw qx qy qz, as in VINS-Mono"


def known(
    name: str, columns: str, checks: str, source: str, note: str = "", **more: Any
) -> Layout:
    """Return a row of the table of layouts: names of columns and checks between spaces."""
    checked = tuple(checks.split())
    return Layout(name, tuple(columns.split()), note, checks=checked, source=source, **more)


OPENVINS_STATE = ("t", "qx", "qy", "qz", "qw", "x", "y", "z", *_V.split(), *_BIASES.split())
# fmt: off
KNOWN = (
    known("t x y z", "t x y z", "time", "Leica and laser trackers; evo without rotation",
          doubt="no header: 4 columns read as t x y z; others, as {option} 't x y yaw'"),
    known("TUM", _POSE, "spaces unit", "cvg.cit.tum.de RGB-D file formats"),
    known("TUM", _POSE, "commas time unit not_ns", "4Seasons, evo_traj edits",
          doubt=f"{_NO_ORDER} qx qy qz qw, as in TUM"),
    known("EuRoC/ASL", _POSE_W, "commas time unit ns", "ASL ground truth, ADVIO",
          doubt=f"{_NO_ORDER} qw qx qy qz, as in EuRoC"),
    known("VINS-Mono", f"{_POSE_W} _", "vins", _VINS, _ORDER),
    known("VINS-Mono", f"{_POSE_W} {_V} _", "vins", _VINS, _ORDER),
    known("TUM with velocity", f"{_POSE} {_V}", "time unit", "rpg, ESVO"),
    known("VINS with velocity", f"{_POSE_W} {_V}", "time unit", "VINS-Mono edited"),
    known("TUM in seconds and nanoseconds", f"t_s nanosec {_ROS_POSE}", "ros2 unit",
          "users' logs of ROS headers"),
    known("TUM with an id", f"_ {_POSE}", "id time unit", "rpg_trajectory_evaluation",
          "the first of 9 columns is an id"),
    known("TUM with an id", f"{_POSE} _", "id_last time unit", "rtabmap export format 11",
          "the last of 9 columns is an id"),
    known("EuRoC/ASL", f"{_POSE_W} {_V} {_BIASES}", "time unit", "ASL state_groundtruth_estimate0",
          "no header: 17 columns read as EuRoC"),
    known("TartanAir", _ROS_POSE, "spaces unit", "TartanAir pose_left.txt",
          "7 columns without timestamps read as TartanAir: x y z qx qy qz qw, z down", up=_NED),
    known("NCLT", "t_us x y z roll pitch yaw", "commas time us angles",
          "robots.engin.umich.edu/nclt",
          "7 columns read as NCLT: microseconds, position, roll, pitch and yaw", up=_NED),
    known("KITTI", _MATRIX, "matrix", "cvlibs.net devkit_odometry", up=CAMERA),
    known("KITTI with a frame index", f"frame {_MATRIX}", "matrix frames", "KITTI-360 poses.txt",
          "the first of 13 columns is a frame index"),
    known("KITTI with a time", f"t {_MATRIX}", "matrix times time", "MulRan global_pose.csv",
          "the first of 13 columns is a time"),
    known("KITTI with a time", f"{_MATRIX} t", "matrix times time", "LIO forks",
          "the last of 13 columns is a time"),
    known("4 x 4 matrices", MATRIX_4X4, "matrix bottom", "Replica traj.txt of NICE-SLAM"),
    known("4 x 4 matrices", f"frame {MATRIX_4X4}", "matrix bottom frames",
          "KITTI-360 cam0_to_world.txt", "the first of 17 columns is a frame index"),
    known("4 x 4 matrices", f"t {MATRIX_4X4}", "matrix bottom times time", "eval3r",
          "the first of 17 columns is a time"),
    known("OpenVINS with covariance", f"{_POSE} {_MARGINALS}", "time unit", "ov_eval Recorder.h"),
    known(FAST_LIO, f"t rx ry rz x y z _ _ _ {_V} {'_ ' * 12}", "time",
          "FAST_LIO dump_lio_state_to_log",
          "no header: 25 columns read as the log of FAST-LIO, whose times start at 0"),
    known("smfeval", f"{_POSE} {_LOWER}", "time unit", "smfeval",
          "covariances read as body twists, position first (default of smfeval)",
          covariances=BODY_TWISTS),
    known("ros2 echo of PointStamped", f"{_STAMP} x y z", "ros2", _ROS2),
    known("ros2 echo of PoseStamped", f"{_STAMP} {_ROS_POSE}", "ros2 unit", _ROS2),
    known("ros2 echo of TransformStamped", f"{_STAMP} text {_ROS_POSE}", "ros2 unit", _ROS2),
    known("ros2 echo of PoseWithCovarianceStamped", f"{_STAMP} {_ROS_POSE} {_COVARIANCE}",
          "ros2 unit", _ROS2),
    known("ros2 echo of Odometry",
          f"{_STAMP} text {_ROS_POSE} {_COVARIANCE} {_TWIST} {'_ ' * 36}", "ros2 unit", _ROS2),
    known("ros2 echo of NavSatFix",
          f"{_STAMP} fix_status _ latitude longitude height {'_ ' * 10}", "ros2", _ROS2),
    known("kapture", "t text qw qx qy qz x y z", "unit", "kapture, LaMAR: trajectories.txt"),
)
# fmt: on


def _lengths(table: TextTable, layout: Layout, _: Floats) -> Any:
    lengths = np.linalg.norm(table.values[:, list(layout.groups["quaternion"])], axis=1)
    lengths = lengths[np.isfinite(lengths) & (lengths > 0.0)]
    typical = 1.0 if len(lengths) < 3 else median(lengths)
    if abs(typical - 1.0) < 2e-2 or "spaces" not in layout.checks or layout.time is None:
        return np.abs(lengths - 1.0) < 2e-2
    return (np.abs(lengths - typical) < 1e-6 * typical) & (typical < 10.0)  # all scaled alike


def _matrices(table: TextTable, layout: Layout, _: Floats) -> Any:
    axes = table.values[:, list(layout.groups["matrix"])].reshape(-1, 3, 4)[:, :, :3]
    axes = axes[np.isfinite(axes).all(axis=(1, 2))]
    errors = np.abs(axes @ np.swapaxes(axes, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    return (errors < ORTHONORMAL) & (np.linalg.det(axes) > 0.0)


def _are_nanoseconds(times: Floats) -> bool:
    return unit_of(times[np.isfinite(times)]) == 1


# By the name in `Layout.checks`: which rows of a table pass. The last argument is its times (N,).
CHECKS: dict[str, Callable[[TextTable, Layout, Floats], Any]] = {
    "spaces": lambda table, layout, times: table.separator in ("", "\t"),
    "commas": lambda table, layout, times: table.separator not in ("", "\t") and not table.at_end,
    "vins": lambda table, layout, times: table.at_end,
    "time": lambda table, layout, times: not goes_back(times) or not goes_back(-times),
    # Position and time are the same in both orders of the quaternion: the unit of time decides.
    "ns": lambda table, layout, times: _are_nanoseconds(times),
    "not_ns": lambda table, layout, times: not _are_nanoseconds(times),
    "frames": lambda table, layout, times: are_whole(times, 1e8).all(),
    "times": lambda table, layout, times: not are_whole(times, 1e8).all(),
    "id": lambda table, layout, times: are_whole(table.values[:, 0], 1e8),
    "id_last": lambda table, layout, times: (are_whole(table.values[:, -1], np.inf)
        & (np.diff(table.values[:, -1], prepend=-1.0) > 0.0)).all(),
    "us": lambda table, layout, times: (times > 1e14) & (times < 4e15),
    "angles": lambda table, layout, times: ~(np.abs(table.values[:, 4:7]) > 6.3).any(axis=1),
    "unit": _lengths,
    "matrix": _matrices,
    "bottom": lambda table, layout, times: (table.values[:, -4:] == [0, 0, 0, 1]).all(axis=1),
    "ros2": lambda table, layout, times: are_whole(table.values[:, 1], 1e9)
        & (times == np.round(times)),
}  # fmt: skip


def fits(table: TextTable, layout: Layout) -> bool:
    """Return whether the sample of a table has a layout."""
    names = layout.columns
    if table.at_end and names[-1] == IGNORED:
        names = names[:-1]
    if len(names) != table.columns or ("vins" in layout.checks) != table.at_end:
        return False
    for name, is_text in zip(names, table.texts.tolist(), strict=True):
        if is_text != (name == TEXT) and name != IGNORED:
            return False
    times = table.values[:, layout.time or 0]
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        passed = [np.atleast_1d(CHECKS[name](table, layout, times)) for name in layout.checks]
    return all(not len(rows) or rows.mean() >= _MOST for rows in passed)


def quaternion_in(values: Floats, places: Sequence[int]) -> Sequence[int]:
    """Return the first four successive `places` (N, columns) with unit length, () without."""
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        for at in range(len(places) - 3):
            lengths = np.linalg.norm(values[:, places[at : at + 4]], axis=1)
            if (np.abs(lengths - 1.0) < 1e-2).all():
                return places[at : at + 4]
    return ()


def with_names(columns: Sequence[str], places: Sequence[int], names: Sequence[str]) -> list[str]:
    """Return names of columns, some of them replaced."""
    new = dict(zip(places, names, strict=False))
    return [new.get(at, name) for at, name in enumerate(columns)]


def examples(table: TextTable, named: Sequence[str] = ()) -> list[list[str]]:
    """Return names for all columns of a table without a known position, with `_` for text.

    If there is a quaternion, these are two examples, for both orders. `named`: names of the
    columns, as far as a header has them.
    """
    header, words = Layout("", tuple(named) or (IGNORED,) * table.columns), table.sample[0]
    used = {place for places in header.groups.values() for place in places} | {header.time}
    columns = [name if at in used else IGNORED for at, name in enumerate(header.columns)]
    time = header.time
    if time is None:
        time = next((at for at, word in enumerate(words) if is_date(word)), None)
        if time is not None:
            columns[time] = "t"
            if any(map(is_time_of_day, words[time + 1 : time + 2])):
                columns[time + 1] = CLOCK
    free = [at for at in np.flatnonzero(~table.texts).tolist() if columns[at] == IGNORED]
    if time is None and free:
        clocks = [at for at in free if is_clock(table.values[:, at])]
        epochs = [at for at in clocks if table.values[0, at] > _LARGEST_ID]
        first = table.values[:, free[0]]
        if epochs or clocks[:1] == free[:1] or (table.columns > 3 and not goes_back(first)):
            time = (epochs or free)[0]  # wide tables usually have the time first
            columns[time] = "t"
            free = free[free.index(time) == 1 :]  # an id before the time is ignored
            free.remove(time)
    for names in (GROUPS["matrix"], _ROTATION_FIRST) if len(free) >= len(_ROTATION_FIRST) else ():
        for at in range(len(free)):
            example = with_names(columns, free[at:] + free[:at], names)
            if fits(table, Layout("", tuple(example), checks=("matrix",))):
                return [example]
    has_rotation = not set(ROTATIONS).isdisjoint(header.groups)
    four = () if has_rotation else quaternion_in(table.values, free)
    free = [at for at in free if at not in four]
    if len(free) < 2:
        return [["t", "x", "y", "z"]]
    pose = ["x", "y", "z"]
    if len(free) == 6 and not has_rotation and not four:
        suffix = "_deg" if np.nanmax(np.abs(table.values[:, free[3:]]), initial=0) > 6.3 else ""
        pose += [f"{angle}{suffix}" for angle in GROUPS["angles"]]
    columns = with_names(columns, free, pose)
    return [with_names(columns, four, order) for order in ORDERS[: 2 if four else 1]]


def options_for(table: TextTable) -> str:
    """Return the options that name the columns of a table as in `examples`."""
    return " or ".join(f"{{option}} '{' '.join(columns)}'" for columns in examples(table))


def by_rows(table: TextTable) -> Layout:
    """Return the layout that a table without a header has.

    Raises:
        InputError: No known layout fits, or several do.
    """
    fitting = [layout for layout in KNOWN if fits(table, layout)]
    if len(fitting) == 1:
        return fitting[0]
    where = f"its first row, line {table.first + 1}, is {table.first_line!r}"
    if fitting:
        options = " or ".join(
            f"{{option}} '{' '.join(layout.columns)}' ({layout.name}: {layout.source})"
            for layout in fitting
        )
        raise InputError(f"several layouts fit, and {where}; name the columns: {options}")
    for line, row in zip(table.sample_lines, table.sample, strict=True):
        wrong = [at for at, word in enumerate(row) if number(word) is None]
        if 0 < len(wrong) <= max(1, table.columns // 4):
            raise InputError(
                f"line {line + 1}, column {wrong[0] + 1}: {row[wrong[0]][:40]!r} is not a number; "
                "correct or remove the line, or name the columns in a header line or as in "
                f"{options_for(table)}"
            )
    raise InputError(
        f"unknown layout with {counted(table.columns, 'column')}, and {where}; name the columns, "
        f"as in {options_for(table)}, with {IGNORED} for columns to ignore"
    )
