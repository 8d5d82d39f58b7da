"""Output to a terminal or a pipe: lines and tables, with control characters made visible."""

from __future__ import annotations

import os
import shutil
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import IO

from trajeval_ros.formatting.escaping import one_line, visible
from trajeval_ros.formatting.text_tables import BOLD, UNDERLINE, MarkedText, TextRow

DIM = "dim"
WARNING, ERROR = "warning", "error"
_CODES = {
    BOLD: "\x1b[1m",
    DIM: "\x1b[2m",
    UNDERLINE: "\x1b[4m",
    WARNING: "\x1b[33m",  # yellow
    ERROR: "\x1b[31m",  # red
}
_END = "\x1b[0m"
_UNWRAPPED = 10_000  # characters
_GAP = "  "  # between columns


class Console:
    """Output of a program: styled and wrapped in a terminal, plain and unwrapped in a pipe."""

    def __init__(
        self, file: IO[str], width: int, *, is_terminal: bool, is_styled: bool = False
    ) -> None:
        self.file = file
        self.width = width
        self.is_terminal = is_terminal
        self.is_styled = is_styled

    def print(self, text: str = "", style: str = "", *, soft_wrap: bool = False) -> None:
        """Print lines.

        `style`: `BOLD`, `DIM`, `UNDERLINE`, `WARNING`, `ERROR` or empty. `soft_wrap`: whether the
        terminal wraps long lines; otherwise they are wrapped at blanks.
        """
        for line in visible(text).split("\n"):
            width = _UNWRAPPED if soft_wrap else self.width
            self.write(self.styled(part, style) for part in _wrapped(line, width))

    def remark(self, level: str, text: str) -> None:
        """Print a remark in one line: `note`, `warning` or `error`, in the style of its level."""
        style = level if level in (WARNING, ERROR) else ""
        self.print(f"{level}: {text}", style, soft_wrap=True)

    def write(self, lines: Iterable[str]) -> None:
        """Print lines that may have control characters."""
        self.file.write("".join(f"{line}\n" for line in lines))
        self.file.flush()

    def show_rows(self, table: Table) -> None:
        """Print the rows of a table."""
        self.write(table.lines(self))

    def styled(self, text: str, style: str) -> str:
        """Return a text in a style, if the terminal has styles."""
        return f"{_CODES[style]}{text}{_END}" if style and text and self.is_styled else text


def console(stream: IO[str] | None = None) -> Console:
    """Return the console of a stream, by default of stdout."""
    output = sys.stdout if stream is None else stream
    if not output.isatty():
        return Console(output, _UNWRAPPED, is_terminal=False)
    is_styled = os.environ.get("TERM", "dumb") not in ("dumb", "unknown")
    is_styled &= not os.environ.get("NO_COLOR")  # https://no-color.org
    width = shutil.get_terminal_size().columns
    return Console(output, width, is_terminal=True, is_styled=is_styled)


