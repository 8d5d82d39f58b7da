"""Layouts of text files: the meaning of their columns, as tables.

A column has one of the names in `NAMES`, which `--columns` also takes. If a header names the
columns, its names apply (`header_names.py`). Otherwise the number of columns selects the layout,
and the layout's note states the assumptions.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis

IGNORED, FAST_LIO = "_", "FAST-LIO"
DATE, FRAME, RECEIVED, NANOSEC = "date", "frame", "received", "nanosec"
# Nanoseconds per unit of time. The unit of `t` is recognised from the values.
UNITS = {"t": None, "t_s": 10**9, "t_ms": 10**6, "t_us": 10**3, "t_ns": 1, DATE: 10**9}
TIMES = (*UNITS, FRAME)
_ANGLES = ("roll", "pitch", "yaw")
_SIX = range(1, 7)
UPPER = tuple(f"c{row}{column}" for row in _SIX for column in range(row, 7))
LOWER = tuple(f"c{row}{column}" for row in _SIX for column in range(1, row + 1))
# Quantities and their columns. A group is present if all of its columns are.
GROUPS: dict[str, tuple[str, ...]] = {
    "position": ("x", "y", "z"),
    "planar": ("x", "y"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "rotation_vector": ("rx", "ry", "rz"),
    "angles": _ANGLES,
    "angles_deg": tuple(f"{each}_deg" for each in _ANGLES),
    "heading": ("yaw",),
    "heading_deg": ("yaw_deg",),
    "velocity": ("vx", "vy", "vz"),
    "body_velocity": ("body_vx", "body_vy", "body_vz"),
    "gyroscope_bias": ("bwx", "bwy", "bwz"),
    "accelerometer_bias": ("bax", "bay", "baz"),
    "matrix": tuple(f"m{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3, 4)),
    "covariance": tuple(f"c{row}{column}" for row in _SIX for column in _SIX),
    "covariance_upper": UPPER,
    "covariance_lower": LOWER,
    "variances": tuple(f"c{each}{each}" for each in _SIX),
    "rotation_covariance": tuple(f"pr{each}" for each in (11, 12, 13, 22, 23, 33)),
    "position_covariance": tuple(f"pt{each}" for each in (11, 12, 13, 22, 23, 33)),
    "place": ("latitude", "longitude", "height"),
    "level_place": ("latitude", "longitude"),
    "place_sigma": ("sigma_east", "sigma_north", "sigma_up"),
    "fix_status": ("fix_status",),
    RECEIVED: (RECEIVED,),  # time of reception, in the unit of the timestamps
    NANOSEC: (NANOSEC,),  # to be added to timestamps of whole seconds, as in a header of ROS
}
_METRES = ("position", "planar", "matrix")
# Groups that contain a position.
_PLACES = {*_METRES, "place", "level_place"}
# Groups with the same quantity: a group is ignored if one of these is present.
_INSTEAD = {
    "planar": ("position",),
    "rotation_vector": ("quaternion",),
    "angles": ("quaternion",),
    "angles_deg": ("quaternion", "angles"),
    "heading": ("quaternion", "angles", "angles_deg"),
    "heading_deg": ("quaternion", "angles", "angles_deg", "heading"),
    "covariance_upper": ("covariance",),
    "covariance_lower": ("covariance",),
    "variances": ("covariance", "covariance_upper", "covariance_lower"),
    "place": _METRES,
    "level_place": (*_METRES, "place"),
    "place_sigma": _METRES,
    "fix_status": _METRES,
}
NAMES = (*TIMES, *dict.fromkeys(name for group in GROUPS.values() for name in group), IGNORED)
EXAMPLE = "--columns 't x y z qw qx qy qz'"
_CAMERA = UpAxis("-y", "KITTI's camera axes")
_NED = UpAxis("-z", "TartanAir's axes: north, east, down")
# Conventions of covariances: about fixed axes, as in PoseWithCovariance, or of body twists.
_LENGTH_ONE = 0.1  # largest deviation of a quaternion's length in an uncertain layout
AS_NAMED = "columns as named"  # layout of --columns
FIXED_AXES, BODY_TWISTS = "fixed axes", "body twists"


@dataclass(frozen=True)
class Layout:
    """The meaning of the columns of a file."""

    name: str  # name of the format
    columns: tuple[str, ...]  # names of the columns, from `NAMES`
    note: str = ""  # assumptions and ignored columns, "" if there are none
    up: UpAxis = Z_UP  # axis of the fixed frame that points up
    covariances: str = FIXED_AXES  # convention of 6 x 6 covariances, `FIXED_AXES` or `BODY_TWISTS`
    # Single separator of columns, which can then be empty or text. "" if any number of spaces and
    # commas separates columns.
    separator: str = ""
    unit: str = "m"  # of the positions

    @cached_property
    def time(self) -> int | None:
        """Index of the column with timestamps or frame numbers, or None."""
        return next((at for at, name in enumerate(self.columns) if name in TIMES), None)

    @property
    def time_name(self) -> str:
        """Name of the column `time`, "" if there is none."""
        return "" if self.time is None else self.columns[self.time]

    @cached_property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Groups of `GROUPS` that are read, with the indices of their columns."""
        found = {
            group: tuple(self.columns.index(name) for name in names)
            for group, names in GROUPS.items()
            if set(names) <= set(self.columns)
        }
        return {
            group: places
            for group, places in found.items()
            if not any(other in found for other in _INSTEAD.get(group, ()))
        }

    @property
    def has_places(self) -> bool:
        """Whether the columns contain a position."""
        return not _PLACES.isdisjoint(self.groups)

    @property
    def is_geographic(self) -> bool:
        """Whether the positions are GNSS fixes: latitude and longitude."""
        return not {"place", "level_place"}.isdisjoint(self.groups)


