"""Tables of a comparison as text for terminals, Markdown, LaTeX and CSV."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.numbers import decimals_of, three_decimals, whole_percent
from trajeval_ros.formatting.text_tables import (
    BOLD,
    UNDERLINE,
    MarkedText,
    TextCell,
    csv_table,
    is_within,
    latex_table,
    markdown_table,
)
from trajeval_ros.report.console import Table

UNRANKED = "¶"
_COLUMN_PT, _PAGE_PT = 252.0, 516.0  # of a page with two columns, as IEEE's


@dataclass(frozen=True)
class Cell:
    """One number of a table."""

    value: float | None  # the number, infinite if most runs have none; None if all have none
    note: str = ""  # a remark such as "8/10" or "†"
    is_ranked: bool = True  # whether it can be the best
    why_unranked: str = ""  # why it is not ranked, if others of its column are
    # Whether the ranked numbers of the column compete with it. A better unranked number competes:
    # without it, a worse number would be marked as the best.
    competes: bool = True
    extremes: tuple[float, float] | None = None  # over the trials
    instead: str = ""  # a word that is printed instead of the number: missing, withheld
    decimals: int | None = None  # those of its table; None for those of the number

    @property
    def text(self) -> str:
        """The number as text."""
        return self.instead or self._printed(self.value)

    @property
    def spread(self) -> str:
        """The range over the trials, such as "(0.05–0.32)"; "" without one."""
        return f"({'–'.join(map(self._printed, self.extremes))})" if self.extremes else ""

    def _printed(self, value: float | None) -> str:
        if value is None or self.decimals is None or not math.isfinite(value):
            return three_decimals(value)
        is_seen = value == 0.0 or abs(value) >= 0.5 * 10.0**-self.decimals
        return f"{value:.{self.decimals}f}" if is_seen else three_decimals(value)

    @property
    def compared(self) -> float | None:
        """The number as printed: ranks use the printed digits."""
        known = self.value is not None and math.isfinite(self.value)
        return float(self.text) if known else self.value

    @property
    def marks(self) -> str:
        """The remark, with the mark of a number that is not ranked."""
        is_marked = self.why_unranked and self.value is not None
        return " ".join(filter(None, (self.note, UNRANKED if is_marked else "")))


@dataclass(frozen=True)
class Matrix:
    """A table of algorithms by sequences or lengths; smaller numbers are better."""

    name: str  # name of its file
    title: str  # the quantity with its unit
    notes: tuple[str, ...]  # how to read it, in sentences that other tables may share
    columns: tuple[str, ...]  # headings of the columns
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]  # name and cells of every algorithm
    runs: tuple[str, ...]  # evaluated and planned runs of every algorithm, such as "29/30"
    coverage: tuple[float, ...]  # mean coverage of every algorithm; failed runs count as zero
    brief: str = ""  # caption in LaTeX, one sentence; by default the title
    has_average: bool = False  # whether the mean over the columns is meaningful

    @property
    def caption(self) -> str:
        """All notes as one text."""
        return " ".join(self.notes)

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


def with_equal_decimals(
    rows: Sequence[tuple[str, tuple[Cell, ...]]],
) -> tuple[tuple[str, tuple[Cell, ...]], ...]:
    """Return rows whose numbers have one number of decimals."""
    decimals = decimals_of(cell.value for _, cells in rows for cell in cells)
    return tuple(
        (name, tuple(replace(cell, decimals=decimals) for cell in cells)) for name, cells in rows
    )


def ranked(cells: Sequence[Cell]) -> list[int]:
    """Return the ranks of cells in a column: 1 for the best, 2 for the second, else 0.

    A number that is worse than an unranked one has no rank. Numbers that are printed alike share
    one.
    """
    if sum(cell.value is not None for cell in cells) < 2:
        return [0] * len(cells)
    values = [cell.compared if cell.is_ranked else None for cell in cells]
    better = [cell.compared for cell in cells if cell.why_unranked and cell.competes]
    limit = min((value for value in better if value is not None), default=math.inf)
    places = sorted({value for value in values if value is not None and value < math.inf})[:2]
    best = [value for value in places if value <= limit]
    return [0 if v is None or v not in best else 1 + best.index(v) for v in values]


def _average(cells: Sequence[Cell]) -> Cell:
    """Return the mean of cells, empty if one is empty."""
    values = [cell.value for cell in cells if cell.value is not None]
    if len(values) < len(cells):
        return Cell(None)
    return Cell(
        sum(values) / len(values),
        is_ranked=all(cell.is_ranked for cell in cells),
        why_unranked=next((cell.why_unranked for cell in cells if cell.why_unranked), ""),
        competes=all(cell.competes for cell in cells),
        decimals=max(cell.decimals or 0 for cell in cells) or None,
    )


def with_common_notes(matrices: Sequence[Matrix]) -> tuple[list[Matrix], list[str]]:
    """Return the tables without the notes that several of them have, and these notes once."""
    counts = Counter(note for matrix in matrices for note in matrix.notes)
    common = [note for note, count in counts.items() if count > 1]
    remaining = [tuple(note for note in matrix.notes if note not in common) for matrix in matrices]
    return [
        replace(matrix, notes=notes) for matrix, notes in zip(matrices, remaining, strict=True)
    ], common


def to_terminal(matrix: Matrix) -> Table:
    """Return the table, the best in bold and the second underlined, without the caption."""
    name, *numbers = _headings(matrix)
    return Table(matrix.title, [name], numbers, _body(matrix))


def to_markdown(matrix: Matrix) -> str:
    """Return the table as Markdown, with the caption."""
    table = markdown_table(_headings(matrix), _body(matrix))
    caption = [markdown_text(matrix.caption), ""] if matrix.notes else []
    return "\n".join([f"### {markdown_text(matrix.title)}", "", *table, "", *caption])


def to_latex(matrix: Matrix, *, transpose: bool = False) -> str:
    """Return the table as LaTeX for the booktabs package, with a caption of one sentence.

    A table that is too wide for one column of a page spans both. If it is too wide for these, too,
    it omits the spread of the trials.
    """
    for is_wide, with_spread in ((False, True), (True, True), (True, False)):
        rows = _latex_rows(matrix, transpose=transpose, with_spread=with_spread)
        if is_within(_PAGE_PT if is_wide else _COLUMN_PT, rows, is_wide=is_wide):
            break
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


def _latex_rows(matrix: Matrix, *, transpose: bool, with_spread: bool) -> list[list[TextCell]]:
    """Return headings and rows of a table with the average, or their transpose."""
    columns = [[cells[place] for _, cells in matrix.rows] for place in range(len(matrix.columns))]
    headings = list(matrix.columns)
    if matrix.has_average:
        columns.append(matrix.averages())
        headings.append("average")
    table: list[list[TextCell]] = [
        ["" if transpose else "algorithm", *(name for name, _ in matrix.rows)]
    ]
    for heading, cells in zip(headings, columns, strict=True):
        marked = [_marked(*item, with_spread=with_spread)
                  for item in zip(cells, ranked(cells), strict=True)]  # fmt: skip
        table.append([heading, *marked])
    table.append(["runs", *matrix.runs])
    table.append(["coverage", *map(whole_percent, matrix.coverage)])
    return table if transpose else [list(row) for row in zip(*table, strict=True)]


def to_csv(matrix: Matrix) -> str:
    """Return the numbers with all digits as CSV; empty cells if there is none.

    The last column has the marks: "MH_01 §, MH_05 † ¶".
    """
    rows: list[list[str | float | None]] = []
    of_each = zip(matrix.rows, matrix.runs, matrix.coverage, strict=True)
    for (name, cells), runs, coverage in of_each:
        marked = zip(matrix.columns, cells, strict=True)
        marks = ", ".join(f"{column} {cell.marks}" for column, cell in marked if cell.marks)
        rows.append([name, *(cell.value for cell in cells), runs, coverage, marks])
    return csv_table([*_headings(matrix), "marks"], rows)


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
    rest = " ".join(filter(None, (cell.spread if with_spread else "", cell.marks)))
    return MarkedText(cell.text, ("", BOLD, UNDERLINE)[rank], f" {rest}" if rest else "")
