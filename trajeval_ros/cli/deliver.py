"""What a verb that evaluates gives: files, tables, and an exit status."""

from __future__ import annotations

import contextlib
import logging
import re
import sys
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.pipes import may_break
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import visible
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.results.error_archive import write_errors
from trajeval_ros.io.results.requirement import Requirement
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import parse_source
from trajeval_ros.io.temporary import collect_leftovers, temporary_folder
from trajeval_ros.io.writing import refused_by_disk, write_text

if TYPE_CHECKING:
    from trajeval_ros.likelihood.assessment import Assessment
    from trajeval_ros.pipeline import Outcome, RunOutcome

_NO_PICTURES = Pictures()
_RESULT = "result.json"
_OURS = re.compile(
    "(trajectory_(top|side)|(absolute|relative)_error|groundtruth_uncertainty|mahalanobis"
    r"|likelihood_by_edge|(consistency|uncertainty_top)(_\d+)?)\.png"
)
_HAVE_FIGURES = find_spec("matplotlib") is not None


def deliver(
    outcome: Outcome,
    requirements: Sequence[Requirement],
    *,
    json: str | None,
    output: Path | None,
    quiet: bool,
    gauge_given: bool,
    pictures: Pictures = _NO_PICTURES,
) -> None:
    """Write and print an evaluation; exit with status 1 if a requirement is not met.

    Args:
        outcome: What was found.
        requirements: To hold for every run.
        json: File for the result, `-` for stdout.
        output: Folder for everything.
        quiet: Print nothing.
        gauge_given: Whether the user chose a gauge.
        pictures: For Rerun.
    """
    result, runs = result_of(outcome), outcome.runs
    # A requirement that names nothing is a mistake to be told before anything is written.
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
        with refused_by_disk(f"the folder {output}"):
            _write_folder(output, result, runs, pictures)
    pictures.write(runs)
    if json == "-":
        with may_break():
            sys.stdout.write(json_text(result, indent=2))
    elif json is not None:
        write_text(Path(json), json_text(result, indent=2), follow_link=True)
    if not quiet and json != "-":
        with may_break():
            _print(runs, output, gauge_given=gauge_given)
        _tell("warning", failed)
    else:
        # Missing data are told even to who wants to hear nothing.
        _tell("warning", outcome.damage)
    pictures.show(runs)
    _tell("trajeval", unmet)
    if unmet:
        raise typer.Exit(1)


def _tell(who: str, lines: Iterable[str]) -> None:
    with may_break():
        for line in lines:
            print(f"{who}: {visible(line)}", file=sys.stderr)


def refuse_inputs(outputs: Sequence[Path | None], sources: Sequence[str]) -> None:
    """Refuse to write over what is to be read, before anything is.

    Raises:
        InputError: An output is an input.
    """
    inputs = [str(parse_source(source).path) for source in sources]
    for output in filter(None, outputs):
        for path in inputs:
            with contextlib.suppress(OSError):  # a URL, or nothing there yet
                if output.samefile(path):
                    raise InputError(f"{output} is to be read, and would be written over")


def _write_folder(
    folder: Path, result: dict[str, object], runs: Sequence[RunOutcome], pictures: Pictures
) -> None:
    """Write everything under a temporary name first, so that nothing is ever half written.

    result.json goes first and comes last: where there is one, all else is of the same evaluation.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    # A folder that exists may be a disk of its own, and the only place that can be written.
    beside = folder if folder.is_dir() else folder.parent
    # A run that was killed may have been the first, which wrote beside the folder.
    collect_leftovers(folder.parent)
    with temporary_folder(folder.name, beside) as temporary:
        write_errors(temporary / "errors.npz", runs)
        if _HAVE_FIGURES:
            # That matplotlib can't write into the user's home is no news about trajectories.
            logging.getLogger("matplotlib").setLevel(logging.ERROR)
            from trajeval_ros.report.figures import write_figures

            write_figures([run.evaluation for run in runs], temporary)
            for place, run in enumerate(runs, start=1):
                if run.consistency is not None:
                    from trajeval_ros.report.consistency_figure import write_consistency

                    suffix = f"_{place}" if len(runs) > 1 else ""
                    name = run.estimate.name
                    write_consistency(run.evaluation, run.consistency, temporary, name, suffix)
            likely = _assessments(runs)
            if likely:
                from trajeval_ros.report.probabilistic_figures import write_probabilistic

                write_probabilistic(list(likely.values()), temporary, list(likely))
        try:
            pictures.write_into(temporary, runs)
        except InputError as error:  # names a place that nobody knows
            raise InputError(str(error).replace(str(temporary), str(folder))) from error
        (temporary / _RESULT).write_text(json_text(result, indent=2), encoding="utf-8")
        folder.mkdir(exist_ok=True)
        (folder / _RESULT).unlink(missing_ok=True)
        # Figures of an evaluation before this one would pass for figures of this one.
        for old in folder.glob("*.png"):
            if _OURS.fullmatch(old.name):
                old.unlink()
        for file in sorted(temporary.iterdir(), key=lambda file: file.name == _RESULT):
            file.replace(folder / file.name)


def _assessments(runs: Sequence[RunOutcome]) -> dict[str, Assessment]:
    return {run.estimate.name: run.likelihood for run in runs if run.likelihood is not None}


def _print(runs: Sequence[RunOutcome], output: Path | None, *, gauge_given: bool) -> None:
    from trajeval_ros.report import tables
    from trajeval_ros.report.calibration_lines import calibration_lines
    from trajeval_ros.report.console import console, show

    evaluations = [run.evaluation for run in runs]
    terminal = console()
    for evaluation in evaluations:
        for line in tables.verdict(evaluation):
            terminal.print(line, soft_wrap=True)
    if not gauge_given:
        terminal.print(
            "  gauge se3 by default: --modality mono, stereo, stereo-inertial, ... picks the one "
            "that fits the sensors",
            soft_wrap=True,
        )
    likely = _assessments(runs)
    if likely:
        from trajeval_ros.report.probabilistic_table import (
            probabilistic_lines,
            probabilistic_table,
        )

        terminal.print()
        show(terminal, probabilistic_table(likely))
        for line in probabilistic_lines(likely):
            terminal.print(line, soft_wrap=True)
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
    for run in runs:
        if run.calibrated is not None:
            for line in calibration_lines(run.estimate.name, run.calibrated):
                terminal.print(line, soft_wrap=True)
        if run.consistency is not None:
            for line in tables.consistency_lines(run.estimate.name, run.consistency):
                terminal.print(line, soft_wrap=True)
    if output is not None:
        terminal.print(f"\n{_contents(output)}", soft_wrap=True)
    terminal.file.flush()
    remarks = console(sys.stderr)
    for trajectory in (evaluations[0].groundtruth, *(each.estimate for each in evaluations)):
        if trajectory.notes:
            remarks.print(
                f"note: {trajectory.name}: {'; '.join(trajectory.notes)}", soft_wrap=True
            )
    for evaluation in evaluations:
        for warning in evaluation.warnings:
            remarks.print(f"warning: {evaluation.estimate.name}: {warning}", soft_wrap=True)


def _contents(folder: Path) -> str:
    if _HAVE_FIGURES:
        return f"result.json, errors.npz and figures are in {folder}"
    return (
        f"result.json and errors.npz are in {folder}; for figures, install matplotlib: "
        "pip install 'trajeval-ros[plot]'"
    )
