"""Words of a header line: the names of columns and their units."""

from __future__ import annotations

import contextlib
import re

from trajeval_ros.io.text.names import TIME_UNITS

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
