"""Structure of a table from its first lines: separator, first row, header, and a sample."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.text.lines import Head, head_of, is_plain, open_lines
from trajeval_ros.io.text.names import CLOCK, DATE, IGNORED, RECEIVED, TIMES
from trajeval_ros.io.text.table import MIXED, Lines, Records, TextTable, body_of, number, split

_SAMPLE = 50  # rows from which a layout is recognised
_LATE = 30  # last lines of the head, which are rows if the file has any
_RECORD_LINES = 200  # lines of rewritten records in the place of a head
_MOST_COLUMNS = 4096
_LONGEST_COUNT = 2  # numbers in a line above the rows that can be a count or a size
_OF_ANY_KIND = (IGNORED, DATE, CLOCK, RECEIVED, *TIMES)  # names of columns that can be text
_WITH_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")


def sniff(
    path: Path,
    names: tuple[str, ...] = (),
    records: Records | None = None,
    head: Head | None = None,
) -> TextTable:
    """Return the structure of a table.

    `names`: of its first columns, by the user. `records`: lines instead of those of the file.
    `head`: the first lines of the file, if they were read before.

    Raises:
        InputError: The file has no rows of numbers.
    """
    opened: Lines
    if records is None:
        opened = lambda advance: open_lines(path, advance)  # noqa: E731
        lines, complete = head_of(path) if head is None else head
        if len(lines) == 1 and not complete:
            raise InputError(f"{path} is not a trajectory: its first line has more than 64 KiB")
    else:
        opened = records.open
        iterator = iter(opened(None))
        lines = list(itertools.islice(iterator, _RECORD_LINES))
        iterator.close()
    bodies = {at: body for at, line in enumerate(lines) if (body := body_of(line)).strip()}
    commas = _has_decimal_commas(path, list(bodies)[-_LATE:], bodies)
    if commas:
        bodies = {at: body.replace(",", ".") for at, body in bodies.items()}
    late = list(bodies.values())[-_LATE:]
    separator, columns = _separator(late, len(names))
    if not columns and names:
        first_line = next(iter(bodies.values()), "")
        most = max(len(split(first_line, mark)) for mark in (",", ";", "\t", ""))
        raise InputError(
            f"{path} has no row of {len(names)} columns as given with {{option}} (its first line "
            f"has {most}); name all columns, and use {IGNORED} for columns to ignore"
        )
    if columns > _MOST_COLUMNS:
        raise InputError(f"{path} has {columns} columns, more than {_MOST_COLUMNS}; reduce them")
    late_rows = [split(body, separator) for body in late]
    at_end = bool(late) and all(len(row) > 1 and not row[-1] for row in late_rows)

    def row_at(at: int) -> list[str]:
        row = split(bodies[at], separator)
        return row[:-1] if at_end and row[-1:] == [""] else row

    if at_end:
        late_rows = [row[:-1] for row in late_rows]
    numeric = _numeric_columns(late_rows, columns)
    if names:  # only these columns are read
        numeric = [name not in _OF_ANY_KIND for name in names]
        numeric += [False] * (columns - len(names))
    first = next((at for at in bodies if _is_row(row_at(at), numeric)), None)
    if first is None or not any(numeric):
        raise InputError(f"{path} is text without a row of numbers; give a file with poses")
    above = [(at, row_at(at)) for at in bodies if at < first]
    _check_lines_above(path, above, numeric, names)
    after = itertools.islice(((at, row_at(at)) for at in bodies if at >= first), _SAMPLE)
    sample = dict(itertools.takewhile(lambda item: len(item[1]) == columns, after))
    values = np.array([[_or_nan(word) for word in row] for row in sample.values()])
    if names:
        numeric = [
            all(number(row[at]) is not None for row in sample.values()) for at in range(columns)
        ]
    signs = [sign for sign in "#%" if any(sign in line for line in lines)]
    return TextTable(
        path, opened, separator, columns, first,
        header=[line for line in lines[:first] if line.strip()],
        named=bool(above),
        sample=list(sample.values()), sample_lines=list(sample), values=values,
        texts=~np.array(numeric), comment=signs[0] if signs else None,
        plain=separator != MIXED and not commas and '"' not in lines[first] and len(signs) < 2,
        direct=records is None and is_plain(path), size=path.stat().st_size,
        at_end=at_end, commas=commas, first_line=lines[first].strip()[:80],
        left_out={} if records is None else records.left_out,
    )  # fmt: skip


def _has_decimal_commas(path: Path, late: Sequence[int], bodies: dict[int, str]) -> bool:
    """Return whether the last rows have decimal commas; refuse them between spaces."""
    last = [bodies[at] for at in late[len(late) // 2 :][-3:]]
    words = [word.strip() for line in last for word in re.split(r"[;\t]", line) if word.strip()]
    if any("," in word for word in words) and all(
        _WITH_COMMA.fullmatch(word) or number(word) is not None for word in words
    ):
        return all((";" in line or "\t" in line) and "." not in line for line in last)
    if (
        last
        and len(last[-1].split()) > 2
        and all(_WITH_COMMA.fullmatch(word) for line in last for word in line.split())
    ):
        raise InputError(
            f"{path}, line {late[-1] + 1}: numbers have decimal commas; write decimal points"
        )
    return False


def _separator(late: Sequence[str], least: int) -> tuple[str, int]:
    """Return the separator with which most fields are numbers, and the number of columns.

    `least`: number of columns, or 0. The number of columns is 0 if there are no numbers.
    """
    best, separator, columns = (0, 0, 0), "", 0
    for candidate in (",", ";", "\t", "", MIXED):
        if candidate in (",", ";", "\t") and candidate not in late[-1:][0] if late else True:
            continue
        rows = [split(line, candidate) for line in late]
        if all(len(row) > 1 and not row[-1] for row in rows):
            rows = [row[:-1] for row in rows]
        widths = Counter(len(row) for row in rows if len(row) >= least)
        if not widths:
            continue
        width = least if widths[least] else widths.most_common(1)[0][0]
        words = [word for row in rows if len(row) == width for word in row]
        count = sum(word != "" and number(word) is not None for word in words)
        if candidate == MIXED and count < len(words):
            continue
        # Most numbers, then fewest other fields, then the shortest separator.
        rank = (count, count - len(words), -len(candidate))
        if count and rank > best:
            best, separator, columns = rank, candidate, width
        if count == len(words) and candidate == "":
            break  # more separators find no more numbers
    return separator, columns


def _numeric_columns(late: Sequence[list[str]], columns: int) -> list[bool]:
    """Return which columns are mostly numbers in the later rows."""
    rows = [row for row in late if len(row) == columns]
    rows = rows[len(rows) // 2 :]
    numeric = []
    for at in range(columns):
        words = [row[at] for row in rows if row[at]]
        numeric.append(2 * sum(number(word) is not None for word in words) >= len(words))
    return numeric


def _is_row(row: Sequence[str], numeric: Sequence[bool]) -> bool:
    return (
        len(row) == len(numeric)
        and any(row)
        and all(
            number(word) is not None
            for word, is_number in zip(row, numeric, strict=True)
            if is_number
        )
    )


def _check_lines_above(
    path: Path, above: Sequence[tuple[int, list[str]]], numeric: Sequence[bool], names: object
) -> None:
    """Refuse lines above the first row that are rows with damage, not a header."""
    for at, row in above:
        numbers = sum(bool(word and number(word)) for word in row)
        if len(row) > _LONGEST_COUNT and all(number(word) is not None for word in row):
            reason = f"{counted(len(numeric), 'column')} expected, found {len(row)}"
        elif not names and len(row) == len(numeric) and 2 * numbers > len(row):
            wrong = [word for word, is_number in zip(row, numeric, strict=True)
                     if is_number and number(word) is None]  # fmt: skip
            reason = f"{wrong[0][:40]!r} is not a number"
        else:
            continue
        raise InputError(f"{path}, line {at + 1}: {reason}; correct or remove the line")


def _or_nan(word: str) -> float:
    value = number(word)
    return float("nan") if value is None else value
