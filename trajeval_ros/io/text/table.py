"""Tables of numbers: their separator, first row and header, and reading by numpy.

np.loadtxt converts plain tables. A table with empty fields, units, brackets, decimal commas or
damage is read line by line by `_repaired`, which also says what is wrong and where.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.lines import Advance, Head, head_of, open_lines
from trajeval_ros.io.text.names import CLOCK, IGNORED, RECEIVED, TIMES, Layout
from trajeval_ros.io.text.stamps import WIDTH, Words

_ROWS = 1 << 13  # rows that are read at once; they fit into the cache
_SAMPLE = 50  # rows from which a layout is recognised
_MOST_COLUMNS = 4096
_LONGEST_COUNT = 2  # numbers in a line above the rows that can be a count or a size
_MIXED = "mixed"  # commas, semicolons, spaces and brackets between numbers, in any number
_MISSING = re.compile(
    r"(?:[-+]?nan(?:\([^)]*\))?|-?1\.#(?:qnan|ind)\d*|n/?a|null|none|-|)", re.IGNORECASE
)
_FLOAT = re.compile(r"[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|inf(?:inity)?|nan)", re.IGNORECASE)
_WITH_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_EXACT = (*TIMES, CLOCK, RECEIVED)  # columns that are kept as text
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
    """What the first lines of a file say of its rows."""

    path: Path
    open: Lines  # opens the lines of the file
    separator: str  # of columns; "" for spaces and tabs, `_MIXED` for any
    columns: int
    first: int  # index of the line with the first row
    header: list[str]  # lines above it
    named: bool  # whether the line above it has no comment sign
    sample: list[list[str]]  # fields of the first rows
    values: Floats  # (N, columns), the sample as numbers, NaN for what is none
    texts: NDArray[np.bool_]  # (columns,), whether a column of the sample is text
    plain: bool  # whether np.loadtxt can read the sample
    comment: str  # sign of comments
    at_end: bool = False  # whether lines end with a separator
    commas: bool = False  # whether numbers have decimal commas
    first_line: str = ""  # the first row as written, for messages
    sample_lines: list[int] = field(default_factory=list)  # indices of the lines of the sample
    # Records that are no rows, by reason; complete after the rows are read.
    left_out: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Rows:
    """The N rows of a table."""

    # (N,) by column name: times, frame numbers, times of the day and of reception. As text, since
    # float64 does not have nanoseconds since 1970; as float64 from arrays.
    texts: dict[str, Words | Floats]
    values: Floats  # (N, M), the columns that `groups` refers to
    groups: dict[str, list[int]]  # columns of `values` by group


def number(word: str) -> float | None:
    """Return a word as a number, NaN for a missing value; None if it is text."""
    if _FLOAT.fullmatch(word):
        return float(word)
    return float("nan") if _MISSING.fullmatch(word) else None


def _body(line: str) -> str:
    """Return a line without its comment."""
    for sign in "#%":
        if sign in line:
            line = line[: line.index(sign)]
    return line


def split(line: str, separator: str) -> list[str]:
    """Return the fields of a row, without spaces and quotes around them."""
    if separator == "":
        return [each.strip('"') for each in line.split()]
    if separator == _MIXED:
        return [each for each in re.split(r"[,;\s\[\]()\"]+", line) if each]
    if '"' in line:
        import csv  # few files have quotes

        fields = next(csv.reader([line.strip()], delimiter=separator, skipinitialspace=True), [])
    else:
        fields = line.split(separator)
    return [each.strip(" \t\r\n\"'") for each in fields]


def sniff(
    path: Path,
    named: tuple[str, ...] = (),
    records: Records | None = None,
    known: Head | None = None,
) -> TextTable:
    """Return what the first lines of a file say of its rows.

    `named`: names of its first columns. `records`: lines instead of those of the file. `known`:
    the first lines of the file, if they were read before.

    Raises:
        InputError: The file has no rows of numbers.
    """
    wanted = len(named)
    lines = None if records is None else records.open
    if lines is None:
        head, complete = head_of(path) if known is None else known
        opened: Lines = lambda advance: open_lines(path, advance)  # noqa: E731
    else:
        iterator = iter(lines(None))
        head, complete, opened = list(itertools.islice(iterator, 200)), False, lines
        iterator.close()
    if len(head) == 1 and not complete and lines is None:
        raise InputError(f"{path} is not a trajectory: its first line has more than 64 KiB")
    bodies = [_body(line) for line in head]
    used = [at for at, body in enumerate(bodies) if body.strip()]
    if not used:
        raise InputError(f"{path} is text without a row of numbers; give a file with poses")
    late = [bodies[at] for at in used[-30:]]
    last = late[len(late) // 2 :][-3:]
    words = [each.strip() for line in last for each in re.split(r"[;\t]", line) if each.strip()]
    commas = (
        all(_WITH_COMMA.fullmatch(each) or number(each) is not None for each in words)
        and any("," in each for each in words)
        and all((";" in line or "\t" in line) and "." not in line for line in last)
    )
    if commas:
        bodies = [line.replace(",", ".") for line in bodies]
        late = [line.replace(",", ".") for line in late]
    elif all(_WITH_COMMA.fullmatch(each) for line in last for each in line.split()) and (
        len(last[-1].split()) > 2
    ):
        raise InputError(
            f"{path}, line {used[-1] + 1}: numbers have decimal commas; write decimal points"
        )
    best = (0, 0, 0)  # numbers, other fields (negative), length of the separator (negative)
    columns, separator = 0, ""
    for candidate in (",", ";", "\t", "", _MIXED):
        if candidate not in ("", _MIXED) and candidate not in late[-1]:
            continue
        rows = [split(line, candidate) for line in late]
        if all(len(row) > 1 and not row[-1] for row in rows):
            rows = [row[:-1] for row in rows]
        count = Counter(len(row) for row in rows if len(row) >= wanted)
        exact = {wanted: count[wanted]} if count[wanted] else count
        if not count:
            continue
        width = Counter(exact).most_common(1)[0][0]
        cells = [
            number(each) is not None and each != ""
            for row in rows
            if len(row) == width
            for each in row
        ]
        score = sum(cells) if candidate != _MIXED or all(cells) else 0
        rank = (score, score - len(cells), -len(candidate))
        if score and (not best[0] or rank > best):
            best, columns, separator = rank, width, candidate
    if not best[0]:
        if wanted:
            found = max(len(split(bodies[used[0]], each)) for each in (",", ";", "\t", ""))
            raise InputError(
                f"{path} has no row of {wanted} columns as given with {{option}} (its first line "
                f"has {found}); name all columns, and use {IGNORED} for columns to ignore"
            )
        raise InputError(f"{path} is text without a row of numbers; give a file with poses")
    if columns > _MOST_COLUMNS:
        raise InputError(f"{path} has {columns} columns, more than {_MOST_COLUMNS}; reduce them")
    rows = [split(line, separator) for line in late]
    at_end = all(len(row) > 1 and not row[-1] for row in rows)
    typical = [row for row in rows if len(row) == columns + at_end]
    late_rows = typical[len(typical) // 2 :]
    numeric = []
    for at in range(columns):
        words = [row[at] for row in late_rows if row[at]]
        numeric.append(2 * sum(number(each) is not None for each in words) >= len(words))
    if named:  # only these columns are read
        numeric = [name != IGNORED for name in named] + [False] * (columns - wanted)
    first = next(
        (
            at
            for at in used
            for row in [split(bodies[at], separator)]
            if len(row) == columns + at_end and any(row)
            and all(number(row[place]) is not None for place in range(columns) if numeric[place])
        ),
        None,
    )  # fmt: skip
    if first is None or not any(numeric):
        raise InputError(f"{path} is text without a row of numbers; give a file with poses")
    for at in used[: used.index(first)]:  # a row of numbers is not a header
        row = split(bodies[at], separator)
        if len(row) > _LONGEST_COUNT and all(number(word) is not None for word in row):
            raise InputError(
                f"{path}, line {at + 1}: {columns} columns expected, found {len(row)}; correct or "
                "remove the line"
            )
    for at in used[: used.index(first)] if not named else ():  # no row is skipped in silence
        row = split(bodies[at], separator)
        if len(row) == columns and 2 * sum(bool(each and number(each)) for each in row) > columns:
            wrong = next(
                (
                    each
                    for each, is_number in zip(row, numeric, strict=True)
                    if is_number and number(each) is None
                ),
                "",
            )
            raise InputError(
                f"{path}, line {at + 1}: {wrong[:40]!r} is not a number; correct or remove the "
                "line"
            )
    sample, sample_lines = [], []
    for at in [each for each in used if each >= first][:_SAMPLE]:
        row = split(bodies[at], separator)
        if len(row) != columns + at_end:
            break
        sample.append(row[:columns])
        sample_lines.append(at)
    values = np.array([[_or_nan(each) for each in row] for row in sample])
    texts = np.array(
        [any(number(row[at]) is None for row in sample) for at in range(columns)]
        if named
        else [not each for each in numeric]
    )
    line = head[first]
    comment = next((sign for sign in "#%" if any(sign in each for each in head)), "#")
    plain = (
        separator != _MIXED
        and not commas
        and '"' not in line
        and not any(
            number(each) is not None and not _FLOAT.fullmatch(each)
            for row in sample
            for each in row
        )
        and not all(any(sign in each for each in head) for sign in "#%")
    )
    return TextTable(
        path, opened, separator, columns, first,
        [each for each in head[:first] if each.strip()],
        any(at < first for at in used), sample, values, texts, plain, comment,
        at_end=at_end,
        commas=commas, first_line=line.strip()[:80],
        sample_lines=sample_lines,
        left_out={} if records is None else records.left_out,
    )  # fmt: skip


def _or_nan(word: str) -> float:
    found = number(word)
    return float("nan") if found is None else found


def read_rows(table: TextTable, layout: Layout, advance: Advance | None = None) -> Rows:
    """Read the rows of a table."""
    wanted = {place for places in layout.groups.values() for place in places}
    stamped = {at for at, name in enumerate(layout.columns) if name in _EXACT}
    kinds = [
        f"S{WIDTH}" if at in stamped else "f8" if at in wanted else "S1"
        for at in range(table.columns)
    ]
    runs = [
        (kind, list(run)) for kind, run in itertools.groupby(range(len(kinds)), kinds.__getitem__)
    ]
    fields = [(f"c{run[0]}", kind, (len(run),)) for kind, run in runs]
    parts: list[NDArray[np.void]] = []
    if table.plain:
        with contextlib.suppress(ValueError, UnicodeError):
            end = [("end", "S1")] if table.at_end else []
            parts = list(_load(table, table.separator, np.dtype(fields + end), advance))
    if not parts:
        lines = _repaired(table, layout, advance)
        parts = list(_load(table, "\x1f", np.dtype(fields), advance, lines))

    def column(place: int) -> Words:
        run = next(run for _, run in runs if place in run)
        name, at = f"c{run[0]}", place - run[0]
        return np.concatenate([part[name][:, at] for part in parts])

    numbers = [f"c{run[0]}" for kind, run in runs if kind == "f8"]
    values = np.empty((sum(map(len, parts)), len(wanted)))
    start = 0
    for part in parts:
        places = 0
        for name in numbers:
            block = part[name]
            values[start : start + len(part), places : places + block.shape[1]] = block
            places += block.shape[1]
        start += len(part)
    order = {at: place for place, at in enumerate(sorted(wanted))}
    groups = {group: [order[at] for at in places] for group, places in layout.groups.items()}
    return Rows(
        {layout.columns[place]: column(place) for place in sorted(stamped)}, values, groups
    )


def _load(
    table: TextTable,
    separator: str,
    dtype: np.dtype[Any],
    advance: Advance | None,
    repaired: Iterator[str] | None = None,
) -> Iterator[NDArray[np.void]]:
    """Yield the rows as arrays of `_ROWS` rows, of a table or of its `repaired` lines."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # on no data
        lines: Any = table.open(advance) if repaired is None else repaired
        with contextlib.closing(lines):
            for _ in range(table.first if repaired is None else 0):
                next(lines)
            while True:
                part = np.loadtxt(
                    lines, dtype, comments=table.comment, delimiter=separator or None, ndmin=1,
                    max_rows=_ROWS, encoding="latin-1",
                )  # fmt: skip
                yield part
                if len(part) < _ROWS:
                    return


