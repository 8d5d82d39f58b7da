"""The figures of all runs together, before they are drawn for the report and as files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from trajeval_ros.batch.comparison_summary import ComparisonSummary
from trajeval_ros.batch.records import Record, RecordStore
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.report.comparison_figures import Box, BoxPlot, ErrorsPlot, PathsPlot
from trajeval_ros.report.definitions import ABSOLUTE_LABELS, RELATIVE_LABELS
from trajeval_ros.report.relative_figure import length_labels

# With more, figures are not readable.
MOST_SEQUENCES, MOST_ALGORITHMS = 50, 24


@dataclass(frozen=True, eq=False)
class FigureDraft:
    """A figure before it is drawn."""

    name: str  # unique name, for a file
    title: str
    caption: str
    plot: BoxPlot | PathsPlot | ErrorsPlot
    # Whether the report shows it. Instead of errors over time by sequence, the report shows those
    # of every run.
    is_in_report: bool = True


def sequence_drafts(
    summary: ComparisonSummary, records: RecordStore, sequence: str
) -> Iterator[FigureDraft]:
    """Yield the figures of one sequence: relative errors, trajectories and errors over time."""
    yield from _relative_plots(summary, sequence)
    medians = _median_records(summary, records, sequence)
    if medians:
        yield _paths(summary, medians, sequence)
        yield _errors(summary, medians, sequence)


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
                _pooled_box(summary.relative.get((algorithm, sequence, str(length), metric)))
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


def _paths(
    summary: ComparisonSummary, medians: dict[int, tuple[str, Record]], sequence: str
) -> FigureDraft:
    _, first = next(iter(medians.values()))
    paths = {place: (name, each.columns["path"]) for place, (name, each) in medians.items()}
    return FigureDraft(
        f"trajectories_{sequence}",
        f"Trajectories on {sequence}",
        f"Aligned trajectories from above.{_of_several(summary, sequence)}",
        PathsPlot(first.groundtruth_up, first.columns["groundtruth"], paths),
    )


def _errors(
    summary: ComparisonSummary, medians: dict[int, tuple[str, Record]], sequence: str
) -> FigureDraft:
    series = {place: (name, each.columns["errors"]) for place, (name, each) in medians.items()}
    return FigureDraft(
        f"errors_{sequence}",
        f"Errors on {sequence}",
        f"Errors of aligned poses.{_of_several(summary, sequence)}",
        ErrorsPlot(series),
        is_in_report=False,
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
        trials = [each for each in summary.of(algorithm, sequence) if "position_m" in each.rmse]
        if not trials:
            continue
        trials.sort(key=lambda trial: trial.rmse["position_m"])
        trial = trials[(len(trials) - 1) // 2]
        if (record := records.read(trial.key, with_pooled=False)) is not None:
            which = f", trial {trial.trial}" if trial.trial else ""
            found[place] = (f"{algorithm}{which}", record)
    return found
