"""What a report draws of all runs together, before it is drawn."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from trajeval_ros.batch.comparison import RECORDS
from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.drawing import FigureDraft
from trajeval_ros.batch.records import read_record
from trajeval_ros.batch.results_table import RE
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.report.comparison_figures import Box, box_plot, overlay
from trajeval_ros.report.tables import ABSOLUTE, RELATIVE

# Each has a figure or three, which take a quarter of a second.
MOST_SEQUENCES = 50
_UNITS = {"m": "[m]", "s": "[s]", "%": "[% of the path]"}


def drafts_of(folder: Path, summary: ComparisonSummary) -> list[FigureDraft]:
    """Return the figures: absolute errors, relative errors, and trajectories by sequence.

    The latter two of the first `MOST_SEQUENCES`.

    Args:
        folder: The comparison's.
        summary: What it found.
    """
    return [*_absolute_plots(summary), *_relative_plots(summary), *_overlays(folder, summary)]


def _absolute_plots(summary: ComparisonSummary) -> list[FigureDraft]:
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
            draw = partial(
                box_plot, f"ate-{metric}", summary.sequences, series, "", ABSOLUTE[metric]
            )
            title = f"ATE over trials, {ABSOLUTE[metric]}"
            caption = (
                "A point is the rmse of a trial; boxes: median and quartiles, whiskers: least and "
                "largest. Failed runs have no point."
            )
            plots.append(FigureDraft(title, caption, draw))
    return plots


def _relative_plots(summary: ComparisonSummary) -> list[FigureDraft]:
    lengths = summary.settings["lengths"]
    by_place = {
        (row["algorithm"], row["sequence"], row["length"], row["metric"]): row
        for row in summary.pooled
        if row["kind"] == RE
    }
    in_metres = not any(length.endswith("s") for length in lengths)
    position = "position_percent" if in_metres else "position_m"
    plots = []
    for sequence in summary.sequences[:MOST_SEQUENCES]:
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
                draw = partial(box_plot, name, groups, series, axis, label)
                caption = (
                    "All sub-trajectories of all trials; boxes: median and quartiles, whiskers: "
                    "5 % to 95 %."
                )
                plots.append(FigureDraft(f"Relative error on {sequence}, {label}", caption, draw))
    return plots


def _pooled_box(row: dict[str, Any] | None) -> Box | None:
    if row is None:
        return None
    return Box(*(row[name] for name in ("p5", "p25", "median", "p75", "p95")))


def _overlays(folder: Path, summary: ComparisonSummary) -> list[FigureDraft]:
    """Draw on each sequence the trial of each algorithm that has the median error."""
    plots = []
    for sequence in summary.sequences[:MOST_SEQUENCES]:
        truth: Floats | None = None
        up = Z_UP
        paths: list[tuple[str, Floats] | None] = []
        for algorithm in summary.algorithms:
            trial = _median_trial(summary.of(algorithm, sequence))
            record = None if trial is None else read_record(folder / RECORDS, trial.key)
            if trial is None or record is None:
                paths.append(None)
                continue
            if truth is None:
                truth, up = record.columns["truth"], record.groundtruth_up
            name = f"{algorithm} {trial.trial}".strip()
            paths.append((name, record.columns["path"]))
        if truth is not None:
            several = len(summary.of(summary.algorithms[0], sequence)) < len(
                [trial for trial in summary.trials if trial.sequence == sequence]
            )
            caption = "From above, aligned."
            if several:
                caption += " Of several trials, that with the median position ATE."
            draw = partial(overlay, f"overlay-{sequence}", up, truth, paths)
            plots.append(FigureDraft(f"Trajectories on {sequence}", caption, draw))
    return plots


def _median_trial(trials: list[Trial]) -> Trial | None:
    ranked = sorted(
        (trial for trial in trials if "position_m" in trial.rmse),
        key=lambda trial: trial.rmse["position_m"],
    )
    return ranked[(len(ranked) - 1) // 2] if ranked else None
