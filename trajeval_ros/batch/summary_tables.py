"""The tables of a comparison, from its summary."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import Any

from trajeval_ros.batch.comparison_summary import KITTI, ComparisonSummary, Trial
from trajeval_ros.batch.plan import association_of
from trajeval_ros.batch.results_table import MISSING, OK, RE
from trajeval_ros.formatting.numbers import counted, whole_percent
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.coverage import LOW_COVERAGE
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.report.definitions import (
    ABSOLUTE_LABELS,
    METHOD_TEXTS,
    RE_FORM_TEXTS,
    RELATIVE_LABELS,
)
from trajeval_ros.report.matrix import UNRANKED, Cell, Matrix, with_equal_decimals

_PARTIAL, _FEW, _DIAGNOSED = "†", "‡", "§"
_COPY = "is the groundtruth"
_NO_MISTAKES = {
    "few_pairs",
    "frames_lost",
    "keyframes",
}  # findings with a separate mark, or without one
_COMPARABLE = (
    f"Only algorithms with at least {whole_percent(LOW_COVERAGE)} of the largest coverage are "
    "ranked. A number that is worse than an unranked one is not marked as the best."
)
WITHHELD = "withheld"
SPAN_NOTE = "Only the common time span of all runs of a sequence"
_MOST_NAMED = 3  # unranked algorithms that a caption names


def definition(settings: dict[str, Any]) -> str:
    """Return a sentence with the settings of all numbers of a comparison."""
    modality = f" for {settings['modality']}" if settings["modality"] else ""
    states = settings["align_states"]
    how = {"all": "all states", 1: "the first state"}.get(states, f"the first {states} states")
    how += " and their orientations" if settings["align_with"] == "poses" else ""
    rule = association_of(settings)
    return (
        f"Protocol {settings['protocol']}, aligned by "
        f"{Gauge(settings['gauge']).description}, gauge {settings['gauge']}{modality}, {how}; "
        f"{METHOD_TEXTS[rule.method].format(rule)}.{_calibration(settings)}"
    )


def _calibration(settings: dict[str, Any]) -> str:
    """Return a sentence with the calibration that was applied."""
    asked = ["clock offset"] if settings["time_offset"] == "auto" else []
    asked += ["body"] if settings["hand_eye"] == "auto" else []
    text = ""
    if asked:
        text = (
            f" Calibrated per run and applied if statistically significant: {' and '.join(asked)}."
        )
    if isinstance(settings["hand_eye"], list):
        text += " With a given hand-eye transform."
    return text


def matrices(summary: ComparisonSummary) -> list[Matrix]:
    """Return the tables: absolute errors by sequence, relative errors by length."""
    tables = [_absolute(summary, "position_m"), _absolute(summary, "rotation_deg")]
    if summary.settings["protocol"] == "kitti":
        tables += [_kitti(summary, *item) for item in KITTI.items()]
    metrics = ("position_percent", "rotation_deg_per_m")
    if not all(Length.parse(length).in_metres for length in summary.settings["lengths"]):
        metrics = ("position_m", "rotation_deg")
    tables += [_relative(summary, metric) for metric in metrics]
    tables += [_values(summary, metric) for metric in _VALUES]
    return [table for table in tables if table is not None]


# By metric: title and definition of the value.
_VALUES = {
    "time_offset_s": (
        "Clock offset [s]",
        "Estimated per run and applied to the errors if statistically significant.",
    ),
    "joint_nees_per_dof": (
        "Joint NEES per degree of freedom",
        "About 1 for consistent covariances.",
    ),
    "pose_nees_per_dof": (
        "NEES per degree of freedom, mean of poses",
        "About 1 for consistent covariances.",
    ),
    "horizontal_hazardous": (
        "Hazardously misleading share of poses, horizontal",
        "Errors over the alert limit with a protection level within it.",
    ),
    "horizontal_available": (
        "Available share of poses, horizontal",
        "Protection levels within the alert limit.",
    ),
    "horizontal_inflation": (
        "Inflation for 99.9 % of the errors, horizontal",
        "What protection levels must be multiplied by to bound the errors.",
    ),
    "as_available_position_m": (
        "As-available error [m], RMSE",
        "Error of the newest received pose. `ATE: 2` is a rank by ATE that differs.",
    ),
    "as_available_age_error_m": (
        "Age error [m], RMSE",
        "The part of the as-available error by latency, dropouts and sampling.",
    ),
    "as_available_age_s": ("Age of the pose in use [s], 95th percentile", "At 100 Hz."),
    "as_available_available_percent": (
        "Available [%]",
        "Percentage of the time with a pose within the deadline.",
    ),
    "nll_per_pose": (
        "Negative log-likelihood per pose",
        "Smaller is better. Comparable between estimates with the same timestamps.",
    ),
    "weighted_m": (
        "ATE weighted by the groundtruth's uncertainty [m]",
        "Over all poses that the continuous groundtruth covers.",
    ),
}
_AVAILABLE = "as_available_position_m"
# Smaller is better.
_RANKED = (
    *("nll_per_pose", "weighted_m"),
    *(_AVAILABLE, "as_available_age_error_m", "as_available_age_s"),
)


def _values(summary: ComparisonSummary, metric: str) -> Matrix | None:
    """Return the table of the medians over trials of a value; None if no run has it."""
    rows, ranked = [], metric in _RANKED
    for algorithm in summary.algorithms:
        cells = []
        for sequence in summary.sequences:
            having = [run for run in summary.of(algorithm, sequence) if metric in run.values]
            known = [run.values[metric] for run in having]
            trials = len(summary.of(algorithm, sequence)) if ranked else len(having)
            value = _median_with_last(known, trials) if known else None
            instead = WITHHELD if value == math.inf else ""
            share = f"{len(known)}/{trials}" if 0 < len(known) < trials else ""
            note = f"{share} {diagnosed(having)}".strip()
            cells.append(Cell(value, note, ranked, instead=instead))
        rows.append((algorithm, tuple(cells)))
    if metric == _AVAILABLE:
        rows = _with_ranks_by_ate(summary, rows)
    title, meaning = _VALUES[metric]
    return _matrix(summary, metric, title, (meaning, definition(summary.settings)), rows)


def _with_ranks_by_ate(
    summary: ComparisonSummary, rows: Sequence[tuple[str, tuple[Cell, ...]]]
) -> list[tuple[str, tuple[Cell, ...]]]:
    """Return the cells with the rank by ATE where it differs from their own."""
    marked: list[list[Cell]] = [[] for _ in rows]
    for column, sequence in enumerate(summary.sequences):
        cells = [cells[column] for _, cells in rows]
        of_each = [summary.of(algorithm, sequence) for algorithm, _ in rows]
        known = [
            [trial.rmse["position_m"] for trial in trials if "position_m" in trial.rmse]
            for trials in of_each
        ]
        ates = [median(item) if item else None for item in known]
        ranks = zip(_ranks([item.value for item in cells]), _ranks(ates), strict=True)
        for place, (cell, (rank, by_ate)) in enumerate(zip(cells, ranks, strict=True)):
            note = f"ATE: {by_ate}" if rank and by_ate and rank != by_ate else ""
            marked[place].append(replace(cell, note=f"{note} {cell.note}".strip()))
    return [(row[0], tuple(cells)) for row, cells in zip(rows, marked, strict=True)]


def _ranks(values: Sequence[float | None]) -> list[int | None]:
    """Return the ranks of values from 1; None for None."""
    known = sorted(value for value in values if value is not None)
    return [None if value is None else known.index(value) + 1 for value in values]


def _absolute(summary: ComparisonSummary, metric: str) -> Matrix | None:
    title, form = f"ATE, {ABSOLUTE_LABELS[metric]}", summary.settings["ate_form"]
    what = f"Absolute trajectory error, {form} form, RMSE"
    return _by_sequence(summary, metric, f"ate_{metric}", title, what, ", RMSE")


def _kitti(summary: ComparisonSummary, metric: str, title: str) -> Matrix | None:
    """Return an error of the table of the KITTI benchmark, by sequence."""
    lengths = [Length.parse(length).text for length in summary.settings["lengths"]]
    what = f"KITTI: mean over the sub-trajectories of {lengths[0]} to {lengths[-1]}"
    return _by_sequence(summary, metric, f"re_{metric}", title, what)


def _by_sequence(
    summary: ComparisonSummary, metric: str, name: str, title: str, what: str, statistic: str = ""
) -> Matrix | None:
    """Return the table of medians over trials by sequence; None without a number."""
    enough = _enough_pairs(summary)
    comparable = {
        sequence: _comparable_coverage(summary, sequence) for sequence in summary.sequences
    }
    rows = [
        (
            algorithm,
            tuple(
                _cell(summary.of(algorithm, sequence), metric, enough, comparable[sequence])
                for sequence in summary.sequences
            ),
        )
        for algorithm in summary.algorithms
    ]
    several = any(
        len(summary.of(row, sequence)) > 1 for row, _ in rows for sequence in summary.sequences
    )
    over = " of trials: median (minimum to maximum); trials without a value are ranked last"
    notes = (f"{what}{over if several else ''}.", *_common_notes(summary))
    brief = _brief(summary, f"{title}{statistic}{', median of trials' if several else ''}")
    # The mean of KITTI's table is over the sub-trajectories of all sequences.
    has_average = metric not in KITTI
    return _matrix(summary, name, title, notes, rows, brief=brief, has_average=has_average)


def _common_notes(summary: ComparisonSummary) -> Iterator[str]:
    """Yield the notes of all tables of errors."""
    yield definition(summary.settings)
    if summary.common_spans:
        yield f"{SPAN_NOTE}: {summary.common_spans}."
    yield _COMPARABLE


def _enough_pairs(summary: ComparisonSummary) -> int:
    """Return the number of pairs that an ATE needs."""
    states = summary.settings["align_states"]
    gauge = Gauge(summary.settings["gauge"])
    return gauge.enough_pairs(None if states == "all" else states)


def _brief(summary: ComparisonSummary, what: str) -> str:
    """Return a caption of one sentence, without the marks and the full stop."""
    gauge = Gauge(summary.settings["gauge"])
    aligned = "unaligned" if gauge is Gauge.NONE else f"aligned by {gauge.description}"
    span = f", common time span: {summary.common_spans}" if summary.common_spans else ""
    return f"{what}, {aligned}{span}; best bold, second best underlined"


def _legend(
    summary: ComparisonSummary, rows: Sequence[tuple[str, Sequence[Cell]]]
) -> list[tuple[str, str]]:
    """Return the meanings of the marks in a table: as a clause, and the end of a sentence."""
    used = " ".join(cell.note for _, cells in rows for cell in cells)
    meanings = (
        (_PARTIAL, f"coverage below {whole_percent(LOW_COVERAGE)}", " of the groundtruth."),
        (_FEW, f"fewer than {_enough_pairs(summary)} pairs", ", too few for an ATE."),
        (
            _DIAGNOSED,
            "mistakes found",
            f" ({_named_mistakes(summary)}); follow the warnings of the runs.",
        ),
    )
    shares = re.search(r"\d+/\d+", used)
    listed = [(f"{shares[0]}: runs with a value, of all runs", ".")] if shares else []
    return listed + [(f"{mark} {clause}", end) for mark, clause, end in meanings if mark in used]


def _comparable_coverage(summary: ComparisonSummary, sequence: str) -> float:
    """Return the smallest coverage of a sequence that is comparable with the largest one."""
    covered = [_coverage(summary.of(algorithm, sequence)) for algorithm in summary.algorithms]
    return LOW_COVERAGE * max(covered, default=0.0)


def _coverage(trials: Sequence[Trial]) -> float:
    """Return the median coverage of the evaluated trials."""
    return median([trial.coverage for trial in trials if trial.status == OK] or [0.0])


def _mean_coverage(trials: Sequence[Trial]) -> float:
    """Return the mean coverage of all trials, of all sequences; failed ones count as zero."""
    return sum(trial.coverage for trial in trials) / max(len(trials), 1)


def _mistakes(trial: Trial) -> list[str]:
    """Return the mistakes that a run shows; keyframes are not a mistake."""
    return [cause for cause in trial.diagnosis if cause not in _NO_MISTAKES]


def diagnosed(trials: Sequence[Trial]) -> str:
    """Return the mark of numbers of a run that shows a mistake; "" for others."""
    return _DIAGNOSED if any(map(_mistakes, trials)) else ""


def _named_mistakes(summary: ComparisonSummary) -> str:
    """Return the mistakes with the first run that shows each: "wxyz: vio MH_01 and 3 more"."""
    runs: dict[str, list[str]] = defaultdict(list)
    for trial in summary.trials:
        for cause in _mistakes(trial):
            runs[cause].append(trial.name)
    return "; ".join(f"{cause}: {and_more(names)}" for cause, names in sorted(runs.items()))


def _cell(trials: Sequence[Trial], metric: str, enough: int, comparable: float) -> Cell:
    """Return the median over trials; a trial without a value is worse than any other.

    A number is not ranked if it has too few pairs, its coverage is not comparable, or an estimate
    is the groundtruth.
    """
    if trials and all(trial.status == MISSING for trial in trials):
        return Cell(math.inf, instead=MISSING)
    known = [trial.rmse[metric] for trial in trials if metric in trial.rmse]
    evaluated = [trial for trial in trials if trial.status == OK]
    if not trials or (evaluated and not known):
        return Cell(None)
    value = _median_with_last(known, len(trials))
    failed = len(trials) - len(evaluated)
    instead = WITHHELD if math.isinf(value) and 2 * failed < len(trials) else ""
    notes = []
    extremes = (min(known), max(known)) if len(known) > 1 else None
    if len(known) < len(trials) and len(trials) > 1:
        notes.append(f"{len(known)}/{len(trials)}")
    if evaluated and _coverage(trials) < LOW_COVERAGE:
        notes.append(_PARTIAL)
    fewest = min((trial.pairs for trial in evaluated), default=enough)
    if fewest < enough:
        notes.append(_FEW)
    notes.append(diagnosed(evaluated))
    why = f"{counted(fewest, 'pair')}" if fewest < enough else ""
    if not evaluated:
        return Cell(value, " ".join(notes))
    if any(trial.is_copy for trial in evaluated):
        why = _COPY
    competes = not why
    if competes and _coverage(trials) < comparable:
        why = f"covers {whole_percent(_coverage(trials))}"
    return Cell(value, " ".join(filter(None, notes)), not why, why, competes, extremes, instead)


def _median_with_last(known: Sequence[float], trials: int) -> float:
    """Return the median over all trials; those without a value count as infinite."""
    return median([*known, *[math.inf] * (trials - len(known))])


def _relative(summary: ComparisonSummary, metric: str) -> Matrix | None:
    lengths = summary.settings["lengths"]
    pooled: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for row in summary.pooled:
        if (row["kind"], row["metric"]) == (RE, metric):
            pooled[row["algorithm"], row["length"]].append(row)
    rows = []
    comparable = LOW_COVERAGE * max(
        _mean_coverage(summary.of(item)) for item in summary.algorithms
    )
    long_enough = {
        length: {row["sequence"] for name in summary.algorithms for row in pooled[name, length]}
        for length in lengths
    }
    for algorithm in summary.algorithms:
        trials = summary.of(algorithm)
        cells = []
        for length in lengths:
            of_length = pooled[algorithm, length]
            count = sum(row["count"] for row in of_length)
            mean = sum(row["mean"] * row["count"] for row in of_length) / count if count else None
            # Omitting runs that failed or whose errors are withheld favours an algorithm.
            # Sequences that are too short for all algorithms favour none.
            evaluated = sum(row["evaluated"] for row in of_length)
            expected = sum(trial.sequence in long_enough[length] for trial in trials)
            is_whole = evaluated == expected
            note = "" if is_whole else f"{evaluated}/{expected}"
            note = f"{note} {diagnosed(trials)}".strip()
            covered = _mean_coverage(trials)
            why = "" if covered >= comparable else f"covers {whole_percent(covered)}"
            why = why if is_whole else f"{evaluated} of {counted(expected, 'run')}"
            is_copy = any(trial.is_copy for trial in trials)
            why = _COPY if is_copy else why
            cells.append(Cell(mean, note if count else "", not why, why, not is_copy))
        rows.append((algorithm, tuple(cells)))
    notes = (
        "Relative error, mean over the sub-trajectories of all sequences and trials; "
        f"{RE_FORM_TEXTS[summary.settings['re_form']]}.",
        *_common_notes(summary),
    )
    title = f"Relative error, {RELATIVE_LABELS[metric]}, by length"
    brief = _brief(summary, f"{title}, mean over all sub-trajectories")
    names = [Length.parse(length).text for length in lengths]
    return _matrix(summary, f"re_{metric}", title, notes, rows, names, brief)


def _unranked(rows: Sequence[tuple[str, Sequence[Cell]]], headings: Sequence[str]) -> str:
    """Return a sentence with the numbers that are not ranked, and why; "" if all are."""
    unranked: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name, cells in rows:
        for cell, heading in zip(cells, headings, strict=True):
            if cell.why_unranked and cell.value is not None:
                unranked[name, cell.why_unranked].append(heading)
    if not unranked:
        return ""
    named = [
        name + (f" on {and_more(where)}" if len(where) < len(headings) else "") + f" ({why})"
        for (name, why), where in unranked.items()
    ]
    return f"{UNRANKED} not ranked: {and_more(named, _MOST_NAMED)}."


def and_more(names: Sequence[str], most: int = 1) -> str:
    """Return the first names, and the number of the others: "MH_01 and 3 more"."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def _matrix(
    summary: ComparisonSummary,
    name: str,
    title: str,
    notes: Sequence[str],
    rows: list[tuple[str, tuple[Cell, ...]]],
    columns: Sequence[str] | None = None,
    brief: str = "",
    *,
    has_average: bool = False,
) -> Matrix | None:
    """Return a table with the meanings of its marks; None without a number."""
    if all(cell.value is None for _, cells in rows for cell in cells):
        return None
    runs, coverage = [], []
    for algorithm, _ in rows:
        trials = summary.of(algorithm)
        runs.append(f"{sum(trial.status == OK for trial in trials)}/{len(trials)}")
        coverage.append(_mean_coverage(trials))
    headings = tuple(summary.sequences if columns is None else columns)
    unranked, legend = _unranked(rows, headings), _legend(summary, rows)
    marks = [clause + end for clause, end in legend]
    return Matrix(
        name,
        title,
        tuple(filter(None, (*notes, *marks, unranked))),
        headings,
        with_equal_decimals(rows),
        tuple(runs),
        tuple(coverage),
        f"{', '.join([brief or title, *(clause for clause, _ in legend)])}. {unranked}".strip(),
        has_average and len(headings) > 1,
    )