def layout_of(columns: Sequence[str]) -> Layout:
    """Return the layout of columns that the user named.

    `columns`: names, as in `t x y z qw qx qy qz`, with `_` for ignored columns.
    """
    for name in columns:
        if name not in NAMES:
            near = difflib.get_close_matches(name, NAMES, n=1)
            hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(NAMES)}"
            raise SettingsError(f"unknown column {name!r}; {hint}")
    counts = Counter(name for name in columns if name != IGNORED)
    twice = [name for name, count in counts.items() if count > 1]
    times = [name for name in columns if name in TIMES]
    if twice or len(times) > 1:
        raise SettingsError(
            f"--columns has {' and '.join(times) if not twice else twice[0] + ' twice'}; name a "
            f"quantity once, and use {IGNORED} for columns to ignore"
        )
    layout = Layout(AS_NAMED, tuple(columns))
    if not layout.has_places:
        raise SettingsError(
            f"columns {' '.join(columns)} have no position; name x, y and z, as in {EXAMPLE}, or "
            "latitude and longitude"
        )
    return layout


def _layout(name: str, columns: str, note: str = "", **more: object) -> Layout:
    return Layout(name, tuple(columns.split()), note, **more)  # type: ignore[arg-type]


_ORDER = "no header with the order of the quaternion: assumed {}, as in {}"
_POSE = "t x y z qx qy qz qw"
_POSE_W = "t x y z qw qx qy qz"
_MATRIX = " ".join(GROUPS["matrix"])
_BIASES = "bwx bwy bwz bax bay baz"
G2O = {
    "VERTEX_SE3:QUAT": _layout("g2o", "frame x y z qx qy qz qw"),
    "VERTEX_SE2": _layout("g2o", "frame x y yaw"),
}
OPENVINS_STATE = _layout("OpenVINS state", f"t qx qy qz qw x y z vx vy vz {_BIASES}")
_ID_LAST = _layout("TUM with an id", f"{_POSE} _", "the last of 9 columns is an id")
_KITTI = _layout("KITTI", _MATRIX, up=_CAMERA)
# Layouts of files without a header, by the number of columns.
_BY_COUNT = {
    len(each.columns): each
    for each in (
        _layout("t x y z", "t x y z"),
        _layout(
            "TartanAir",
            "x y z qx qy qz qw",
            "7 columns without timestamps read as TartanAir: x y z qx qy qz qw, z down",
            up=_NED,
        ),
        _layout("TUM", _POSE),
        _layout("TUM with an id", f"_ {_POSE}", "the first of 9 columns is an id"),
        _layout("TUM with velocity", f"{_POSE} vx vy vz", _ORDER.format("qx qy qz qw", "TUM")),
        _layout(
            "EuRoC/ASL", f"{_POSE_W} vx vy vz {_BIASES}", "no header: 17 columns read as EuRoC"
        ),
        _layout(
            "OpenVINS with covariance",
            " ".join([_POSE, *GROUPS["rotation_covariance"], *GROUPS["position_covariance"]]),
        ),
        _layout(
            FAST_LIO,
            f"t rx ry rz x y z _ _ _ vx vy vz {'_ ' * 12}",
            "no header: 25 columns read as the log of FAST-LIO, whose times start at 0",
        ),
        _layout(
            "smfeval",
            " ".join([_POSE, *LOWER]),
            "covariances read as body twists, position first (default of smfeval)",
            covariances=BODY_TWISTS,
        ),
    )
}
# The same for files with commas and with timestamps in nanoseconds since 1970.
_OF_NANOSECONDS = {
    len(each.columns): each
    for each in (
        _layout("EuRoC/ASL", _POSE_W, _ORDER.format("qw qx qy qz", "EuRoC")),
        _layout("VINS-Mono", f"{_POSE_W} vx vy vz", _ORDER.format("qw qx qy qz", "VINS-Mono")),
    )
}
KNOWN = (
    "supported: TUM (8 columns), KITTI (12 or 13), EuRoC/ASL (17), VINS-Mono (11), OpenVINS "
    "(20), FAST-LIO (25), smfeval (29), TartanAir (7), t x y z (4), g2o, and files with a header; "
    f"for others, use {EXAMPLE}, with {IGNORED} for columns to ignore"
)