def _repaired(table: TextTable, layout: Layout, advance: Advance | None) -> Iterator[str]:
    """Yield the rows of a table with one separator and NaN for missing numbers.

    Raises:
        InputError: A line is no row; the message states where and why.
    """
    wanted = sorted({place for places in layout.groups.values() for place in places})
    kept = {*wanted, *(at for at, name in enumerate(layout.columns) if name in _EXACT)}
    above = [each.strip() for each in table.header[-1:]]
    with contextlib.closing(table.open(advance)) as lines:
        for index, line in enumerate(lines):
            if index < table.first:
                continue
            body = _body(line)
            if not body.strip() or line.strip() in above:
                continue
            where = f"{table.path}, line {index + 1}"
            fields = split(body.replace(",", ".") if table.commas else body, table.separator)
            if table.at_end and not fields[-1]:
                fields.pop()
            if len(fields) != table.columns:
                raise InputError(
                    f"{where}: {table.columns} columns expected, found {len(fields)}; correct or "
                    "remove the line"
                )
            for place in wanted:
                word = fields[place]
                if not _FLOAT.fullmatch(word):
                    if not _MISSING.fullmatch(word):
                        name = layout.columns[place]
                        raise InputError(
                            f"{where}: {word[:40]!r} is not a number, in column {place + 1} "
                            f"({name}); "
                            "correct or remove the line"
                        )
                    fields[place] = "nan"
            text = "\x1f".join(
                (each or "nan").replace("\x1f", "?") if at in kept else ""
                for at, each in enumerate(fields)
            )
            yield text if text.isascii() else text.encode("ascii", "replace").decode()
