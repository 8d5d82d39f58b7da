"""A comparison as one HTML page that needs nothing else, online or off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import three_decimals, whole_percent
from trajeval_ros.report.matrix import Matrix


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


def render(
    title: str,
    definition: str,
    findings: Sequence[str],
    matrices: Sequence[Matrix],
    plots: Sequence[Plot],
    runs: Sequence[RunPage],
    version: str,
    state: str,
) -> str:
    """Return the page.

    Args:
        title: Of the comparison.
        definition: What all numbers depend on.
        findings: What it says, a sentence each.
        matrices: The tables.
        plots: The figures.
        runs: All runs, the failed ones included.
        version: Of this program.
        state: Hash of what the tables were made from, to know the report of other tables by.

    Raises:
        InputError: Jinja2 is not installed.
    """
    try:
        import jinja2
    except ImportError as error:
        raise InputError(
            "a report needs Jinja2, which is not installed: pip install 'trajeval-ros[compare]'"
        ) from error
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("trajeval_ros.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        finalize=_shown,
    )
    environment.filters["number"] = three_decimals
    environment.filters["coverage"] = whole_percent
    return environment.get_template("comparison.html.j2").render(
        title=title,
        definition=definition,
        findings=findings,
        matrices=matrices,
        plots=plots,
        runs=runs,
        version=version,
        state=state,
    )


def _shown(value: object) -> object:
    """Return what the page shows of a value; markup, such as a figure, stays as it is."""
    return one_line(value) if type(value) is str else value
