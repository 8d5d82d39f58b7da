"""From a comparison on disk to its report: what is drawn, and what is said of each run."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

from trajeval_ros import __version__
from trajeval_ros.batch.comparison import RECORDS, RUNS
from trajeval_ros.batch.records import Array, Record, read_record
from trajeval_ros.batch.summary import Summary, Trial, definition, matrices
from trajeval_ros.batch.table import ATE, OK, POOLED, RE, STATISTICS, Rows
from trajeval_ros.io.results import write_text
from trajeval_ros.report.comparison_figures import Box, box_plot, overlay, run_figures
from trajeval_ros.report.comparison_page import Plot, RunPage, render
from trajeval_ros.report.matrix import coverage_text, number_text
from trajeval_ros.report.tables import ABSOLUTE, RELATIVE

REPORT = "report.html"
# A page of more figures than this takes a browser long to open.
_MOST_FIGURES = 200
_UNITS = {"m": "[m]", "s": "[s]", "%": "[% of the path]"}


def write_report(folder: Path, summary: Summary) -> Path:
    """Write the report of a comparison beside its tables.

    Raises:
        InputError: It can't be written, or Jinja2 or matplotlib are not installed.
    """
    page = render(
        title=summary.title,
        definition=definition(summary.settings),
        findings=_findings(summary),
        matrices=matrices(summary),
        plots=[
            *_absolute_plots(summary), *_relative_plots(summary), *_overlays(folder, summary),
        ],
        runs=_runs(folder, summary),
        version=__version__,
    )  # fmt: skip
    write_text(folder / REPORT, page)
    return folder / REPORT


def _findings(summary: Summary) -> list[str]:
    """Return what one wants to know first."""
    trials = summary.trials
    lost = [trial for trial in trials if trial.status != OK]
    findings = [
        f"{len(trials)} runs of {_counted(summary.algorithms, 'algorithm')} on "
        f"{_counted(summary.sequences, 'sequence')}: {len(trials) - len(lost)} evaluated"
        + (f", {len(lost)} failed or missing, which count as worse than all." if lost else ".")
    ]
    if len(trials) > _MOST_FIGURES:
        findings.append(f"Figures are of the first {_MOST_FIGURES} runs, numbers of all.")
    tables = matrices(summary)
    if tables and len(summary.algorithms) > 1:
        wins: dict[str, int] = defaultdict(int)
        for (name, _), ranks in zip(tables[0].rows, tables[0].ranks(), strict=True):
            wins[name] += ranks.count(1)
        best = max(wins, key=lambda name: wins[name])
        findings.append(
            f"Smallest position ATE most often: {best}, on {wins[best]} of "
            f"{_counted(summary.sequences, 'sequence')}."
        )
        coverage = dict(zip(summary.algorithms, tables[0].coverage, strict=True))
        most = max(coverage, key=lambda name: coverage[name])
        if coverage[best] < 0.9 * coverage[most]:
            findings.append(
                f"But {best} covers {coverage_text(coverage[best])} of the groundtruth's time and "
                f"{most} {coverage_text(coverage[most])}: errors over a part compare only with "
                "errors over the same part; --common-time-span compares these."
            )
    return findings


def _counted(names: list[str], what: str) -> str:
    return f"{len(names)} {what}{'' if len(names) == 1 else 's'}"


def _absolute_plots(summary: Summary) -> list[Plot]:
    plots = []
    for metric in ("position_m", "rotation_deg"):
        series = []
        for algorithm in summary.algorithms:
            boxes: list[Box | None] = []
            for sequence in summary.sequences:
                trials = summary.of(algorithm, sequence)
                values = [trial.rmse[metric] for trial in trials if metric in trial.rmse]
                boxes.append(Box.of(values) if values else None)
            series.append((algorithm, boxes))
        if any(box for _, boxes in series for box in boxes):
            figure = box_plot(f"ate-{metric}", summary.sequences, series, "", ABSOLUTE[metric])
            title = f"ATE over trials, {ABSOLUTE[metric]}"
            caption = (
                "A point is the rmse of a trial; boxes: median and quartiles, whiskers: least and "
                "largest. Failed runs have no point."
            )
            plots.append(Plot(title, caption, figure))
    return plots


def _relative_plots(summary: Summary) -> list[Plot]:
    lengths = summary.settings["lengths"]
    by_place = {
        (row["algorithm"], row["sequence"], row["length"], row["metric"]): row
        for row in summary.pooled
        if row["kind"] == RE
    }
    in_metres = not any(length.endswith("s") for length in lengths)
    position = "position_percent" if in_metres else "position_m"
    plots = []
    for sequence in summary.sequences:
        for metric in (position, "rotation_deg"):
            series = [
                (
                    algorithm,
                    [_pooled_box(by_place.get((algorithm, sequence, length, metric)))
                     for length in lengths],
                )
                for algorithm in summary.algorithms
            ]  # fmt: skip
            if any(box for _, boxes in series for box in boxes):
                label = RELATIVE[metric]
                name = f"re-{sequence}-{metric}"
                units = {length[-1] for length in lengths}
                unit = f" {_UNITS[units.pop()]}" if len(units) == 1 else ""
                groups = [length[:-1] if unit else length for length in lengths]
                axis = f"length of sub-trajectory{unit}"
                figure = box_plot(name, groups, series, axis, label)
                caption = (
                    "All sub-trajectories of all trials; boxes: median and quartiles, whiskers: "
                    "5 % to 95 %."
                )
                plots.append(Plot(f"Relative error on {sequence}, {label}", caption, figure))
    return plots


def _pooled_box(row: dict[str, Any] | None) -> Box | None:
    if row is None:
        return None
    return Box(*(row[name] for name in ("p5", "p25", "median", "p75", "p95")))


def _overlays(folder: Path, summary: Summary) -> list[Plot]:
    """Draw on each sequence the trial of each algorithm that has the median error."""
    plots = []
    for sequence in summary.sequences:
        truth: Array | None = None
        paths: list[tuple[str, Array] | None] = []
        for algorithm in summary.algorithms:
            trial = _median_trial(summary.of(algorithm, sequence))
            record = None if trial is None else read_record(folder / RECORDS, trial.key)
            if trial is None or record is None:
                paths.append(None)
                continue
            truth = record.columns["truth"] if truth is None else truth
            name = f"{algorithm} {trial.trial}".strip()
            paths.append((name, record.columns["path"]))
        if truth is not None:
            several = len(summary.of(summary.algorithms[0], sequence)) < len(
                [trial for trial in summary.trials if trial.sequence == sequence]
            )
            caption = "From above, aligned."
            if several:
                caption += " Of several trials, that with the median position ATE."
            figure = overlay(f"overlay-{sequence}", truth, paths)
            plots.append(Plot(f"Trajectories on {sequence}", caption, figure))
    return plots


def _median_trial(trials: list[Trial]) -> Trial | None:
    ranked = sorted(
        (trial for trial in trials if "position_m" in trial.rmse),
        key=lambda trial: trial.rmse["position_m"],
    )
    return ranked[(len(ranked) - 1) // 2] if ranked else None


def _runs(folder: Path, summary: Summary) -> list[RunPage]:
    statistics: dict[str, list[tuple[str, ...]]] = defaultdict(list)
    facts: dict[str, tuple[tuple[str, str], ...]] = {}
    names = ("key", "kind", "metric", "length", "count", *STATISTICS)
    more = (
        "groundtruth", "estimate", "pairs", "estimate_coverage", "span_s", "scale",
        "estimate_sha256", "groundtruth_sha256",
    )  # fmt: skip
    for row in Rows(folder / RUNS).select((*names, *more), status=OK):
        key = row["key"]
        statistics[key].append(_statistics(row))
        if key not in facts:
            facts[key] = _facts(row)
    pages = []
    for place, trial in enumerate(summary.trials):
        svgs: tuple[str, ...] = ()
        if trial.status == OK and place < _MOST_FIGURES:
            record = read_record(folder / RECORDS, trial.key)
            svgs = () if record is None else _run_svgs(record, summary, trial)
        pages.append(
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
                svgs=svgs,
            )
        )
    return pages


def _run_svgs(record: Record, summary: Summary, trial: Trial) -> tuple[str, str]:
    place = summary.algorithms.index(trial.algorithm)
    columns = record.columns
    return run_figures(record.key, place, columns["truth"], columns["path"], columns["errors"])


def _statistics(row: dict[str, Any]) -> tuple[str, ...]:
    labels = ABSOLUTE if row["kind"] == ATE else RELATIVE
    where = {ATE: "ATE", RE: f"RE {row['length']}", POOLED: "RE all lengths"}[row["kind"]]
    values = [number_text(row[name]) for name in STATISTICS]
    return (f"{where}, {labels[row['metric']]}", *values, str(row["count"]))


def _facts(row: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    return (
        ("estimate", row["estimate"]),
        ("groundtruth", row["groundtruth"]),
        ("pairs", f"{row['pairs']} over {row['span_s']:.1f} s, "
                  f"{100 * row['estimate_coverage']:.1f} % of the poses"),
        ("scale", f"{row['scale']:.5g}"),
        ("sha256", f"{row['estimate_sha256'][:16]}… and {row['groundtruth_sha256'][:16]}…"),
    )  # fmt: skip
