"""Names in header lines, translated to those of `names.NAMES`."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.header_words import TIME_NAME, UNIT_OF_WORD, name_and_unit
from trajeval_ros.io.text.layouts import ORDERS, examples, quaternion_in, with_names
from trajeval_ros.io.text.names import (
    CLOCK,
    FRAME,
    GROUPS,
    IGNORED,
    NAMES,
    PARTS,
    RECEIVED,
    ROTATIONS,
    TIME_UNITS,
    TIMES,
    WEEK,
    WEEK_S,
    Layout,
)
from trajeval_ros.io.text.stamps import are_whole, goes_back, goes_forward, is_clock, likely_name
from trajeval_ros.io.text.table import TextTable

# Patterns are compiled on use, since most files have no header.
_OTHER_SPEED = r"[\[(](?!m[ /])[a-z]+ ?(?:/ ?[sh]|s\^?-1)|[\[(]m ?/ ?h"  # not m/s
_LENGTHS = ("m", "mm", "cm", "km")
_NO_UNITS_OF_TIME = r"\d.*|.*s|min|h|d"  # others, such as [utc], do not say how long a step is
_PART_OF_UNIT = {UNIT_OF_WORD[part]: part for part in PARTS if part != WEEK}
_EXACT_TIME = "t|time|timestamp|stamp"  # preferred to times of something, such as track_time
_RECEIVED = "received"
_FRAME = r"frame|frame_?(?:index|number|num|no|id)|index|image|image_id|id|no|num|pose_index"
# Patterns of quantities, and the name that the groups of the match make.
_FRAMES = r"(?:_(?:world|odom|map|device|body|imu|cam(?:era)?|enu|ecef|local|global))*"
_POSITION = (
    r"(?:(?:t|p|pos|position|p_[a-z_]+|ecef_p|trans|loc(?:ation)?|pose)?_?"
    r"|(?:.*_)?(?:position|translation|point|pos)_)([xyz])(?:_?pos)?" + _FRAMES
)
_QUATERNION = (
    r"(?:(?:q|quat|quaternion|orientation|q_[a-z_]+)_?"
    r"|(?:.*_)?(?:orientation|rotation|quaternion|quat|att|attitude)_)([xyzw])" + _FRAMES
)
_PATTERNS = (
    (r"p([rt])(11|12|13|22|23|33)", "p{}{}"),
    (_POSITION, "{}"),
    (_QUATERNION, "q{}"),
    (r"(?:.*_)?twist_linear_([xyz])", "body_v{}"),
    (r"(?:(?:v|vel|velocity|v_[a-z_]+)_?|(?:.*_)?linear_velocity_)([xyz])", "v{}"),
    (r"b_?[wg](?:_[a-z_]+)?_?([xyz])", "bw{}"),
    (r"b_?a(?:_[a-z_]+)?_?([xyz])", "ba{}"),
    (r"(?:.*_)?(roll|pitch|yaw)", "{}"),
)  # fmt: skip
_ANGLES = ("roll", "pitch", "yaw")
_OF_MATRIX = {"x": "m14", "y": "m24", "z": "m34"}  # the same quantities
_POSSIBLE = {  # units of quantities; others have one unit alone
    **dict.fromkeys(("x", "y", "z", *_OF_MATRIX.values()), _LENGTHS),
    **dict.fromkeys(("height", "sigma_east", "sigma_north", "sigma_up"), ("m",)),
    **dict.fromkeys(("latitude", "longitude"), ("deg",)),
    **dict.fromkeys(_ANGLES, ("rad",)),
}
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw", *_ANGLES, *(f"{angle}_deg" for angle in _ANGLES))
_UP = "up|alt|altitude|height|elevation"
# Sets that are used only if all their names are present and no other name is the quantity, with
# the columns that they also need.
_SETS: tuple[tuple[dict[str, str], set[str]], ...] = (
    ({"x": "east(?:ing)?", "y": "north(?:ing)?", "z": f"{_UP}|z"}, set()),
    ({"x": "e(?:_baseline)?", "y": "n(?:_baseline)?", "z": "u(?:_baseline)?"}, set()),
    ({"x": "x_east", "y": "y_north", "z": "z_up"}, set()),
    ({"z": _UP}, {"x", "y"}),
    ({"qw": "w"}, {"qx", "qy", "qz"}),
    ({f"q{axis}": f"(?:rot|r|o)_?{axis}" for axis in "xyzw"}, set()),
    ({"qx": "qi", "qy": "qj", "qz": "qk", "qw": "q[rw]"}, set()),
    ({"roll": "phi", "pitch": "theta", "yaw": "psi"}, set()),
    *(
        ({axis: f"{word}_?{at}" for axis, at in zip("xyz", numbers, strict=True)}, needed)
        for numbers in ("012", "123")
        for word, needed in (("(?:.*_)?(?:position|pos|translation)", set()), ("t", {"m33"}))
    ),
)
_FIXES = {  # used only if both latitude and longitude are present
    "latitude": r"(?:.*_)?(?:lat|latitude)",
    "longitude": r"(?:.*_)?(?:lon|lng|long|longitude)",
    "height": r"(?:.*_)?(?:h|height|elevation|h_ell|ellipsoidal_?height|alt|altitude)"
    r"(?:_ellipsoid)?",
    "sigma_east": r"(?:s|sd|std|sigma)_?(?:e|east|x)",
    "sigma_north": r"(?:s|sd|std|sigma)_?(?:n|north|y)",
    "sigma_up": r"(?:s|sd|std|sigma)_?(?:u|up|z)",
    "fix_status": r"(?:.*_)?(?:fix_?)?status(?:_status)?",
}
_COVARIANCE = r"(?!.*twist)(?:.*_)?(?:c|cov|covariance)_?(\d+)(?:_(\d))?"
_MATRIX = r"(?:.*_)?(?:m|mat|matrix|t|tf|transform|pose|r|rot|rotation)_?([0-4])_?([0-4])"
_AXES = ("x", "y", "z", *_ANGLES)
_AXIS = "|".join(_AXES)
# A covariance of two axes, or the variance of one.
_PAIR = rf"(?:.*_)?(?:(?:cov|covariance)_?({_AXIS})_?|(?:var|variance)_?)({_AXIS})"
_MARGINALS = dict(  # of OpenVINS
    zip(
        ["qrr", "qrp", "qry", "qpp", "qpy", "qyy", "pxx", "pxy", "pxz", "pyy", "pyz", "pzz"],
        (*GROUPS["rotation_covariance"], *GROUPS["position_covariance"]),
        strict=True,
    )
)
# Words of what is no part of a pose: quantities, and labels, which may count or be times.
_END = r"(?:[xyzneu]|\d{1,4})?(?:_.*)?"
_QUANTITIES = (
    r"(?:vel|velocity|speed|twist|linear|angular|ang(?:vel)?|omega|acc|accel(?:eration)?"
    r"|gyro|mag|gravity|wind|force|torque|wrench|temp(?:erature)?|pressure|battery|voltage"
    r"|exposure|gain|cov(?:ar(?:iance)?)?|var(?:iance)?|std(?:dev)?|sigma|sd|sd[neu]+"
    r"|err(?:or)?|residual|rmse|quality|score|confidence|conf|ratio|dop|[hpv]dop|scale|bias|b[agw]"
    r"|distance|dist|length|width|hz|rate|fov|fx|fy|cx|cy)"
)
_QUANTITY = rf"(?:.*_)?{_QUANTITIES}{_END}"
# A position or a rotation of another quantity, such as mag_pos_x; ang_roll is an angle.
_OF_ANOTHER = rf"(?:.*_)?(?!ang_){_QUANTITIES}_(?:[a-z]+_)?(?:[xyzw]|roll|pitch|yaw)"
_LABEL = (
    r"(?:.*_)?(?:id|uid|name|key|seq|counter|topic|type|state|mode|flag|valid|camera|device|label"
    r"|q|num|count|sats?|satellites|ns|nsat|age|status|fix|service|duration|dt|week|seconds"
    r"|v|w|a|b|d|l|marker|mean|tracking|lidar|image|file|path|frame)" + _END
)
_OF_WEEK = r"(?:.*_)?(?:tow|sow)(?:_.*)?"  # seconds of the week of GPS
_WEEK = r"(?:gps_?)?(?:week|wn)(?:_?(?:number|num|no))?"
_COMPASS = r"(?:.*_)?(?:heading|azimuth|course|bearing|track)"
_MOST_NAMES = 100  # in a header of a pose that is no table
_FEWEST_ENTRIES = 9  # of a matrix: those of a rotation


def count_of_pose(names: Sequence[str]) -> int:
    """Return how many names are of a time, a position or a quaternion."""
    plain = [name_and_unit(name)[0] for name in names[:_MOST_NAMES]]
    return sum(
        any(re.fullmatch(pattern, word) for pattern in (TIME_NAME, _POSITION, _QUATERNION))
        for word in plain
    )


@dataclass(frozen=True)
class _Header:
    """The names of the columns of a table."""

    names: Sequence[str]  # as written
    plain: Sequence[str]  # in lower case, without units
    units: Sequence[str]  # "" for columns without
    table: TextTable

    def places(self, pattern: str) -> list[int]:
        """Return the columns whose names a pattern matches."""
        return [at for at, word in enumerate(self.plain) if re.fullmatch(pattern, word)]


def from_header(names: Sequence[str], table: TextTable) -> Layout | None:
    """Return the layout that the names of all columns describe; None if they are no names.

    Raises:
        InputError: A quantity is missing that a column with an unknown name may be.
    """
    plain, units = map(list, zip(*map(name_and_unit, names), strict=True))
    header = _Header(names, plain, units, table)
    columns, rivals = _columns(header)
    layout = Layout("", tuple(columns))
    places = [at for at, name in enumerate(columns) if name in (*_OF_MATRIX, *_OF_MATRIX.values())]
    layout = dataclasses.replace(
        layout, unit=" and ".join(dict.fromkeys(units[place] or "m" for place in places)) or "m"
    )
    known = [
        name != IGNORED or re.fullmatch(f"{_QUANTITY}|{_LABEL}|{_COMPASS}|", word) is not None
        for name, word in zip(columns, plain, strict=True)
    ]
    if set(columns) == {IGNORED} and 2 * sum(known) < len(names):
        return None
    _check(header, columns)
    if rivals:
        place, quantity = next(iter(rivals.items()))
        swapped = [
            rivals.get(at, IGNORED if name in rivals.values() else name)
            for at, name in enumerate(columns)
        ]
        raise InputError(
            f"its header names {names[columns.index(quantity)]!r} and {names[place]!r}, as for "
            f"several bodies; name the columns of one: {{option}} '{layout.named()}' or "
            f"{{option}} '{layout.with_columns(swapped).named()}'"
        )
    unknown = [
        at
        for at, column in enumerate(table.values.T)
        if not known[at] and not _is_constant(column)
    ]
    quantity, complete = _missing(header, layout, unknown)
    if quantity:
        words = ", ".join(repr(names[at][:40]) for at in unknown[:6])
        doubt = f", and the meaning of {words} is unknown" if unknown else ""
        time = likely_name(table.values[:, layout.time or 0]) if layout.time_name == "t" else ""
        options = " or ".join(
            f"{{option}} '{layout.with_columns(example).named(time)[:300]}'"
            for example in complete
        )
        raise InputError(
            f"no column has a name of a {quantity} ({', '.join(names)[:200]}){doubt}; if one is "
            f"there, name the columns: {options}"
        )
    used = {place for places in layout.groups.values() for place in places} | {layout.time}
    ignored = [
        name or f"column {at + 1}"
        for at, name in enumerate(names)
        if at not in used and name != CLOCK
    ]
    note = f"ignored columns: {', '.join(ignored)}" if ignored else ""
    compass = [at for at, word in enumerate(plain) if re.fullmatch(_COMPASS, word)]
    if compass and not layout.is_geographic and set(ROTATIONS).isdisjoint(layout.groups):
        name = names[compass[0]]
        note += f"; {name} may count from north: no rotations are read; name it yaw if not"
    return dataclasses.replace(layout, name=_title(layout), note=note)


def _check(header: _Header, columns: Sequence[str]) -> None:
    """Refuse a unit that a quantity can't have, and text in the place of a position."""
    for name, column, unit in zip(header.names, columns, header.units, strict=True):
        possible = tuple(TIME_UNITS) if column in TIMES else _POSSIBLE.get(column, ())
        is_unit = column not in TIMES or re.fullmatch(_NO_UNITS_OF_TIME, unit)
        if unit and possible and unit not in possible and is_unit:
            raise InputError(
                f"the unit of {name[:40]!r}, {unit!r}, is unknown; convert it to "
                f"{' or '.join(possible)}, and write that unit in the header"
            )
    table = header.table
    for at in np.flatnonzero(table.texts).tolist():
        match = re.fullmatch(_POSITION, header.plain[at])
        if match and match[1] not in columns:
            raise InputError(
                f"line {table.first + 1}, column {at + 1} ({header.names[at][:40]}): "
                f"{table.sample[0][at][:40]!r} is not a number; correct the column"
            )


