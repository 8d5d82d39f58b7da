"""Words of a header line, and patterns of the names of quantities and units in them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence

from trajeval_ros.io.text.names import GROUPS, IGNORED, NAMES, PARTS, TIME_UNITS, WEEK

# Patterns are compiled on use, since most files have no header.
_UNIT = r"\[([^\[\]]*)\]|\(([^()]*)\)"
UNIT_OF_WORD = {
    word: unit
    for unit, words in {
        "ns": "ns nsec nsecs nanosec nanosecs nanosecond nanoseconds nanos nano",
        "us": "us usec usecs microsec microsecond microseconds micros micro",
        "ms": "ms msec msecs millisec millisecond milliseconds millis milli",
        "s": "s sec secs second seconds",
        "deg": "deg degree degrees °",
        "rad": "rad radian radians",
        "m": "m metre metres meter meters",
        "mm": "mm millimetre millimetres millimeter millimeters",
        "cm": "cm centimetre centimetres centimeter centimeters",
        "km": "km kilometre kilometres kilometer kilometers",
        "ft": "ft feet",
        "inch": "inch inches",
        "min": "min minute minutes",
        "h": "h hour hours",
        "d": "d day days",
    }.items()
    for word in words.split()
}
TIME_NAME = (
    r"(?:t|ts|utime|epoch|rostime|gpst|(?:gps|utc|ros|unix)_?time|time.*|stamp.*"
    r"|(?:.*_)?(?:time|timestamp|stamp|date|datetime|utc|i?tow|sow)(?:_.*)?)"
)
_LONGEST_NAME = 80  # characters: patterns need quadratic time for longer ones
# Patterns are compiled on use, since most files have no header.
OTHER_SPEED = r"[\[(](?!m[ /])[a-z]+ ?(?:/ ?[sh]|s\^?-1)|[\[(]m ?/ ?h"  # not m/s
LENGTHS = ("m", "mm", "cm", "km")
NO_UNITS_OF_TIME = r"\d.*|.*s|min|h|d"  # others, such as [utc], do not say how long a step is
PART_OF_UNIT = {UNIT_OF_WORD[part]: part for part in PARTS if part != WEEK}
EXACT_TIME = "t|time|timestamp|stamp"  # preferred to times of something, such as track_time
FRAME_NAMES = r"frame|frame_?(?:index|number|num|no|id)|index|image|image_id|id|no|num|pose_index"
# Patterns of quantities, and the name that the groups of the match make.
_FRAMES = r"(?:_(?:world|odom|map|device|body|imu|cam(?:era)?|enu|ecef|local|global))*"
POSITION = (
    r"(?:(?:t|p|pos|position|p_[a-z_]+|ecef_p|trans|loc(?:ation)?|pose)?_?"
    r"|(?:.*_)?(?:position|translation|point|pos)_)([xyz])(?:_?pos)?" + _FRAMES
)
_QUATERNION = (
    r"(?:(?:q|quat|quaternion|orientation|q_[a-z_]+)_?"
    r"|(?:.*_)?(?:orientation|rotation|quaternion|quat|att|attitude)_)([xyzw])" + _FRAMES
)
PATTERNS = (
    (r"p([rt])(11|12|13|22|23|33)", "p{}{}"),
    (POSITION, "{}"),
    (_QUATERNION, "q{}"),
    (r"(?:.*_)?twist_linear_([xyz])", "body_v{}"),
    (r"(?:(?:v|vel|velocity|v_[a-z_]+)_?|(?:.*_)?linear_velocity_)([xyz])", "v{}"),
    (r"b_?[wg](?:_[a-z_]+)?_?([xyz])", "bw{}"),
    (r"b_?a(?:_[a-z_]+)?_?([xyz])", "ba{}"),
    (r"(?:.*_)?(roll|pitch|yaw)", "{}"),
)  # fmt: skip
ANGLES = ("roll", "pitch", "yaw")
OF_MATRIX = {"x": "m14", "y": "m24", "z": "m34"}  # the same quantities
POSSIBLE = {  # units of quantities; others have one unit alone
    **dict.fromkeys(("x", "y", "z", *OF_MATRIX.values()), LENGTHS),
    **dict.fromkeys(("height", "sigma_east", "sigma_north", "sigma_up"), ("m",)),
    **dict.fromkeys(("latitude", "longitude"), ("deg",)),
    **dict.fromkeys(ANGLES, ("rad",)),
}
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw", *ANGLES, *(f"{angle}_deg" for angle in ANGLES))
_UP = "up|alt|altitude|height|elevation"
_FIX = {
    "latitude": r"(?:.*_)?(?:lat|latitude)",
    "longitude": r"(?:.*_)?(?:lon|lng|long|longitude)",
}
_HEIGHT = r"(?:.*_)?(?:h|height|elevation|h_ell|ellipsoidal_?height|alt|altitude)(?:_ellipsoid)?"
# Sets that are used only if all their names are present and no other name is the quantity, with
# the columns that they also need. Those of GNSS fixes exclude the others.
SETS: tuple[tuple[dict[str, str], set[str]], ...] = (
    (_FIX, set()),
    ({"height": _HEIGHT}, {*_FIX}),
    (
        {
            f"sigma_{name}": rf"(?:s|sd|std|sigma)_?(?:{name[0]}|{name}|{axis})"
            for name, axis in (("east", "x"), ("north", "y"), ("up", "z"))
        },
        {*_FIX},
    ),
    ({"fix_status": r"(?:.*_)?(?:fix_?)?status(?:_status)?"}, {*_FIX}),
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
_COVARIANCE = r"(?!.*twist)(?:.*_)?(?:c|cov|covariance)_?(\d+)(?:_(\d))?"
_MATRIX = r"(?:.*_)?(?:m|mat|matrix|t|tf|transform|pose|r|rot|rotation)_?([0-4])_?([0-4])"
_AXES = ("x", "y", "z", *ANGLES)
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
QUANTITY = rf"(?:.*_)?{_QUANTITIES}{_END}"
# A position or a rotation of another quantity, such as mag_pos_x; ang_roll is an angle.
OF_ANOTHER = rf"(?:.*_)?(?!ang_){_QUANTITIES}_(?:[a-z]+_)?(?:[xyzw]|roll|pitch|yaw)"
LABEL = (
    r"(?:.*_)?(?:id|uid|name|key|seq|counter|topic|type|state|mode|flag|valid|camera|device|label"
    r"|q|num|count|sats?|satellites|ns|nsat|age|status|fix|service|duration|dt|week|seconds"
    r"|v|w|a|b|d|l|marker|mean|tracking|lidar|image|file|path|frame)" + _END
)
OF_WEEK = r"(?:.*_)?(?:tow|sow)(?:_.*)?"  # seconds of the week of GPS
WEEK_NAMES = r"(?:gps_?)?(?:week|wn)(?:_?(?:number|num|no))?"
COMPASS = r"(?:.*_)?(?:heading|azimuth|course|bearing|track)"
_MOST_NAMES = 100  # in a header of a pose that is no table
_FEWEST_ENTRIES = 9  # of a matrix: those of a rotation


def split_header(line: str, separator: str) -> list[str]:
    """Return the names in a header line."""
    line = re.sub(r"(?i)\A[#%\s]*(?:(?:fields|format|columns|header)\s*[:=]?\s+)?", "", line)
    with contextlib.suppress(UnicodeError):
        line = line.encode("latin-1").decode("utf-8")
    line = re.sub("[µμ]", "u", line)
    if not separator:  # a unit after a space belongs to the name before it
        line = re.sub(rf" (?={_UNIT})", "", " ".join(line.split()))  # runs of spaces are slow
    return [name.strip(" \"'\t\r\n") for name in line.split(separator or None)]


def name_and_unit(name: str) -> tuple[str, str]:
    """Return a name in lower case, with _ between its words, and its unit, "" if it has none.

    The unit is in brackets or one of the words: `time [ms]`, `x_mm`, `yaw/deg`, `deg_roll`. A
    single letter is a unit as the last word alone; a unit of time in front needs a name of a time.
    """
    words = plain_of(name).split("_")
    match = re.search(_UNIT, name)
    bracket = (match[1] or match[2] or "").strip().lower() if match else ""
    last, unit = len(words) - 1, ""
    places = [
        at
        for at, word in enumerate(words)
        if word in UNIT_OF_WORD and (len(word) > 1 or at == last)
    ]
    if places:
        at, unit = places[-1], UNIT_OF_WORD[words[places[-1]]]
        others = [*words[: at - (at > 0 and words[at - 1] == "in")], *words[at + 1 :]]
        is_of_time = unit in ("min", "h", "d") or (at < last and unit in TIME_UNITS)
        if others and not (is_of_time and not re.fullmatch(TIME_NAME, "_".join(others))):
            words = others
        elif others or unit not in TIME_UNITS:
            unit = ""
    word = "_".join(words)
    if bracket and not bracket.isdigit():
        unit = UNIT_OF_WORD.get(bracket, bracket)
    return word, {"utime": "us", "itow": "ms"}.get(word, unit)


def plain_of(name: str) -> str:
    """Return a name in lower case, with _ between its words and without brackets."""
    name = name[: 2 * _LONGEST_NAME]
    name = re.sub(r"\A[^(]*\(\s*(?=\w+\Z)", "", re.sub(r"\s*\)\Z(?<!\()", ")", name))
    name = name[:-1] if name.endswith(")") and "(" not in name else name
    name = re.sub(r"\[(\d)\]", r"_\1", name)
    name = re.sub(
        r"(?<=[a-z])(?=(?:[A-Z][a-z]|Ns|Us|Ms)[a-z]*)|(?<=[A-Z])(?=Time\b)"
        r"|(?:(?<=time)|(?<=stamp))(?=[mun]s)|(?<=\b[xyzXYZ])(?=[mck]m\b)",
        "_",
        name,
    )
    return re.sub(r"[^a-z0-9]+", "_", re.sub(_UNIT, "", name).lower()).strip("_")[:_LONGEST_NAME]


def count_of_pose(names: Sequence[str]) -> int:
    """Return how many names are of a time, a position or a quaternion."""
    plain = [name_and_unit(name)[0] for name in names[:_MOST_NAMES]]
    return sum(
        any(re.fullmatch(pattern, word) for pattern in (TIME_NAME, POSITION, _QUATERNION))
        for word in plain
    )


def entries(plain: Sequence[str]) -> dict[int, str]:
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
