"""The page of an evaluation: result lines, figures, tables, definitions, messages, command."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

from trajeval_ros import __version__
from trajeval_ros.report import evaluation_text
from trajeval_ros.report.comparison_page import Plot, ReportPages
from trajeval_ros.report.console import Console, Table

if TYPE_CHECKING:
    from trajeval_ros.pipeline.outcome import Outcome
    from trajeval_ros.report.canvas import Drawing

_WIDE = 10_000  # columns of characters; tables have all statistics
_WIDTH_IN = 4.6  # of figures, of which a page shows two side by side


def evaluation_page(outcome: Outcome, drawings: Mapping[str, Drawing], command: str) -> str:
    """Return the page; it needs no network. `drawings`: its figures by name."""
    names = ", ".join(run.estimate.name or "estimate" for run in outcome.runs)
    title = f"{names} against {outcome.groundtruth.name or 'groundtruth'}"
    headline, tables, definitions, messages = (PageConsole() for _ in range(4))
    evaluation_text.print_verdicts(headline, outcome)
    evaluation_text.print_tables(tables, outcome)
    evaluation_text.print_definitions(definitions, outcome)
    evaluation_text.print_remarks(messages, outcome.runs)
    for failure in outcome.failed:
        messages.remark("warning", f"{failure.name}: {failure.reason}")
    return ReportPages(title, __version__, "").evaluation(
        headline.parts, _plots(drawings), tables.parts, definitions.parts, messages.parts, command
    )


class PageConsole(Console):
    """A console that keeps lines, with their styles, and tables for a page."""

    def __init__(self) -> None:
        super().__init__(io.StringIO(), _WIDE, is_terminal=False)
        self.parts: list[tuple[str, str] | Table] = []  # text and style of lines

    def print(self, text: str = "", style: str = "", *, soft_wrap: bool = False) -> None:  # noqa: ARG002
        """Keep a line; empty ones are left out."""
        if text:
            self.parts.append((text, style))

    def remark(self, level: str, text: str) -> None:
        """Keep a remark with its level as style."""
        self.parts.append((text, level))

    def show_rows(self, table: Table) -> None:
        """Keep a table."""
        self.parts.append(table)


def _plots(drawings: Mapping[str, Drawing]) -> list[Plot]:
    """Draw the figures; the first line of a title is the heading, the others the caption."""
    if not drawings:
        return []
    from trajeval_ros.report.figure_output import hide_title
    from trajeval_ros.report.figure_style import FigureStyle, apply_style
    from trajeval_ros.report.page_figures import page_figure

    plots = []
    with apply_style(FigureStyle(width_in=_WIDTH_IN)):
        for name, draw in drawings.items():
            figure = draw()
            title, *lines = str(figure.get_label()).split("\n")
            caption = ". ".join(lines)
            hide_title(figure)
            plots.append(Plot(title or name, caption, page_figure(figure, title or name)))
    return plots
