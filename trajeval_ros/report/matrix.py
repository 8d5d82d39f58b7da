"""Tables of a comparison as text for terminals, Markdown, LaTeX and CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.numbers import three_decimals, whole_percent
from trajeval_ros.formatting.text_tables import (
    BOLD,
    UNDERLINE,
    MarkedText,
    TextCell,
    csv_table,
    latex_table,
    markdown_table,
)
from trajeval_ros.report.console import add_rows, new_table

if TYPE_CHECKING:
    from rich.table import Table

_MOST_NARROW = 6  # columns of numbers that fit into one column of a two-column page


@dataclass(frozen=True)
class Cell:
    """One number of a table.

    Attributes:
        value: The number, infinite if too many runs failed; None if there is none.
        note: A remark such as "8/10" or "†".
        is_ranked: Whether it can be the best. It cannot if failed runs are left out, or if its
            coverage is lower than that of others.
        spread: Range over the trials, such as "(0.05–0.32)".
    """

    value: float | None
    note: str = ""
    is_ranked: bool = True
    spread: str = ""

    @property
    def text(self) -> str:
        """The number as text."""
        return three_decimals(self.value)


@dataclass(frozen=True)
class Matrix:
    """A table of algorithms by sequences or lengths; smaller numbers are better.

    Attributes:
        name: Name of its file.
        title: The quantity with its unit.
        caption: The definition of the numbers.
        columns: Headings of the columns.
        rows: Name and cells of every algorithm.
        runs: Evaluated and planned runs of every algorithm, such as "29/30".
        coverage: Mean coverage of every algorithm; failed runs count as zero.
        brief: Caption in LaTeX, one sentence; by default the title.
        has_average: Whether the mean over the columns is meaningful.
    """

    name: str
    title: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    runs: tuple[str, ...]
    coverage: tuple[float, ...]
    brief: str = ""
    has_average: bool = False

    def ranks(self) -> list[list[int]]:
        """Return the ranks of cells in their columns: 1 for the best, 2 for the second, else 0."""
        by_column = [
            ranked([cells[column] for _, cells in self.rows])
            for column in range(len(self.columns))
        ]
        return [list(row) for row in zip(*by_column, strict=True)]

    def averages(self) -> list[Cell]:
        """Return the mean over the columns of every algorithm, empty if a column is."""
        return [_average(cells) for _, cells in self.rows]


def ranked(cells: Sequence[Cell]) -> list[int]:
    """Return the ranks of competing cells: 1 for the best, 2 for the second, else 0."""
    if sum(cell.value is not None for cell in cells) < 2:
        return [0] * len(cells)
    values = [cell.value if cell.is_ranked else None for cell in cells]
    best = sorted({value for value in values if value is not None and value < math.inf})[:2]
    return [0 if v is None or v not in best else 1 + best.index(v) for v in values]


def _average(cells: Sequence[Cell]) -> Cell:
    """Return the mean of cells, empty if one is empty."""
    values = [cell.value for cell in cells if cell.value is not None]
    if len(values) < len(cells):
        return Cell(None)
    return Cell(sum(values) / len(values), is_ranked=all(cell.is_ranked for cell in cells))


def to_terminal(matrix: Matrix) -> Table:
    """Return the table, the best in bold and the second underlined, without the caption."""
    name, *numbers = _headings(matrix)
    table = new_table(matrix.title, [name], numbers)
    add_rows(table, _body(matrix))
    return table


def to_markdown(matrix: Matrix) -> str:
    """Return the table as Markdown, with the caption."""
    table = markdown_table(_headings(matrix), _body(matrix))
    title, caption = markdown_text(matrix.title), markdown_text(matrix.caption)
    return "\n".join([f"### {title}", "", *table, "", caption, ""])


def to_latex(matrix: Matrix, *, transpose: bool = False) -> str:
    """Return the table as LaTeX for the booktabs package, with a caption of one sentence.

    A table with many columns spans both columns of a page and omits the spread of the trials.

    Args:
        matrix: The table.
        transpose: Make the algorithms its columns.
    """
    names = [name for name, _ in matrix.rows]
    columns = [[cells[place] for _, cells in matrix.rows] for place in range(len(matrix.columns))]
    headings = list(matrix.columns)
    if matrix.has_average:
        columns.append(matrix.averages())
        headings.append("average")
    across = names if transpose else headings
    is_wide = len(across) > _MOST_NARROW
    by_column: list[list[TextCell]] = [
        [
            heading,
            *(
                _marked(*ranked_cell, with_spread=not is_wide)
                for ranked_cell in zip(cells, ranked(cells), strict=True)
            ),
        ]
        for heading, cells in zip(headings, columns, strict=True)
    ]
    by_column.append(["runs", *matrix.runs])
    by_column.append(["coverage", *map(whole_percent, matrix.coverage)])
    corner = "" if transpose else "algorithm"
    table: list[list[TextCell]] = [[corner, *names], *by_column]
    rows = table if transpose else [list(row) for row in zip(*table, strict=True)]
    return "\n".join(
        latex_table(
            matrix.name,
            matrix.brief or matrix.title,
            rows[0],
            rows[1:],
            remarks=[matrix.caption],
            is_wide=is_wide,
        )
    )


def to_csv(matrix: Matrix) -> str:
    """Return the numbers with all digits as CSV; empty cells if there is none."""
    rows = (
        [name, *(cell.value for cell in cells), runs, coverage]
        for (name, cells), runs, coverage in zip(
            matrix.rows, matrix.runs, matrix.coverage, strict=True
        )
    )
    return csv_table(_headings(matrix), rows)


def _headings(matrix: Matrix) -> list[str]:
    return ["algorithm", *matrix.columns, "runs", "coverage"]


def _body(matrix: Matrix) -> list[list[TextCell]]:
    """Return the rows as text cells with marks for the ranks."""
    rows: list[list[TextCell]] = []
    for place, ((name, cells), ranks) in enumerate(zip(matrix.rows, matrix.ranks(), strict=True)):
        texts = [_marked(*ranked_cell) for ranked_cell in zip(cells, ranks, strict=True)]
        rows.append([name, *texts, matrix.runs[place], whole_percent(matrix.coverage[place])])
    return rows


def _marked(cell: Cell, rank: int, *, with_spread: bool = True) -> MarkedText:
    """Return a cell as text with the mark of its rank."""
    rest = " ".join(filter(None, (cell.spread if with_spread else "", cell.note)))
    return MarkedText(cell.text, ("", BOLD, UNDERLINE)[rank], f" {rest}" if rest else "")
