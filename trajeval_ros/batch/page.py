"""The report of a comparison on disk: one page, and further pages for many runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

from trajeval_ros import __version__
from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.finished_comparison import RUNS
from trajeval_ros.batch.overview_figures import (
    MOST_ALGORITHMS,
    MOST_SEQUENCES,
    FigureDraft,
    absolute_drafts,
    sequence_drafts,
)
from trajeval_ros.batch.record_store import RECORDS, RecordStore
from trajeval_ros.batch.results_table import OK, state_of
from trajeval_ros.batch.run_details import run_pages
from trajeval_ros.batch.summary_tables import definition, matrices
from trajeval_ros.formatting.numbers import counted, whole_percent
from trajeval_ros.io.writing import refused_by_disk, write_text
from trajeval_ros.report.comparison_page import Plot, ReportPages
from trajeval_ros.report.comparison_plots import BoxPlot, PathsPlot
from trajeval_ros.report.page_figures import box_svg, paths_svg

REPORT, PAGES = "report.html", "report"
_HEAD_BYTES = 2000
_MOST_DETAILS = 1000  # runs with figures and statistics
_MOST_ON_A_PAGE = 100
# Limit of details on a page and of figures on the first one; a page stays below 5 MB.
_MOST_BYTES = 2_000_000


def write_report(
    folder: Path,
    summary: ComparisonSummary,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write the report of a comparison into its folder.

    Args:
        folder: Folder of the comparison.
        summary: Its results.
        advance: Called with the number of runs whose details are written, and of all.

    Raises:
        InputError: It can't be written, or Jinja2 is not installed.
    """
    pages = ReportPages(summary.title, __version__, state_of(folder / RUNS))
    records = RecordStore(folder / RECORDS)
    shown = _shown(summary.trials)
    runs, details = [], []
    for number, run in enumerate(run_pages(folder, summary, records, shown), 1):
        details.append(pages.details(number, run))
        runs.append(run.brief())
        advance(number, len(shown))
    plots, drawn = _plots(summary, records)
    parts = _parts(details)
    names = [f"runs_{number}.html" for number in range(1, len(parts) + 1)]
    on_first_page = len(parts) == 1
    with refused_by_disk(f"the folder {folder / PAGES}"):
        _remove_pages(folder / PAGES)
        if not on_first_page:
            (folder / PAGES).mkdir(exist_ok=True)
    links = []
    for name, part in zip(names, parts, strict=True):
        where = "" if on_first_page else f"{PAGES}/{name}"
        links += [f"{where}#run{place + 1}" for place in part]
        if not on_first_page:
            inside = details[part.start : part.stop]
            write_text(folder / PAGES / name, pages.runs(name, names, REPORT, inside))
    text = pages.overview(
        definition(summary.settings),
        _findings(summary, drawn),
        matrices(summary),
        plots,
        runs,
        links,
        details if on_first_page else (),
        "All runs" if len(shown) == len(summary.trials) else "Runs that stand out",
    )
    write_text(folder / REPORT, text)  # last: its existence states that the report is complete
    return folder / REPORT


def is_drawn(folder: Path) -> bool:
    """Return whether the report belongs to the tables, by their hash, not by file times."""
    state = state_of(folder / RUNS)
    try:
        with (folder / REPORT).open("rb") as file:
            return bool(state) and state.encode() in file.read(_HEAD_BYTES)
    except FileNotFoundError:
        return False


def _shown(trials: Sequence[Trial]) -> list[Trial]:
    """Return the runs with details, in their order: all, or failed and inaccurate ones."""
    if len(trials) <= _MOST_DETAILS:
        return list(trials)
    by_sequence: dict[str, list[float]] = {}
    for each in trials:
        if "position_m" in each.rmse:
            by_sequence.setdefault(each.sequence, []).append(each.rmse["position_m"])
    usual = {sequence: median(errors) for sequence, errors in by_sequence.items()}

    def standing_out(place: int) -> tuple[bool, float]:
        each = trials[place]
        error = each.rmse.get("position_m", 0.0)
        return each.status != OK, error / (usual.get(each.sequence) or 1.0)

    order = sorted(range(len(trials)), key=standing_out, reverse=True)
    return [trials[place] for place in sorted(order[:_MOST_DETAILS])]


