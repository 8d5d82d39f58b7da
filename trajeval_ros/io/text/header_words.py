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
        "ns": "ns nsec nsecs nanosec nanosecs nanosecond nanoseconds nanos",
        "us": "us usec usecs microsec microsecond microseconds micros",
        "ms": "ms msec msecs millisec millisecond milliseconds millis",
        "s": "s sec secs second seconds",
        "deg": "deg degree degrees °",
        "rad": "rad radian radians",
        "m": "m metre metres meter meters",
        "mm": "mm millimetre millimetres millimeter millimeters",
        "cm": "cm centimetre centimetres centimeter centimeters",
        "km": "km kilometre kilometres kilometer kilometers",
        "min": "min minute minutes",
        "h": "h hour hours",
        "d": "d day days",
    }.items()
    for word in words.split()
}
TIME_NAME = (
    r"(?:t|ts|utime|epoch|rostime|gpst|(?:gps|utc|ros|unix)_?time|time.*|stamp.*"
    r"|(?:.*_)?(?:time|timestamp|stamp|date|datetime|utc)(?:_.*)?)"
)
_LONGEST_NAME = 80  # characters: patterns need quadratic time for longer ones


def split_header(line: str, separator: str) -> list[str]:
    """Return the names in a header line."""
    line = re.sub(r"\A[#%\s]*(?:(?:fields|format|columns|header)\s*[:=]?\s+)?", "", line)
    with contextlib.suppress(UnicodeError):
        line = line.encode("latin-1").decode("utf-8")
    line = re.sub("[µμ]", "u", line)
    if not separator:  # a unit after a space belongs to the name before it
        line = re.sub(rf" (?={_UNIT})", "", " ".join(line.split()))  # runs of spaces are slow
    return [name.strip(" \"'\t\r\n") for name in line.split(separator or None)]


def name_and_unit(name: str) -> tuple[str, str]:
    """Return a name in lower case, with _ between its words, and its unit, "" if it has none.

    The unit is in brackets or the last word: `time [ms]`, `x_mm`, `yaw/deg`.
    """
    word = plain_of(name)
    match = re.search(_UNIT, name)
    bracket = (match[1] or match[2] or "").strip().lower() if match else ""
    before, _, last = word.rpartition("_")
    unit = UNIT_OF_WORD.get(last, "")
    if before and unit and (unit not in ("min", "h", "d") or re.fullmatch(TIME_NAME, before)):
        word = before.removesuffix("_in")
    elif before or unit not in TIME_UNITS:
        unit = ""
    if bracket and not bracket.isdigit():
        unit = UNIT_OF_WORD.get(bracket, bracket)
    return word, "us" if word == "utime" else unit


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
