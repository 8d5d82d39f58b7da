"""Rows of tables of numbers in text.

np.loadtxt converts plain tables, or pyarrow if they are large. A table with empty fields, quotes,
brackets, decimal commas, comments after `%` or damage is read line by line by `_repaired`, which
also states what is wrong and where.
"""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
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
_LARGE = 1 << 24  # bytes of a file that is read by pyarrow, or by chunks
_MOST_COMMENTS = 1000  # different ones that are kept; one may name the columns in another order
MOST_ROWS = 10**8  # a day at 1 kHz; more need tens of gigabytes of memory
SEPARATORS = (",", ";", "\t", "")  # "" for spaces and tabs
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
    sample: list[list[str]]  # fields of the first rows
    sample_lines: list[int]  # indices of their lines
    values: Floats  # (N, columns), the sample as numbers, NaN for what is none
    texts: Booleans  # (columns,), whether a column of the sample is text
    plain: bool  # whether np.loadtxt can read the rows
    direct: bool  # whether np.loadtxt can open the file itself
    size: int  # bytes of the file
    at_end: bool  # whether lines end with a separator
    commas: bool  # whether numbers have decimal commas
    first_line: str  # the first row as written, for messages
    # Records that are no rows, by reason; complete after the rows are read.
    left_out: Mapping[str, int]
    # Comments between the rows with their lines, counted from 1; complete after the rows are read.
    comments: dict[str, int] = field(default_factory=dict)

    @property
    def is_large(self) -> bool:
        """Whether pyarrow saves more time than its import takes."""
        return self.size >= _LARGE


@dataclass(frozen=True, eq=False)
class Rows:
    """The N rows of a table."""

    count: int  # N
    # (N,) by column name: times, frame numbers, times of the day, receive times. As text, since
    # float64 does not have nanoseconds since 1970; as float64 from arrays.
    texts: dict[str, Words | Floats]
    groups: dict[str, Floats]  # (N, width) by the name of the group in the layout

    def where(self, kept: Booleans) -> Rows:
        """Return the rows of a mask (N,)."""
        texts = {name: column[kept] for name, column in self.texts.items()}
        groups = {name: columns[kept] for name, columns in self.groups.items()}
        return Rows(int(kept.sum()), texts, groups)


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


def split(line: str, separator: str, *, at_end: bool = False) -> list[str]:
    """Return the fields of a row, without spaces and quotes around them.

    `at_end`: whether lines end with a separator, after which there is no field.
    """
    if separator == "":
        fields = [word.strip('"') for word in line.split()]
    elif separator == MIXED:
        fields = [word for word in re.split(r"[,;\s\[\]()\"]+", line) if word]
    else:
        fields = line.split(separator)
        if '"' in line:
            import csv  # few files have quotes

            rows = csv.reader([line.strip()], delimiter=separator, skipinitialspace=True)
            fields = next(rows, [])
        fields = [word.strip(" \t\r\n\"'") for word in fields]
    return fields[:-1] if at_end and fields[-1:] == [""] else fields


def read_rows(table: TextTable, layout: Layout, advance: Advance | None = None) -> Rows:
    """Read the rows of a table.

    Raises:
        InputError: A line is no row; the message states where and why.
    """
    exact = {name: at for at, name in enumerate(layout.columns) if name in EXACT}
    numbers = {at for places in layout.groups.values() for at in places}
    rows = _by_arrow(table, layout, exact, numbers)
    if rows is not None:
        if advance is not None:
            advance(table.size, table.size)
        return rows
    # Ignored columns are read as one character: usecols switches off the check of their number.
    fields = [(str(at), "f8" if at in numbers else "S1") for at in range(table.columns)]
    for at in exact.values():
        fields[at] = str(at), f"S{WIDTH}"
    parts: list[NDArray[np.void]] = []
    if table.plain:
        kinds = np.dtype(fields + [("end", "S1")] * table.at_end)
        with contextlib.suppress(ValueError, UnicodeError):
            if table.direct and not table.is_large:  # numpy opens the file: 15 % less time
                parts = [
                    _load(table.path, kinds, table.separator, skiprows=table.first, comments="#")
                ]
                _keep_comments(table)
                if advance is not None:
                    advance(table.size, table.size)
            else:
                lines = _from_first(table, advance)
                parts = _by_chunks(lines, table, kinds, table.separator)
    if not parts:
        repaired = _repaired(table, layout, {*exact.values(), *numbers}, advance)
        parts = _by_chunks(repaired, table, np.dtype(fields), _JOINT)

    count = sum(map(len, parts))
    texts = {name: np.empty(count, f"S{WIDTH}") for name in exact}
    groups = {group: np.empty((count, len(places))) for group, places in layout.groups.items()}
    unread = count
    while parts:  # the last one first: its memory can be returned
        part = parts.pop()
        chunk = slice(unread - len(part), unread)
        unread -= len(part)
        for name, at in exact.items():
            texts[name][chunk] = part[str(at)]
        for group, places in layout.groups.items():
            for column, at in enumerate(places):
                groups[group][chunk, column] = part[str(at)]
    return Rows(count, dict(texts), groups)