def _missing(
    header: _Header, layout: Layout, unknown: Sequence[int]
) -> tuple[str, list[list[str]]]:
    """Return the quantity that a column with an unknown name may be, "" if all is known.

    With it, names of all columns as examples, the quantity included.
    """
    columns, plain, units, table = list(layout.columns), header.plain, header.units, header.table
    if not layout.has_places:
        return "position", examples(table, columns)
    is_unpaired = layout.time_name in ("", FRAME)
    clocks = [
        at
        for at, column in enumerate(table.values.T)
        if is_unpaired
        and columns[at] == IGNORED
        and units[at] in ("", *TIME_UNITS)
        and not re.fullmatch(_QUANTITY, plain[at])
        and is_clock(column)
    ]
    if clocks:
        columns = [IGNORED if name == FRAME else name for name in columns]
        words = [
            units[clocks[0]],
            *(UNIT_OF_WORD.get(word) for word in plain[clocks[0]].split("_")),
        ]
        unit = next((word for word in words if word in TIME_UNITS), "")
        columns[clocks[0]] = f"t_{unit}".rstrip("_")
        return "time", [columns]
    if "planar" in layout.groups and unknown:
        columns[unknown[0]] = "z"
        return "height", [columns]
    has_rotation = not {"matrix", *ROTATIONS}.isdisjoint(layout.groups)
    four = quaternion_in(table, range(len(columns)))
    if four and not layout.is_geographic and not has_rotation:
        return "rotation", [with_names(columns, four, order) for order in ORDERS]
    return "", []


