"""Output of the verbs that evaluate: files, tables and the exit status."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.programs import may_break, write_json
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import visible
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.reading import ASSUMED, FORMAT
from trajeval_ros.io.results.requirement import Requirement
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import parse_source
from trajeval_ros.report.figure_style import PLAIN, FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.pipeline.outcome import Outcome, RunOutcome
    from trajeval_ros.report.console import Console

_NO_PICTURES = Pictures()


def write_and_print(
    outcome: Outcome,
    requirements: Sequence[Requirement],
    *,
    json: str | None,
    output: Path | None,
    quiet: bool,
    pictures: Pictures = _NO_PICTURES,
    mcap: Path | None = None,
    look: FigureStyle = PLAIN,
    repeat: str = "",
) -> None:
    """Write and print an evaluation; exit with status 1 if a requirement is not met.

    `json`: file for result.json, `-` for stdout. `mcap`: file for the errors as ROS 2 messages.
    `quiet`: whether to print only missing data and unmet requirements. `repeat`: the command that
    states all that was assumed.
    """
    result, runs = result_of(outcome), outcome.runs
    # A requirement with an unknown name is an error; it is raised before anything is written.
    lengths = result["provenance"]["settings"]["lengths"]
    unmet = [
        f"{run['estimate']['name']}: {why}"
        for run in result["runs"]
        for requirement in requirements
        if (why := requirement.unmet(run, lengths))
    ]
    failed = [f"{each.name}: {each.reason}" for each in outcome.failed]
    if requirements:
        unmet += failed
    if output is not None:
        from trajeval_ros.cli.evaluation_folder import write_folder

        write_folder(output, result, outcome, look)
    pictures.write(runs)
    if mcap is not None:
        from trajeval_ros.io.results.error_recording import write_error_recording

        write_error_recording(mcap, outcome)
    write_json(json, result)
    if not quiet and json != "-":
        with may_break():
            _print(outcome, output)
            if repeat:
                print(f"\nrepeat: {repeat}")
        _tell("warning", failed)
    else:
        # Missing data are reported even with --quiet.
        _tell("warning", outcome.damage)
    pictures.show(runs)
    _tell("trajeval", unmet)
    if unmet:
        raise click.exceptions.Exit(1)


def _tell(who: str, lines: Iterable[str]) -> None:
    with may_break():
        for line in lines:
            print(f"{who}: {visible(line)}", file=sys.stderr)


def refuse_inputs(outputs: Sequence[Path | str | None], sources: Sequence[str]) -> None:
    """Refuse to overwrite an input, before anything is read."""
    inputs = [str(parse_source(source).path) for source in sources]
    for output in outputs:
        for path in inputs:
            with contextlib.suppress(OSError):  # a URL, or a file that does not exist
                if output is not None and Path(output).samefile(path):
                    raise InputError(f"output {output} is also an input; choose another output")


def _print(outcome: Outcome, output: Path | None) -> None:
    from trajeval_ros.report.available_lines import stream_line
    from trajeval_ros.report.calibration_lines import calibration_lines
    from trajeval_ros.report.consistency_lines import consistency_lines
    from trajeval_ros.report.console import console
    from trajeval_ros.report.verdict_lines import definitions

    terminal = console()
    _print_verdicts(terminal, outcome)
    _print_likelihoods(terminal, outcome)
    _print_errors(terminal, outcome.runs)
    for run in outcome.runs:
        if run.calibrated is not None:
            for line in calibration_lines(run.estimate.name, run.calibrated):
                terminal.print(line, soft_wrap=True)
        if run.consistency is not None:
            for line in consistency_lines(run.estimate.name, run.consistency):
                terminal.print(line, soft_wrap=True)
    _print_integrity(terminal, outcome.runs)
    terminal.print()
    for run in outcome.runs:
        for text in definitions(run.evaluation):
            terminal.print(text, soft_wrap=True)
        if run.stream is not None and (arrival := stream_line(run.stream)):
            terminal.print(arrival, soft_wrap=True)
    if output is not None:
        from trajeval_ros.cli.evaluation_folder import contents

        terminal.print(f"\n{contents(output)}", soft_wrap=True)
    terminal.file.flush()
    _print_remarks(outcome.runs)


def _print_verdicts(terminal: Console, outcome: Outcome) -> None:
    from trajeval_ros.formatting.text_tables import BOLD
    from trajeval_ros.metrics.discontinuities.handling import SPLIT
    from trajeval_ros.report.available_lines import available_lines
    from trajeval_ros.report.console import WARNING
    from trajeval_ros.report.verdict_lines import diagnosis_lines, doubt, own_error_line, verdict

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
            for line in available_lines(run.available.numbers, position.rmse):
                terminal.print(line, soft_wrap=True)
        if run.own_error is not None:
            terminal.print(own_error_line(run.own_error), soft_wrap=True)
    if outcome.request.gauge_is_default:
        terminal.print(
            f"  gauge {outcome.runs[0].evaluation.protocol.gauge.value} by default; set the "
            "sensors with --modality (mono, stereo, stereo-inertial, ...)",
            soft_wrap=True,
        )


def _print_likelihoods(terminal: Console, outcome: Outcome) -> None:
    likely = outcome.likelihoods
    if not likely:
        return
    from trajeval_ros.report.console import show
    from trajeval_ros.report.tables import probabilistic_lines, probabilistic_table

    terminal.print()
    show(terminal, probabilistic_table(likely))
    for line in probabilistic_lines(likely):
        terminal.print(line, soft_wrap=True)


def _print_errors(terminal: Console, runs: Sequence[RunOutcome]) -> None:
    from trajeval_ros.report import tables
    from trajeval_ros.report.console import show

    evaluations = [run.evaluation for run in runs]
    terminal.print()
    show(terminal, tables.absolute_table(evaluations, terminal.width))
    by_states = tables.states_table(runs)
    if by_states is not None:
        terminal.print()
        show(terminal, by_states)
        for line in tables.states_remarks(runs):
            terminal.print(line, soft_wrap=True)
    relative = tables.relative_table(evaluations, terminal.width)
    if relative is not None:
        terminal.print()
        show(terminal, relative)


def _print_remarks(runs: Sequence[RunOutcome]) -> None:
    """Print notes about the inputs, and warnings, on stderr."""
    from trajeval_ros.report.console import WARNING, console

    remarks = console(sys.stderr)
    groundtruth = runs[0].evaluation.groundtruth
    for trajectory in (groundtruth, *(run.evaluation.estimate for run in runs)):
        notes = [each for each in trajectory.reading.remarks if each.level is Level.NOTE]
        shown = [each for each in notes if each.code not in (ASSUMED, FORMAT)]
        said = "; ".join(each.text for each in shown)
        if said:
            remarks.remark("note", f"{trajectory.name}: {said}")
        for each in notes:
            if each.code == ASSUMED:
                remarks.remark("assumed", each.text)
    for run in runs:
        printed = {each.cause for each in run.diagnosis.findings}  # below the headline
        for remark in run.evaluation.remarks:
            if remark.code not in printed:
                kind = "note" if remark.level is Level.NOTE else WARNING
                remarks.remark(kind, f"{run.estimate.name}: {remark.text}")


def _print_integrity(terminal: Console, runs: Sequence[RunOutcome]) -> None:
    asked = {run.estimate.name: run.integrity for run in runs if run.integrity is not None}
    if not asked:
        return
    from trajeval_ros.report import consistency_lines
    from trajeval_ros.report.console import Table, show

    table = Table("", consistency_lines.INTEGRITY_WORDS, consistency_lines.INTEGRITY_NUMBERS)
    for name, integrity in asked.items():
        for row in consistency_lines.integrity_rows(name, integrity):
            table.add(row)
    terminal.print()
    show(terminal, table)
    for name, integrity in asked.items():
        for line in consistency_lines.integrity_lines(name, integrity):
            terminal.print(line, soft_wrap=True)
