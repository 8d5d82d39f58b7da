"""Names in header lines, translated to those of `names.NAMES`."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.io.text.names import (
    CLOCK,
    FRAME,
    GROUPS,
    IGNORED,
    NANOSEC,
    RECEIVED,
    ROTATIONS,
    Layout,
    with_pose,
)
from trajeval_ros.io.text.stamps import is_clock, may_be_time

# Patterns are compiled on use, since most files have no header.
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
# Sets that are used only if all their names are present and no other name is the quantity, with
# the columns that they also need.
_SETS: tuple[tuple[dict[str, str], set[str]], ...] = (
    ({"x": "east(?:ing)?(?:_m)?", "y": "north(?:ing)?(?:_m)?", "z": f"{_UP}|z"}, set()),
    ({"x": "e", "y": "n", "z": "u"}, set()),
    ({"x": "x_east", "y": "y_north", "z": "z_up"}, set()),
    ({"z": _UP}, {"x", "y"}),
    ({"qw": "w"}, {"qx", "qy", "qz"}),
    ({f"q{axis}": f"(?:rot|r|o)_?{axis}" for axis in "xyzw"}, set()),
    ({"qx": "qi", "qy": "qj", "qz": "qk", "qw": "q[rw]"}, set()),
    ({"roll": "phi", "pitch": "theta", "yaw": "psi"}, set()),
)
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
# Words of what is no part of a pose: quantities, and labels, which may count or be times.
_END = r"(?:[xyzneu]|\d{1,4})?(?:_.*)?"
_QUANTITY = (
    r"(?:.*_)?(?:vel|velocity|speed|twist|linear|angular|ang(?:vel)?|omega|acc|accel(?:eration)?"
    r"|gyro|mag|gravity|wind|force|torque|wrench|temp(?:erature)?|pressure|battery|voltage"
    r"|exposure|gain|cov(?:ar(?:iance)?)?|var(?:iance)?|std(?:dev)?|sigma|sd|sd[neu]+"
    r"|err(?:or)?|residual|rmse|quality|score|confidence|conf|ratio|dop|[hpv]dop|scale|bias|b[agw]"
    r"|distance|dist|length|width|hz|rate|fov|fx|fy|cx|cy)" + _END
)
_LABEL = (
    r"(?:.*_)?(?:id|uid|name|key|seq|counter|topic|type|state|mode|flag|valid|camera|device|label"
    r"|q|num|count|sats?|satellites|ns|nsat|age|status|fix|service|duration|dt|week|seconds"
    r"|v|w|a|b|d|l|marker|mean|tracking|lidar|image|file|path|frame)" + _END
)
_COMPASS = r"(?:.*_)?(?:heading|azimuth|course|bearing|track)(?:_deg)?"


_LONGEST_NAME = 80  # characters: patterns need quadratic time for longer ones


def split_header(line: str, separator: str) -> list[str]:
    """Return the names in a header line."""
    line = re.sub(r"\A[#%\s]*(?:fields\s+)?", "", line)
    line = line.encode("latin-1", "replace").decode("utf-8", "replace")
    if not separator:  # a unit after a space belongs to the name before it
        line = re.sub(rf" (?={_UNIT})", "", " ".join(line.split()))  # runs of spaces are slow
    names = [name.strip(" \"'\t\r\n") for name in line.split(separator or None)]
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
    columns = _columns(names, plain, sample, ~texts)
    known = [
        name != IGNORED
        or bool(re.fullmatch(f"{_QUANTITY}|{_LABEL}|{_COMPASS}", plain[at]))
        or not plain[at]
        for at, name in enumerate(columns)
    ]
    layout = Layout("", tuple(columns))
    used = {place for places in layout.groups.values() for place in places} | {layout.time}
    varies = np.array([np.unique(column[np.isfinite(column)]).size > 1 for column in sample.T])
    unknown = [
        at for at, is_known in enumerate(known) if not is_known and (varies[at] or len(sample) < 2)
    ]
    if not any(name != IGNORED for name in columns) and 2 * sum(known) < len(names):
        return None
    unit = re.search(_UNIT, names[layout.time]) if layout.time is not None else None
    named_unit = (unit[1] or unit[2] or "").strip().lower() if unit else ""
    if (
        named_unit
        and named_unit not in _UNITS
        and layout.time_name == "t"
        and re.search(r"\d|s$|\A(?:min|minutes?|h|hours?|d|days?)\Z", named_unit)
    ):
        raise InputError(
            f"the unit of the time, {named_unit!r}, is unknown; convert it to s, ms, us or ns, "
            "and write that unit in the header"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        quantity = _missing(layout, unknown, sample, plain)
    if quantity:
        words = ", ".join(repr(names[at][:40]) for at in unknown[:6])
        doubt = f", and the meaning of {words} is unknown" if unknown else ""
        options = " or ".join(
            f"{{option}} '{' '.join(example)[:300]}'"
            for example in _examples(quantity, layout, unknown, sample, plain, texts)
        )
        raise InputError(
            f"no column has a name of a {quantity} ({', '.join(names)[:200]}){doubt}; if one is "
            f"there, name the columns: {options}"
        )
    ignored = [
        name or f"column {at + 1}"
        for at, name in enumerate(names)
        if at not in used and name != CLOCK
    ]
    note = f"ignored columns: {', '.join(ignored)}" if ignored else ""
    if not layout.is_geographic and set(ROTATIONS).isdisjoint(layout.groups):
        compass = [
            name for name, word in zip(names, plain, strict=True) if re.fullmatch(_COMPASS, word)
        ]
        if compass:
            note += (
                f"; {compass[0]} may count from north: no rotations are read; name it yaw if not"
            )
    return Layout(_title(layout), tuple(columns), note, unit=_unit_of(names, layout))


def _missing(layout: Layout, unknown: Sequence[int], sample: Floats, plain: Sequence[str]) -> str:
    """Return the quantity that a column with an unknown name may be, "" if all is known."""
    if not layout.has_places:
        return "position"
    if _clock_of(layout, sample, plain) is not None:
        return "time"
    if "planar" in layout.groups and unknown:
        return "height"
    if not layout.is_geographic and set(ROTATIONS).isdisjoint(layout.groups):
        return "" if _unit_of_four(sample) is None else "rotation"
    return ""


def _unit_of_four(sample: Floats) -> int | None:
    """Return the first of four neighbouring columns of unit length, which may be a quaternion."""
    for at in range(sample.shape[1] - 3):
        lengths = np.linalg.norm(sample[:, at : at + 4], axis=1)
        if len(lengths) and (np.abs(lengths - 1.0) < 1e-2).all():
            return at
    return None


def _examples(
    quantity: str,
    layout: Layout,
    unknown: Sequence[int],
    sample: Floats,
    plain: Sequence[str],
    texts: Booleans,
) -> list[list[str]]:
    """Return names of all columns, `quantity` included, where it may be."""
    columns = list(layout.columns)
    if quantity == "height":
        columns[unknown[0]] = "z"
    elif quantity == "rotation":
        four = _unit_of_four(sample) or 0
        quaternions = ("qx", "qy", "qz", "qw"), ("qw", "qx", "qy", "qz")
        return [[*columns[:four], *names, *columns[four + 4 :]] for names in quaternions]
    elif quantity == "time":
        columns = [IGNORED if name == FRAME else name for name in columns]
        columns[_clock_of(layout, sample, plain) or 0] = "t"
    else:
        places = [at for at in np.flatnonzero(~texts).tolist() if at != layout.time]
        if layout.time is None and places and may_be_time(sample[:, places[0]], len(columns)):
            columns[places.pop(0)] = "t"
        columns = with_pose(columns, places)
    return [columns]


def _clock_of(layout: Layout, sample: Floats, plain: Sequence[str]) -> int | None:
    """Return the first ignored column that may be the time, if rows are paired by number."""
    places = range(len(plain)) if layout.time_name in ("", FRAME) else ()
    ignored = (
        at
        for at in places
        if layout.columns[at] == IGNORED and not re.fullmatch(_QUANTITY, plain[at])
    )
    return next((at for at in ignored if is_clock(sample[:, at])), None)


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
    columns = [IGNORED] * len(names)

    def name(place: int, word: str) -> None:
        if word not in columns and columns[place] == IGNORED:
            columns[place] = word

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
            for place in [at for at in all_at if numeric[at]][:1]:
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
        return columns
    for patterns, needed in _SETS:
        at = {word: places(pattern) for word, pattern in patterns.items()}
        if all(at.values()) and not set(patterns) & set(columns) and needed <= set(columns):
            for word, all_at in at.items():
                name(all_at[0], word)
    return columns


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
    first = 0 if any("0" in digit for digit in digits) else 1
    for place, number in numbered.items():
        if digits == {str(number) for number in range(36)}:
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