def _by_arrow(
    table: TextTable, layout: Layout, exact: dict[str, int], numbers: set[int]
) -> Rows | None:
    """Read the rows of a large plain table without compression: the same bits in half the time.

    None for other tables, or if pyarrow is not installed or cannot read a row.
    """
    if not (table.is_large and table.direct and table.plain) or table.at_end:
        return None
    try:
        import pyarrow as pa
        from pyarrow import csv
    except ImportError:
        return None
    types = {str(at): pa.binary() for at in (0, *exact.values())}  # the first may be a comment
    types |= {str(at): pa.float64() for at in numbers}
    names = list(map(str, range(table.columns)))
    try:
        with table.path.open("rb") as file:
            content = csv.read_csv(
                file,
                csv.ReadOptions(use_threads=False, skip_rows=table.first, column_names=names),
                csv.ParseOptions(delimiter=table.separator or " ", quote_char=False),
                csv.ConvertOptions(
                    column_types=types, include_columns=list(types), null_values=[]
                ),
            )
    except pa.ArrowInvalid:
        return None
    require_rows(table.path, len(content))
    columns = {
        at: np.concatenate([_words(part) for part in content.column(str(at)).chunks])
        for at in {0, *exact.values()} - numbers
    }
    if any(words.itemsize >= WIDTH for words in columns.values()) or (
        0 in columns and _has_comment(columns[0].view(np.uint8)[:: columns[0].itemsize])
    ):
        return None
    texts: dict[str, Words | Floats] = {name: columns[at] for name, at in exact.items()}
    groups = {
        group: np.column_stack([_floats(content.column(str(at)).chunks) for at in places])
        for group, places in layout.groups.items()
    }
    return Rows(len(content), texts, groups)


def _floats(parts: Sequence[Any]) -> Floats:
    """Return arrays of pyarrow without nulls as one of numpy; its own way imports pandas."""
    return np.concatenate([
        np.frombuffer(part.buffers()[1], np.float64, len(part), 8 * part.offset) for part in parts
    ])  # fmt: skip


def _words(part: Any) -> Words:
    """Return an array of pyarrow as text of one width."""
    _, places, letters = part.buffers()
    ends = np.frombuffer(places, np.int32)[part.offset : part.offset + len(part) + 1]
    width = int(ends[1] - ends[0])
    if not width or (np.diff(ends) != width).any():
        return np.array(part.to_pylist(), dtype=np.bytes_)
    return np.frombuffer(letters, f"S{width}", len(part), int(ends[0]))


def _from_first(table: TextTable, advance: Advance | None) -> Any:
    """Return the lines of a table from its first row on."""
    lines = table.open(advance)
    for _ in range(table.first):
        next(lines)
    return lines


def _load(source: Any, dtype: np.dtype[Any], separator: str, **more: Any) -> NDArray[np.void]:
    """Return rows; tables with comments after `%` are read by `_repaired`.

    `more`: other arguments of np.loadtxt, which has one sign of comments at its full speed.

    Raises:
        ValueError: A line is no row, or a comment with a sign that is not in `more`.
    """
    more = {"comments": None, **more}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # on no data
        rows = np.loadtxt(
            source, dtype, delimiter=separator or None, encoding="latin-1", ndmin=1, **more
        )
    if dtype[0].kind == "S" and _has_comment(rows.view(np.uint8)[:: dtype.itemsize]):
        raise ValueError("a comment")
    return rows


def _keep_comments(table: TextTable) -> None:
    """Keep the comments between the rows of a file that numpy has read."""
    content = table.path.read_bytes()
    last = content.rfind(b"#")
    if last < 0 or content.count(b"\n", 0, last) < table.first:
        return
    for index, line in enumerate(content.decode("latin-1").split("\n"), 1):
        if index > table.first and "#" in line and line.lstrip()[0] == "#":
            _keep_comment(table, line.strip(), index)


def _keep_comment(table: TextTable, comment: str, line: int) -> None:
    if len(table.comments) < _MOST_COMMENTS:
        table.comments.setdefault(comment, line)


def _has_comment(letters: NDArray[np.uint8]) -> bool:
    """Return whether one of N lines is a comment, by their first letters."""
    letters = np.ascontiguousarray(letters)  # they are far apart in memory: one pass
    return bool(((letters == ord("#")) | (letters == ord("%"))).any())


def _by_chunks(
    lines: Any, table: TextTable, dtype: np.dtype[Any], separator: str
) -> list[NDArray[np.void]]:
    parts: list[NDArray[np.void]] = []
    with contextlib.closing(lines):
        while not parts or len(parts[-1]) == _ROWS:
            parts.append(_load(lines, dtype, separator, max_rows=_ROWS))
            require_rows(table.path, _ROWS * (len(parts) - 1) + len(parts[-1]))
    return parts


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
            body, whole = body_of(line), line.strip()
            if not body.strip() or whole in above:
                if whole not in above:
                    _keep_comment(table, whole, index)
                continue
            where = f"{table.path}, line {index}"
            body = body.replace(",", ".") if table.commas else body
            fields = split(body, table.separator, at_end=table.at_end)
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