def _is_constant(column: Floats) -> bool:
    finite = column[np.isfinite(column)]
    return len(column) > 1 and bool((finite == finite[:1]).all())


def _columns(header: _Header) -> tuple[list[str], dict[int, str]]:
    """Return the name in `NAMES` of every column, `_` if unknown or used before.

    With it, columns that have an equal claim to the name of another, by index. The shortest name
    wins: `x` is no rival of `target_x`, but `a_x` is one of `b_x`.
    """
    plain, units, places = header.plain, header.units, header.places
    columns = [IGNORED] * len(plain)
    rivals: dict[int, str] = {}

    def name(place: int, word: str) -> None:
        if word not in columns and columns[place] == IGNORED:
            columns[place] = word

    for place in places(_RECEIVED):
        name(place, RECEIVED)
    _name_time(header, name)
    for place, word in _entries(plain).items():
        name(place, word)
    theta_is_yaw = not places("phi|psi")
    is_global = ["ecef" in word for word in plain]  # next to the same in a local frame (Aria)
    by_length = sorted(range(len(plain)), key=lambda at: (is_global[at], len(plain[at])))
    for pattern, template in _PATTERNS:
        for place in by_length:
            word = re.sub(r"\Atheta", "yaw", plain[place]) if theta_is_yaw else plain[place]
            match = re.fullmatch(pattern, word)
            if match is None or header.table.texts[place]:
                continue
            quantity = template.format(*match.groups())
            if quantity in _ANGLES and units[place] == "deg":
                quantity += "_deg"
            if quantity in _POSE and re.fullmatch(_OF_ANOTHER, word):
                continue
            if "v" in quantity and (
                units[place] in (*TIME_UNITS, *_LENGTHS)
                or re.search(_OTHER_SPEED, header.names[place].lower())
            ):
                continue
            name(place, quantity)
            if columns[place] == IGNORED and quantity in _POSE and quantity not in rivals.values():
                chosen = columns.index(quantity)
                is_same = plain[chosen] == plain[place] and units[chosen] != units[place]
                is_longer = plain[place].endswith(f"_{plain[chosen]}")
                if not (is_same or is_longer or is_global[chosen] != is_global[place]):
                    rivals[place] = quantity
    if places(_FIXES["latitude"]) and places(_FIXES["longitude"]):
        for word, pattern in _FIXES.items():
            for place in places(pattern)[:1]:
                name(place, word)
        return columns, {}
    for patterns, needed in _SETS:
        at = {word: places(pattern) for word, pattern in patterns.items()}
        if all(at.values()) and not set(patterns) & set(columns) and needed <= set(columns):
            for word, all_at in at.items():
                name(all_at[0], word)
    if "m33" in columns and "m34" not in columns and not rivals:  # with a position of its own
        columns = [_OF_MATRIX.get(word, word) for word in columns]
    return columns, rivals


