"""Output to a terminal or a pipe: lines and tables, with control characters made visible."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import IO, Any

from rich import box
from rich.console import Console
from rich.table import Column, Table
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
    _fit(table, width)
    terminal.width = max(width, _natural_width(table))
    if table.title:  # rich wraps it at the table's width
        terminal.print(Text(str(table.title), style="bold"))
        table.title = None
    if terminal.is_terminal:
        terminal.print(table)
    else:  # programs that read the table need no trailing blanks
        with terminal.capture() as captured:
            terminal.print(table)
        lines = captured.get().splitlines()
        terminal.print("\n".join(map(str.rstrip, lines)), soft_wrap=True)
    terminal.width = width


def show_fitting(
    terminal: Console,
    words: Sequence[str],
    numbers: Sequence[str],
    rows: Sequence[TextRow],
    hidden_first: Sequence[str],
) -> None:
    """Print a table with as many columns as fit into the terminal, and name the hidden ones.

    Args:
        terminal: Where the table is printed.
        words: Headings of text columns, as for `new_table`.
        numbers: Headings of the columns of numbers after them.
        rows: The rows, with a cell for every heading.
        hidden_first: Headings that a narrow terminal hides, the least important first.
    """
    for count in range(len(hidden_first) + 1):
        hidden = hidden_first[:count]
        kept = [at for at, name in enumerate((*words, *numbers)) if name not in hidden]
        table = new_table(
            "",
            [name for name in words if name not in hidden],
            [name for name in numbers if name not in hidden],
        )
        add_rows(table, [tuple(row[at] for at in kept) for row in rows])
        if _width_of(table) <= terminal.width:
            break
    show(terminal, table)
    if count:
        names = ", ".join(hidden_first[:count])
        terminal.print(
            f"columns hidden (narrow terminal): {names}; widen it or redirect the output",
            soft_wrap=True,
        )


def _width_of(table: Table) -> int:
    """Return the smallest width of a table in characters; columns of numbers can wrap."""
    widest, narrowest = map(_widest, table.columns), _narrowest(table)
    return _natural_width(table) - sum(widest) + sum(narrowest)


def _fit(table: Table, width: int) -> None:
    """Set the widths of columns that must wrap: rich would cut words and numbers."""
    widths, narrowest = list(map(_widest, table.columns)), _narrowest(table)
    excess = min(_natural_width(table) - width, sum(widths) - sum(narrowest))
    for _ in range(excess):
        most = max(range(len(widths)), key=lambda at: widths[at] - narrowest[at])
        widths[most] -= 1
        table.columns[most].width = widths[most]


def _natural_width(table: Table) -> int:
    """Return the width of a table in characters without further wrapping."""
    return Console(width=_UNWRAPPED, markup=False).measure(table).maximum


def _widest(column: Column) -> int:
    """Return the width of a column on one line."""
    return max(Text(str(each)).cell_len for each in (column.header, *column.cells))


def _narrowest(table: Table) -> list[int]:
    """Return the smallest widths of the columns: a column of numbers wraps between words.

    The last column never wraps, because versions of rich differ in the padding of its set width.
    """
    *columns, last = table.columns
    widths = []
    for column in columns:
        texts = [str(each) for each in (column.header, *column.cells)]
        words = texts if column.no_wrap else [word for each in texts for word in each.split()]
        widths.append(max((Text(word).cell_len for word in words), default=0))
    return [*widths, _widest(last)]


def _cell(cell: str | MarkedText) -> Text:
    """Return a cell as text for rich."""
    if isinstance(cell, str):
        return Text(one_line(cell))
    return Text.assemble((one_line(cell.text), cell.mark), one_line(cell.rest))
