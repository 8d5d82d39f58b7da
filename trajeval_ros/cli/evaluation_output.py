"""Output of the verbs that evaluate: files, tables and the exit status."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trajeval_ros.cli.command import command_line
from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.programs import may_break, write_json
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import visible
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import parse_source
from trajeval_ros.report.figure_style import PLAIN, FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.io.results.requirement import Requirement
    from trajeval_ros.pipeline.outcome import Outcome

_NO_PICTURES = Pictures()


def write_and_print(
    outcome: Outcome,
    requirements: Sequence[Requirement],
    *,
    json: str | None,
    output: Path | None,
    quiet: bool,
    diagnosis: bool = False,
    statistic: str = "",
    pictures: Pictures = _NO_PICTURES,
    mcap: Path | None = None,
    look: FigureStyle = PLAIN,
    repeat: str = "",
) -> None:
    """Write and print an evaluation; exit with status 1 if a requirement is not met.

    `json`: file for result.json, `-` for stdout. `mcap`: file for the errors as ROS 2 messages.
    `quiet`: whether to print only missing data and unmet requirements. `diagnosis`: whether to
    print all tests for mistakes. `statistic`: of the relative errors. `repeat`: the command that
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
    failed = [f"{item.name}: {item.reason}" for item in outcome.failed]
    if requirements:
        unmet += failed
    if output is not None:
        from trajeval_ros.cli.evaluation_folder import write_folder

        write_folder(output, result, outcome, look, repeat or command_line())
    pictures.write(runs)
    if mcap is not None:
        from trajeval_ros.io.results.error_recording import write_error_recording

        write_error_recording(mcap, outcome)
    write_json(json, result)
    if not quiet and json != "-":
        with may_break():
            _print(outcome, output, statistic, diagnosis=diagnosis)
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


def _print(outcome: Outcome, output: Path | None, statistic: str, *, diagnosis: bool) -> None:
    from trajeval_ros.report import evaluation_text
    from trajeval_ros.report.console import console

    terminal = console()
    evaluation_text.print_verdicts(terminal, outcome)
    evaluation_text.print_tables(terminal, outcome, statistic)
    terminal.print()
    evaluation_text.print_definitions(terminal, outcome)
    if diagnosis:
        evaluation_text.print_tests(terminal, outcome.runs)
    if output is not None:
        from trajeval_ros.cli.evaluation_folder import contents

        terminal.print(f"\n{contents(output)}", soft_wrap=True)
    terminal.file.flush()
    evaluation_text.print_remarks(console(sys.stderr), outcome.runs)
