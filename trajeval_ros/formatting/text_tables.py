"""Tables as text, with one writer per format; every cell is escaped for its format."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape

from trajeval_ros.formatting.escaping import csv_text, latex_text, markdown_text, one_line

BOLD, UNDERLINE = "bold", "underline"
_MARKDOWN = {"": "{}", BOLD: "**{}**", UNDERLINE: "<u>{}</u>"}
_LATEX = {"": "{}", BOLD: "\\textbf{{{}}}", UNDERLINE: "\\underline{{{}}}"}
# The mean width of a character in \footnotesize, and the space between columns.
_CHARACTER_PT, _COLUMN_GAP_PT = 3.8, 4.0
_UNDERSCORE, _BREAKABLE = "\\_", "\\_\\allowbreak{}"


@dataclass(frozen=True)
class MarkedText:
    """A cell with a mark."""

    text: str
    mark: str = ""  # `BOLD`, `UNDERLINE`, or empty
    rest: str = ""  # unmarked text after it


TextCell = str | MarkedText
TextRow = Sequence[TextCell]


def markdown_table(headings: TextRow, rows: Iterable[TextRow]) -> list[str]:
    """Return the lines of a table: text in the first column, numbers in the others."""
    rule = ["---", *["---:"] * (len(headings) - 1)]
    lines = [_cells(headings, markdown_text, _MARKDOWN), rule]
    lines += [_cells(row, markdown_text, _MARKDOWN) for row in rows]
    return [f"| {' | '.join(line)} |" for line in lines]


def latex_table(
    label: str,
    caption: str,
    headings: TextRow,
    rows: Iterable[TextRow],
    *,
    remarks: Sequence[str] = (),
    is_wide: bool = False,
) -> list[str]:
    """Return the lines of a table for the booktabs package; the first column is text.

    `label`: name for references: letters, digits, - and _.
    """
    numbers = len(headings) - 1
    heads = _cells(headings, latex_text, _LATEX)
    begin, end = f"\\begin{{tabular}}{{l{'r' * numbers}}}", "\\end{tabular}"
    if is_wide:
        # Names of sequences can be broken at underscores.
        heads = [f"\\scriptsize {head.replace(_UNDERSCORE, _BREAKABLE)}" for head in heads]
        right = ">{\\raggedleft\\arraybackslash}X"
        begin = f"\\begin{{tabularx}}{{\\textwidth}}{{l*{{{numbers}}}{{{right}}}}}"
        end = "\\end{tabularx}"
    star = "*" if is_wide else ""
    return [
        "% needs \\usepackage{booktabs" + (",tabularx}" if is_wide else "}"),
        *(f"% {latex_text(remark)}" for remark in remarks),
        f"\\begin{{table{star}}}",
        "  \\centering",
        "  \\footnotesize",
        f"  \\setlength{{\\tabcolsep}}{{{_COLUMN_GAP_PT / 2:g}pt}}",
        f"  \\caption{{{latex_text(caption)}}}",
        f"  \\label{{tab:{label.replace('_', '-')}}}",
        f"  {begin}",
        "    \\toprule",
        f"    {' & '.join(heads)} \\\\",
        "    \\midrule",
        *(f"    {' & '.join(_cells(row, latex_text, _LATEX))} \\\\" for row in rows),
        "    \\bottomrule",
        f"  {end}",
        f"\\end{{table{star}}}",
        "",
    ]


def is_within(width_pt: float, rows: Sequence[TextRow], *, is_wide: bool) -> bool:
    """Return whether the rows of `latex_table`, headings first, fit in a width, approximately."""
    widths = []
    for place, column in enumerate(zip(*rows, strict=True)):
        cells = column[place > 0 and is_wide :]  # headings of a wide table are broken
        texts = (cell if isinstance(cell, str) else cell.text + cell.rest for cell in cells)
        widths.append(_CHARACTER_PT * max(map(len, texts)) + _COLUMN_GAP_PT)
    numbers = max(widths[1:]) * len(widths[1:]) if is_wide else sum(widths[1:])
    return widths[0] + numbers <= width_pt


def csv_table(headings: Sequence[str], rows: Iterable[Sequence[str | float | None]]) -> str:
    """Return numbers with all digits and texts as CSV; None is an empty field."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(map(_csv_field, headings))
    writer.writerows(map(_csv_field, row) for row in rows)
    return stream.getvalue()


def html_table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as HTML."""
    head = "".join(f"<th>{_html(heading)}</th>" for heading in headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{_html(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f"<table><caption>{_html(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _cells(row: TextRow, escaped: Callable[[str], str], marks: dict[str, str]) -> list[str]:
    """Return the cells of a row with escaped text and a format's marks."""
    marked = (cell if isinstance(cell, MarkedText) else MarkedText(cell) for cell in row)
    return [marks[cell.mark].format(escaped(cell.text)) + escaped(cell.rest) for cell in marked]


def _csv_field(value: str | float | None) -> str:
    if value is None:
        return ""
    return csv_text(value) if isinstance(value, str) else repr(value)


def _html(text: str) -> str:
    return escape(one_line(text))
