"""The details of a run in the report: figures, statistics and inputs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.finished_comparison import RUNS
from trajeval_ros.batch.record_store import RecordStore
from trajeval_ros.batch.results_table import ATE, OK, POOLED, RE, STATISTICS, ResultsTable
from trajeval_ros.formatting.numbers import percent, three_decimals
from trajeval_ros.metrics.coverage import Gap
from trajeval_ros.metrics.sub_trajectory_length import Length
from trajeval_ros.report.comparison_page import RunPage
from trajeval_ros.report.metric_labels import ABSOLUTE_LABELS, RELATIVE_LABELS
from trajeval_ros.report.page_figures import run_errors_svg, run_path_svg

_COLUMNS = (
    "key", "kind", "metric", "length", "count", *STATISTICS, "groundtruth", "estimate", "pairs",
    "estimate_coverage", "span_s", "scale", "groundtruth_span", "longest_gap_s", "longest_gap_m",
    "longest_gap_deg", "estimate_sha256", "groundtruth_sha256",
)  # fmt: skip


def run_pages(
    folder: Path, summary: ComparisonSummary, records: RecordStore, trials: Sequence[Trial]
) -> Iterator[RunPage]:
    """Yield the details of some runs.

    Args:
        folder: Folder of the comparison.
        summary: Its results.
        records: Its records.
        trials: The runs to describe.

    Raises:
        InputError: The table of the comparison can't be read.
    """
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
    places = {algorithm: place for place, algorithm in enumerate(summary.algorithms)}
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
            facts=facts.get(trial.key, ()),
            headings=("error", *STATISTICS, "count"),
            statistics=tuple(statistics.get(trial.key, ())),
            warnings=trial.warnings,
            svgs=_figures(records, trial.key, places[trial.algorithm]) if trial.key else (),
        )


def _figures(records: RecordStore, key: str, place: int) -> tuple[str, ...]:
    record = records.read(key, with_pooled=False)
    if record is None:
        return ()
    columns = record.columns
    return (
        run_path_svg(place, record.groundtruth_up, columns["truth"], columns["path"]),
        run_errors_svg(place, columns["errors"]),
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
