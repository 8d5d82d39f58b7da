"""A comparison as HTML pages: one, and more of them where runs are many."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting import palette
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import three_decimals, whole_percent
from trajeval_ros.report.matrix import Matrix

# Of a table on a page; more of it takes browsers long and people longer.
_MOST_ROWS, _MOST_COLUMNS, _MOST_CELLS = 500, 100, 5000


@dataclass(frozen=True)
class Plot:
    """A figure with what it shows.

    Attributes:
        title: In few words.
        caption: How to read it.
        svg: The figure itself.
    """

    title: str
    caption: str
    svg: str


@dataclass(frozen=True)
class RunPage:
    """What the page says of one run.

    Attributes:
        algorithm, sequence, trial: Which.
        status: `ok`, `failed` or `missing`.
        reason: Why there are no numbers.
        position_m: rmse of the absolute error; None without numbers.
        rotation_deg: Likewise; None also where withheld.
        coverage: Of the groundtruth's time.
        facts: Name and text of what else is known.
        headings: Of the statistics.
        statistics: Error and its statistics, row by row.
        warnings: What a reader of the numbers must know.
        svgs: Its figures.
    """

    algorithm: str
    sequence: str
    trial: str
    status: str
    reason: str
    position_m: float | None
    rotation_deg: float | None
    coverage: float
    facts: tuple[tuple[str, str], ...] = ()
    headings: tuple[str, ...] = ()
    statistics: tuple[tuple[str, ...], ...] = ()
    warnings: tuple[str, ...] = ()
    svgs: tuple[str, ...] = ()

    def brief(self) -> RunPage:
        """Return what a list of runs shows of it."""
        return dataclasses.replace(self, facts=(), statistics=(), warnings=(), svgs=())


class ReportPages:
    """The pages of one report: they share their look, and need nothing else, online or off."""

    def __init__(self, title: str, version: str, state: str) -> None:
        """Prepare to write pages.

        Args:
            title: Of the comparison.
            version: Of this program.
            state: Hash of what the tables were made from, to know the report of other tables by.

        Raises:
            InputError: Jinja2 is not installed.
        """
        try:
            import jinja2
        except ImportError as error:
            raise InputError(
                "a report needs Jinja2, which is not installed: " + extra_command("compare")
            ) from error
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
        """Return what is said of one run, to be unfolded; `#runNUMBER` leads there."""
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
        """Return the first page.

        Args:
            definition: What all numbers depend on.
            findings: What it says, a sentence each.
            matrices: The tables; of large ones the start is shown.
            plots: The figures.
            runs: Those that are listed, the failed ones included.
            links: To the details of each of them.
            details: Those that stand on this page.
            runs_title: What the list of runs is called.
        """
        beginnings = [_beginning(each) for each in matrices]
        cut = {
            each.name: (
                f"Shown are the first {len(begun.rows)} of {len(each.rows)} rows and "
                f"{len(begun.columns)} of {len(each.columns)} columns; all are in "
                f"{each.name}.csv."
            )
            for each, begun in zip(matrices, beginnings, strict=True)
            if begun is not each
        }
        return self._templates.get_template("comparison.html.j2").render(
            definition=definition,
            findings=findings,
            matrices=beginnings,
            cut=cut,
            all_ranks={each.name: each.ranks() for each in matrices},
            plots=plots,
            runs=runs,
            links=links,
            details=details,
            runs_title=runs_title,
        )

    def runs(self, name: str, others: Sequence[str], report: str, details: Sequence[str]) -> str:
        """Return a page of details.

        Args:
            name: Of its file.
            others: Names of all such pages' files, this one included.
            report: Name of the first page's file, in the folder above.
            details: Of its runs.
        """
        return self._templates.get_template("runs.html.j2").render(
            name=name, others=others, report=report, details=details
        )


def _beginning(matrix: Matrix) -> Matrix:
    """Return as much of a table as a page can hold."""
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
    """Return what the page shows of a value; markup, such as a figure, stays as it is."""
    return one_line(value) if type(value) is str else value