def by_count(rows: Sequence[Sequence[float]], commas: bool, comma_at_end: bool = False) -> Layout:
    """Return the usual layout of files without a header, by the number of columns.

    `rows`: first rows of the file, all of the same length, at least one. `comma_at_end`: whether
    lines end with a comma, as those of VINS in any unit of time.
    """
    columns = len(rows[0])
    if columns in (12, 13):
        return _kitti(rows)
    is_of_vins = comma_at_end or (commas and abs(rows[0][0]) > 1e12)
    of_nanoseconds = _OF_NANOSECONDS if is_of_vins else {}
    found = of_nanoseconds.get(columns) or _BY_COUNT.get(columns)
    if columns == len(_ID_LAST.columns) and _ends_with_id(np.array(rows)):
        return _ID_LAST
    if found is None or not _fits(found, np.array(rows)):
        raise InputError(f"unknown layout with {counted(columns, 'column')}; {KNOWN}")
    return found


def _fits(layout: Layout, rows: Floats) -> bool:
    """Return whether rows (N, C) can have a layout that many other tables of C columns share.

    Tables with further columns, or with angles, also have 7 or 9 columns.
    """
    if layout.columns[0] == IGNORED and (rows[:, 0] != np.round(rows[:, 0])).any():
        return False
    if len(layout.columns) not in (7, 9):
        return True
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        lengths = np.linalg.norm(rows[:, list(layout.groups["quaternion"])], axis=1)
    usable = lengths[np.isfinite(lengths) & (lengths > 0.0)]
    return bool((np.abs(usable - 1.0) < _LENGTH_ONE).all())


def _ends_with_id(rows: Floats) -> bool:
    """Return whether rows (N, C) are poses of TUM, and whole numbers that increase."""
    ids = rows[:, -1]
    whole = bool((ids == np.round(ids)).all() and (np.diff(ids) >= 1.0).all())
    return whole and _fits(_ID_LAST, rows)


def _kitti(rows: Sequence[Sequence[float]]) -> Layout:
    """Return KITTI's layout: a 3 x 4 matrix, optionally after a frame index or a time."""
    leading = len(rows[0]) - 12
    matrices = np.array(rows)[:, leading:].reshape(-1, 3, 4)
    axes = matrices[np.isfinite(matrices).all(axis=(1, 2)), :, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        squares = axes @ np.swapaxes(axes, 1, 2)
    if not np.allclose(squares, np.eye(3), atol=1e-2):
        raise InputError(
            f"{counted(len(rows[0]), 'column')}, but not 3 x 4 pose matrices (KITTI); {KNOWN}"
        )
    if not leading:
        return _KITTI
    first = np.array(rows)[:, 0]
    indexed = bool((first == np.round(first)).all() and (first < 1e8).all())
    name, said = (FRAME, "a frame index") if indexed else ("t", "a time")
    return dataclasses.replace(
        _KITTI,
        name=f"KITTI with {said}",
        columns=(name, *_KITTI.columns),
        note=f"the first of 13 columns is {said}",
    )


@dataclass(frozen=True)
class TextHints:
    """Information about text files that the user states."""

    columns: tuple[str, ...] = ()  # names of the columns (`layouts.NAMES`); () to recognise them
    # Rows per second of files without timestamps; None if unknown.
    frame_rate_hz: float | None = None

    def __post_init__(self) -> None:
        if self.columns:
            layout_of(self.columns)
        rate = self.frame_rate_hz
        if rate is not None and not (math.isfinite(rate) and rate > 0.0):
            raise SettingsError(f"the frame rate must be greater than zero, not {rate:g}")

    @property
    def of_reference(self) -> TextHints:
        """Hints for the groundtruth or reference: the rate only, since its columns can differ."""
        return TextHints(frame_rate_hz=self.frame_rate_hz)

    @classmethod
    def of(cls, columns: str | None, frame_rate_hz: float | None) -> TextHints:
        """Return hints from options of the command line.

        `columns`: names separated by spaces or commas; None to recognise them.
        """
        names = () if columns is None else tuple(columns.replace(",", " ").split())
        if columns is not None and not names:
            raise SettingsError("--columns is empty; name at least x, y and z")
        return cls(names, frame_rate_hz)


NO_HINTS = TextHints()
