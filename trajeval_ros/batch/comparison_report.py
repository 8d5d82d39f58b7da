"""The report of a comparison on disk: one page, figures, and further pages for many runs."""

from __future__ import annotations

import contextlib
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import Any

from trajeval_ros import __version__
from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.executors import Pool, results_in_order
from trajeval_ros.batch.finished_comparison import FIGURES, PAGES, REPORT, RUNS
from trajeval_ros.batch.planned_figures import (
    DEFAULT_FIGURES,
    MOST_ALGORITHMS,
    MOST_SEQUENCES,
    DrawnFigure,
    FigureChoice,
    PlannedFigure,
    absolute_figures,
    draw,
    run_figures,
    sequence_figures,
)
from trajeval_ros.batch.records import RECORDS, RecordStore
from trajeval_ros.batch.results_table import (
    ATE,
    OK,
    POOLED,
    RE,
    STATISTICS,
    ResultsTable,
    state_of,
)
from trajeval_ros.batch.summary_tables import SPAN_NOTE, definition, diagnosed, matrices
from trajeval_ros.formatting.numbers import counted, three_decimals, whole_percent
from trajeval_ros.io.writing import refused_by_disk, write_text, write_whole
from trajeval_ros.metrics.coverage import LOW_COVERAGE, Gap
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.report.comparison_figures import BoxPlot
from trajeval_ros.report.comparison_page import Plot, ReportPages, RunPage
from trajeval_ros.report.definitions import ABSOLUTE_LABELS, RELATIVE_LABELS

_HEAD_BYTES = 2000
_MOST_DETAILS = 1000  # runs with figures and statistics
_MOST_ON_A_PAGE = 100
# Limit of details on a page and of figures on the first one; a page stays below 5 MB.
_MOST_BYTES = 2_000_000
_OURS = re.compile(r"(ate|re|trajectories|errors)_.*\.(png|pdf|svg|pgf)")
_COLUMNS = (
    "key", "kind", "metric", "length", "count", *STATISTICS, "groundtruth", "estimate", "pairs",
    "estimate_coverage", "span_s", "scale", "groundtruth_span", "longest_gap_s", "longest_gap_m",
    "longest_gap_deg", "estimate_sha256", "groundtruth_sha256",
)  # fmt: skip


