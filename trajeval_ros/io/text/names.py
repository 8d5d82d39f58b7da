"""Names of columns: those of --columns, and their translation from header lines."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis

IGNORED, TEXT = "_", "text"
FRAME, FRAME_1, DATE, CLOCK, NANOSEC, RECEIVED = (
    *("frame", "frame1", "date", "clock", "nanosec", "received"),
)
UNPADDED = "t_unpadded"  # seconds, a point, and nanoseconds without leading zeros
UNITS = {
    "t": None,
    "t_s": 10**9,
    UNPADDED: 10**9,
    "t_ms": 10**6,
    "t_us": 10**3,
    "t_ns": 1,
    DATE: 10**9,
}
TIMES = (*UNITS, FRAME, FRAME_1)
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
    "variances": tuple(f"c{each}{each}" for each in _SIX),
    "rotation_covariance": tuple(f"pr{each}" for each in _TRIPLE),
    "position_covariance": tuple(f"pt{each}" for each in _TRIPLE),
    "place": ("latitude", "longitude", "height"),
    "level_place": ("latitude", "longitude"),
    "place_sigma": ("sigma_east", "sigma_north", "sigma_up"),
    "fix_status": ("fix_status",),
    NANOSEC: (NANOSEC,),  # to be added to timestamps of whole seconds, as in a header of ROS
}
_METRIC = ("position", "planar", "matrix")
_PLACES = {*_METRIC, "place", "level_place"}
_ROTATIONS = ("quaternion", "rotation_vector", "angles", "angles_deg", "heading", "heading_deg")
# Groups with the same quantity, the preferred first.
_RIVALS = (
    ("matrix", "position", "planar"),
    ("matrix", *_ROTATIONS),
    ("covariance", "covariance_upper", "covariance_lower", "variances"),
    *((each, "place", "level_place") for each in _METRIC),
    *((each, other) for each in _METRIC for other in ("place_sigma", "fix_status")),
)
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}
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

    @cached_property
    def groups(self) -> dict[str, tuple[int, ...]]:
        """Groups of `GROUPS` that are read, with the indices of their columns."""
        found = {
            group: tuple(self.columns.index(name) for name in names)
            for group, names in GROUPS.items()
            if set(names) <= set(self.columns)
        }
        if self.extra:
            found["extra"] = tuple(map(self.columns.index, self.extra))
        for rivals in _RIVALS:
            for other in [each for each in rivals if each in found][1:]:
                del found[other]
        return found

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


# ---- header lines. Patterns are compiled on use, since most files have no header.
_UNIT = r"\[([^\[\]]*)\]|\(([^()]*)\)"
_UNITS = {
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), "ns"),
    **dict.fromkeys(("us", "usec", "usecs", "microseconds", "micros"), "us"),
    **dict.fromkeys(("ms", "msec", "msecs", "milliseconds", "millis"), "ms"),
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
}
_OTHER_SPEED = r"[\[(](?!m[ /])[a-z]+ ?(?:/ ?[sh]|s\^?-1)|[\[(]m ?/ ?h"  # not m/s
_LENGTH = rf"{_UNIT}|[^a-z0-9](mm|cm|k?m)$"
_TIME = (
    r"(?:t|ts|utime|epoch|rostime|secs?|(?:gps|utc|ros|unix)_?time|t_?(?:ms|us|ns|s|secs?)"
    r"|[nu]secs?|nanosecs?|ns|time.*|stamp.*|(?:.*_)?(?:time|timestamp|stamp|date|datetime|utc)"
    r"(?:_.*)?)"
)
_NANOSECONDS = r"(?:.*_)?(?:nano|n)secs?"  # of a timestamp of ROS, next to its seconds
_RECEIVED = r"received(?:_(?:s|ms|us|ns))?"
_FRAME = r"frame|frame_?(?:index|number|num|no|id)|index|image|image_id|id|no|num|pose_index"
# Patterns of column names by group. `{}` is the element: x, y, z or w.
_FRAMES = r"(?:_(?:world|odom|map|device|body|imu|cam(?:era)?|enu|ecef|local|global))*"
_VECTORS = {
    "position": r"(?:(?:t|p|pos|position|p_[a-z_]+|ecef_p|trans|loc(?:ation)?|pose)?_?"
    r"|(?:.*_)?(?:position|translation|point|pos)_){}(?:_?pos)?" + _FRAMES + r"(?:_(mm|cm|m|km))?",
    "quaternion": r"(?:(?:q|quat|quaternion|orientation|q_[a-z_]+)_?"
    r"|(?:.*_)?(?:orientation|rotation|quaternion|quat)_){}" + _FRAMES,
    "body_velocity": r"(?:.*_)?twist_linear_{}",
    "velocity": r"(?:(?:v|vel|velocity|v_[a-z_]+)_?|(?:.*_)?linear_velocity_){}",
    "gyroscope_bias": r"b_?[wg](?:_[a-z_]+)?_?{}",
    "accelerometer_bias": r"b_?a(?:_[a-z_]+)?_?{}",
}
_UP = "(?:up|alt|altitude|height|elevation)(?:_m)?"
# Sets that are used only if all their names are present, and if no other name is the quantity.
_SETS: tuple[tuple[dict[str, str], ...], ...] = (
    ({"x": "east(?:ing)?(?:_m)?", "y": "north(?:ing)?(?:_m)?", "z": f"{_UP}|z"},),
    ({"x": "e", "y": "n", "z": "u"},),
    ({"x": "x_east", "y": "y_north", "z": "z_up"},),
    ({"z": _UP},),
    ({"qw": "w"},),
    ({f"q{axis}": f"(?:rot|r|o)_?{axis}" for axis in "xyzw"},),
    ({"qx": "qi", "qy": "qj", "qz": "qk", "qw": "q[rw]"},),
    ({"roll": "phi", "pitch": "theta", "yaw": "psi"},),
)
_NEEDED = {"z": {"x", "y"}, "qw": {"qx", "qy", "qz"}}  # by a set of one name
_ANGLE = r"(?:.*_)?(roll|pitch|yaw)(?:_(deg|degrees|rad|radians))?"
_THETA = r"theta(?:_(deg|degrees|rad|radians))?"
_COVARIANCE = r"(?!.*twist)(?:.*_)?(?:c|cov|covariance)_?(\d+)(?:_(\d))?"
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")
_AXIS = "|".join(_AXES)
_VARIANCE = rf"(?:.*_)?(?:var|variance)_?({_AXIS})"
_PAIR = rf"(?:.*_)?(?:cov|covariance)_?({_AXIS})_?({_AXIS})"
_TRIANGLES = dict(
    zip(
        ["qrr", "qrp", "qry", "qpp", "qpy", "qyy", "pxx", "pxy", "pxz", "pyy", "pyz", "pzz"],
        (*GROUPS["rotation_covariance"], *GROUPS["position_covariance"]),
        strict=True,
    )
)
_FIXES = {  # used only if both latitude and longitude are present
    "latitude": r"(?:.*_)?(?:lat|latitude)(?:_?deg)?",
    "longitude": r"(?:.*_)?(?:lon|lng|long|longitude)(?:_?deg)?",
    "height": r"(?:.*_)?(?:h|height|alt|altitude|ellipsoidal_?height|elevation|h_ell)(?:_?m)?",
    "sigma_east": r"(?:s|sd|std|sigma)_?(?:e|east|x)(?:_?m)?",
    "sigma_north": r"(?:s|sd|std|sigma)_?(?:n|north|y)(?:_?m)?",
    "sigma_up": r"(?:s|sd|std|sigma)_?(?:u|up|z)(?:_?m)?",
    "fix_status": r"(?:.*_)?(?:fix_?)?status(?:_status)?",
}
# Words of quantities that are no part of a pose.
_OTHER = (
    r"(?:.*_)?(?:id|uid|name|key|seq|counter|topic|type|state|mode|flag|valid|camera|device|label"
    r"|vel|velocity|speed|twist|linear|angular|ang(?:vel)?|omega|acc|accel(?:eration)?|gyro|mag"
    r"|gravity|wind|force|torque|wrench|temp(?:erature)?|pressure|battery|voltage|exposure|gain"
    r"|cov(?:ar(?:iance)?)?|var(?:iance)?|std(?:dev)?|sigma|sd|sd[neu]+|err(?:or)?|residual|rmse"
    r"|quality|q|score|confidence|conf|num|count|sats?|satellites|ns|nsat|age|ratio|dop|[hpv]dop"
    r"|status|fix|service|scale|bias|b[agw]|distance|dist|length|width|duration|dt|hz|rate|week"
    r"|seconds|v|w|a|b|d|l|fov|fx|fy|cx|cy|marker|mean|tracking|lidar|image|file|path|frame)"
    r"(?:[xyzneu]|\d{1,4})?(?:_.*)?"
)
_OPENVINS = r"\bq p v bg ba\b"  # one name per vector
_COMPASS = r"(?:.*_)?(?:heading|azimuth|course|bearing|track)(?:_deg)?"


_LONGEST_NAME = 80  # characters: patterns need quadratic time for longer ones


def split_header(line: str, separator: str) -> list[str]:
    """Return the names in a header line."""
    line = re.sub(r"\A[#%\s]*(?:fields\s+)?", "", line)
    line = line.encode("latin-1", "replace").decode("utf-8", "replace")
    if not separator:  # a unit after a space belongs to the name before it
        line = re.sub(rf" (?={_UNIT})", "", " ".join(line.split()))  # runs of spaces are slow
    names = [each.strip(" \"'\t\r\n") for each in line.split(separator or None)]
    return names[:-1] if len(names) > 1 and not names[-1] else names


def plain_of(name: str) -> str:
    """Return a name in lower case, with _ between its words and without its unit."""
    name = name[: 2 * _LONGEST_NAME]
    name = re.sub(r"\A[^(]*\(\s*(?=\w+\Z)", "", re.sub(r"\s*\)\Z(?<!\()", ")", name))
    name = name[:-1] if name.endswith(")") and "(" not in name else name
    name = re.sub(r"\[(\d)\]", r"_\1", name)
    name = re.sub(r"(?<=[a-z])(?=(?:[A-Z][a-z]|Ns|Us|Ms)[a-z]*)|(?<=[A-Z])(?=Time\b)", "_", name)
    return re.sub(r"[^a-z0-9]+", "_", re.sub(_UNIT, "", name).lower()).strip("_")[:_LONGEST_NAME]


def from_header(names: Sequence[str], sample: Floats, texts: Booleans) -> Layout | None:
    """Return the layout that the names of all columns describe; None if they are no names.

    `sample`: (N, C) first rows, NaN for what is no number. `texts`: (C,), whether a
    column is text.

    Raises:
        InputError: A quantity is missing that a column with an unknown name may be.
    """
    plain = [plain_of(name) for name in names]
    found = _columns(names, plain, sample, ~texts)
    known = [
        name != IGNORED or bool(re.fullmatch(f"{_OTHER}|{_COMPASS}", plain[at])) or not plain[at]
        for at, name in enumerate(found)
    ]
    layout = Layout("", tuple(found))
    used = {place for places in layout.groups.values() for place in places} | {layout.time}
    varies = np.array([np.unique(column[np.isfinite(column)]).size > 1 for column in sample.T])
    unknown = [
        at for at, is_known in enumerate(known) if not is_known and (varies[at] or len(sample) < 2)
    ]
    if not any(name != IGNORED for name in found) and 2 * sum(known) < len(names):
        return None
    unit = re.search(_UNIT, names[layout.time]) if layout.time is not None else None
    said = (unit[1] or unit[2] or "").strip().lower() if unit else ""
    if said and said not in _UNITS and layout.time_name == "t" and re.search(r"\d|s$", said):
        raise InputError(
            f"the unit of the time, {said!r}, is unknown; convert it, and name the columns: "
            f"{{option}} '{' '.join(found)}'"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        wanted = _missing(layout, unknown, sample, plain)
    if wanted:
        words = ", ".join(repr(names[at][:40]) for at in unknown[:6])
        said = f", and the meaning of {words} is unknown" if unknown else ""
        known_names = [name for name in found if name != IGNORED]
        example = (
            found
            if known_names
            else [*["t", "x", "y", "z", "qx", "qy", "qz", "qw"], *found][: len(found)]
        )
        raise InputError(
            f"no column has a name of a {wanted} ({', '.join(names)[:200]}){said}; name the "
            f"columns: {{option}} '{' '.join(example)[:300]}', with x, y, z, t, qx ... for _"
        )
    ignored = [
        name or f"column {at + 1}"
        for at, name in enumerate(names)
        if at not in used and name != CLOCK
    ]
    note = f"ignored columns: {', '.join(ignored)}" if ignored else ""
    if not layout.is_geographic and set(_ROTATIONS).isdisjoint(layout.groups):
        compass = [
            name for name, word in zip(names, plain, strict=True) if re.fullmatch(_COMPASS, word)
        ]
        if compass:
            note += (
                f"; {compass[0]} may count from north: no rotations are read; name it yaw if not"
            )
    return Layout(_title(layout), tuple(found), note, unit=_unit_of(names, layout))


def _missing(layout: Layout, unknown: Sequence[int], sample: Floats, plain: Sequence[str]) -> str:
    """Return the quantity that a column with an unknown name may be, "" if all is known."""
    if not layout.has_places:
        return "position"
    if layout.time is None and len(sample) > 1:
        steps = np.diff(sample[:, unknown], axis=0)
        if ((steps >= 0.0).all(axis=0) & (steps > 0.0).any(axis=0)).any():
            return "time"
    if "planar" in layout.groups and unknown:
        return "height"
    if not layout.is_geographic and set(_ROTATIONS).isdisjoint(layout.groups):
        for at in range(len(plain) - 3):
            four = range(at, at + 4)
            lengths = np.linalg.norm(sample[:, four], axis=1)
            if len(lengths) and (np.abs(lengths - 1.0) < 1e-2).all():
                return "rotation"
    return ""


def _unit_of(names: Sequence[str], layout: Layout) -> str:
    """Return the unit in brackets, or at the end, of the names of positions."""
    places = layout.groups.get("position") or layout.groups.get("planar", ())
    matches = [re.search(_LENGTH, names[place].lower()) for place in places]
    units = [match[match.lastindex or 0].strip() or "m" if match else "m" for match in matches]
    units = [unit for unit in units if not unit.isdigit()]
    return " and ".join(dict.fromkeys(units)) or "m"


def _columns(
    names: Sequence[str], plain: Sequence[str], sample: Floats, numeric: Booleans
) -> list[str]:
    """Return the name in `NAMES` of every column; `_` if unknown or used before."""
    found = [IGNORED] * len(names)

    def name(place: int, word: str) -> None:
        if word not in found and found[place] == IGNORED:
            found[place] = word

    def places(pattern: str) -> list[int]:
        return [at for at, word in enumerate(plain) if re.fullmatch(pattern, word)]

    for place, word in enumerate(plain):
        if match := re.fullmatch(r"(?:.*_)?m_?([123])_?([1-4])", word):
            name(place, f"m{match[1]}{match[2]}")
        if word in _TRIANGLES or word in _TRIANGLES.values():
            name(place, _TRIANGLES.get(word, word))
        elif re.fullmatch(_RECEIVED, word):
            name(place, RECEIVED)
    _name_time(names, plain, places, name, sample)
    _name_covariances(plain, name)
    for group, pattern in _VECTORS.items():
        at = {
            word: places(pattern.format(axis))
            for word, axis in zip(GROUPS[group], "xyzw", strict=False)
        }
        for word, all_at in at.items():
            for place in [each for each in all_at if numeric[each]][:1]:
                if "velocity" not in group or not re.search(_OTHER_SPEED, names[place].lower()):
                    name(place, word)
    for place, word in enumerate(plain):
        match = re.fullmatch(_ANGLE, word)
        if match or (re.fullmatch(_THETA, word) and not places("phi|psi")):
            axis = match[1] if match else "yaw"
            unit = _UNITS.get(word.rpartition("_")[2], "") or _bracket(names[place])
            name(place, f"{axis}_deg" if unit == "deg" else axis)
    level = [places(_FIXES[word]) for word in ("latitude", "longitude")]
    if all(level):
        for word, pattern in _FIXES.items():
            for place in places(pattern)[:1]:
                name(place, word)
        return found
    for (patterns,) in _SETS:
        at = {word: places(pattern) for word, pattern in patterns.items()}
        needed = _NEEDED.get(next(iter(patterns)), set())
        if all(at.values()) and not set(patterns) & set(found) and needed <= set(found):
            for word, all_at in at.items():
                name(all_at[0], word)
    return found


def _bracket(name: str) -> str:
    match = re.search(_UNIT, name)
    return _UNITS.get((match[1] or match[2] or "").strip().lower(), "") if match else ""


def _name_time(names, plain, places, name, sample) -> None:  # type: ignore[no-untyped-def]
    """Name the column of timestamps, preferably of the header; without one, frame numbers."""
    joined = {  # places of nanoseconds, by that of their seconds
        place: part
        for part in places(_NANOSECONDS)
        for place in places(re.sub("(?:nano|n)secs?$", "secs?", plain[part]))
    }
    times = [place for place in places(_TIME) if place not in joined.values()]
    still = [len(sample) > 1 and bool((column == column[0]).all()) for column in sample.T]
    times.sort(key=lambda at: ("header_stamp" not in plain[at], at not in joined, still[at], at))
    for place in times[:1]:
        unit = _bracket(names[place]) or _UNITS.get(plain[place].rpartition("_")[2], "")
        unit = unit or ("us" if plain[place] == "utime" else "")
        name(place, f"t_{unit}" if unit in ("ns", "us", "ms", "s") else "t")
        if place in joined:
            name(joined[place], NANOSEC)
    for place in times[1:]:
        if plain[place] == "receive_time":  # of Foxglove's tables
            name(place, RECEIVED)
    for place in places(_FRAME) if not times else ():
        column = sample[:, place]
        if np.isfinite(column).all() and not (len(column) > 1 and (column == column[0]).all()):
            name(place, "t" if len(column) and column[0] > 1e8 else FRAME)
            break


def _name_covariances(plain, name) -> None:  # type: ignore[no-untyped-def]
    """Name columns of covariances, numbered 0 to 35, 11 to 66 or 00 to 55, or named by axes."""
    numbered = {
        place: f"{match[1]}{match[2] or ''}"
        for place, word in enumerate(plain)
        if (match := re.fullmatch(_COVARIANCE, word))
    }
    digits = set(numbered.values())
    first = 0 if any("0" in each for each in digits) else 1
    for place, number in numbered.items():
        if digits == {str(each) for each in range(36)}:
            row, column = divmod(int(number), 6)
        elif len(number) == 2:
            row, column = int(number[0]) - first, int(number[1]) - first
        else:
            continue
        if row < 6 and column < 6:
            name(place, f"c{row + 1}{column + 1}")
    for place, word in enumerate(plain):
        if match := re.fullmatch(_PAIR, word) or re.fullmatch(_VARIANCE, word):
            row, column = (_AXES.index(match[at]) + 1 for at in (1, match.lastindex or 1))
            name(place, f"c{row}{column}")


def _title(layout: Layout) -> str:
    """Return the name of the format that has these columns."""
    groups = layout.groups
    if "rotation_covariance" in groups:
        return "OpenVINS with covariance"
    if "gyroscope_bias" in groups:
        return "EuRoC/ASL"
    if layout.is_geographic:
        return "latitude, longitude" + (", height" if "place" in groups else "")
    if layout.columns[1:] == ("x", "y", "z", "qx", "qy", "qz", "qw"):
        return "TUM"
    return "columns named by the header"
