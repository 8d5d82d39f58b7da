"""Figures of all runs together, for the report and as files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.record_store import RecordStore
from trajeval_ros.batch.records import Record
from trajeval_ros.metrics.sub_trajectory_length import Length
from trajeval_ros.report.comparison_plots import Box, BoxPlot, ErrorsPlot, PathsPlot
from trajeval_ros.report.metric_labels import ABSOLUTE_LABELS, RELATIVE_LABELS
from trajeval_ros.report.relative_figure import length_labels

# With more, figures are not readable.
MOST_SEQUENCES, MOST_ALGORITHMS = 50, 24


@dataclass(frozen=True, eq=False)
class FigureDraft:
    """A figure before it is drawn.

    Attributes:
        name: Unique name, for a file.
        title: Its title.
        caption: Its explanation.
        plot: Its data.
    """

    name: str
    title: str
    caption: str
    plot: BoxPlot | PathsPlot | ErrorsPlot


def drafts_of(summary: ComparisonSummary, records: RecordStore) -> Iterator[FigureDraft]:
    """Yield the figures: absolute errors, and by sequence relative errors and trajectories.

    They are limited to the first `MOST_SEQUENCES` sequences and `MOST_ALGORITHMS` algorithms.

    Args:
        summary: Results of the comparison.
        records: Its records.
    """
    yield from absolute_drafts(summary)
    for sequence in summary.sequences[:MOST_SEQUENCES]:
        yield from sequence_drafts(summary, records, sequence)


def sequence_drafts(
    summary: ComparisonSummary, records: RecordStore, sequence: str
) -> Iterator[FigureDraft]:
    """Yield the figures of one sequence."""
    yield from _relative_plots(summary, sequence)
    yield from _overlay(summary, records, sequence)


def absolute_drafts(summary: ComparisonSummary) -> Iterator[FigureDraft]:
    """Yield the figures of absolute errors on all sequences."""
    sequences = summary.sequences[:MOST_SEQUENCES]
    for metric in ("position_m", "rotation_deg"):
        series = []
        for algorithm in summary.algorithms[:MOST_ALGORITHMS]:
            boxes: list[Box | None] = []
            for sequence in sequences:
                trials = summary.of(algorithm, sequence)
                values = [trial.rmse[metric] for trial in trials if metric in trial.rmse]
                boxes.append(Box.of(values) if values else None)
            series.append((algorithm, boxes))
        if any(box for _, boxes in series for box in boxes):
            yield FigureDraft(
                f"ate_{metric}",
                f"ATE over trials, {ABSOLUTE_LABELS[metric]}",
                "Points: RMSE per trial. Boxes: median and quartiles; whiskers: minimum and "
                "maximum. Failed runs have no point.",
                BoxPlot(sequences, series, "", ABSOLUTE_LABELS[metric]),
            )


def _relative_plots(summary: ComparisonSummary, sequence: str) -> Iterator[FigureDraft]:
    asked = [Length.parse(length) for length in summary.settings["lengths"]]
    algorithms = summary.algorithms[:MOST_ALGORITHMS]
    in_metres = all(length.in_metres for length in asked)
    for metric in ("position_percent" if in_metres else "position_m", "rotation_deg"):
        boxes = {
            length: [
                _pooled_box(summary.pooled_errors(algorithm, sequence, str(length), metric))
                for algorithm in algorithms
            ]
            for length in asked
        }
        lengths = [length for length in asked if any(boxes[length])]  # that occur
        if lengths:
            by_algorithm = zip(*(boxes[length] for length in lengths), strict=True)
            series = list(zip(algorithms, by_algorithm, strict=True))
            groups, across = length_labels(lengths)
            yield FigureDraft(
                f"re_{metric}_{sequence}",
                f"Relative error on {sequence}, {RELATIVE_LABELS[metric]}",
                "All sub-trajectories of all trials. Boxes: median and quartiles; whiskers: 5 % "
                "to 95 %.",
                BoxPlot(groups, series, across, RELATIVE_LABELS[metric]),
            )


def _pooled_box(row: dict[str, Any] | None) -> Box | None:
    if row is None:
        return None
    return Box(*(row[name] for name in ("p5", "p25", "median", "p75", "p95")))


def _overlay(
    summary: ComparisonSummary, records: RecordStore, sequence: str
) -> Iterator[FigureDraft]:
    medians = _median_records(summary, records, sequence)
    if medians:
        _, first = next(iter(medians.values()))
        paths = {place: (name, each.columns["path"]) for place, (name, each) in medians.items()}
        yield FigureDraft(
            f"trajectories_{sequence}",
            f"Trajectories on {sequence}",
            f"Aligned trajectories from above.{_of_several(summary, sequence)}",
            PathsPlot(first.groundtruth_up, first.columns["truth"], paths),
        )


def error_drafts(summary: ComparisonSummary, records: RecordStore) -> Iterator[FigureDraft]:
    """Yield the figures of errors over time, by sequence, with the limits of `drafts_of`.

    Reports show errors over time by run instead.

    Args:
        summary: Results of the comparison.
        records: Its records.
    """
    for sequence in summary.sequences[:MOST_SEQUENCES]:
        medians = _median_records(summary, records, sequence)
        if medians:
            series = {
                place: (name, each.columns["errors"]) for place, (name, each) in medians.items()
            }
            yield FigureDraft(
                f"errors_{sequence}",
                f"Errors on {sequence}",
                f"Errors of aligned poses.{_of_several(summary, sequence)}",
                ErrorsPlot(series),
            )


def _of_several(summary: ComparisonSummary, sequence: str) -> str:
    runs = sum(trial.sequence == sequence for trial in summary.trials)
    return (
        " If there are several trials, the trial with the median position ATE is shown."
        if runs > len(summary.algorithms)
        else ""
    )


def _median_records(
    summary: ComparisonSummary, records: RecordStore, sequence: str
) -> dict[int, tuple[str, Record]]:
    """Return name and record of the trial with the median error, by index of the algorithm."""
    found = {}
    for place, algorithm in enumerate(summary.algorithms[:MOST_ALGORITHMS]):
        trial = _median_trial(summary.of(algorithm, sequence))
        record = None if trial is None else records.read(trial.key, with_pooled=False)
        if trial is not None and record is not None:
            which = f", trial {trial.trial}" if trial.trial else ""
            found[place] = (f"{algorithm}{which}", record)
    return found


def _median_trial(trials: list[Trial]) -> Trial | None:
    ranked = sorted(
        (trial for trial in trials if "position_m" in trial.rmse),
        key=lambda trial: trial.rmse["position_m"],
    )
    return ranked[(len(ranked) - 1) // 2] if ranked else None
