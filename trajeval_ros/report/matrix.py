"""Tables of a comparison, algorithms by columns: terminal, Markdown, LaTeX and CSV."""

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

_MOST_NARROW = 6  # columns of numbers in one column of a page


@dataclass(frozen=True)
class Cell:
    """What a table says of an algorithm in one column.

    Attributes:
        value: The number, infinite where too many runs failed; None where there is nothing.
        note: What stands behind it: "8/10", "†".
        is_ranked: Whether it may be the best: not what leaves out runs that failed, or more of the
            way than others.
        spread: Of the trials, "(0.05–0.32)".
    """

    value: float | None
    note: str = ""
    is_ranked: bool = True
    spread: str = ""

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
        brief: Its caption in LaTeX, of one sentence; by default the title.
        has_average: Whether a mean over the columns means something.
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
        """Return for each cell 1 if it is the best of its column, 2 the second, else 0."""
        by_column = [
            ranked([cells[column] for _, cells in self.rows])
            for column in range(len(self.columns))
        ]
        return [list(each) for each in zip(*by_column, strict=True)]

    def averages(self) -> list[Cell]:
        """Return the mean over each algorithm's columns, none where a column is empty."""
        return [_average(cells) for _, cells in self.rows]


def ranked(cells: Sequence[Cell]) -> list[int]:
    """Return for each of cells that compete 1 if it is the best, 2 the second, else 0."""
    if sum(each.value is not None for each in cells) < 2:
        return [0] * len(cells)
    values = [each.value if each.is_ranked else None for each in cells]
    best = sorted({each for each in values if each is not None and each < math.inf})[:2]
    return [0 if each is None or each not in best else 1 + best.index(each) for each in values]


def _average(cells: Sequence[Cell]) -> Cell:
    values = [each.value for each in cells if each.value is not None]
    if len(values) < len(cells):
        return Cell(None)
    return Cell(sum(values) / len(values), is_ranked=all(each.is_ranked for each in cells))


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


def to_latex(matrix: Matrix, *, transpose: bool = False) -> str:
    """Return the table, likewise, for the booktabs package, with a caption of one sentence.

    A table of many columns takes both columns of a page, and says nothing of the trials' spread.

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
                _marked(*each, with_spread=not is_wide)
                for each in zip(cells, ranked(cells), strict=True)
            ),
        ]
        for heading, cells in zip(headings, columns, strict=True)
    ]
    by_column.append(["runs", *matrix.runs])
    by_column.append(["coverage", *map(whole_percent, matrix.coverage)])
    corner = "" if transpose else "algorithm"
    table: list[list[TextCell]] = [[corner, *names], *by_column]
    rows = table if transpose else [list(each) for each in zip(*table, strict=True)]
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
    rows: list[list[TextCell]] = []
    for place, ((name, cells), ranks) in enumerate(zip(matrix.rows, matrix.ranks(), strict=True)):
        texts = [_marked(*each) for each in zip(cells, ranks, strict=True)]
        rows.append([name, *texts, matrix.runs[place], whole_percent(matrix.coverage[place])])
    return rows


def _marked(cell: Cell, rank: int, *, with_spread: bool = True) -> MarkedText:
    rest = " ".join(filter(None, (cell.spread if with_spread else "", cell.note)))
    return MarkedText(cell.text, ("", BOLD, UNDERLINE)[rank], f" {rest}" if rest else "")
