"""The result of an evaluation as lines and tables, for a terminal or a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.formatting.remarks import Level
from trajeval_ros.formatting.text_tables import BOLD
from trajeval_ros.geometry.source_info import ASSUMED, ASSUMED_COLUMNS, FORMAT
from trajeval_ros.metrics.discontinuities.handling import SPLIT
from trajeval_ros.pipeline.evaluation_remarks import SCALE_DRIFT
from trajeval_ros.report import tables
from trajeval_ros.report.console import WARNING, Console, Table, show
from trajeval_ros.report.verdict_lines import (
    definitions,
    diagnosis_lines,
    doubt,
    explanation,
    noise_corrected_line,
    verdict,
)

if TYPE_CHECKING:
    from trajeval_ros.pipeline.outcome import Outcome, RunOutcome


def print_verdicts(terminal: Console, outcome: Outcome) -> None:
    """Print the result lines of every estimate, and the detected mistakes."""
    split = outcome.request.discontinuities.on_restart == SPLIT
    for run in outcome.runs:
        headline, *rest = verdict(run.evaluation, run.likelihood, split=split)
        headline += doubt(run.diagnosis)
        terminal.print(headline, BOLD, soft_wrap=True)
        for line in diagnosis_lines(run):
            terminal.print(line, WARNING, soft_wrap=True)
        for line in rest:
            terminal.print(line, soft_wrap=True)
        position = run.evaluation.ate["position_m"]
        if run.available is not None and position is not None:
            from trajeval_ros.report.requested_lines import available_lines

            for line in available_lines(run.available.numbers, position.rmse):
                terminal.print(line, soft_wrap=True)
        if run.noise_corrected_ate is not None:
            terminal.print(noise_corrected_line(run.noise_corrected_ate), soft_wrap=True)
    for side in (outcome.groundtruth, *(run.estimate for run in outcome.runs)):
        for remark in side.remarks:
            if remark.code == ASSUMED_COLUMNS:
                terminal.print(f"  {side.name}: {remark.text}", WARNING, soft_wrap=True)
    protocol = outcome.runs[0].evaluation.protocol
    if outcome.request.gauge_is_default and outcome.groundtruth.fixes is not None:
        terminal.print(
            f"  gauge {protocol.gauge.value} by default for GNSS fixes, because their heights "
            "tilt the estimate; set another with --gauge",
            soft_wrap=True,
        )
    elif outcome.request.gauge_is_default and protocol.modality is None:
        terminal.print(
            f"  gauge {protocol.gauge.value} by default; set the sensors with --modality (mono, "
            "stereo, stereo-inertial, ...)",
            soft_wrap=True,
        )


def print_tables(terminal: Console, outcome: Outcome, statistic: str = "") -> None:
    """Print the tables of errors, and the lines on calibration and consistency.

    `statistic`: that of relative errors; by default that of the protocol.
    """
    _print_likelihoods(terminal, outcome)
    _print_errors(terminal, outcome.runs, statistic)
    for run in outcome.runs:
        name = run.estimate.name
        if run.calibrated is not None:
            from trajeval_ros.report.requested_lines import calibration_lines

            _print_titled(terminal, calibration_lines(name, run.calibrated))
        if run.consistency is not None:
            from trajeval_ros.report.requested_lines import consistency_lines

            _print_titled(terminal, consistency_lines(name, run.consistency))
    _print_integrity(terminal, outcome.runs)


def _print_titled(terminal: Console, lines: Sequence[str]) -> None:
    """Print lines of which the second, after an empty one, is the title."""
    for place, line in enumerate(lines):
        terminal.print(line, BOLD if place == 1 else "", soft_wrap=True)


def print_definitions(terminal: Console, outcome: Outcome) -> None:
    """Print how the numbers are defined."""
    for run in outcome.runs:
        for text in definitions(run.evaluation):
            terminal.print(text, soft_wrap=True)
        if run.stream is not None:
            from trajeval_ros.report.requested_lines import stream_line

            if arrival := stream_line(run.stream):
                terminal.print(arrival, soft_wrap=True)


def print_tests(terminal: Console, runs: Sequence[RunOutcome]) -> None:
    """Print the tests for mistakes, with their results and statistics."""
    for run in runs:
        terminal.print(f"\n{run.estimate.name}: tests, their results and statistics")
        for line in explanation(run.diagnosis):
            terminal.print(f"  {line}", soft_wrap=True)


def _print_likelihoods(terminal: Console, outcome: Outcome) -> None:
    likely = outcome.likelihoods
    if not likely:
        return

    terminal.print()
    show(terminal, tables.probabilistic_table(likely))
    for line in tables.probabilistic_lines(likely):
        terminal.print(line, soft_wrap=True)


def _print_errors(terminal: Console, runs: Sequence[RunOutcome], statistic: str) -> None:

    evaluations = [run.evaluation for run in runs]
    terminal.print()
    show(terminal, tables.absolute_table(evaluations, terminal.width))
    by_states = tables.states_table(runs)
    if by_states is not None:
        terminal.print()
        show(terminal, by_states)
        for line in tables.states_remarks(runs):
            terminal.print(line, soft_wrap=True)
    relative = tables.relative_table(evaluations, terminal.width, statistic)
    if relative is not None:
        terminal.print()
        show(terminal, relative)
    scale = tables.scale_table(evaluations)
    if scale is not None:
        terminal.print()
        show(terminal, scale)


def print_remarks(remarks: Console, runs: Sequence[RunOutcome]) -> None:
    """Print notes about the inputs, and warnings."""
    groundtruth = runs[0].evaluation.groundtruth
    for trajectory in (groundtruth, *(run.evaluation.estimate for run in runs)):
        notes = [item for item in trajectory.reading.remarks if item.level is Level.NOTE]
        shown = [note for note in notes if note.code not in (ASSUMED, FORMAT)]
        texts = "; ".join(item.text for item in shown)
        if texts:
            remarks.remark("note", f"{trajectory.name}: {texts}")
        for note in notes:
            if note.code == ASSUMED:
                remarks.remark("assumed", note.text)
    for run in runs:
        # Below the headline.
        printed = {
            SCALE_DRIFT,
            ASSUMED_COLUMNS,
            *(finding.cause for finding in run.diagnosis.findings),
        }
        for remark in run.evaluation.remarks:
            if remark.code not in printed:
                kind = "note" if remark.level is Level.NOTE else WARNING
                remarks.remark(kind, f"{run.estimate.name}: {remark.text}")


def _print_integrity(terminal: Console, runs: Sequence[RunOutcome]) -> None:
    asked = {run.estimate.name: run.integrity for run in runs if run.integrity is not None}
    if not asked:
        return
    from trajeval_ros.report import requested_lines

    table = Table("", requested_lines.INTEGRITY_WORDS, requested_lines.INTEGRITY_NUMBERS)
    for name, integrity in asked.items():
        for row in requested_lines.integrity_rows(name, integrity):
            table.add(row)
    terminal.print()
    show(terminal, table)
    for name, integrity in asked.items():
        for line in requested_lines.integrity_lines(name, integrity):
            terminal.print(line, soft_wrap=True)
