"""Output to a terminal or a pipe: lines and tables, with control characters made visible."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import IO, Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from trajeval_ros.formatting.escaping import one_line, visible
from trajeval_ros.formatting.text_tables import MarkedText, TextRow

_UNWRAPPED = 10_000  # characters


class VisibleConsole(Console):
    """A console that shows control characters in printed text instead of executing them."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text as it is printed; all text of tables and lines passes this method."""
        return super().render_str(visible(text), **options)


def console(stream: IO[str] | None = None) -> VisibleConsole:
    """Return a console: styled and as wide as the terminal; plain and unwrapped in a pipe."""
    output = sys.stdout if stream is None else stream
    terminal = VisibleConsole(file=output, highlight=False, markup=False, emoji=False)
    if terminal.is_terminal:
        return terminal
    return VisibleConsole(
        file=output, width=_UNWRAPPED, highlight=False, markup=False, emoji=False, no_color=True
    )


def new_table(title: str, words: Sequence[str], numbers: Sequence[str] = ()) -> Table:
    """Return a table without rows: with a frame in a terminal, plain in a pipe.

    Args:
        title: Title above the table; empty for none.
        words: Headings of text columns, which are not wrapped; hidden if all are empty.
        numbers: Headings of the columns of numbers after them.
    """
    table = Table(
        title=one_line(title) or None,
        title_justify="left",
        title_style="bold",
        show_header=any(words),
        box=box.SIMPLE_HEAD if sys.stdout.isatty() and any(words) else None,
        pad_edge=False,
    )
    for heading in words:
        table.add_column(one_line(heading), no_wrap=True)
    for heading in numbers:
        table.add_column(one_line(heading), justify="right")
    return table


def add_rows(table: Table, rows: Iterable[TextRow]) -> None:
    """Add rows to a table."""
    for row in rows:
        table.add_row(*map(_cell, row))


def show(terminal: Console, table: Table) -> None:
    """Print a table without cutting words or numbers, wider than the terminal if necessary."""
    width = terminal.width
    terminal.width = max(width, width_of(table))
    if terminal.is_terminal:
        terminal.print(table)
    else:  # programs that read the table need no trailing blanks
        with terminal.capture() as captured:
            terminal.print(table)
        lines = captured.get().splitlines()
        terminal.print("\n".join(map(str.rstrip, lines)), soft_wrap=True)
    terminal.width = width


def width_of(table: Table) -> int:
    """Return the width of a table in characters; only columns of numbers can wrap."""
    for column in table.columns:
        if column.no_wrap:  # rich cuts these columns unless they have a minimum width
            cells = (column.header, *column.cells)
            column.min_width = max(Text(str(cell)).cell_len for cell in cells)
    return Console(width=_UNWRAPPED, markup=False).measure(table).minimum


def _cell(cell: str | MarkedText) -> Text:
    """Return a cell as text for rich."""
    if isinstance(cell, str):
        return Text(one_line(cell))
    return Text.assemble((one_line(cell.text), cell.mark), one_line(cell.rest))