def _plots(summary: ComparisonSummary, records: RecordStore) -> tuple[list[Plot], int]:
    """Return the figures of all runs together, and the number of sequences in them."""
    absolute = [_drawn(each) for each in absolute_drafts(summary)]
    boxes: list[Plot] = []
    paths: list[Plot] = []
    size = count = 0
    for sequence in summary.sequences[:MOST_SEQUENCES]:
        drafts = list(sequence_drafts(summary, records, sequence))
        plots = list(map(_drawn, drafts))
        size += sum(len(each.svg) for each in plots)
        if size > _MOST_BYTES:
            break
        count += 1
        for draft, plot in zip(drafts, plots, strict=True):
            (boxes if isinstance(draft.plot, BoxPlot) else paths).append(plot)
    return [*absolute, *boxes, *paths], count


def _drawn(draft: FigureDraft) -> Plot:
    assert isinstance(draft.plot, BoxPlot | PathsPlot)
    svg = box_svg(draft.plot) if isinstance(draft.plot, BoxPlot) else paths_svg(draft.plot)
    return Plot(draft.title, draft.caption, svg)


def _parts(details: Sequence[str]) -> list[range]:
    """Return the details of each page; a single page if they are few and small."""
    parts, first, size = [], 0, 0
    for place, each in enumerate(details):
        if place - first == _MOST_ON_A_PAGE or (size + len(each) > _MOST_BYTES and size):
            parts.append(range(first, place))
            first, size = place, 0
        size += len(each)
    return [*parts, range(first, len(details))]


def _remove_pages(folder: Path) -> None:
    """Remove the pages of a previous report."""
    for each in folder.glob("runs_*.html"):
        each.unlink()
    with contextlib.suppress(OSError):  # it does not exist, or has other files
        folder.rmdir()


def _findings(summary: ComparisonSummary, drawn: int) -> list[str]:
    """Return the main findings."""
    trials = summary.trials
    lost = [trial for trial in trials if trial.status != OK]
    findings = [
        f"{counted(len(trials), 'run')} of {counted(len(summary.algorithms), 'algorithm')} on "
        f"{counted(len(summary.sequences), 'sequence')}: {len(trials) - len(lost)} evaluated"
        + (f", {len(lost)} failed or missing. Failed runs are ranked last." if lost else ".")
    ]
    if len(trials) > _MOST_DETAILS:
        findings.append(
            f"Details are shown for {_MOST_DETAILS} runs: failed runs first, then runs with the "
            "largest error relative to the median of their sequence. Tables include all runs."
        )
    if len(summary.sequences) > drawn or len(summary.algorithms) > MOST_ALGORITHMS:
        findings.append(
            f"Figures by sequence show the first {drawn} sequences and {MOST_ALGORITHMS} "
            "algorithms. Tables include all."
        )
    tables = matrices(summary)
    wins = {
        name: ranks.count(1)
        for table in tables[:1]
        for (name, _), ranks in zip(table.rows, table.ranks(), strict=True)
    }
    most_wins = max(wins.values(), default=0)
    if most_wins:
        best = [name for name, count in wins.items() if count == most_wins]
        *others, last = best
        listed = f"{', '.join(others)} and {last}" if others else last
        cells = [cell for _, cells in tables[0].rows for cell in cells]
        among = "" if all(cell.is_ranked for cell in cells) else " of those that are ranked"
        findings.append(
            f"Most sequences with the smallest position ATE{among}: {listed}, on "
            f"{most_wins} of {counted(len(summary.sequences), 'sequence')}."
        )
        coverage = dict(zip(summary.algorithms, tables[0].coverage, strict=True))
        most = max(coverage, key=lambda name: coverage[name])
        findings += [
            f"{name} covers {whole_percent(coverage[name])} of the groundtruth and {most} covers "
            f"{whole_percent(coverage[most])}. Compare only runs with the same coverage: use "
            "--common-time-span."
            for name in summary.algorithms
            if coverage[name] < 0.9 * coverage[most]
        ]
    return findings
