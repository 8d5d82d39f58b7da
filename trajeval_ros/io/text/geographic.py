"""GNSS fixes in text: columns named latitude and longitude, and GGA lines of NMEA 0183."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.fix_selection import trajectory_of_rows
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_ANY_GGA = rb"(?m)^\$..GGA,"  # start of a line with a fix
_KNOWN = 2.0  # type of a diagonal covariance in sensor_msgs/NavSatFix; 0 is unknown

# Patterns are compiled on use, since few files are NMEA.
_GGA = (
    rb"(?m)^\$(..GGA,(\d\d)(\d\d)(\d\d)(?:\.(\d+))?,(\d+\.?\d*),([NS]),(\d+\.?\d*),([EW]),"
    rb"(\d),[^,\n]*,[^,\n]*,(-?\d+\.?\d*),M?,(-?\d+\.?\d*)?,[^*\n]*)\*([0-9A-Fa-f]{2})"
)
# A receiver without a fix (RMC with V) may not know the date yet.
_DATE = (
    rb"(?m)^\$(..RMC,(\d{6})(?:\.\d+)?,A(?:,[^,\n]*){6},(\d\d)(\d\d)(\d\d)[^*\n]*"
    rb"|..ZDA,(\d{6})(?:\.\d+)?,(\d\d),(\d\d),(\d{4})[^*\n]*)\*([0-9A-Fa-f]{2})"
)
_HALF_A_DAY_S, _DAY_S = 43_200, 86_400
# Status of sensor_msgs/NavSatFix by GGA's quality: none, fix, differential, PPS, RTK fixed, RTK
# float, dead reckoning, manual input, simulation.
_QUALITIES = np.array([-1.0, 0.0, 1.0, 0.0, 2.0, 2.0, -1.0, -1.0, 0.0, 0.0])


def fixes_of(
    path: Path, stamps: Stamps, groups: Mapping[str, Floats], reading: SourceInfo
) -> Trajectory:
    """Return the trajectory of the fixes in the columns of a file.

    `stamps`: (N,), nanoseconds. `groups`: columns (N, width), by the name of their group in the
    layout.
    """
    if not reading.stamped:
        raise InputError(
            f"{path} has latitude and longitude, but no time; add a column named time, or name "
            "the columns with --columns 't latitude longitude height'"
        )
    places = groups.get("place")
    if places is None:
        places = np.column_stack([groups["level_place"], np.full(len(stamps), np.nan)])
    quality = np.zeros((len(stamps), 11))
    if "fix_status" in groups:
        quality[:, 0] = np.nan_to_num(groups["fix_status"][:, 0], nan=-1.0)
    if "place_sigma" in groups:
        quality[:, 1] = _KNOWN
        quality[:, [2, 6, 10]] = groups["place_sigma"] ** 2
    return trajectory_of_rows(str(path), stamps, places, quality, reading, name=path.stem)


def has_gga(beginning: bytes) -> bool:
    """Return whether the first bytes of a file have a line with a fix."""
    return re.search(_ANY_GGA, beginning.replace(b"\r", b"\n")) is not None


def read_nmea(path: Path) -> Trajectory:
    """Read the GGA lines of a file.

    The date is taken from the first intact RMC or ZDA line with a valid one. Without such a line,
    the first day is 1970-01-01. Heights are above the ellipsoid: the sum of altitude and geoid
    separation.
    """
    # Every line ends in a line feed; offsets of characters are kept.
    data = path.read_bytes().replace(b"\r", b"\n")
    matches = list(re.finditer(_GGA, data))
    intact = _intact(data, matches)
    lines = [match for match, good in zip(matches, intact.tolist(), strict=True) if good]
    broken = len(re.findall(_ANY_GGA, data)) - len(lines)
    if not lines:
        raise InputError(f"{path}: no complete fix in {counted(broken, 'GGA line')}")
    fields = [line.groups() for line in lines]
    clock = np.array([field[1:4] for field in fields]).astype(np.int64)
    seconds = clock @ np.array([3600, 60, 1])
    parts = np.array([(field[4] or b"0").ljust(9, b"0")[:9] for field in fields]).astype(np.int64)
    days, timing = _days(data, [line.start() for line in lines], seconds)
    stamps = (days * _DAY_S + seconds) * NANOSECONDS + parts
    level = np.array([(field[5], field[7]) for field in fields]).astype(np.float64)
    whole = np.floor(level / 100.0)
    level = whole + (level - 100.0 * whole) / 60.0
    level[[field[6] == b"S" for field in fields], 0] *= -1.0
    level[[field[8] == b"W" for field in fields], 1] *= -1.0
    heights = np.array([(field[10], field[11] or b"0") for field in fields]).astype(np.float64)
    quality = np.zeros((len(lines), 11))
    quality[:, 0] = _QUALITIES[np.array([field[9] for field in fields]).astype(np.int64)]
    return trajectory_of_rows(
        str(path),
        stamps,
        np.column_stack([level, heights.sum(axis=1)]),
        quality,
        SourceInfo(
            dropped={"undecodable": broken},
            remarks=(note("format", "format: NMEA 0183, GGA"), *timing),
        ),
        name=path.stem,
    )


def _intact(data: bytes, matches: Sequence[re.Match[bytes]]) -> Booleans:
    """Return the mask (N,) of lines with a correct checksum."""
    if not matches:
        return np.zeros(0, dtype=bool)
    ends = np.array([match.span(1) for match in matches]).ravel()
    sums = np.bitwise_xor.reduceat(np.frombuffer(data, dtype=np.uint8), ends)[::2]
    stated = np.array([int(match.groups()[-1], 16) for match in matches])
    return np.asarray(sums == stated)


def _days(
    data: bytes, places: Sequence[int], seconds: Indices
) -> tuple[Indices, tuple[Remark, ...]]:
    """Return the days since 1970 (N,) of lines at byte offsets, by their times of day, seconds."""
    days = np.concatenate([[0], np.cumsum(np.diff(seconds) < -_HALF_A_DAY_S)])
    for match in re.finditer(_DATE, data):
        _, time, *words, _ = filter(None, match.groups())
        day = _day(*words)
        if day is not None and _intact(data, [match])[0]:
            break
    else:
        undated = "no RMC or ZDA line with a date: timestamps count from midnight, 1970-01-01"
        return days, (note("no_date", undated),)
    # The line with the date has the same day as the GGA line before it, except over midnight.
    row = max(int(np.searchsorted(places, match.start())) - 1, 0)
    of_match_s = int(time[:2]) * 3600 + int(time[2:4]) * 60 + int(time[4:6])
    between = round((of_match_s - int(seconds[row])) / _DAY_S)
    return days + day - int(days[row]) + between, ()


def _day(day: bytes, month: bytes, year: bytes) -> int | None:
    """Return the days since 1970 of a date; None if there is no such date."""
    number = int(year) + (2000 if len(year) == 2 else 0)
    try:
        return (date(number, int(month), int(day)) - date(1970, 1, 1)).days
    except ValueError:
        return None
