"""The figures of a comparison: those that are planned, and how a worker draws one."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajeval_ros.batch.comparison_summary import ComparisonSummary
from trajeval_ros.batch.records import Record, RecordStore
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.report.comparison_figures import Box, BoxPlot, ErrorsPlot, PathsPlot, figure_of
from trajeval_ros.report.definitions import ABSOLUTE_LABELS, RELATIVE_LABELS
from trajeval_ros.report.figure_output import save
from trajeval_ros.report.figure_style import FigureStyle, apply_style
from trajeval_ros.report.page_figures import page_figure
from trajeval_ros.report.relative_figure import length_labels

# With more, figures are not readable.
MOST_SEQUENCES, MOST_ALGORITHMS = 50, 24
_WIDTH_IN = 4.6  # of which a page shows two side by side


@dataclass(frozen=True)
class FigureChoice:
    """The figures of a comparison that are requested."""

    most: int = 100  # largest number of runs with figures, and of sequences
    formats: tuple[str, ...] = ("svg",)  # of the files

    @property
    def mark(self) -> str:
        """A text that differs if other figures are requested."""
        return f"{self.most} {','.join(self.formats)}"


DEFAULT_FIGURES = FigureChoice()


@dataclass(frozen=True, eq=False)
class PlannedFigure:
    """A figure before it is drawn."""

    name: str  # unique name, for files; "" for a figure of the report only
    title: str
    caption: str
    plot: BoxPlot | PathsPlot | ErrorsPlot
    # Whether the report shows it. Instead of errors over time by sequence, the report shows those
    # of every run.
    is_in_report: bool = True


@dataclass(frozen=True)
class DrawnFigure:
    """A figure as an element of a page and as files."""

    svg: str  # "" if the report does not show it
    files: dict[str, bytes]  # contents by name


def draw(planned: PlannedFigure, formats: tuple[str, ...]) -> DrawnFigure:
    """Draw a figure for the page and in the formats of its files; called in a worker."""
    stem = re.sub(r"[^\w.-]+", "_", planned.name)
    svg, files = "", {}
    with apply_style(FigureStyle(width_in=_WIDTH_IN)), tempfile.TemporaryDirectory() as folder:
        figure = figure_of(planned.plot)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # the layout of the first drawing is kept
        if planned.is_in_report:
            svg = page_figure(figure, planned.title)
        # PGF is the last, because it escapes the texts of the figure.
        for file_format in sorted(formats, key="pgf".__eq__) if stem else ():
            save(figure, Path(folder) / f"{stem}.{file_format}", file_format, planned.title)
        for path in sorted(Path(folder).iterdir()):
            files[path.name] = path.read_bytes()
    return DrawnFigure(svg, files)


def run_figures(record: Record, place: int) -> Iterator[PlannedFigure]:
    """Yield the figures of one run: path and errors over time.

    `place`: position of its algorithm, which determines the colour.
    """
    columns = record.columns
    paths = {place: ("estimate", columns["path"])}
    plot = PathsPlot(record.groundtruth_up, columns["groundtruth"], paths)
    yield PlannedFigure("", "path from above", "", plot)
    yield PlannedFigure(
        "", "errors over time", "", ErrorsPlot({place: ("estimate", columns["errors"])})
    )


def sequence_figures(
    summary: ComparisonSummary, records: RecordStore, sequence: str
) -> Iterator[PlannedFigure]:
    """Yield the figures of one sequence: relative errors, trajectories and errors over time."""
    yield from _relative_plots(summary, sequence)
    medians = _median_records(summary, records, sequence)
    if medians:
        yield _paths(summary, medians, sequence)
        yield _errors(summary, medians, sequence)


def absolute_figures(summary: ComparisonSummary) -> Iterator[PlannedFigure]:
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
            plot = BoxPlot(sequences, series, "", ABSOLUTE_LABELS[metric])
            yield PlannedFigure(
                f"ate_{metric}",
                f"ATE over trials, {ABSOLUTE_LABELS[metric]}",
                "Points: RMSE per trial. Boxes: median and quartiles; whiskers: minimum and "
                f"maximum. Failed runs have no point.{_scale(plot)}",
                plot,
            )


def _relative_plots(summary: ComparisonSummary, sequence: str) -> Iterator[PlannedFigure]:
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
            plot = BoxPlot(groups, series, across, RELATIVE_LABELS[metric])
            yield PlannedFigure(
                f"re_{metric}_{sequence}",
                f"Relative error on {sequence}, {RELATIVE_LABELS[metric]}",
                "All sub-trajectories of all trials. Boxes: median and quartiles; whiskers: 5 % "
                f"to 95 %.{_scale(plot)}",
                plot,
            )


def _scale(plot: BoxPlot) -> str:
    """Return a sentence about a logarithmic axis; "" for a linear one."""
    return " The axis is logarithmic." if plot.is_logarithmic else ""


def _pooled_box(row: dict[str, Any] | None) -> Box | None:
    if row is None:
        return None
    return Box(*(row[name] for name in ("p5", "p25", "median", "p75", "p95")))


def _paths(
    summary: ComparisonSummary, medians: dict[int, tuple[str, Record]], sequence: str
) -> PlannedFigure:
    _, first = next(iter(medians.values()))
    paths = {place: (name, item.columns["path"]) for place, (name, item) in medians.items()}
    return PlannedFigure(
        f"trajectories_{sequence}",
        f"Trajectories on {sequence}",
        f"Aligned trajectories from above.{_of_several(summary, sequence)}",
        PathsPlot(first.groundtruth_up, first.columns["groundtruth"], paths),
    )


def _errors(
    summary: ComparisonSummary, medians: dict[int, tuple[str, Record]], sequence: str
) -> PlannedFigure:
    series = {place: (name, item.columns["errors"]) for place, (name, item) in medians.items()}
    return PlannedFigure(
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
    medians = {}
    for place, algorithm in enumerate(summary.algorithms[:MOST_ALGORITHMS]):
        trials = [item for item in summary.of(algorithm, sequence) if "position_m" in item.rmse]
        if not trials:
            continue
        trials.sort(key=lambda trial: trial.rmse["position_m"])
        trial = trials[(len(trials) - 1) // 2]
        if (record := records.read(trial.key, with_pooled=False)) is not None:
            which = f", trial {trial.trial}" if trial.trial else ""
            medians[place] = (f"{algorithm}{which}", record)
    return medians
