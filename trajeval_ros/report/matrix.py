"""Tables of a comparison, algorithms by columns: terminal, Markdown, LaTeX and CSV."""

from __future__ import annotations

import math
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


@dataclass(frozen=True)
class Cell:
    """What a table says of an algorithm in one column.

    Attributes:
        value: The number, infinite where too many runs failed; None where there is nothing.
        note: What stands behind it: "(0.05–0.32)", "8/10", "†".
        is_ranked: Whether it may be the best: not what leaves out runs that failed.
    """

    value: float | None
    note: str = ""
    is_ranked: bool = True

    @property
    def text(self) -> str:
        """The number as read by people."""
        return three_decimals(self.value)


@dataclass(frozen=True)
class Matrix:
    """A table of algorithms by sequences or lengths; smaller is better.

    Attributes:
        name: For a file.
        title: What is measured, with its unit.
        caption: The definition: a number without it is not a result.
        columns: Headings of the cells.
        rows: Name and cells of each algorithm.
        runs: Of each algorithm, "29/30": evaluated, and how many there should be.
        coverage: Of each algorithm, mean share of the groundtruth's time, failed runs as zeros.
    """

    name: str
    title: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    runs: tuple[str, ...]
    coverage: tuple[float, ...]

    def ranks(self) -> list[list[int]]:
        """Return for each cell 1 if it is the best of its column, 2 the second, else 0."""
        ranks = [[0] * len(self.columns) for _ in self.rows]
        for column in range(len(self.columns)):
            cells_here = [cells[column] for _, cells in self.rows]
            values = [each.value if each.is_ranked else None for each in cells_here]
            distinct = sorted({each for each in values if each is not None and each < math.inf})
            if sum(each.value is not None for each in cells_here) < 2:
                continue
            for row, value in enumerate(values):
                if value in distinct[:2]:
                    ranks[row][column] = distinct.index(value) + 1
        return ranks


def to_terminal(matrix: Matrix) -> Table:
    """Return the table with the best in bold and the second underlined, without its caption."""
    name, *numbers = _headings(matrix)
    table = new_table(matrix.title, [name], numbers)
    add_rows(table, _body(matrix))
    return table


def to_markdown(matrix: Matrix) -> str:
    """Return the table, likewise, with its caption."""
    table = markdown_table(_headings(matrix), _body(matrix))
    title, caption = markdown_text(matrix.title), markdown_text(matrix.caption)
    return "\n".join([f"### {title}", "", *table, "", caption, ""])


def to_latex(matrix: Matrix) -> str:
    """Return the table, likewise, for the booktabs package."""
    caption = f"{matrix.title}. {matrix.caption}"
    return "\n".join(latex_table(matrix.name, caption, _headings(matrix), _body(matrix)))


def to_csv(matrix: Matrix) -> str:
    """Return the numbers with all their digits; empty where there is none."""
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
    """Return the rows as texts, marked by rank."""
    marks = ("", BOLD, UNDERLINE)
    rows: list[list[TextCell]] = []
    for place, ((name, cells), ranks) in enumerate(zip(matrix.rows, matrix.ranks(), strict=True)):
        texts = [
            MarkedText(cell.text, marks[rank], f" {cell.note}" if cell.note else "")
            for cell, rank in zip(cells, ranks, strict=True)
        ]
        rows.append([name, *texts, matrix.runs[place], whole_percent(matrix.coverage[place])])
    return rows
