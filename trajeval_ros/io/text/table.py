"""Tables of numbers in text, read by numpy.

np.loadtxt converts plain tables. A table with empty fields, quotes, brackets, decimal commas or
damage is read line by line by `_repaired`, which also states what is wrong and where.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.io.text.lines import Advance
from trajeval_ros.io.text.names import CLOCK, RECEIVED, TIMES, Layout
from trajeval_ros.io.text.stamps import WIDTH, Words

_ROWS = 1 << 13  # rows that are read at once; they fit into the cache
_LARGE = 1 << 24  # bytes from which reading by pyarrow saves more than its import takes
MOST_ROWS = 10**8  # a day at 1 kHz; more need tens of gigabytes of memory
MIXED = "mixed"  # commas, semicolons, spaces and brackets between numbers, in any number
_JOINT = "\x1f"  # separator of repaired rows: a control character that no table has
_MISSING = re.compile(
    r"(?:[-+]?nan(?:\([^)]*\))?|-?1\.#(?:qnan|ind)\d*|n/?a|null|none|-|)", re.IGNORECASE
)
EXACT = (*TIMES, CLOCK, RECEIVED)  # columns that are kept as text
Lines = Callable[[Advance | None], Any]  # a file or a generator of lines


@dataclass(frozen=True, eq=False)
class Records:
    """The poses of a file as lines of a table."""

    open: Lines
    layout: Layout | None = None  # None if the first line is a header
    # Records that are no rows, by reason; counted when the lines are read.
    left_out: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class TextTable:
    """The structure of a table, from the first lines of its file."""

    path: Path
    open: Lines  # opens the lines of the file
    separator: str  # of columns; "" for spaces and tabs, `MIXED` for any
    columns: int
    first: int  # index of the line with the first row
    header: list[str]  # lines above it
    named: bool  # whether a line above it has no comment sign
    sample: list[list[str]]  # fields of the first rows
    sample_lines: list[int]  # indices of their lines
    values: Floats  # (N, columns), the sample as numbers, NaN for what is none
    texts: Booleans  # (columns,), whether a column of the sample is text
    comment: str | None  # sign of comments, None if the first lines have none
    plain: bool  # whether np.loadtxt can read the rows
    direct: bool  # whether np.loadtxt can open the file itself
    size: int  # bytes of the file
    at_end: bool  # whether lines end with a separator
    commas: bool  # whether numbers have decimal commas
    first_line: str  # the first row as written, for messages
    # Records that are no rows, by reason; complete after the rows are read.
    left_out: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Rows:
    """The N rows of a table."""

    count: int  # N
    # (N,) by column name: times, frame numbers, times of the day and of reception. As text, since
    # float64 does not have nanoseconds since 1970; as float64 from arrays.
    texts: dict[str, Words | Floats]
    groups: dict[str, Floats]  # (N, width) by the name of the group in the layout


def number(word: str) -> float | None:
    """Return a word as a number, NaN for a missing value; None if it is text."""
    try:
        value = float(word)
    except ValueError:
        return float("nan") if _MISSING.fullmatch(word) else None
    return value if word.isascii() and "_" not in word else None


def body_of(line: str) -> str:
    """Return a line without its comment."""
    for sign in "#%":
        if sign in line:
            line = line[: line.index(sign)]
    return line


def split(line: str, separator: str) -> list[str]:
    """Return the fields of a row, without spaces and quotes around them."""
    if separator == "":
        return [word.strip('"') for word in line.split()]
    if separator == MIXED:
        return [word for word in re.split(r"[,;\s\[\]()\"]+", line) if word]
    if '"' in line:
        import csv  # few files have quotes

        fields = next(csv.reader([line.strip()], delimiter=separator, skipinitialspace=True), [])
    else:
        fields = line.split(separator)
    return [word.strip(" \t\r\n\"'") for word in fields]


def read_rows(table: TextTable, layout: Layout, advance: Advance | None = None) -> Rows:
    """Read the rows of a table.

    Raises:
        InputError: A line is no row; the message states where and why.
    """
    is_large = table.size >= _LARGE
    if is_large and table.direct and table.plain and not table.at_end:
        from trajeval_ros.io.text.arrow_rows import read_with_arrow

        large = read_with_arrow(table, layout, advance)
        if large is not None:
            return large
    owner = {at: group for group, places in layout.groups.items() for at in places}
    owner |= {at: name for at, name in enumerate(layout.columns) if name in EXACT}
    # One field per run of columns of a group; ignored columns are read as one character, since
    # usecols switches off the check of the number of columns.
    runs = [
        (name, list(run))
        for name, run in itertools.groupby(range(table.columns), lambda at: owner.get(at, ""))
    ]
    kinds = {"": "S1", **dict.fromkeys(EXACT, f"S{WIDTH}")}
    fields = [(str(run[0]), kinds.get(name, "f8"), (len(run),)) for name, run in runs]
    parts: list[NDArray[np.void]] = []
    if table.plain:
        end = [("end", "S1")] if table.at_end else []
        with contextlib.suppress(ValueError, UnicodeError):
            direct = table.direct and not is_large
            lines = None if direct else _from_first(table, advance)
            parts = list(_load(lines, table, np.dtype(fields + end)))
            if direct and advance is not None:
                advance(table.size, table.size)
    if not parts:
        repaired = _repaired(table, layout, set(owner), advance)
        parts = list(_load(repaired, table, np.dtype(fields), _JOINT))

    count = sum(map(len, parts))
    texts = {name: np.empty(count, f"S{WIDTH}") for name in owner.values() if name in EXACT}
    groups = {group: np.empty((count, len(places))) for group, places in layout.groups.items()}
    unread = count
    while parts:  # the last one first: its memory can be returned
        part = parts.pop()
        rows = slice(unread - len(part), unread)
        unread -= len(part)
        for name, run in runs:
            if name in texts:
                texts[name][rows] = part[str(run[0])][:, 0]
            elif name:
                places = [layout.groups[name].index(at) for at in run]
                is_slice = places == list(range(places[0], places[-1] + 1))
                at: Any = slice(places[0], places[-1] + 1) if is_slice else places
                groups[name][rows, at] = part[str(run[0])]
    return Rows(count, dict(texts), groups)


def _from_first(table: TextTable, advance: Advance | None) -> Any:
    """Return the lines of a table from its first row on."""
    lines = table.open(advance)
    for _ in range(table.first):
        next(lines)
    return lines


def _load(
    lines: Any, table: TextTable, dtype: np.dtype[Any], separator: str = ""
) -> Iterator[NDArray[np.void]]:
    """Yield rows by arrays of `_ROWS`; without lines, numpy opens the file: 15 % less time.

    `separator`: instead of that of the table.
    """
    delimiter = separator or table.separator or None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # on no data
        if lines is None:
            yield np.loadtxt(
                table.path, dtype, table.comment, delimiter, encoding="latin-1", ndmin=1,
                skiprows=table.first,
            )  # fmt: skip
            return
        part, count = None, 0
        with contextlib.closing(lines):
            while part is None or len(part) == _ROWS:
                part = np.loadtxt(
                    lines, dtype, table.comment, delimiter, encoding="latin-1", ndmin=1,
                    max_rows=_ROWS,
                )  # fmt: skip
                count += len(part)
                require_rows(table.path, count)
                yield part


def require_rows(path: Path, count: int) -> None:
    """Refuse a file with too many rows."""
    if count > MOST_ROWS:
        raise InputError(f"{path} has more than {MOST_ROWS} rows; use a part of the recording")


def _repaired(
    table: TextTable, layout: Layout, kept: set[int], advance: Advance | None
) -> Iterator[str]:
    """Yield the rows of a table with one separator and NaN for missing numbers.

    `kept`: indices of the columns that are read.

    Raises:
        InputError: A line is no row; the message states where and why.
    """
    above = [line.strip() for line in table.header[-1:]]  # headers can be repeated
    lines = _from_first(table, advance)
    with contextlib.closing(lines):
        for index, line in enumerate(lines, table.first + 1):
            body = body_of(line)
            if not body.strip() or line.strip() in above:
                continue
            where = f"{table.path}, line {index}"
            fields = split(body.replace(",", ".") if table.commas else body, table.separator)
            if table.at_end and not fields[-1]:
                fields.pop()
            if len(fields) != table.columns:
                raise InputError(
                    f"{where}: {table.columns} columns expected, found {len(fields)}; correct or "
                    "remove the line"
                )
            for at, word in enumerate(fields):
                if at not in kept:
                    fields[at] = ""
                elif layout.columns[at] in EXACT:
                    fields[at] = word.replace(_JOINT, "?") or "nan"
                elif (value := number(word)) is None:
                    raise InputError(
                        f"{where}: {word[:40]!r} is not a number, in column {at + 1} "
                        f"({layout.columns[at]}); correct or remove the line"
                    )
                elif value != value:
                    fields[at] = "nan"
            text = _JOINT.join(fields)
            yield text if text.isascii() else text.encode("ascii", "replace").decode()
