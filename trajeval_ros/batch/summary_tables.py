"""From the summary of a comparison to the tables that people read."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from statistics import median
from typing import Any

from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.results_table import OK, RE
from trajeval_ros.diagnosis.warnings import LOW_COVERAGE
from trajeval_ros.formatting.numbers import three_decimals, whole_percent
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.enough_pairs import enough_pairs
from trajeval_ros.report.matrix import Cell, Matrix
from trajeval_ros.report.tables import ABSOLUTE, RE_FORMS, RELATIVE

_PARTIAL, _FEW = "†", "‡"


def definition(settings: dict[str, Any]) -> str:
    """Say in a sentence what all numbers of a comparison depend on."""
    modality = f" for {settings['modality']}" if settings["modality"] else ""
    states = settings["align_states"]
    how = {"all": "all states", 1: "the first state"}.get(states, f"the first {states} states")
    # Comparisons of older versions don't say it.
    how += " and their orientations" if settings.get("align_with") == "poses" else ""
    span = (
        ", only the time that all runs of a sequence have" if settings["common_time_span"] else ""
    )
    return (
        f"Protocol {settings['protocol']}, aligned by {settings['gauge']} "
        f"({Gauge(settings['gauge']).description}){modality} with {how}, association "
        f"{settings['association']}{span}.{_calibration(settings)}"
    )


def _calibration(settings: dict[str, Any]) -> str:
    """Say what of clocks and bodies the numbers are with."""
    asked = ["clock offset"] if settings["calibrate_time_offset"] else []
    asked += ["body"] if settings["hand_eye"] == "auto" else []
    text = ""
    if asked:
        text = f" Calibrated for each run, and applied where significant: {' and '.join(asked)}."
    if isinstance(settings["hand_eye"], list):
        text += " With a given hand-eye transform."
    return text


def matrices(summary: ComparisonSummary) -> list[Matrix]:
    """Return the tables: absolute errors by sequence, relative errors by length."""
    tables = [_absolute(summary, "position_m"), _absolute(summary, "rotation_deg")]
    in_metres = not any(length.endswith("s") for length in summary.settings["lengths"])
    metrics = ("position_percent", "rotation_deg_per_m")
    if not in_metres:
        metrics = ("position_m", "rotation_deg")
    tables += [_relative(summary, metric) for metric in metrics]
    tables += [_values(summary, metric) for metric in _VALUES]
    return [table for table in tables if table is not None]


# Metric: title, and what the number is.
_VALUES = {
    "time_offset_s": (
        "Clock offset [s]",
        "Estimated for each run and applied where it is significant; errors are with it.",
    ),
    "joint_nees_per_dof": (
        "Joint NEES per degree of freedom",
        "About 1 where covariances fit the errors.",
    ),
    "pose_nees_per_dof": (
        "NEES per degree of freedom, mean of poses",
        "About 1 where covariances fit the errors.",
    ),
    "nll_per_pose": (
        "Negative log-likelihood per pose",
        "Smaller is better; comparable among estimates with the same stamps.",
    ),
    "weighted_m": (
        "ATE weighted by the groundtruth's uncertainty [m]",
        "Over all poses of an estimate that the continuous groundtruth covers.",
    ),
}
_RANKED = ("nll_per_pose", "weighted_m")  # smaller is better


def _values(summary: ComparisonSummary, metric: str) -> Matrix | None:
    """Return the median over trials of a number that was asked for; None where nobody did."""
    rows, ranked = [], metric in _RANKED
    for algorithm in summary.algorithms:
        found = [
            [
                each.values[metric]
                for each in summary.of(algorithm, sequence)
                if metric in each.values
            ]
            for sequence in summary.sequences
        ]
        rows.append(
            (algorithm, tuple(Cell(median(each) if each else None, "", ranked) for each in found))
        )
    if all(cell.value is None for _, cells in rows for cell in cells):
        return None
    title, meaning = _VALUES[metric]
    caption = f"{meaning} {definition(summary.settings)}"
    return _matrix(summary, metric, title, caption, rows)


def _absolute(summary: ComparisonSummary, metric: str) -> Matrix | None:
    states = summary.settings["align_states"]
    gauge = Gauge(summary.settings["gauge"])
    enough = enough_pairs(gauge, None if states == "all" else states)
    rows = [
        (
            algorithm,
            tuple(
                _cell(summary.of(algorithm, each), metric, enough) for each in summary.sequences
            ),
        )
        for algorithm in summary.algorithms
    ]
    if all(cell.value is None for _, cells in rows for cell in cells):
        return None
    several = any(len(summary.of(row, each)) > 1 for row, _ in rows for each in summary.sequences)
    over = " of trials: median (least to largest); a failed one counts as worse than all"
    caption = (
        f"Absolute trajectory error, {summary.settings['ate_form']} form, rmse"
        f"{over if several else ''}. {definition(summary.settings)}"
    )
    notes = "".join(cell.note for _, cells in rows for cell in cells)
    if _PARTIAL in notes:
        least = whole_percent(LOW_COVERAGE)
        caption += f" {_PARTIAL} covers less than {least} of the groundtruth's time."
    if _FEW in notes:
        caption += f" {_FEW} from fewer than {enough} pairs, too few for an ATE, and not ranked."
    return _matrix(summary, f"ate_{metric}", f"ATE, {ABSOLUTE[metric]}", caption, rows)


def _cell(trials: Sequence[Trial], metric: str, enough: int) -> Cell:
    """Return the median over trials, of which a failed one is worse than any other.

    What is from fewer pairs than enough is not ranked.
    """
    known = [trial.rmse[metric] for trial in trials if metric in trial.rmse]
    evaluated = [trial for trial in trials if trial.status == OK]
    if not trials or (evaluated and not known):
        return Cell(None)
    value = median([*known, *[math.inf] * (len(trials) - len(evaluated))])
    notes = []
    if len(known) > 1:
        notes.append(f"({three_decimals(min(known))}–{three_decimals(max(known))})")
    if len(known) < len(trials) and len(trials) > 1:
        notes.append(f"{len(known)}/{len(trials)}")
    if evaluated and median(trial.coverage for trial in evaluated) < LOW_COVERAGE:
        notes.append(_PARTIAL)
    has_few = any(trial.pairs < enough for trial in evaluated)
    if has_few:
        notes.append(_FEW)
    return Cell(value, " ".join(notes), is_ranked=not has_few)


def _relative(summary: ComparisonSummary, metric: str) -> Matrix | None:
    lengths = summary.settings["lengths"]
    pooled: dict[tuple[str, str], list[tuple[float, int]]] = defaultdict(list)
    for row in summary.pooled:
        if (row["kind"], row["metric"]) == (RE, metric):
            pooled[row["algorithm"], row["length"]].append((row["mean"], row["count"]))
    rows = []
    some_lost = False
    for algorithm in summary.algorithms:
        trials = summary.of(algorithm)
        evaluated = sum(trial.status == OK for trial in trials)
        # Means without the hardest runs would be the best ones.
        is_whole = evaluated == len(trials)
        some_lost |= not is_whole
        note = "" if is_whole else f"{evaluated}/{len(trials)}"
        cells = []
        for length in lengths:
            means = pooled[algorithm, length]
            count = sum(each for _, each in means)
            mean = sum(value * each for value, each in means) / count if count else None
            cells.append(Cell(mean, note if count else "", is_ranked=is_whole))
        rows.append((algorithm, tuple(cells)))
    if all(cell.value is None for _, cells in rows for cell in cells):
        return None
    caption = (
        "Relative error, mean over the sub-trajectories of all sequences and trials; "
        f"{RE_FORMS[summary.settings['re_form']]}. {definition(summary.settings)}"
    )
    if some_lost:
        caption += " Who lost runs, which have no sub-trajectories, is not ranked."
    title = f"Relative error, {RELATIVE[metric]}, by length"
    return _matrix(summary, f"re_{metric}", title, caption, rows, lengths)


def _matrix(
    summary: ComparisonSummary,
    name: str,
    title: str,
    caption: str,
    rows: list[tuple[str, tuple[Cell, ...]]],
    columns: Sequence[str] | None = None,
) -> Matrix:
    runs, coverage = [], []
    for algorithm, _ in rows:
        trials = summary.of(algorithm)
        runs.append(f"{sum(trial.status == OK for trial in trials)}/{len(trials)}")
        coverage.append(sum(trial.coverage for trial in trials) / len(trials))
    headings = tuple(summary.sequences if columns is None else columns)
    return Matrix(name, title, caption, headings, tuple(rows), tuple(runs), tuple(coverage))
