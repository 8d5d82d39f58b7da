"""Tables of a comparison, algorithms by columns: terminal, Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trajeval_ros.report.numbers import coverage_text, number_text
from trajeval_ros.report.tables import new_table

if TYPE_CHECKING:
    from rich.table import Table

_LATEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "–": "--", "†": r"$^\dagger$", "×": r"$\times$",
    **{each: f"\\{each}" for each in "&%$#_{}"},
}  # fmt: skip


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
        if self.value is None:
            return "-"
        if math.isinf(self.value):
            return "failed"
        return number_text(self.value)


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
    from rich.text import Text

    styles = ("", "bold", "underline")
    table = new_table(matrix.title)
    table.add_column("algorithm", no_wrap=True)
    for heading in (*matrix.columns, "runs", "coverage"):
        table.add_column(heading, justify="right")
    for place, ((name, cells), ranks) in enumerate(zip(matrix.rows, matrix.ranks(), strict=True)):
        texts = [
            Text.assemble((cell.text, styles[rank]), f" {cell.note}" if cell.note else "")
            for cell, rank in zip(cells, ranks, strict=True)
        ]
        table.add_row(name, *texts, matrix.runs[place], coverage_text(matrix.coverage[place]))
    return table


def to_markdown(matrix: Matrix) -> str:
    """Return the table with the best in bold and the second underlined."""
    marks: tuple[Callable[[str], str], ...] = (
        lambda text: text,
        lambda text: f"**{text}**",
        lambda text: f"<u>{text}</u>",
    )
    return "\n".join(
        [
            f"### {matrix.title}",
            "",
            *markdown_table(["algorithm", *matrix.columns, "runs", "coverage"], [
                [markdown_text(each) for each in row] for row in _body(matrix, marks)
            ]),
            "",
            matrix.caption,
            "",
        ]
    )  # fmt: skip


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table whose first column is text and whose others are numbers."""
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]
    return [f"| {' | '.join(each)} |" for each in lines]


def markdown_text(text: str) -> str:
    """Return a text that doesn't end a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")


def to_latex(matrix: Matrix) -> str:
    """Return a table for the booktabs package, the best bold and the second underlined."""
    marks: tuple[Callable[[str], str], ...] = (
        lambda text: text,
        lambda text: f"\\textbf{{{text}}}",
        lambda text: f"\\underline{{{text}}}",
    )
    headings = ["algorithm", *matrix.columns, "runs", "coverage"]
    rows = [
        f"    {' & '.join(row)} \\\\" for row in _body(matrix, marks, latex_text)
    ]  # the marks are LaTeX already
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            "\\begin{table}",
            "  \\centering",
            f"  \\caption{{{latex_text(matrix.title)}. {latex_text(matrix.caption)}}}",
            f"  \\label{{tab:{matrix.name.replace('_', '-')}}}",
            f"  \\begin{{tabular}}{{l{'r' * (len(headings) - 1)}}}",
            "    \\toprule",
            f"    {' & '.join(map(latex_text, headings))} \\\\",
            "    \\midrule",
            *rows,
            "    \\bottomrule",
            "  \\end{tabular}",
            "\\end{table}",
            "",
        ]
    )


def latex_text(text: str) -> str:
    """Return a text as LaTeX prints it."""
    return re.sub(".", lambda match: _LATEX.get(match[0], match[0]), text)


def to_csv(matrix: Matrix) -> str:
    """Return the numbers with all their digits; empty where there is none."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["algorithm", *matrix.columns, "runs", "coverage"])
    for place, (name, cells) in enumerate(matrix.rows):
        values = ["" if cell.value is None else repr(cell.value) for cell in cells]
        writer.writerow([name, *values, matrix.runs[place], repr(matrix.coverage[place])])
    return stream.getvalue()


def _body(
    matrix: Matrix,
    marks: Sequence[Callable[[str], str]],
    escape: Callable[[str], str] = lambda text: text,
) -> list[list[str]]:
    """Return the rows as texts, marked by rank."""
    rows = []
    for place, ((name, cells), ranks) in enumerate(zip(matrix.rows, matrix.ranks(), strict=True)):
        texts = [
            " ".join(filter(None, (marks[rank](escape(cell.text)), escape(cell.note))))
            for cell, rank in zip(cells, ranks, strict=True)
        ]
        coverage = escape(coverage_text(matrix.coverage[place]))
        rows.append([escape(name), *texts, escape(matrix.runs[place]), coverage])
    return rows