class Table:
    """A table with a row of headings: text columns, then columns of numbers.

    Cells of text columns are not wrapped. Numbers are aligned right, and a narrow terminal wraps
    them between words.
    """

    def __init__(
        self,
        title: str,
        words: Sequence[str],
        numbers: Sequence[str] = (),
        rows: Iterable[TextRow] = (),
    ) -> None:
        """Create a table.

        `title`: title above the table; empty for none. `words`: headings of text columns; hidden
        if all are empty.
        """
        self.title = one_line(title)
        self.headings = tuple(map(one_line, (*words, *numbers))) if any(words) else ()
        self.words, self._count = len(words), len(words) + len(numbers)  # columns of text, and all
        self._rows: list[list[MarkedText] | None] = []
        for row in rows:
            self.add(row)

    def add(self, row: TextRow) -> None:
        """Add a row."""
        self._rows.append([_cell(item) for item in row])

    @property
    def rows(self) -> list[list[MarkedText]]:
        """The cells of all rows, without lines between them."""
        return [row for row in self._rows if row is not None]

    def add_section(self) -> None:
        """Add a line, which only a terminal shows."""
        self._rows.append(None)

    def widths(self, room: int) -> list[int]:
        """Return the widths of the columns in a terminal; wider than `room` if necessary."""
        texts = [[cell.text + cell.rest for cell in row] for row in self.rows]
        widths, narrowest = [0] * self._count, [0] * self._count
        for row in (self.headings, *texts):
            for at, text in enumerate(row):
                words = [text] if at < self.words else text.split()
                widths[at] = max(widths[at], _width(text))
                narrowest[at] = max([narrowest[at], *map(_width, words)])
        while total_width(widths) > room and widths != narrowest:
            most = max(range(len(widths)), key=lambda at: widths[at] - narrowest[at])
            widths[most] -= 1
        return widths

    def lines(self, terminal: Console) -> list[str]:
        """Return the lines of the table without its title."""
        widths = self.widths(terminal.width)
        rule = [_rule(terminal.file) * total_width(widths)] if terminal.is_terminal else []
        lines = []
        if self.headings:
            headings = [MarkedText(heading, BOLD) for heading in self.headings]
            lines = [*self._lines_of(headings, widths, terminal, at_bottom=True), *rule]
        for row in self._rows:
            lines += rule if row is None else self._lines_of(row, widths, terminal)
        return lines

    def _lines_of(
        self,
        row: list[MarkedText],
        widths: list[int],
        terminal: Console,
        *,
        at_bottom: bool = False,
    ) -> list[str]:
        """Return the lines of a row, with the cells at the top or at the bottom of the row."""
        columns = []
        for at, (cell, width) in enumerate(zip(row, widths, strict=True)):
            column = []
            marked = len(cell.text)
            for part in _wrapped(cell.text + cell.rest, width):
                text = terminal.styled(part[:marked], cell.mark) + part[marked:]
                marked = max(0, marked - len(part) - 1)  # and the blank between the lines
                blanks = " " * (width - _width(part))
                column.append(text + blanks if at < self.words else blanks + text)
            columns.append(column[::-1] if at_bottom else column)
        lines = [
            _GAP.join(part or " " * width for part, width in zip(parts, widths, strict=True))
            for parts in zip_longest(*columns)
        ]
        return [line.rstrip() for line in (lines[::-1] if at_bottom else lines)]


def total_width(widths: Sequence[int]) -> int:
    """Return the width of a table in characters."""
    return sum(widths) + len(_GAP) * (len(widths) - 1)


def show(terminal: Console, table: Table) -> None:
    """Print a table without cutting words or numbers, wider than the terminal if necessary."""
    if table.title:
        terminal.print(table.title, BOLD)
    terminal.show_rows(table)


def show_fitting(
    terminal: Console,
    words: Sequence[str],
    numbers: Sequence[str],
    rows: Sequence[TextRow],
    hidden_first: Sequence[str],
) -> None:
    """Print a table with as many columns as fit into the terminal, and name the hidden ones.

    `hidden_first`: headings that a narrow terminal hides, the least important first.
    """
    for count in range(len(hidden_first) + 1):
        hidden = hidden_first[:count]
        kept = [at for at, name in enumerate((*words, *numbers)) if name not in hidden]
        table = Table(
            "",
            [name for name in words if name not in hidden],
            [name for name in numbers if name not in hidden],
        )
        for row in rows:
            table.add([row[at] for at in kept])
        if total_width(table.widths(terminal.width)) <= terminal.width:
            break
    show(terminal, table)
    if count:
        names = ", ".join(hidden_first[:count])
        terminal.print(
            f"columns hidden (narrow terminal): {names}; widen it or redirect the output",
            soft_wrap=True,
        )


def _cell(cell: str | MarkedText) -> MarkedText:
    """Return a cell with visible control characters."""
    if isinstance(cell, str):
        return MarkedText(one_line(cell))
    return MarkedText(one_line(cell.text), cell.mark, one_line(cell.rest))


def _wrapped(text: str, width: int) -> list[str]:
    """Return a text in lines of at most a width, broken at single blanks; words are not cut."""
    if _width(text) <= width:
        return [text]
    lines = [""]
    for number, word in enumerate(text.split(" ")):
        longer = f"{lines[-1]} {word}" if number else word
        if number and _width(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _width(text: str) -> int:
    """Return the number of cells of a terminal that a text needs."""
    if text.isascii():
        return len(text)
    wide = sum(unicodedata.east_asian_width(item) in "WF" for item in text)
    return len(text) + wide - sum(unicodedata.combining(item) != 0 for item in text)


def _rule(file: IO[str]) -> str:
    """Return the character of lines that the encoding of a file has."""
    return "─" if "utf" in (getattr(file, "encoding", None) or "").lower() else "-"
