"""Translation of column names in header lines to the names in `layouts.NAMES`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from trajeval_ros.io.text.layouts import (
    FRAME,
    GROUPS,
    IGNORED,
    NANOSEC,
    OPENVINS_STATE,
    RECEIVED,
    Layout,
)

SEPARATORS = (",", ";", "\t")  # single separators of columns; spaces separate in any number
# Patterns are compiled on use, since most files have no header.
_UNIT = r"\[([^\[\]]*)\]|\(([^()]*)\)"
_WORDS = r"[^a-z0-9]+"
_UNITS = {
    **dict.fromkeys(("ns", "nsec", "nanosec", "nanoseconds"), "ns"),
    **dict.fromkeys(("us", "usec", "microseconds"), "us"),
    **dict.fromkeys(("ms", "msec", "milliseconds"), "ms"),
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
}
_OTHER_SPEED = r"[\[(](?!m[ /])[a-z]+ ?(?:/ ?[sh]|s\^?-1)|[\[(]m ?/ ?h"  # not m/s
_POSITION_UNIT = rf"{_UNIT}|[^a-z0-9](mm|cm|k?m)$"
_TIME = (
    r"(?:t(?:_(?:s|ms|us|ns))?|secs?|time.*|stamp.*"
    r"|(?:.*_)?(?:time|timestamp|stamp|date|datetime|utc)(?:_.*)?)"
)
_NANOSECONDS = r"(?:.*_)?(?:nano|n)secs?"  # of a timestamp of ROS, next to its seconds
_RECEIVED = r"received(?:_(?:s|ms|us|ns))?"
_FRAME = r"frame|frame_(?:index|number)|index|image|image_id|id|no"
# Patterns of column names by group. `{}` is the element: x, y, z or w.
_VECTORS = {
    "position": r"(?:(?:t|p|pos|position|p_[a-z_]+)?_?"
    r"|(?:.*_)?(?:position|translation|point|pos)_){}(?:_(mm|cm|m|km))?",
    "quaternion": r"(?:(?:q|quat|quaternion|orientation|q_[a-z_]+)_?"
    r"|(?:.*_)?(?:orientation|rotation|quaternion|quat)_){}",
    "body_velocity": r"(?:.*_)?twist_linear_{}",
    "velocity": r"(?:(?:v|vel|velocity|v_[a-z_]+)_?|(?:.*_)?linear_velocity_){}",
    "gyroscope_bias": r"b_?[wg](?:_[a-z_]+)?_?{}",
    "accelerometer_bias": r"b_?a(?:_[a-z_]+)?_?{}",
}
_ANGLE = r"(?:.*_)?(roll|pitch|yaw)(?:_(deg|degrees|rad|radians))?"
_THETA = r"theta(?:_(deg|degrees|rad|radians))?"
_COVARIANCE = r"(?!.*twist)(?:.*_)?(?:c|cov|covariance)_?(\d+)(?:_(\d))?"
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")
_AXIS = "|".join(_AXES)
_VARIANCE = rf"(?:.*_)?(?:var|variance)_?({_AXIS})"
_PAIR = rf"(?:.*_)?(?:cov|covariance)_?({_AXIS})_?({_AXIS})"
_OPENVINS_TRIANGLES = {
    "pr11": "pr11", "pr12": "pr12", "pr13": "pr13", "pr22": "pr22", "pr23": "pr23", "pr33": "pr33",
    "pt11": "pt11", "pt12": "pt12", "pt13": "pt13", "pt22": "pt22", "pt23": "pt23", "pt33": "pt33",
    "qrr": "pr11", "qrp": "pr12", "qry": "pr13", "qpp": "pr22", "qpy": "pr23", "qyy": "pr33",
    "pxx": "pt11", "pxy": "pt12", "pxz": "pt13", "pyy": "pt22", "pyz": "pt23", "pzz": "pt33",
}  # fmt: skip
# Names of GNSS fixes, used only if both latitude and longitude are present.
_FIXES = {
    "latitude": r"(?:lat|latitude)(?:_?deg)?",
    "longitude": r"(?:lon|lng|long|longitude)(?:_?deg)?",
    "height": r"(?:h|height|alt|altitude|ellipsoidal_?height|elevation)(?:_?m)?",
    "sigma_east": r"(?:s|sd|std|sigma)_?(?:e|east|x)(?:_?m)?",
    "sigma_north": r"(?:s|sd|std|sigma)_?(?:n|north|y)(?:_?m)?",
    "sigma_up": r"(?:s|sd|std|sigma)_?(?:u|up|z)(?:_?m)?",
    "fix_status": r"(?:fix_?)?status(?:_status)?",
}
# OpenVINS writes one name per vector: quaternion (xyzw), position, velocity, biases.
_OPENVINS = r"\bq p v bg ba\b"
_TRAJECTOPY = r"\A#?\s*fields\s+"


def separator_of(line: str) -> str:
    """Return the separator of a line: a comma, a semicolon, a tab, or "" for spaces."""
    return next((each for each in SEPARATORS if each in line), "")


def from_header(line: str, columns: int) -> Layout | None:
    """Return the layout that a header line describes; None if it names no position.

    Also None if the number of names is not `columns`.
    """
    plain = re.sub(_TRAJECTOPY, "", line)
    if re.search(_OPENVINS, re.sub(_UNIT, "", plain).lower()) and columns >= len(
        OPENVINS_STATE.columns
    ):
        rest = (IGNORED,) * (columns - len(OPENVINS_STATE.columns))
        return Layout(OPENVINS_STATE.name, (*OPENVINS_STATE.columns, *rest))
    separator = separator_of(plain)
    if not separator:  # a unit after a space belongs to the name before it
        plain = re.sub(rf"\s+(?={_UNIT})", "", plain)
    names = [each.strip() for each in plain.split(separator or None)]
    if names and not names[-1]:
        names.pop()
    if len(names) != columns:
        return None
    found = _columns(names)
    layout = Layout("", found)
    groups = layout.groups
    if not layout.has_places:
        return None
    used = {place for places in groups.values() for place in places} | {layout.time}
    ignored = [
        name or f"column {place + 1}" for place, name in enumerate(names) if place not in used
    ]
    note = f"ignored columns: {', '.join(ignored)}" if ignored else ""
    return Layout(_title(layout, line), found, note, unit=_position_unit(names, layout))


def _position_unit(names: Sequence[str], layout: Layout) -> str:
    """Return the unit in brackets, or at the end, of the names of positions."""
    places = layout.groups.get("position") or layout.groups.get("planar", ())
    matches = [re.search(_POSITION_UNIT, names[place].lower()) for place in places]
    units = [match[match.lastindex or 0].strip() or "m" if match else "m" for match in matches]
    return " and ".join(dict.fromkeys(units)) or "m"


def _columns(names: Sequence[str]) -> tuple[str, ...]:
    """Return the name in `layouts.NAMES` of every column; `_` if unknown or used before."""
    plain = [re.sub(_WORDS, "_", re.sub(_UNIT, "", name).lower()).strip("_") for name in names]
    units = [_unit(name) for name in names]
    found = [IGNORED] * len(names)

    def name(place: int, word: str) -> None:
        if word not in found and found[place] == IGNORED:
            found[place] = word

    for place, word in enumerate(plain):
        if word in _OPENVINS_TRIANGLES:
            name(place, _OPENVINS_TRIANGLES[word])
        elif re.fullmatch(_RECEIVED, word):
            name(place, RECEIVED)
    _name_time(plain, units, name)
    _name_covariances(plain, name)
    for group, pattern in _VECTORS.items():
        for word, element in zip(GROUPS[group], "xyzw", strict=False):
            for place in _places(plain, pattern.format(element))[:1]:
                if "velocity" not in group or not re.search(_OTHER_SPEED, names[place].lower()):
                    name(place, word)
    for place, word in enumerate(plain):
        match = re.fullmatch(_ANGLE, word) or re.fullmatch(_THETA, word)
        if match:
            axis = match[1] if match.re.pattern == _ANGLE else "yaw"
            unit = _UNITS.get(match[match.lastindex or 1] or "", "") or units[place]
            name(place, f"{axis}_deg" if unit == "deg" else axis)
    _name_fixes(plain, name)
    return tuple(found)


def _places(plain: Sequence[str], pattern: str) -> list[int]:
    return [place for place, word in enumerate(plain) if re.fullmatch(pattern, word)]


def _unit(name: str) -> str:
    match = re.search(_UNIT, name)
    return _UNITS.get((match[1] or match[2] or "").strip().lower(), "") if match else ""


def _name_time(
    plain: Sequence[str], units: Sequence[str], name: Callable[[int, str], None]
) -> None:
    """Name the column of timestamps, preferably of the header; without one, frame numbers."""
    joined = {  # places of nanoseconds, by that of their seconds
        place: part
        for part in _places(plain, _NANOSECONDS)
        for place in _places(plain, re.sub("(?:nano|n)secs?$", "secs?", plain[part]))
    }
    times = [place for place in _places(plain, _TIME) if place not in joined.values()]
    times.sort(key=lambda at: ("header_stamp" not in plain[at], at not in joined, at))
    for place in times[:1]:
        unit = units[place] or _UNITS.get(plain[place].rpartition("_")[2], "")
        name(place, f"t_{unit}" if unit in ("ns", "us", "ms", "s") else "t")
        if place in joined:
            name(joined[place], NANOSEC)
    for place in times[1:]:
        if plain[place] == "receive_time":  # of Foxglove's tables
            name(place, RECEIVED)
    if not times:
        for place in _places(plain, _FRAME)[:1]:
            name(place, FRAME)


def _name_fixes(plain: Sequence[str], name: Callable[[int, str], None]) -> None:
    """Name the columns of GNSS fixes, if latitude and longitude are present."""
    places = {word: _places(plain, pattern) for word, pattern in _FIXES.items()}
    if places["latitude"] and places["longitude"]:
        for word, at in places.items():
            for place in at[:1]:
                name(place, word)


def _name_covariances(plain: Sequence[str], name: Callable[[int, str], None]) -> None:
    """Name columns of covariances, numbered 0 to 35, 11 to 66 or 00 to 55, or named by axes."""
    numbered = {
        place: f"{match[1]}{match[2] or ''}"
        for place, word in enumerate(plain)
        if (match := re.fullmatch(_COVARIANCE, word))
    }
    digits = set(numbered.values())
    row_major = digits == {str(each) for each in range(36)}
    first = 0 if any("0" in each for each in digits) else 1
    for place, number in numbered.items():
        if row_major:
            row, column = divmod(int(number), 6)
        elif len(number) == 2:
            row, column = int(number[0]) - first, int(number[1]) - first
        else:
            continue
        if row < 6 and column < 6:
            name(place, f"c{row + 1}{column + 1}")
    for place, word in enumerate(plain):
        if match := re.fullmatch(_PAIR, word):
            name(place, f"c{_AXES.index(match[1]) + 1}{_AXES.index(match[2]) + 1}")
        elif match := re.fullmatch(_VARIANCE, word):
            name(place, f"c{_AXES.index(match[1]) + 1}{_AXES.index(match[1]) + 1}")


def _title(layout: Layout, line: str) -> str:
    """Return the name of the format that has these columns."""
    groups = layout.groups
    if re.match(_TRAJECTOPY, line):
        return "trajectopy"
    if "rotation_covariance" in groups:
        return "OpenVINS with covariance"
    if "gyroscope_bias" in groups:
        return "EuRoC/ASL"
    if layout.is_geographic:
        return "latitude, longitude" + (", height" if "place" in groups else "")
    if layout.columns[1:] == ("x", "y", "z", "qx", "qy", "qz", "qw"):
        return "TUM"
    return "columns named by the header"