def _name_time(header: _Header, name: Callable[[int, str], None]) -> None:
    """Name the column of timestamps, preferably of the header; without one, frame numbers."""
    plain, units, sample = header.plain, header.units, header.table.values
    clocks = list(map(goes_forward, sample.T))
    times = [
        at
        for at in header.places(TIME_NAME)
        if header.table.texts[at]
        or "header_stamp" in plain[at]
        or re.fullmatch(_EXACT_TIME, plain[at])
        or not goes_back(sample[:, at])  # as time differences do
    ]
    times += [
        at for at, word in enumerate(plain) if clocks[at] and UNIT_OF_WORD.get(word) in TIME_UNITS
    ]
    stems = ["" if word in UNIT_OF_WORD else word for word in plain]
    seconds = {
        stems[at]: at
        for at, column in enumerate(sample.T)
        if units[at] == "s" and 2 * np.sum(column == np.round(column)) >= len(column)
    }
    joined = {  # columns of the parts of whole seconds, by that of the seconds
        seconds[stems[at]]: at
        for at, column in enumerate(sample.T)
        if units[at] in _PART_OF_UNIT
        and stems[at] in seconds
        and 2 * np.sum(are_whole(column, PARTS[_PART_OF_UNIT[units[at]]][1])) >= len(column)
    }
    times = sorted(
        {*times, *joined} - {*joined.values()},
        key=lambda at: (
            "header_stamp" not in plain[at],
            at not in joined,
            not (clocks[at] or header.table.texts[at]),
            not re.fullmatch(_EXACT_TIME, plain[at]),
            at,
        ),
    )
    for place in times[:1]:
        unit = _unit_of_time(header, place, name)
        name(place, f"t_{unit}" if unit in TIME_UNITS else "t")
        if place in joined:
            name(joined[place], _PART_OF_UNIT[units[joined[place]]])
    for place in times[1:]:
        if plain[place] == "receive_time":  # of Foxglove's tables
            name(place, RECEIVED)
    for place in header.places(_FRAME) if not times else ():
        if np.isfinite(sample[:, place]).all() and not _is_constant(sample[:, place]):
            name(place, "t" if len(sample) and sample[0, place] > 1e8 else FRAME)
            break


