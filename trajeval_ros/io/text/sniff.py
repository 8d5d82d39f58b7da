"""Structure of a table from its first lines: separator, first row, header, and a sample."""

from __future__ import annotations

import contextlib
import functools
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
from trajeval_ros.io.text.table import (
    MIXED,
    SEPARATORS,
    Records,
    TextTable,
    body_of,
    number,
    split,
)

_SAMPLE = 50  # rows from which a layout is recognised
_LATE = 30  # last lines of the head, which are rows if the file has any
_RECORD_LINES = 200  # lines of rewritten records in the place of a head
_MOST_COLUMNS = 4096
_LONGEST_COUNT = 2  # numbers in a line above the rows that can be a count or a size
_OF_ANY_KIND = (IGNORED, DATE, CLOCK, RECEIVED, *TIMES)  # names of columns that can be text
_WITH_COMMA = re.compile(r"[-+]?\d{1,3}(?:\.\d{3})+,\d+|[-+]?\d+,\d+(?:[eE][-+]?\d+)?")


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
    if records is None:
        lines, complete = head_of(path) if head is None else head
        if len(lines) == 1 and not complete:
            raise InputError(f"{path} is not a trajectory: its first line has more than 64 KiB")
    else:
        with contextlib.closing(records.open(None)) as file:
            lines = list(itertools.islice(file, _RECORD_LINES))
    bodies = {at: body for at, line in enumerate(lines) if (body := body_of(line)).strip()}
    commas = _has_decimal_commas(path, list(bodies.items())[-_LATE:])
    if commas:
        bodies = {at: body.replace(",", ".") for at, body in bodies.items()}
    late = list(bodies)[-_LATE:]
    separator, columns, at_end = _separator([bodies[at] for at in late], len(names))
    if not columns and names:
        first_line = next(iter(bodies.values()), "")
        most = max(len(split(first_line, mark)) for mark in SEPARATORS)
        raise InputError(
            f"{path} has no row of {len(names)} columns as given with {{option}} (its first line "
            f"has {most}); name all columns, and use {IGNORED} for columns to ignore"
        )
    if columns > _MOST_COLUMNS:
        raise InputError(f"{path} has {columns} columns, more than {_MOST_COLUMNS}; reduce them")

    def row_at(at: int) -> list[str]:
        return split(bodies[at], separator, at_end=at_end)

    if names:  # only these columns are read
        numeric = [at for at, name in enumerate(names) if name not in _OF_ANY_KIND]
    else:
        rows = [row for row in map(row_at, late) if len(row) == columns]
        rows = rows[len(rows) // 2 :]
        filled = Counter(at for row in rows for at, word in enumerate(row) if word)
        text = Counter(at for row in rows for at, word in enumerate(row) if number(word) is None)
        numeric = [at for at in range(columns) if 2 * text[at] <= filled[at]]

    def is_row(row: list[str]) -> bool:
        is_filled = len(row) == columns and any(word and number(word) is not None for word in row)
        return is_filled and all(number(row[at]) is not None for at in numeric)

    below = dict(itertools.pairwise(bodies))

    def is_of_header(at: int) -> bool:  # identifiers of bodies, as `,ID,1,1` and `,,1,1` of Motive
        is_labelled = row_at(at)[:1] == [""] and at in below
        return is_labelled and not is_row(row_at(below[at]))

    first = next((at for at in bodies if is_row(row_at(at)) and not is_of_header(at)), None)
    if first is None or not numeric:
        raise InputError(f"{path} is text without a row of numbers; give a file with poses")
    for at in itertools.takewhile(lambda at: at < first, bodies):
        if not is_of_header(at):
            _check_line_above(f"{path}, line {at + 1}", row_at(at), numeric, columns, bool(names))
    after = itertools.islice(((at, row_at(at)) for at in bodies if at >= first), _SAMPLE)
    sample = dict(itertools.takewhile(lambda item: len(item[1]) == columns, after))
    values = np.array([[number(word) for word in row] for row in sample.values()], np.float64)
    if names:
        is_text = [
            any(number(row[at]) is None for row in sample.values()) for at in range(columns)
        ]
    else:
        is_text = [at not in numeric for at in range(columns)]
    return TextTable(
        path, functools.partial(open_lines, path) if records is None else records.open,
        separator, columns, first,
        header=[line for line in lines[:first] if line.strip()],
        sample=list(sample.values()), sample_lines=list(sample), values=values,
        texts=np.array(is_text),
        plain=separator != MIXED and not commas and '"' not in lines[first],
        direct=records is None and is_plain(path), size=path.stat().st_size,
        at_end=at_end, commas=commas, first_line=lines[first].strip()[:80],
        left_out={} if records is None else records.left_out,
    )  # fmt: skip


def _has_decimal_commas(path: Path, late: Sequence[tuple[int, str]]) -> bool:
    """Return whether the last rows have decimal commas; refuse them between spaces."""
    last = [line for _, line in late[len(late) // 2 :][-3:]]
    words = [word.strip() for line in last for word in re.split(r"[;\t]", line) if word.strip()]
    if any("," in word for word in words) and all(
        _WITH_COMMA.fullmatch(word) or number(word) is not None for word in words
    ):
        if not any("." in line for line in last):
            return all(";" in line or "\t" in line for line in last)
        raise InputError(
            f"{path}, line {late[-1][0] + 1}: numbers have decimal commas and points; write "
            "decimal points, without separators of thousands"
        )
    if len(" ".join(last[-1:]).split()) > 2 and all(
        map(_WITH_COMMA.fullmatch, " ".join(last).split())
    ):
        raise InputError(
            f"{path}, line {late[-1][0] + 1}: numbers have decimal commas; write decimal points"
        )
    return False


def _separator(late: Sequence[str], least: int) -> tuple[str, int, bool]:
    """Return the separator with which most fields are numbers, and the number of columns.

    Last, whether lines end with the separator. `least`: number of columns, or 0. The number of
    columns is 0 if there are no numbers.
    """
    best, result = (0, 0, 0), ("", 0, False)
    for candidate in (*SEPARATORS, MIXED) if late else ():
        if candidate in (",", ";", "\t") and candidate not in late[-1]:
            continue
        rows = [split(line, candidate) for line in late]
        at_end = all(len(row) > 1 and not row[-1] for row in rows)
        if at_end:
            rows = [row[:-1] for row in rows]
        widths = Counter(len(row) for row in rows if len(row) >= least)
        if not widths:
            continue
        width = least if widths[least] else widths.most_common(1)[0][0]
        words = [word for row in rows if len(row) == width for word in row]
        count = sum(word != "" and number(word) is not None for word in words)
        if candidate == MIXED and (count < len(words) or count <= best[0]):
            continue
        # Most numbers, then fewest other fields, then the shortest separator.
        rank = (count, count - len(words), -len(candidate))
        if count and rank > best:
            best, result = rank, (candidate, width, at_end)
        if count == len(words) and candidate == "":
            break  # more separators find no more numbers
    return result


def _check_line_above(
    where: str, row: Sequence[str], numeric: Sequence[int], columns: int, are_named: bool
) -> None:
    """Refuse a line above the first row that is a row with damage, not a header."""
    if len(row) > _LONGEST_COUNT and all(number(word) is not None for word in row):
        reason = f"{counted(columns, 'column')} expected, found {len(row)}"
    elif (
        not are_named
        and len(row) == columns
        and 2 * sum(bool(word and number(word)) for word in row) > columns
    ):
        wrong = next(row[at] for at in numeric if number(row[at]) is None)
        reason = f"{wrong[:40]!r} is not a number"
    else:
        return
    raise InputError(f"{where}: {reason}; correct or remove the line")
