"""HTML pages: of an evaluation, and of a comparison with details of its runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting import palette
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import three_decimals, whole_percent
from trajeval_ros.report.matrix import Matrix, with_common_notes

# Largest table on a page; larger ones are slow to display and hard to read.
_MOST_ROWS, _MOST_COLUMNS, _MOST_CELLS = 500, 100, 5000


@dataclass(frozen=True)
class Plot:
    """A figure with its description."""

    title: str  # a short title
    caption: str  # how to read the figure
    svg: str


@dataclass(frozen=True)
class RunPage:
    """The content of one run on a page."""

    algorithm: str
    sequence: str
    trial: str
    status: str  # `ok`, `failed` or `missing`
    reason: str  # why there are no numbers; empty otherwise
    position_m: float | None  # RMSE of the position; None without numbers
    rotation_deg: float | None  # RMSE of the rotation; None without numbers, or if withheld
    coverage: float  # share of the groundtruth's time
    marks: str = ""  # marks of the numbers, as in the tables
    facts: tuple[tuple[str, str], ...] = ()  # names and texts of further results
    headings: tuple[str, ...] = ()  # headings of the statistics
    # Names of errors and their statistics, row by row.
    statistics: tuple[tuple[str, ...], ...] = ()
    warnings: tuple[str, ...] = ()  # warnings about the validity of the numbers
    svgs: tuple[str, ...] = ()  # figures of the run

    def brief(self) -> RunPage:
        """Return the part that a list of runs shows."""
        return dataclasses.replace(self, facts=(), statistics=(), warnings=(), svgs=())


def require_jinja2() -> None:
    """Check that Jinja2, which writes the pages, is installed.

    Raises:
        InputError: It is not installed.
    """
    try:
        import jinja2  # noqa: F401
    except ImportError as error:
        raise InputError(
            "a report needs Jinja2, which is not installed: " + extra_command("compare")
        ) from error


class ReportPages:
    """The pages of one report. They share a style and need no network."""

    def __init__(self, title: str, version: str, state: str) -> None:
        require_jinja2()
        import jinja2

        self._templates = jinja2.Environment(
            loader=jinja2.PackageLoader("trajeval_ros.report"),
            autoescape=True,
            trim_blocks=True,
            lstrip_blocks=True,
            undefined=jinja2.StrictUndefined,
            finalize=_shown,
        )
        self._templates.filters["number"] = three_decimals
        self._templates.filters["coverage"] = whole_percent
        self._templates.globals.update(
            title=title,
            version=version,
            state=state,
            colours={"light": palette.ESTIMATES, "dark": palette.ESTIMATES_ON_DARK},
        )

    def details(self, number: int, run: RunPage) -> str:
        """Return the collapsed details of one run, with the anchor `#runNUMBER`."""
        return self._templates.get_template("run.html.j2").render(number=number, run=run)

    def overview(
        self,
        definition: str,
        findings: Sequence[str],
        matrices: Sequence[Matrix],
        plots: Sequence[Plot],
        runs: Sequence[RunPage],
        links: Sequence[str],
        details: Sequence[str],
        runs_title: str,
    ) -> str:
        """Return the first page."""
        matrices, notes = with_common_notes(matrices)
        beginnings = [_beginning(matrix) for matrix in matrices]
        cut = {
            matrix.name: (
                f"Shown are the first {len(begun.rows)} of {len(matrix.rows)} rows and "
                f"{len(begun.columns)} of {len(matrix.columns)} columns; all are in "
                f"{matrix.name}.csv."
            )
            for matrix, begun in zip(matrices, beginnings, strict=True)
            if begun is not matrix
        }
        return self._templates.get_template("comparison.html.j2").render(
            definition=definition,
            findings=findings,
            notes=[note for note in notes if note != definition],
            matrices=beginnings,
            cut=cut,
            all_ranks={matrix.name: matrix.ranks() for matrix in matrices},
            plots=plots,
            runs=runs,
            links=links,
            details=details,
            runs_title=runs_title,
        )

    def evaluation(
        self,
        headline: Sequence[object],
        plots: Sequence[Plot],
        tables: Sequence[object],
        definitions: Sequence[object],
        messages: Sequence[object],
        command: str,
    ) -> str:
        """Return the page of one evaluation; parts are tables, or lines with their style."""
        return self._templates.get_template("evaluation.html.j2").render(
            headline=headline,
            plots=plots,
            tables=tables,
            definitions=definitions,
            messages=messages,
            command=command,
        )

    def runs(self, name: str, others: Sequence[str], report: str, details: Sequence[str]) -> str:
        """Return a page of details."""
        return self._templates.get_template("runs.html.j2").render(
            name=name, others=others, report=report, details=details
        )


def _beginning(matrix: Matrix) -> Matrix:
    """Return the rows and columns of a table that fit on a page."""
    rows = min(len(matrix.rows), _MOST_ROWS)
    columns = min(len(matrix.columns), _MOST_COLUMNS, max(1, _MOST_CELLS // max(rows, 1)))
    if (rows, columns) == (len(matrix.rows), len(matrix.columns)):
        return matrix
    return dataclasses.replace(
        matrix,
        columns=matrix.columns[:columns],
        rows=tuple((name, cells[:columns]) for name, cells in matrix.rows[:rows]),
    )


def _shown(value: object) -> object:
    """Return a value as it is displayed: text on one line, markup such as figures unchanged."""
    return one_line(value) if type(value) is str else value