def _unit_of_time(header: _Header, place: int, name: Callable[[int, str], None]) -> str:
    """Return the unit of a time, "" if unknown; if it is of the week of GPS, name the week."""
    unit, weeks = header.units[place], header.places(_WEEK)
    if weeks or re.fullmatch(_OF_WEEK, header.plain[place]):
        latest = np.nanmax(header.table.values[:, place], initial=0.0)
        unit = unit or ("s" if latest <= WEEK_S else "ms")
        if unit in TIME_UNITS and latest * TIME_UNITS[unit] <= WEEK_S * TIME_UNITS["s"]:
            for week in weeks:
                name(week, WEEK)
        else:
            unit = header.units[place]
    return unit


def _entries(plain: Sequence[str]) -> dict[int, str]:
    """Return names of the entries of covariances and of a matrix by column.

    Covariances are numbered (0 to 35, 11 to 66 or 00 to 55), named by axes, or of OpenVINS.
    Matrices are numbered from 11 or from 00.
    """
    named: dict[int, str] = {}
    numbers: dict[str, dict[int, str]] = {"c": {}, "m": {}}
    for place, word in enumerate(plain):
        if match := re.fullmatch(_COVARIANCE, word):
            numbers["c"][place] = f"{match[1]}{match[2] or ''}"
        elif match := re.fullmatch(_PAIR, word):
            row, column = _AXES.index(match[1] or match[2]), _AXES.index(match[2])
            named[place] = f"c{row + 1}{column + 1}"
        elif word in _MARGINALS:
            named[place] = _MARGINALS[word]
        elif match := re.fullmatch(_MATRIX, word):
            numbers["m"][place] = match[1] + match[2]
    if len(numbers["m"]) < _FEWEST_ENTRIES:
        del numbers["m"]
    for letter, digits_of in numbers.items():
        counted = set(digits_of.values()) == set(map(str, range(36)))
        first = 0 if any("0" in digits for digits in digits_of.values()) else 1
        for place, digits in digits_of.items():
            if counted or len(digits) == 2:
                both = divmod(int(digits), 6) if counted else (int(at) - first for at in digits)
                word = letter + "".join(str(at + 1) for at in both)
                named[place] = word if word in NAMES else IGNORED
    return named


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
