"""Names of columns, as --columns takes them, and the layouts that they make."""

from __future__ import annotations

import dataclasses
import difflib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis

IGNORED, TEXT = "_", "text"
FRAME, FRAME_1, DATE, CLOCK, RECEIVED = ("frame", "frame1", "date", "clock", "received")
UNPADDED = "t_unpadded"  # seconds, a point, and nanoseconds without leading zeros
TIME_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}  # in nanoseconds
# Units of the names of times, nanoseconds; None if the values tell it.
UNITS = {
    "t": None,
    "t_s": TIME_UNITS["s"],
    UNPADDED: TIME_UNITS["s"],
    "t_ms": TIME_UNITS["ms"],
    "t_us": TIME_UNITS["us"],
    "t_ns": TIME_UNITS["ns"],
    DATE: TIME_UNITS["s"],
}
TIMES = (*UNITS, FRAME, FRAME_1)
WEEK, WEEK_S = "week", 604_800  # of GPS, which times of the week count from, and its seconds
# Columns to be added to times, as in a header of ROS: their unit in nanoseconds, and the number
# of it in what they count in, whole seconds or years.
PARTS = {
    "nanosec": (1, 10**9),
    "microsec": (10**3, 10**6),
    "millisec": (10**6, 10**3),
    WEEK: (WEEK_S * 10**9, 10_000),
}
_SIX = range(1, 7)
_TRIPLE = (11, 12, 13, 22, 23, 33)
_XYZ = ("x", "y", "z")
# Quantities and their columns. A group is present if all of its columns are.
GROUPS: dict[str, tuple[str, ...]] = {
    "position": _XYZ,
    "planar": ("x", "y"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "rotation_vector": ("rx", "ry", "rz"),
    "angles": ("roll", "pitch", "yaw"),
    "angles_deg": ("roll_deg", "pitch_deg", "yaw_deg"),
    "heading": ("yaw",),
    "heading_deg": ("yaw_deg",),
    "velocity": ("vx", "vy", "vz"),
    "body_velocity": ("body_vx", "body_vy", "body_vz"),
    "gyroscope_bias": ("bwx", "bwy", "bwz"),
    "accelerometer_bias": ("bax", "bay", "baz"),
    "matrix": tuple(f"m{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3, 4)),
    "covariance": tuple(f"c{row}{column}" for row in _SIX for column in _SIX),
    "covariance_upper": tuple(f"c{row}{column}" for row in _SIX for column in range(row, 7)),
    "covariance_lower": tuple(f"c{row}{column}" for row in _SIX for column in range(1, row + 1)),
    "variances": tuple(f"c{axis}{axis}" for axis in _SIX),
    "rotation_covariance": tuple(f"pr{entry}" for entry in _TRIPLE),
    "position_covariance": tuple(f"pt{entry}" for entry in _TRIPLE),
    "place": ("latitude", "longitude", "height"),
    "level_place": ("latitude", "longitude"),
    "place_sigma": ("sigma_east", "sigma_north", "sigma_up"),
    "fix_status": ("fix_status",),
    **{part: (part,) for part in PARTS},
}
_METRIC = ("position", "planar", "matrix")
_PLACES = {*_METRIC, "place", "level_place"}
ROTATIONS = ("quaternion", "rotation_vector", "angles", "angles_deg", "heading", "heading_deg")
# Groups with the same quantity, the preferred first.
_RIVALS = (
    ("matrix", "position", "planar"),
    ("matrix", *ROTATIONS),
    ("covariance", "covariance_upper", "covariance_lower", "variances"),
    *((group, "place", "level_place") for group in _METRIC),
    *((group, other) for group in _METRIC for other in ("place_sigma", "fix_status")),
)
NAMES = (
    *TIMES, CLOCK, RECEIVED, *dict.fromkeys(name for group in GROUPS.values() for name in group),
    *(f"{axis}_{unit}" for unit in ("mm", "cm", "km") for axis in _XYZ), IGNORED,
)  # fmt: skip
AS_NAMED = "columns as named"  # name of the layout of --columns
EXAMPLE = "--columns 't x y z qw qx qy qz'"
FAST_LIO = "FAST-LIO"
# Conventions of covariances: about fixed axes, as in PoseWithCovariance, or of body twists.
FIXED_AXES, BODY_TWISTS = "fixed axes", "body twists"


@dataclass(frozen=True)
class Layout:
    """The meaning of the columns of a file."""

    name: str  # name of the format
    columns: tuple[str, ...]  # names of the columns, from `NAMES`
    note: str = ""  # assumptions and ignored columns, "" if there are none
    up: UpAxis = Z_UP  # axis of the fixed frame that points up
    covariances: str = FIXED_AXES  # convention of 6 x 6 covariances
    unit: str = "m"  # of the positions
    checks: tuple[str, ...] = ()  # names of `layouts.CHECKS`, which all rows must pass
    source: str = field(default="", compare=False)  # who writes it, for the documentation
    extra: tuple[str, ...] = ()  # other columns of numbers, one group of their own
    doubt: str = ""  # what the file does not say, for a warning
    inverse: bool = False  # whether the poses are those of the world in the camera

    @cached_property
    def time(self) -> int | None:
        """Index of the column with timestamps or frame numbers, or None."""
        return next((at for at, name in enumerate(self.columns) if name in TIMES), None)

    @property
    def time_name(self) -> str:
        """Name of the column `time`, "" if there is none."""
        return "" if self.time is None else self.columns[self.time]

    def named(self, time: str = "") -> str:
        """Return the columns as --columns takes them, without ignored ones at the end.

        `time`: another name of the column `time`, such as one with its unit.
        """
        known = (name if name in NAMES else IGNORED for name in self.columns)
        names = [
            f"{name}_{self.unit}" if name in _XYZ and self.unit != "m" else name for name in known
        ]
        if self.time is not None and time:
            names[self.time] = time
        return " ".join(names).rstrip(f" {IGNORED}")

    def with_columns(self, columns: Iterable[str]) -> Layout:
        """Return this layout with other names of the columns."""
        return dataclasses.replace(self, columns=tuple(columns))

    @cached_property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Groups of `GROUPS` that are read, with the indices of their columns."""
        present = {
            group: tuple(self.columns.index(name) for name in names)
            for group, names in GROUPS.items()
            if set(names) <= set(self.columns)
        }
        if self.extra:
            present["extra"] = tuple(map(self.columns.index, self.extra))
        for rivals in _RIVALS:
            for other in [group for group in rivals if group in present][1:]:
                del present[other]
        return present

    @property
    def has_places(self) -> bool:
        """Whether the columns contain a position."""
        return not _PLACES.isdisjoint(self.groups)

    @property
    def is_geographic(self) -> bool:
        """Whether the positions are GNSS fixes: latitude and longitude."""
        return not {"place", "level_place"}.isdisjoint(self.groups)


def layout_of(columns: Sequence[str]) -> Layout:
    """Return the layout of columns that the user named with an option, `_` for ignored ones."""
    for name in columns:
        if name not in NAMES:
            near = difflib.get_close_matches(name, NAMES, n=1)
            hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(NAMES)}"
            raise SettingsError(f"unknown column {name!r}; {hint}")
    counts = Counter(name for name in columns if name != IGNORED)
    twice = [f"{name} twice" for name, count in counts.items() if count > 1]
    times = [name for name in columns if name in TIMES]
    if twice or len(times) > 1:
        raise SettingsError(
            f"--columns has {' and '.join(twice[:1] or times)}; name a quantity once, and use "
            f"{IGNORED} for columns to ignore"
        )
    units = {name[2:] or "m" for name in columns if name[:1] in _XYZ and name[1:2] in ("", "_")}
    plain = (name[0] if name[1:] in ("_mm", "_cm", "_km") else name for name in columns)
    layout = Layout(AS_NAMED, tuple(plain), unit=" and ".join(sorted(units)) or "m")
    if not layout.has_places:
        raise SettingsError(
            f"columns {' '.join(columns)} have no position; name x, y and z, as in {EXAMPLE}, "
            "or latitude and longitude"
        )
    return layout
