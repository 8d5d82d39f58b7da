"""Figures of a comparison as files, for a paper."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

from trajeval_ros.batch.comparison_summary import ComparisonSummary
from trajeval_ros.batch.drawing import Advance, draw_all
from trajeval_ros.batch.executors import Pool
from trajeval_ros.batch.overview_figures import FigureDraft, drafts_of, error_drafts
from trajeval_ros.batch.record_store import RECORDS, RecordStore
from trajeval_ros.io.writing import refused_by_disk
from trajeval_ros.report import canvas
from trajeval_ros.report.comparison_figures import figure_of
from trajeval_ros.report.figure_output import save_all
from trajeval_ros.report.figure_style import FigureStyle

FIGURES = "figures"


def write_figure_files(
    folder: Path,
    summary: ComparisonSummary,
    style: FigureStyle,
    pool: Pool,
    advance: Advance = lambda done, total: None,
) -> Path:
    """Write the figures of the report, and errors over time, into a folder `figures`.

    Args:
        folder: Folder of the comparison.
        summary: Its results.
        style: Formats and style.
        pool: Processes of this machine.
        advance: Called with the number of drawn figures and of all.

    Returns:
        The folder.

    Raises:
        InputError: They can't be written, or matplotlib is not installed.
    """
    figures = folder / FIGURES
    with refused_by_disk(f"the folder {figures}"):
        figures.mkdir(exist_ok=True)
    records = RecordStore(folder / RECORDS)
    drafts = [*drafts_of(summary, records), *error_drafts(summary, records)]
    draw_all([partial(_write, each, figures, style) for each in drafts], pool, advance)
    return figures


def _write(draft: FigureDraft, folder: Path, style: FigureStyle) -> str:
    name = re.sub(r"[^\w.-]+", "_", draft.name)
    save_all(
        {name: partial(canvas.titled, partial(figure_of, draft.plot), draft.title)}, folder, style
    )
    return name
