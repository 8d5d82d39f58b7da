"""Which column of a text file means what.

A header that names the columns is believed; without one, the number of columns decides, and
whatever is then a guess is said in the layout's note.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError

_AXES = "xyz"
_UNIT = re.compile(r"\[[^\]]*\]|\([^)]*\)")
_NANOSECONDS = re.compile(r"[\[(]\s*ns(ec)?\s*[\])]", re.IGNORECASE)
_TIME = re.compile(r"t|time.*|stamp.*|timestamp.*")
# One pattern per group; the last letters tell which element of the group a column holds.
_GROUPS = {
    "position": (r"(?:t|p|pos|position|p_[a-z_]+)?[_.]?{}", _AXES),
    "quaternion": (r"(?:q|quat|quaternion|orientation|q_[a-z_]+)[_.]?{}", "xyzw"),
    "velocity": (r"(?:v|vel|velocity|v_[a-z_]+)[_.]?{}", _AXES),
    "gyroscope_bias": (r"b_?[wg](?:_[a-z_]+)?[_.]?{}", _AXES),
    "accelerometer_bias": (r"b_?a(?:_[a-z_]+)?[_.]?{}", _AXES),
}
_UPPER_TRIANGLE = ("11", "12", "13", "22", "23", "33")
_COVARIANCES = {
    "rotation_covariance": (
        [f"pr{element}" for element in _UPPER_TRIANGLE],
        ["qrr", "qrp", "qry", "qpp", "qpy", "qyy"],
    ),
    "position_covariance": (
        [f"pt{element}" for element in _UPPER_TRIANGLE],
        ["pxx", "pxy", "pxz", "pyy", "pyz", "pzz"],
    ),
}
# OpenVINS writes whole vectors under one name each: quaternion (xyzw) first.
_OPENVINS_STATE = re.compile(r"\bq p v bg ba\b")

KNOWN = (
    "known are TUM (t x y z qx qy qz qw), KITTI (12 or 13 columns), EuRoC/ASL (17), VINS-Mono "
    "(11), OpenVINS (20), t x y z (4), or any other with a first line that names its columns"
)


@dataclass(frozen=True)
class Layout:
    """The meaning of columns.

    Attributes:
        name: What it is called.
        time: Index of the column with the stamps, or None.
        groups: For each of position, quaternion (xyzw), velocity, gyroscope_bias,
            accelerometer_bias, rotation_covariance, position_covariance (upper triangles) and
            matrix (3 x 4, row-major) that the file has, the indices of its columns.
        note: What was guessed, "" if nothing.
        in_nanoseconds: Whether the header says so.
        indexed: Whether the time column counts rows (KITTI) instead of seconds.
    """

    name: str
    time: int | None
    groups: Mapping[str, tuple[int, ...]]
    note: str = ""
    in_nanoseconds: bool = False
    indexed: bool = False


def recognise(header: Sequence[str], rows: Sequence[Sequence[float]], commas: bool) -> Layout:
    """Return the layout of a file.

    Args:
        header: The lines before the first row, without comment signs.
        rows: The first few rows, all of the same length, at least one.
        commas: Whether commas separate the columns.

    Raises:
        InputError: No layout fits.
    """
    columns = len(rows[0])
    for line in reversed(header):
        named = _from_names(line, columns)
        if named is not None:
            return named
    if columns in (12, 13):
        return _kitti(rows)
    return _from_count(columns, commas and abs(rows[0][0]) > 1e12)


def _from_names(line: str, columns: int) -> Layout | None:
    """Return the layout that a header line describes, if it names every column."""
    in_nanoseconds = bool(_NANOSECONDS.search(line))
    plain = _UNIT.sub("", line).strip().lstrip("#").lower()
    names = [name.strip() for name in (plain.split(",") if "," in plain else plain.split())]
    if _OPENVINS_STATE.search(plain) and columns >= 17:
        groups = {"quaternion": range(1, 5), "position": range(5, 8), "velocity": range(8, 11)}
        biases = {"gyroscope_bias": range(11, 14), "accelerometer_bias": range(14, 17)}
        spans = {group: tuple(span) for group, span in {**groups, **biases}.items()}
        return Layout("OpenVINS state", 0, spans)
    if names and not names[-1]:
        names.pop()
    if len(names) != columns:
        return None
    found: dict[str, tuple[int, ...]] = {}
    for group, (pattern, elements) in _GROUPS.items():
        places = [_find(names, pattern.format(element)) for element in elements]
        if None not in places:
            found[group] = tuple(place for place in places if place is not None)
    for group, spellings in _COVARIANCES.items():
        for spelling in spellings:
            if set(spelling) <= set(names):
                found[group] = tuple(names.index(name) for name in spelling)
    time = next((place for place, name in enumerate(names) if _TIME.fullmatch(name)), None)
    if len(found.keys() & _COVARIANCES) == 1:
        found = {group: places for group, places in found.items() if group not in _COVARIANCES}
    if "position" not in found or time is None or time > 1:
        return None
    return Layout(_name(names, found), time, found, in_nanoseconds=in_nanoseconds)


def _find(names: Sequence[str], pattern: str) -> int | None:
    """Return the place of the first name that matches the whole pattern."""
    return next((place for place, name in enumerate(names) if re.fullmatch(pattern, name)), None)


def _name(names: Sequence[str], groups: Mapping[str, tuple[int, ...]]) -> str:
    """Return what a file with these named columns is called."""
    if "rotation_covariance" in groups:
        return "OpenVINS with covariance"
    if "gyroscope_bias" in groups:
        return "EuRoC/ASL"
    if groups.get("quaternion") == (4, 5, 6, 7) and len(names) == 8:
        return "TUM"
    return "columns named by the header"


def _kitti(rows: Sequence[Sequence[float]]) -> Layout:
    """Return KITTI's layout: a 3 x 4 matrix, with an index or a time before it or not."""
    leading = len(rows[0]) - 12
    matrices = np.array(rows)[:, leading:].reshape(-1, 3, 4)
    axes = matrices[np.isfinite(matrices).all(axis=(1, 2)), :, :3]
    if not np.allclose(axes @ np.swapaxes(axes, 1, 2), np.eye(3), atol=1e-2):
        raise InputError(
            f"its {len(rows[0])} columns are no 3 x 4 pose matrices as KITTI's are; {KNOWN}"
        )
    groups = {"matrix": tuple(range(leading, leading + 12))}
    if not leading:
        return Layout("KITTI", None, groups)
    first = np.array(rows)[:, 0]
    indexed = bool((first == np.round(first)).all() and (first < 1e8).all())
    said = "a frame index" if indexed else "a time"
    return Layout(
        f"KITTI with {said}", 0, groups, f"the first of 13 columns is {said}", indexed=indexed
    )


