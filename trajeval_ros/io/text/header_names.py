"""Names in header lines, translated to those of `names.NAMES`."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.io.text.layouts import example_for
from trajeval_ros.io.text.names import (
    CLOCK,
    FRAME,
    GROUPS,
    IGNORED,
    NANOSEC,
    RECEIVED,
    ROTATIONS,
    Layout,
)
from trajeval_ros.io.text.stamps import is_clock
from trajeval_ros.io.text.table import TextTable

# Patterns are compiled on use, since most files have no header.
_UNIT = r"\[([^\[\]]*)\]|\(([^()]*)\)"
_UNITS = {
    word: unit
    for unit, words in {
        "ns": "ns nsec nsecs nanosec nanosecs nanoseconds",
        "us": "us usec usecs microseconds micros",
        "ms": "ms msec msecs milliseconds millis",
        "s": "s sec secs seconds",
        "deg": "deg degree degrees °",
        "rad": "rad radian radians",
    }.items()
    for word in words.split()
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
# Patterns of quantities, and the name that the groups of the match make.
_FRAMES = r"(?:_(?:world|odom|map|device|body|imu|cam(?:era)?|enu|ecef|local|global))*"
_PATTERNS = (
    (r"(?:.*_)?m_?([123])_?([1-4])", "m{}{}"),
    (r"p([rt])(11|12|13|22|23|33)", "p{}{}"),
    (r"(?:(?:t|p|pos|position|p_[a-z_]+|ecef_p|trans|loc(?:ation)?|pose)?_?"
     r"|(?:.*_)?(?:position|translation|point|pos)_)([xyz])(?:_?pos)?" + _FRAMES
     + r"(?:_(?:mm|cm|m|km))?", "{}"),
    (r"(?:(?:q|quat|quaternion|orientation|q_[a-z_]+)_?"
     r"|(?:.*_)?(?:orientation|rotation|quaternion|quat)_)([xyzw])" + _FRAMES, "q{}"),
    (r"(?:.*_)?twist_linear_([xyz])", "body_v{}"),
    (r"(?:(?:v|vel|velocity|v_[a-z_]+)_?|(?:.*_)?linear_velocity_)([xyz])", "v{}"),
    (r"b_?[wg](?:_[a-z_]+)?_?([xyz])", "bw{}"),
    (r"b_?a(?:_[a-z_]+)?_?([xyz])", "ba{}"),
    (r"(?:.*_)?(roll|pitch|yaw)(?:_(?:deg|degrees|rad|radians))?", "{}"),
)  # fmt: skip
_ANGLES = ("roll", "pitch", "yaw")
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
_FIXES = {  # used only if both latitude and longitude are present
    "latitude": r"(?:.*_)?(?:lat|latitude)(?:_?deg)?",
    "longitude": r"(?:.*_)?(?:lon|lng|long|longitude)(?:_?deg)?",
    "height": r"(?:.*_)?(?:h|height|alt|altitude|ellipsoidal_?height|elevation|h_ell)(?:_?m)?",
    "sigma_east": r"(?:s|sd|std|sigma)_?(?:e|east|x)(?:_?m)?",
    "sigma_north": r"(?:s|sd|std|sigma)_?(?:n|north|y)(?:_?m)?",
    "sigma_up": r"(?:s|sd|std|sigma)_?(?:u|up|z)(?:_?m)?",
    "fix_status": r"(?:.*_)?(?:fix_?)?status(?:_status)?",
}
_COVARIANCE = r"(?!.*twist)(?:.*_)?(?:c|cov|covariance)_?(\d+)(?:_(\d))?"
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
    return [name.strip(" \"'\t\r\n") for name in line.split(separator or None)]


def plain_of(name: str) -> str:
    """Return a name in lower case, with _ between its words and without its unit."""
    name = name[: 2 * _LONGEST_NAME]
    name = re.sub(r"\A[^(]*\(\s*(?=\w+\Z)", "", re.sub(r"\s*\)\Z(?<!\()", ")", name))
    name = name[:-1] if name.endswith(")") and "(" not in name else name
    name = re.sub(r"\[(\d)\]", r"_\1", name)
    name = re.sub(r"(?<=[a-z])(?=(?:[A-Z][a-z]|Ns|Us|Ms)[a-z]*)|(?<=[A-Z])(?=Time\b)", "_", name)
    return re.sub(r"[^a-z0-9]+", "_", re.sub(_UNIT, "", name).lower()).strip("_")[:_LONGEST_NAME]


def from_header(names: Sequence[str], table: TextTable) -> Layout | None:
    """Return the layout that the names of all columns describe; None if they are no names.

    Raises:
        InputError: A quantity is missing that a column with an unknown name may be.
    """
    plain = [plain_of(name) for name in names]
    columns = _columns(names, plain, table.values, ~table.texts)
    layout = Layout("", tuple(columns))
    known = [
        name != IGNORED or re.fullmatch(f"{_QUANTITY}|{_LABEL}|{_COMPASS}|", word) is not None
        for name, word in zip(columns, plain, strict=True)
    ]
    if set(columns) == {IGNORED} and 2 * sum(known) < len(names):
        return None
    time_unit = _bracket(names[layout.time or 0]) if layout.time_name == "t" else ""
    if time_unit not in _UNITS and re.search(
        r"\d|s$|\A(?:min|minutes?|h|hours?|d|days?)\Z", time_unit
    ):
        raise InputError(
            f"the unit of the time, {time_unit!r}, is unknown; convert it to s, ms, us or ns, "
            "and write that unit in the header"
        )
    unknown = [
        at
        for at, column in enumerate(table.values.T)
        if not known[at] and not _is_constant(column)
    ]
    quantity, examples = _missing(layout, unknown, table, plain)
    if quantity:
        words = ", ".join(repr(names[at][:40]) for at in unknown[:6])
        doubt = f", and the meaning of {words} is unknown" if unknown else ""
        options = " or ".join(f"{{option}} '{example[:300]}'" for example in examples)
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
    return Layout(_title(layout), tuple(columns), note, unit=_unit_of(names, layout))


def _missing(
    layout: Layout, unknown: Sequence[int], table: TextTable, plain: Sequence[str]
) -> tuple[str, list[str]]:
    """Return the quantity that a column with an unknown name may be, "" if all is known.

    With it, names of all columns as examples, the quantity included.
    """
    columns = list(layout.columns)
    has_rotation = not set(ROTATIONS).isdisjoint(layout.groups)
    is_unpaired = layout.time_name in ("", FRAME)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        clocks = [
            at
            for at, column in enumerate(table.values.T)
            if is_unpaired
            and columns[at] == IGNORED
            and not re.fullmatch(_QUANTITY, plain[at])
            and is_clock(column)
        ]
        lengths = [
            np.linalg.norm(table.values[:, at : at + 4], axis=1) for at in range(len(columns) - 3)
        ]
    if not layout.has_places:
        return "position", [example_for(table, columns)]
    if clocks:
        columns = [IGNORED if name == FRAME else name for name in columns]
        columns[clocks[0]] = "t"
        return "time", [" ".join(columns)]
    if "planar" in layout.groups and unknown:
        columns[unknown[0]] = "z"
        return "height", [" ".join(columns)]
    four = [at for at, length in enumerate(lengths) if (np.abs(length - 1.0) < 1e-2).all()]
    if not layout.is_geographic and not has_rotation and four:  # neighbours of unit length
        before, after = columns[: four[0]], columns[four[0] + 4 :]
        orders = "qx qy qz qw", "qw qx qy qz"
        return "rotation", [" ".join([*before, order, *after]) for order in orders]
    return "", []


def _unit_of(names: Sequence[str], layout: Layout) -> str:
    """Return the unit in brackets, or at the end, of the names of positions."""
    places = layout.groups.get("position") or layout.groups.get("planar", ())
    matches = [re.search(_LENGTH, names[place].lower()) for place in places]
    units = [match[match.lastindex or 0].strip() or "m" if match else "m" for match in matches]
    return " and ".join(dict.fromkeys(unit for unit in units if not unit.isdigit())) or "m"


def _is_constant(column: Floats) -> bool:
    finite = column[np.isfinite(column)]
    return len(column) > 1 and bool((finite == finite[:1]).all())


def _bracket(name: str) -> str:
    """Return the words in the brackets of a name, in lower case."""
    match = re.search(_UNIT, name)
    return (match[1] or match[2] or "").strip().lower() if match else ""


def _unit(name: str, word: str) -> str:
    """Return the unit that a name has in brackets or `word`, its plain form, at the end."""
    return _UNITS.get(_bracket(name)) or _UNITS.get(word.rpartition("_")[2], "")


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

    for place in places(_RECEIVED):
        name(place, RECEIVED)
    _name_time(names, plain, places, name, sample)
    for place, word in _covariances(plain).items():
        name(place, word)
    theta_is_yaw = not places("phi|psi")
    for pattern, template in _PATTERNS:
        for place, word in enumerate(plain):
            match = re.fullmatch(
                pattern, re.sub(r"\Atheta", "yaw", word) if theta_is_yaw else word
            )
            if match is None or not numeric[place]:
                continue
            quantity = template.format(*match.groups())
            if quantity in _ANGLES and _unit(names[place], word) == "deg":
                quantity += "_deg"
            if "v" not in quantity or not re.search(_OTHER_SPEED, names[place].lower()):
                name(place, quantity)
    if places(_FIXES["latitude"]) and places(_FIXES["longitude"]):
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


def _name_time(names, plain, places, name, sample) -> None:  # type: ignore[no-untyped-def]
    """Name the column of timestamps, preferably of the header; without one, frame numbers."""
    joined = {  # places of nanoseconds, by that of their seconds
        place: part
        for part in places(_NANOSECONDS)
        for place in places(re.sub("(?:nano|n)secs?$", "secs?", plain[part]))
    }
    constant = list(map(_is_constant, sample.T))
    times = [place for place in places(_TIME) if place not in joined.values()]
    times.sort(
        key=lambda at: ("header_stamp" not in plain[at], at not in joined, constant[at], at)
    )
    for place in times[:1]:
        unit = "us" if plain[place] == "utime" else _unit(names[place], plain[place])
        name(place, f"t_{unit}" if unit in ("ns", "us", "ms", "s") else "t")
        if place in joined:
            name(joined[place], NANOSEC)
    for place in times[1:]:
        if plain[place] == "receive_time":  # of Foxglove's tables
            name(place, RECEIVED)
    for place in places(_FRAME) if not times else ():
        if np.isfinite(sample[:, place]).all() and not constant[place]:
            name(place, "t" if len(sample) and sample[0, place] > 1e8 else FRAME)
            break


def _covariances(plain: Sequence[str]) -> dict[int, str]:
    """Return names of covariances by column: numbered, named by axes, or of OpenVINS.

    Numbers are 0 to 35, 11 to 66 or 00 to 55.
    """
    named, numbers = {}, {}
    for place, word in enumerate(plain):
        if match := re.fullmatch(_COVARIANCE, word):
            numbers[place] = f"{match[1]}{match[2] or ''}"
        elif match := re.fullmatch(_PAIR, word):
            row, column = _AXES.index(match[1] or match[2]), _AXES.index(match[2])
            named[place] = f"c{row + 1}{column + 1}"
        elif word in _MARGINALS:
            named[place] = _MARGINALS[word]
    counted = set(numbers.values()) == set(map(str, range(36)))
    first = 0 if any("0" in digits for digits in numbers.values()) else 1
    for place, digits in numbers.items():
        if counted or len(digits) == 2:
            row, column = divmod(int(digits), 6) if counted else (int(at) - first for at in digits)
            named[place] = f"c{row + 1}{column + 1}" if max(row, column) < 6 else IGNORED
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
