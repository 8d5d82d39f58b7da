"""From a comparison on disk to its report: what is drawn, and what is said of each run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from trajeval_ros import __version__
from trajeval_ros.batch.comparison import RECORDS, RUNS
from trajeval_ros.batch.comparison_summary import ComparisonSummary
from trajeval_ros.batch.drawing import Advance, draw_all
from trajeval_ros.batch.executors import Pool
from trajeval_ros.batch.overview_figures import MOST_SEQUENCES, drafts_of
from trajeval_ros.batch.records import read_record
from trajeval_ros.batch.results_table import (
    ATE,
    OK,
    POOLED,
    RE,
    STATISTICS,
    ResultsTable,
    state_of,
)
from trajeval_ros.batch.summary_tables import definition, matrices
from trajeval_ros.formatting.numbers import percent, three_decimals, whole_percent
from trajeval_ros.io.writing import write_text
from trajeval_ros.metrics.coverage import Gap
from trajeval_ros.report.comparison_figures import run_errors, run_path
from trajeval_ros.report.comparison_page import Plot, RunPage, render
from trajeval_ros.report.tables import ABSOLUTE, RELATIVE

REPORT = "report.html"
_HEAD_BYTES = 2000
# A page of more figures than this takes a browser long to open.
_MOST_FIGURES = 200


def write_report(
    folder: Path,
    summary: ComparisonSummary,
    pool: Pool,
    advance: Advance = lambda done, total: None,
) -> Path:
    """Write the report of a comparison beside its tables.

    Args:
        folder: The comparison's.
        summary: What it found.
        pool: Processes of this machine, to draw on.
        advance: Called with how many figures are drawn, and how many there are.

    Raises:
        InputError: It can't be written, or Jinja2 or matplotlib are not installed.
    """
    drafts = drafts_of(folder, summary)
    shown = [trial for trial in summary.trials[:_MOST_FIGURES] if trial.status == OK]
    draws = [draft.draw for draft in drafts]
    for trial in shown:
        what = (folder, trial.key, summary.algorithms.index(trial.algorithm))
        draws += [partial(_run_path, *what), partial(_run_errors, *what)]
    svgs = iter(draw_all(draws, pool, advance))
    plots = [Plot(draft.title, draft.caption, next(svgs)) for draft in drafts]
    figures = {trial.key: (next(svgs), next(svgs)) for trial in shown}
    page = render(
        title=summary.title,
        definition=definition(summary.settings),
        findings=_findings(summary),
        matrices=matrices(summary),
        plots=plots,
        runs=_runs(folder, summary, figures),
        version=__version__,
        state=state_of(folder / RUNS),
    )
    write_text(folder / REPORT, page)
    return folder / REPORT


def is_drawn(folder: Path) -> bool:
    """Return whether the report is of the tables beside it; clocks tell it wrongly."""
    state = state_of(folder / RUNS)
    try:
        with (folder / REPORT).open("rb") as file:
            return bool(state) and state.encode() in file.read(_HEAD_BYTES)
    except FileNotFoundError:
        return False


def _findings(summary: ComparisonSummary) -> list[str]:
    """Return what one wants to know first."""
    trials = summary.trials
    lost = [trial for trial in trials if trial.status != OK]
    findings = [
        f"{len(trials)} runs of {_counted(summary.algorithms, 'algorithm')} on "
        f"{_counted(summary.sequences, 'sequence')}: {len(trials) - len(lost)} evaluated"
        + (f", {len(lost)} failed or missing, which count as worse than all." if lost else ".")
    ]
    if len(trials) > _MOST_FIGURES or len(summary.sequences) > MOST_SEQUENCES:
        findings.append(
            f"Figures are of the first {_MOST_FIGURES} runs and {MOST_SEQUENCES} sequences, "
            "numbers of all."
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
        findings.append(
            f"Smallest position ATE most often: {' and '.join(best)}, on {most_wins} of "
            f"{_counted(summary.sequences, 'sequence')}{' each' if len(best) > 1 else ''}."
        )
        coverage = dict(zip(summary.algorithms, tables[0].coverage, strict=True))
        most = max(coverage, key=lambda name: coverage[name])
        findings += [
            f"But {name} covers {whole_percent(coverage[name])} of the groundtruth's time and "
            f"{most} {whole_percent(coverage[most])}: errors over a part compare only with "
            "errors over the same part; --common-time-span compares these."
            for name in best
            if coverage[name] < 0.9 * coverage[most]
        ]
    return findings


def _counted(names: list[str], what: str) -> str:
    return f"{len(names)} {what}{'' if len(names) == 1 else 's'}"


def _runs(
    folder: Path, summary: ComparisonSummary, figures: Mapping[str, tuple[str, ...]]
) -> list[RunPage]:
    statistics: dict[str, list[tuple[str, ...]]] = defaultdict(list)
    facts: dict[str, tuple[tuple[str, str], ...]] = {}
    names = ("key", "kind", "metric", "length", "count", *STATISTICS)
    more = (
        "groundtruth", "estimate", "pairs", "estimate_coverage", "span_s", "scale",
        "groundtruth_span", "longest_gap_s", "longest_gap_m", "longest_gap_deg",
        "estimate_sha256", "groundtruth_sha256",
    )  # fmt: skip
    for row in ResultsTable(folder / RUNS).select((*names, *more), status=OK):
        key = row["key"]
        if key not in facts:
            facts[key] = _facts(row)
        if row["kind"] in (ATE, RE, POOLED):
            statistics[key].append(_statistics(row))
        else:
            facts[key] += ((f"{row['kind']}, {row['metric']}", three_decimals(row["mean"])),)
    return [
        RunPage(
            algorithm=trial.algorithm,
            sequence=trial.sequence,
            trial=trial.trial,
            status=trial.status,
            reason=trial.reason,
            position_m=trial.rmse.get("position_m"),
            rotation_deg=trial.rmse.get("rotation_deg"),
            coverage=trial.coverage,
            facts=facts.get(trial.key, ()),
            headings=("error", *STATISTICS, "count"),
            statistics=tuple(statistics.get(trial.key, ())),
            warnings=trial.warnings,
            svgs=tuple(filter(None, figures.get(trial.key, ()))),
        )
        for trial in summary.trials
    ]


def _run_path(folder: Path, key: str, place: int) -> str:
    record = read_record(folder / RECORDS, key)
    if record is None:
        return ""
    columns = record.columns
    return run_path(key, place, record.groundtruth_up, columns["truth"], columns["path"])


def _run_errors(folder: Path, key: str, place: int) -> str:
    record = read_record(folder / RECORDS, key)
    return "" if record is None else run_errors(key, place, record.columns["errors"])


def _statistics(row: dict[str, Any]) -> tuple[str, ...]:
    labels = ABSOLUTE if row["kind"] == ATE else RELATIVE
    where = {ATE: "ATE", RE: f"RE {row['length']}", POOLED: "RE all lengths"}[row["kind"]]
    values = [three_decimals(row[name]) for name in STATISTICS]
    return (f"{where}, {labels[row['metric']]}", *values, str(row["count"]))


def _facts(row: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    return (
        ("estimate", row["estimate"]),
        ("groundtruth", row["groundtruth"]),
        ("pairs", f"{row['pairs']} over {row['span_s']:.1f} s, "
                  f"{percent(row['estimate_coverage'])} of the poses"),
        *_gap(row),
        ("scale", f"{row['scale']:.5g}"),
        ("sha256", f"{row['estimate_sha256'][:16]}… and {row['groundtruth_sha256'][:16]}…"),
    )  # fmt: skip


def _gap(row: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    if row["longest_gap_s"] is None:
        return ()
    gap = Gap(row["longest_gap_s"], row["longest_gap_m"], row["longest_gap_deg"])
    first_to_last = f"{percent(row['groundtruth_span'])} of the groundtruth's time"
    return (("first to last pair", first_to_last), ("longest gap", str(gap)))
