"""What is read of text with mistakes and what is said of them, by format, as it was kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from kept import assert_kept
from kept_runs import told

COUNT = 12
TIMES = 1_700_000_000 + 0.1 * np.arange(COUNT)
XYZ = np.stack([np.arange(COUNT), np.sin(np.arange(COUNT)), 0.1 * np.arange(COUNT)], axis=1)
HALF = 0.05 * np.arange(COUNT)
ZEROS = np.zeros((COUNT, 2))
XYZW = np.hstack([ZEROS, np.sin(HALF)[:, None], np.cos(HALF)[:, None]])
MATRICES = np.stack(
    [
        *(np.cos(2 * HALF), -np.sin(2 * HALF), 0 * HALF, XYZ[:, 0]),
        *(np.sin(2 * HALF), np.cos(2 * HALF), 0 * HALF, XYZ[:, 1]),
        *(0 * HALF, 0 * HALF, 1 + 0 * HALF, XYZ[:, 2]),
    ],
    axis=1,
)


def rows(
    *columns: np.ndarray, separator: str = " ", times: str = "{:.9f}", unit: float = 1.0
) -> list[str]:
    table = np.hstack([column.reshape(COUNT, -1) for column in columns])
    return [
        separator.join([times.format(time / unit), *(f"{value:.6f}" for value in row)]).strip()
        for time, row in zip(TIMES, table, strict=True)
    ]


FORMATS = {
    "tum": rows(XYZ, XYZW),
    "euroc": [
        "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z",
        *rows(XYZ, XYZW[:, [3, 0, 1, 2]], separator=",", times="{:.0f}", unit=1e-9),
    ],
    "named": ["t,x,y,z,qx,qy,qz,qw", *rows(XYZ, XYZW, separator=",")],
    "kitti": rows(MATRICES, times=""),
    "points": rows(XYZ),
    "openvins": ["# timestamp(s) q p v", *rows(XYZW, XYZ, XYZ)],
    "vins": rows(XYZ, XYZW[:, [3, 0, 1, 2]], XYZ, separator=",", times="{:.0f}", unit=1e-9),
    "geographic": [
        "time,latitude,longitude,altitude",
        *rows(np.array([47.4, 8.5, 430.0]) + 1e-5 * XYZ, separator=","),
    ],
}
Lines = list[str]


def cell(line: str, place: int, value: str) -> str:
    """Return a row with another value in a column."""
    separator = "," if "," in line else " "
    values = line.split(separator)
    values[place] = value
    return separator.join(values)


def at(row: int, place: int, value: str) -> Callable[[Lines], Lines]:
    return lambda lines: [*lines[:row], cell(lines[row], place, value), *lines[row + 1 :]]


def each_time(change: Callable[[float], float]) -> Callable[[Lines], Lines]:
    """Return what changes the first number of all rows that begin with one."""
    return lambda lines: [
        cell(line, 0, f"{change(float(line.replace(',', ' ').split()[0])):.9f}")
        if line[0].isdigit()
        else line
        for line in lines
    ]


MISTAKES: dict[str, Callable[[Lines], Lines]] = {
    "none": lambda lines: lines,
    "NaN": at(3, 1, "nan"),
    "a word": at(4, 2, "lost"),
    "a huge position": at(5, 1, "1e300"),
    "a far position": at(5, 1, "2e9"),
    "an empty cell": at(5, 1, ""),
    "no orientation": at(6, -1, "nan"),
    "a long quaternion": at(6, -1, "7.5"),
    "a wild time": at(7, 0, "9e18"),
    "a time of zero": at(7, 0, "0.0"),
    "a negative time": at(2, 0, "-5.0"),
    "a row twice": lambda lines: [*lines[:6], lines[5], *lines[6:]],
    "rows backwards": lambda lines: [*lines[:2], *lines[:1:-1]],
    "a short row": lambda lines: [*lines[:5], lines[5][:12], *lines[6:]],
    "a short last row": lambda lines: [*lines[:-1], lines[-1][:-20]],
    "a long row": lambda lines: [*lines[:5], lines[5] + lines[5][-9:], *lines[6:]],
    "a blank row": lambda lines: [*lines[:5], "", *lines[5:]],
    "a comment": lambda lines: [*lines[:5], "# here", *lines[5:]],
    "another header": lambda lines: [*lines[:5], "a b c", *lines[5:]],
    "one row": lambda lines: lines[:2],
    "two rows": lambda lines: lines[:3],
    "milliseconds": each_time(lambda seconds: 1e3 * seconds),
    "microseconds": each_time(lambda seconds: 1e6 * seconds),
    "nanoseconds": each_time(lambda seconds: 1e9 * seconds),
    "since start": each_time(lambda seconds: seconds % 1e6),
    "equal times": each_time(lambda seconds: 5.0),
    "semicolons": lambda lines: [line.replace(",", ";").replace(" ", ";") for line in lines],
    "tabs": lambda lines: [line.replace(" ", "\t") for line in lines],
    "a trailing separator": lambda lines: [f"{line}," for line in lines],
    "a control character": at(4, 2, "\x00"),
}


@pytest.mark.parametrize("name", FORMATS)
def test_mistakes_are_told_as_they_were(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("poses.txt")
    lines = []
    for mistake, make in MISTAKES.items():
        path.write_text("\n".join(make(FORMATS[name])) + "\n")
        lines.append(f"{mistake}: {told('poses.txt')}")
    assert_kept(f"rows_{name}", "\n".join(lines) + "\n")
