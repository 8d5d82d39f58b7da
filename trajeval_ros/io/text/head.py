"""Recognition of the layout of a text file from its first lines."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.text.header_names import SEPARATORS, from_header, separator_of
from trajeval_ros.io.text.layouts import (
    DATE,
    EXAMPLE,
    FRAME,
    G2O,
    IGNORED,
    Layout,
    by_count,
    layout_of,
)

# A comment ends at a carriage return too: a file with these alone as line ends is refused then,
# and does not lose all rows after its first comment.
COMMENT = re.compile(rb"[#%][^\r\n]*")
_DATE = rb"\d{4}[-/]\d\d?[-/]\d\d?([T ].*)?"
_HEAD = 1 << 16  # bytes
_SAMPLE = 50  # rows from which a layout is recognised
_UTF8_MARK = b"\xef\xbb\xbf"
# Beginnings of files without rows, and what to do with these.
_REFUSED = {
    rb"\s*\Z": "empty; check that the recording has poses",
    rb"\xff\xfe|\xfe\xff": "UTF-16 text; convert it to UTF-8",
    rb"\x1f\x8b": "compressed with gzip; decompress it with gunzip",
    rb"\x89PNG": "a picture (PNG); give a file with poses",
    rb"\xff\xd8\xff": "a picture (JPEG); give a file with poses",
    rb"GIF8": "a picture (GIF); give a file with poses",
    rb"[^\n]*\0": "a binary file of unknown format, neither text nor a bag",
    rb"\s*\[\s*\{": "a JSON array; write one object per line, as jq -c '.[]' does",
    rb"(---\s+)?header:\s+stamp:": "YAML of ros2 topic echo; record a bag, or use ros2 topic echo "
    "--csv and name its columns, as in --columns 't_s nanosec _ x y z qx qy qz qw'",
}
_WITH_COMMA = rb"[-+]?\d+,\d+([eE][-+]?\d+)?"
_DECIMAL_COMMAS = re.compile(rb"%s((\s*;\s*|\s+)%s){2,}" % (_WITH_COMMA, _WITH_COMMA))
ANY_GGA = rb"(?m)^\$..GGA,"
_GRAPH = rb"(?m)^(VERTEX_SE3:QUAT|VERTEX_SE2)\s"
_BODY_TWISTS, _OTHERS = "RIGHT_PERTURBATION", "LEFT_PERTURBATION|ROTATION_TRANSLATION"


@dataclass(frozen=True)
class TextFormat:
    """Layout and start of the rows of a text file."""

    layout: Layout  # meaning of the columns
    start: int  # offset of the first row, bytes
    # Pattern of the text that does not belong to rows, such as comments.
    no_row: re.Pattern[bytes] = COMMENT


def holds_nmea(path: Path) -> bool:
    """Return whether the first 64 KiB of a file contain a GGA line of NMEA 0183."""
    with path.open("rb") as file:
        return re.search(ANY_GGA, file.read(_HEAD).replace(b"\r", b"\n")) is not None


def recognise_text(path: Path, named: Sequence[str] = ()) -> TextFormat:
    """Return the layout of a file, from its first lines.

    `named`: names of the columns, as the user states them; () to recognise the layout.
    """
    if named:
        return _as_named(path, layout_of(named))
    graph = _graph(path)
    if graph is not None:
        return graph
    head = read_head(path)
    try:
        titled = (from_header(line, len(head.sample[0])) for line in reversed(head.header))
        layout = head.table or next(filter(None, titled), None)
        layout = layout or by_count(head.sample, head.commas, head.comma_at_end)
    except InputError as error:
        raise InputError(f"{path} is not a readable trajectory: {error}") from None
    if layout.name == "smfeval":
        layout = _smfeval(layout, head.header)
    return TextFormat(layout, head.start)


def _as_named(path: Path, layout: Layout) -> TextFormat:
    """Return the format of a file with columns that the user named."""
    start, lines = _first_lines(path)
    count = 0
    for line in lines:
        for separator in (*SEPARATORS, ""):
            found = _of_row(dataclasses.replace(layout, separator=separator), line)
            if found is not None:
                return TextFormat(found, start)
        count = count or len(_words(line))
        start += len(line)
    raise InputError(
        f"{path} has no row of {counted(len(layout.columns), 'column')} as given with --columns "
        f"(its first line has {count}); name all columns, and use {IGNORED} for columns to "
        "ignore"
    )


def _of_row(layout: Layout, line: bytes) -> Layout | None:
    """Return the layout if a line is a row of it, else None.

    If the time in the line is a calendar date, the returned layout has a date as time. Empty
    fields are missing values.
    """
    if layout.separator:
        fields = [each.strip(b' "\t\r\n') for each in line.split(layout.separator.encode())]
    else:
        fields = _words(line)
    columns = layout.columns
    if len(fields) != len(columns):
        return None
    wanted = {place for places in layout.groups.values() for place in places}
    if not all(_to_float(fields[place] or b"nan") is not None for place in wanted):
        return None
    if layout.time is not None and _to_float(fields[layout.time]) is None:
        if layout.time_name == FRAME or not re.fullmatch(_DATE, fields[layout.time]):
            return None
        columns = tuple(DATE if at == layout.time else each for at, each in enumerate(columns))
    return dataclasses.replace(layout, columns=columns)


def _smfeval(layout: Layout, header: Sequence[str]) -> Layout:
    """Return the layout with the convention of covariances that the header of SQUARE states."""
    said = " ".join(header).upper()
    if re.search(_OTHERS, said):
        note = "covariances dropped: their axes or their order are not supported"
        return dataclasses.replace(layout, columns=layout.columns[:8] + (IGNORED,) * 21, note=note)
    return dataclasses.replace(layout, note="") if _BODY_TWISTS in said else layout


def _graph(path: Path) -> TextFormat | None:
    """Return the format of the vertices of a g2o file; None if the file is not g2o."""
    with path.open("rb") as file:
        found = re.search(_GRAPH, file.read(_HEAD))
    if found is None:
        return None
    tag = found[1]
    # Other lines become empty and are not removed: line numbers in messages stay correct.
    no_row = re.compile(rb"(?m)^(?!%s\s)[^\n]*|^%s\s" % (tag, tag))
    return TextFormat(G2O[tag.decode()], 0, no_row)


@dataclass(frozen=True)
class Head:
    """The first lines of a file: header lines and the first rows."""

    header: list[str]  # lines before the first row, without comment signs
    sample: list[list[float]]  # numbers of the first rows; can be empty if `table` is set
    commas: bool  # whether commas separate columns
    start: int  # offset of the first row, bytes
    comma_at_end: bool = False  # whether the first row ends with a comma
    # Layout, if the line above the rows names all columns and has single separators, as in CSV;
    # else None.
    table: Layout | None = None


def read_head(path: Path) -> Head:
    """Return the header and the first rows of a file."""
    start, lines = _first_lines(path)
    header: list[str] = []
    named = False
    for index, line in enumerate(lines):
        words = _words(line)
        if _DECIMAL_COMMAS.fullmatch(line.strip()):
            raise InputError(
                f"{path}, line {index + 1}: numbers have decimal commas; write decimal points"
            )
        table = _table(header, line) if words else None
        if table is not None:
            return Head(header, _sample(lines[index:]), True, start, table=table)
        numbers = [_to_float(word) for word in words]
        if words and None not in numbers:
            commas, at_end = b"," in line or b";" in line, line.rstrip().endswith(b",")
            return Head(header, _sample(lines[index:]), commas, start, at_end)
        if words and (named or numbers.count(None) < len(numbers)):
            at = numbers.index(None)
            wrong = words[at][:40].decode(errors="replace")
            raise InputError(
                f"{path}, line {index + 1}, column {at + 1}: {wrong!r} is not a number; correct "
                f"or remove the line, or name the columns in a header line or with {EXAMPLE}"
            )
        named = named or bool(words)
        header.append(line.decode(errors="replace").strip().lstrip("#%").strip())
        start += len(line)
    raise InputError(f"{path} is text without a row of numbers; give a file with poses")


def _table(header: Sequence[str], line: bytes) -> Layout | None:
    """Return the layout of a table if `line` is a row below its header; else None."""
    separator = separator_of(header[-1]) if header else ""
    if not separator:
        return None
    layout = from_header(header[-1], line.count(separator.encode()) + 1)
    if layout is None:
        return None
    return _of_row(dataclasses.replace(layout, separator=separator), line)


def _first_lines(path: Path) -> tuple[int, list[bytes]]:
    """Return the position of the first line of a file, and its first lines with their ends."""
    data = _beginning(path)
    start = len(_UTF8_MARK) if data.startswith(_UTF8_MARK) else 0
    lines = data[start:].splitlines(keepends=True)
    if len(data) == _HEAD and len(lines) > 1:
        lines.pop()  # the last line can be incomplete
    return start, lines


def _beginning(path: Path) -> bytes:
    """Return the first `_HEAD` bytes of a text file."""
    with path.open("rb") as file:
        data = file.read(_HEAD)
    for beginning, said in _REFUSED.items():
        if re.match(beginning, data):
            raise InputError(f"{path} is {said}")
    return data


def _words(line: bytes) -> list[bytes]:
    """Return the words of a line between spaces, commas and semicolons, without its comment."""
    return COMMENT.sub(b"", line).replace(b",", b" ").replace(b";", b" ").split()


def _to_float(word: bytes) -> float | None:
    """Return a word as a number; None if it is not a number."""
    try:
        return None if b"_" in word else float(word)
    except ValueError:
        return None


def _sample(lines: list[bytes]) -> list[list[float]]:
    """Return the numbers of the first rows, up to a row with text or other columns."""
    sample: list[list[float]] = []
    for line in lines[:_SAMPLE]:
        numbers = [_to_float(word) for word in _words(line)]
        if None in numbers or (sample and len(numbers) not in (0, len(sample[0]))):
            break
        if numbers:
            sample.append([number for number in numbers if number is not None])
    return sample
