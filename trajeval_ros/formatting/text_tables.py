"""Tables as text, one writer for each format; every cell passes that format's rule of escaping."""

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
_UNDERSCORE, _BREAKABLE = "\\_", "\\_\\allowbreak{}"


@dataclass(frozen=True)
class MarkedText:
    """A cell that stands out.

    Attributes:
        text: What is marked.
        mark: `BOLD`, `UNDERLINE`, or empty.
        rest: What stands behind it, unmarked.
    """

    text: str
    mark: str = ""
    rest: str = ""


TextCell = str | MarkedText
TextRow = Sequence[TextCell]


def markdown_table(headings: TextRow, rows: Iterable[TextRow]) -> list[str]:
    """Return the lines of a table whose first column is text and whose others are numbers."""
    rule = ["---", *["---:"] * (len(headings) - 1)]
    lines = [_cells(headings, markdown_text, _MARKDOWN), rule]
    lines += [_cells(each, markdown_text, _MARKDOWN) for each in rows]
    return [f"| {' | '.join(each)} |" for each in lines]


def latex_table(
    label: str,
    caption: str,
    headings: TextRow,
    rows: Iterable[TextRow],
    *,
    remarks: Sequence[str] = (),
    is_wide: bool = False,
) -> list[str]:
    """Return the lines of a table for the booktabs package, laid out likewise.

    Args:
        label: A name for references, of letters, digits, - and _.
        caption: What is in it, as plain text.
        headings: Of the columns.
        rows: Cells of each.
        remarks: Sentences for the source, which LaTeX doesn't print.
        is_wide: Make it as wide as a page of two columns, by the tabularx package.
    """
    numbers = len(headings) - 1
    heads = _cells(headings, latex_text, _LATEX)
    size: list[str] = []
    begin, end = f"\\begin{{tabular}}{{l{'r' * numbers}}}", "\\end{tabular}"
    if is_wide:
        # Names of sequences may be broken where they have an underscore.
        heads = [f"\\scriptsize {each.replace(_UNDERSCORE, _BREAKABLE)}" for each in heads]
        size = ["  \\footnotesize", "  \\setlength{\\tabcolsep}{2pt}"]
        right = ">{\\raggedleft\\arraybackslash}X"
        begin = f"\\begin{{tabularx}}{{\\textwidth}}{{l*{{{numbers}}}{{{right}}}}}"
        end = "\\end{tabularx}"
    star = "*" if is_wide else ""
    return [
        "% needs \\usepackage{booktabs" + (",tabularx}" if is_wide else "}"),
        *(f"% {latex_text(each)}" for each in remarks),
        f"\\begin{{table{star}}}",
        "  \\centering",
        *size,
        f"  \\caption{{{latex_text(caption)}}}",
        f"  \\label{{tab:{label.replace('_', '-')}}}",
        f"  {begin}",
        "    \\toprule",
        f"    {' & '.join(heads)} \\\\",
        "    \\midrule",
        *(f"    {' & '.join(_cells(each, latex_text, _LATEX))} \\\\" for each in rows),
        "    \\bottomrule",
        f"  {end}",
        f"\\end{{table{star}}}",
        "",
    ]


def csv_table(headings: Sequence[str], rows: Iterable[Sequence[str | float | None]]) -> str:
    """Return numbers with all their digits and texts; a field is empty where there is nothing."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(map(_csv_field, headings))
    writer.writerows(map(_csv_field, row) for row in rows)
    return stream.getvalue()


def html_table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as HTML."""
    head = "".join(f"<th>{_html(each)}</th>" for each in headings)
    body = "".join(
        "<tr>" + "".join(f"<td>{_html(each)}</td>" for each in row) + "</tr>" for row in rows
    )
    return (
        f"<table><caption>{_html(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _cells(row: TextRow, escaped: Callable[[str], str], marks: dict[str, str]) -> list[str]:
    marked = (each if isinstance(each, MarkedText) else MarkedText(each) for each in row)
    return [marks[each.mark].format(escaped(each.text)) + escaped(each.rest) for each in marked]


def _csv_field(value: str | float | None) -> str:
    if value is None:
        return ""
    return csv_text(value) if isinstance(value, str) else repr(value)


def _html(text: str) -> str:
    return escape(one_line(text))