def write_report(
    folder: Path,
    summary: ComparisonSummary,
    start_pool: Callable[[], Pool],
    choice: FigureChoice = DEFAULT_FIGURES,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write the report of a comparison, and its figures as files, into its folder.

    `start_pool`: returns the workers that draw; called only if there are figures.
    """
    pages = ReportPages(summary.title, __version__, _state(folder, choice))
    records = RecordStore(folder / RECORDS)
    shown = _standing_out(summary.trials, _MOST_DETAILS)
    plots, svgs = _draw_all(folder / FIGURES, summary, records, start_pool, choice, advance)
    runs, details = [], []
    for number, run in enumerate(_run_pages(folder, shown, svgs), 1):
        details.append(pages.details(number, run))
        runs.append(run.brief())
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
        _findings(summary, choice, len(svgs), plots),
        matrices(summary),
        [plot for plot in plots if plot.svg],
        runs,
        links,
        details if on_first_page else (),
        "All runs" if len(shown) == len(summary.trials) else "Runs that stand out",
    )
    write_text(folder / REPORT, text)  # last: its existence states that the report is complete
    return folder / REPORT


def is_drawn(folder: Path, choice: FigureChoice = DEFAULT_FIGURES) -> bool:
    """Return whether the report belongs to the tables, by their hash, not by file times."""
    try:
        with (folder / REPORT).open("rb") as file:
            begun = file.read(_HEAD_BYTES)
    except FileNotFoundError:
        return False
    state = _state(folder, choice)
    return bool(state) and f'"{state}"'.encode() in begun and (folder / FIGURES).is_dir()


def _state(folder: Path, choice: FigureChoice) -> str:
    """Return a text that identifies tables and figures; "" without tables."""
    tables = state_of(folder / RUNS)
    return f"{tables} {choice.mark}" if tables else ""


def _standing_out(trials: Sequence[Trial], most: int) -> list[Trial]:
    """Return at most some runs, in their order: all, or failed and inaccurate ones."""
    if len(trials) <= most:
        return list(trials)
    by_sequence: dict[str, list[float]] = {}
    for trial in trials:
        if "position_m" in trial.rmse:
            by_sequence.setdefault(trial.sequence, []).append(trial.rmse["position_m"])
    usual = {sequence: median(errors) for sequence, errors in by_sequence.items()}

    def standing_out(place: int) -> tuple[bool, float]:
        item = trials[place]
        error = item.rmse.get("position_m", 0.0)
        return item.status != OK, error / (usual.get(item.sequence) or 1.0)

    order = sorted(range(len(trials)), key=standing_out, reverse=True)
    return [trials[place] for place in sorted(order[:most])]


def _draw_all(
    folder: Path,
    summary: ComparisonSummary,
    records: RecordStore,
    start_pool: Callable[[], Pool],
    choice: FigureChoice,
    advance: Callable[[int, int], None],
) -> tuple[list[Plot], dict[str, list[str]]]:
    """Draw all figures in workers; return those of all runs together, and by key of the run."""
    with refused_by_disk(f"the folder {folder}"):
        folder.mkdir(exist_ok=True)
        for old in folder.iterdir():
            if _OURS.fullmatch(old.name):
                old.unlink()
    boxes: list[Plot] = []
    paths: list[Plot] = []
    svgs: dict[str, list[str]] = defaultdict(list)
    if not choice.most:
        return [], svgs
    planned = _planned(summary, records, choice.most)
    drawings = results_in_order(start_pool(), partial(_draw_task, choice.formats), planned)
    evaluated = [trial for trial in summary.trials if trial.status == OK]
    total = 2 * min(choice.most, len(evaluated)) + 2 + 4 * len(_sequences(summary, choice.most))
    size = 0  # of the figures of all runs together
    for number, ((key, figure), drawn) in enumerate(drawings, 1):
        advance(min(number, total), total)
        for name, content in drawn.files.items():
            write_whole(folder / name, partial(Path.write_bytes, data=content))
        if key:
            svgs[key].append(drawn.svg)
        elif figure.is_in_report:
            size += len(drawn.svg)
            svg = drawn.svg if size < _MOST_BYTES else ""
            plots = boxes if isinstance(figure.plot, BoxPlot) else paths
            plots.append(Plot(figure.title, figure.caption, svg))
    return [*boxes, *paths], svgs


def _planned(
    summary: ComparisonSummary, records: RecordStore, most: int
) -> Iterator[tuple[str, PlannedFigure]]:
    """Yield figures with the key of their run; "" for those of all runs together."""
    for figure in absolute_figures(summary):
        yield "", figure
    for sequence in _sequences(summary, most):
        for figure in sequence_figures(summary, records, sequence):
            yield "", figure
    places = {algorithm: place for place, algorithm in enumerate(summary.algorithms)}
    evaluated = [trial for trial in summary.trials if trial.status == OK]
    for trial in _standing_out(evaluated, most):
        record = records.read(trial.key, with_pooled=False)
        if record is not None:
            for figure in run_figures(record, places[trial.algorithm]):
                yield trial.key, figure


def _sequences(summary: ComparisonSummary, most: int) -> Sequence[str]:
    """Return the sequences with figures."""
    return summary.sequences[: min(most, MOST_SEQUENCES)]


def _draw_task(formats: tuple[str, ...], task: tuple[str, PlannedFigure]) -> DrawnFigure:
    _, figure = task
    return draw(figure, formats)


def _parts(details: Sequence[str]) -> list[range]:
    """Return the details of each page; a single page if they are few and small."""
    parts, first, size = [], 0, 0
    for place, detail in enumerate(details):
        if place - first == _MOST_ON_A_PAGE or (size + len(detail) > _MOST_BYTES and size):
            parts.append(range(first, place))
            first, size = place, 0
        size += len(detail)
    return [*parts, range(first, len(details))]


def _remove_pages(folder: Path) -> None:
    """Remove the pages of a previous report."""
    for path in folder.glob("runs_*.html"):
        path.unlink()
    with contextlib.suppress(OSError):  # it does not exist, or has other files
        folder.rmdir()


def _findings(
    summary: ComparisonSummary, choice: FigureChoice, drawn: int, plots: Sequence[Plot]
) -> list[str]:
    """Return the main findings. `drawn`: number of runs with figures."""
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
    if choice.most and 0 < drawn < len(trials) - len(lost):
        findings.append(
            f"Figures are drawn for {counted(drawn, 'run')} with the largest error relative to "
            "the median of their sequence. --figures N sets the number."
        )
    sequences = len(_sequences(summary, choice.most))
    if choice.most and (
        len(summary.sequences) > sequences or len(summary.algorithms) > MOST_ALGORITHMS
    ):
        findings.append(
            f"Figures by sequence show the first {sequences} sequences and {MOST_ALGORITHMS} "
            "algorithms. Tables include all."
        )
    if not all(plot.svg for plot in plots):
        findings.append(f"Further figures by sequence are in the folder {FIGURES}.")
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
        among = "" if all(cell.is_ranked for cell in cells) else " of the ranked runs"
        has = "each have" if others else "has"
        findings.append(
            f"{listed} {has} the smallest position ATE{among} on {most_wins} of "
            f"{counted(len(summary.sequences), 'sequence')}."
        )
    if tables and not summary.settings["common_time_span"]:
        shares = {
            name: [trial.coverage for trial in summary.of(name) if trial.status == OK]
            for name in summary.algorithms
        }
        coverage = {name: fmean(of_runs) for name, of_runs in shares.items() if of_runs}
        most = max(coverage, key=lambda name: coverage[name], default="")
        findings += [
            f"{name} covers {whole_percent(coverage[name])} of the groundtruth and {most} covers "
            f"{whole_percent(coverage[most])}. Compare only runs with the same coverage: use "
            "--common-time-span."
            for name in coverage
            if coverage[name] < LOW_COVERAGE * coverage[most]
        ]
    elif summary.common_spans:
        findings.append(f"{SPAN_NOTE}: {summary.common_spans}.")
    return findings


def _run_pages(
    folder: Path, trials: Sequence[Trial], svgs: Mapping[str, Sequence[str]]
) -> Iterator[RunPage]:
    """Yield the details of some runs. `svgs`: their figures by key."""
    statistics: dict[str, list[tuple[str, ...]]] = defaultdict(list)
    facts: dict[str, tuple[tuple[str, str], ...]] = {}
    keys = [trial.key for trial in trials if trial.status == OK]
    for row in ResultsTable(folder / RUNS).select(_COLUMNS, key=keys):
        key = row["key"]
        if key not in facts:
            facts[key] = _facts(row)
        if row["kind"] in (ATE, RE, POOLED):
            statistics[key].append(_statistics(row))
        else:
            facts[key] += ((f"{row['kind']}, {row['metric']}", three_decimals(row["mean"])),)
    for trial in trials:
        yield RunPage(
            algorithm=trial.algorithm,
            sequence=trial.sequence,
            trial=trial.trial,
            status=trial.status,
            reason=trial.reason,
            position_m=trial.rmse.get("position_m"),
            rotation_deg=trial.rmse.get("rotation_deg"),
            coverage=trial.coverage,
            marks=diagnosed([trial]),
            facts=facts.get(trial.key, ()),
            headings=("error", *STATISTICS, "count"),
            statistics=tuple(statistics.get(trial.key, ())),
            warnings=trial.warnings,
            svgs=tuple(svgs.get(trial.key, ())),
        )


def _statistics(row: dict[str, Any]) -> tuple[str, ...]:
    labels = ABSOLUTE_LABELS if row["kind"] == ATE else RELATIVE_LABELS
    where = {ATE: "ATE", POOLED: "RE all lengths"}.get(row["kind"])
    where = where or f"RE {Length.parse(row['length']).text}"
    values = [three_decimals(row[name]) for name in STATISTICS]
    return (f"{where}, {labels[row['metric']]}", *values, str(row["count"]))


def _facts(row: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    return (
        ("estimate", row["estimate"]),
        ("groundtruth", row["groundtruth"]),
        ("pairs", f"{row['pairs']} over {row['span_s']:.1f} s, "
                  f"{whole_percent(row['estimate_coverage'])} of the poses"),
        *_gap(row),
        ("scale", f"{row['scale']:.5g}"),
        ("sha256", f"{row['estimate_sha256'][:16]}… and {row['groundtruth_sha256'][:16]}…"),
    )  # fmt: skip


def _gap(row: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    if row["longest_gap_s"] is None:
        return ()
    gap = Gap(row["longest_gap_s"], row["longest_gap_m"], row["longest_gap_deg"])
    first_to_last = f"{whole_percent(row['groundtruth_span'])} of the groundtruth's time"
    return (("first to last pair", first_to_last), ("longest gap", str(gap)))