def _from_count(columns: int, nanoseconds_and_commas: bool) -> Layout:
    """Return the layout that files with so many columns and no header usually have."""
    position, after = (1, 2, 3), 8
    xyzw, wxyz = (4, 5, 6, 7), (5, 6, 7, 4)
    velocity = tuple(range(after, after + 3))
    if columns == 4:
        return Layout("t x y z", 0, {"position": position})
    if columns == 8 and not nanoseconds_and_commas:
        return Layout("TUM", 0, {"position": position, "quaternion": xyzw})
    if columns == 8:
        note = "no header names the order of the quaternion: qw qx qy qz was assumed, as EuRoC"
        return Layout("EuRoC/ASL", 0, {"position": position, "quaternion": wxyz}, note)
    if columns == 9:
        groups = {"position": (2, 3, 4), "quaternion": (5, 6, 7, 8)}
        return Layout("TUM with an id", 1, groups, "the first of 9 columns is an id")
    if columns == 11 and nanoseconds_and_commas:
        note = "no header names the order of the quaternion: qw qx qy qz was assumed, as VINS-Mono"
        groups = {"position": position, "quaternion": wxyz, "velocity": velocity}
        return Layout("VINS-Mono", 0, groups, note)
    if columns == 11:
        note = "no header names the order of the quaternion: qx qy qz qw was assumed, as TUM"
        groups = {"position": position, "quaternion": xyzw, "velocity": velocity}
        return Layout("TUM with velocity", 0, groups, note)
    if columns == 17:
        groups = {
            "position": position,
            "quaternion": wxyz,
            "velocity": velocity,
            "gyroscope_bias": (11, 12, 13),
            "accelerometer_bias": (14, 15, 16),
        }
        return Layout("EuRoC/ASL", 0, groups, "no header: its 17 columns were read as EuRoC's")
    if columns == 20:
        groups = {
            "position": position,
            "quaternion": xyzw,
            "rotation_covariance": tuple(range(8, 14)),
            "position_covariance": tuple(range(14, 20)),
        }
        return Layout("OpenVINS with covariance", 0, groups)
    plural = "s" if columns > 1 else ""
    raise InputError(f"no layout with {columns} column{plural} is known; {KNOWN}")
