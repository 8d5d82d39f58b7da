"""Output of the verbs that evaluate: files, tables and the exit status."""

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

from trajeval_ros.cli.pictures import PICTURE, Pictures
from trajeval_ros.cli.pipes import may_break
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import visible
from trajeval_ros.formatting.install_command import extra_command, pyarrow_command
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.live.pair_file import SUFFIX
from trajeval_ros.io.results.error_archive import ARCHIVE, TABLE, error_files
from trajeval_ros.io.results.requirement import Requirement
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import parse_source
from trajeval_ros.io.temporary import collect_leftovers, temporary_folder
from trajeval_ros.io.writing import refused_by_disk, write_text
from trajeval_ros.report.figure_style import PLAIN, FigureStyle

if TYPE_CHECKING:
    from rich.console import Console

    from trajeval_ros.likelihood.assessment import Assessment
    from trajeval_ros.pipeline.outcome import Outcome, RunOutcome

_NO_PICTURES = Pictures()
_RESULT = "result.json"
_OURS = re.compile(
    "(trajectory_(top|side)|(absolute|relative)_error|groundtruth_uncertainty|mahalanobis"
    r"|likelihood_by_edge|(consistency|uncertainty_top|stanford)(_\d+)?)(-img\d+)?\.(png|pdf|svg|pgf)"
)
_HAVE_FIGURES = find_spec("matplotlib") is not None


def deliver(
    outcome: Outcome,
    requirements: Sequence[Requirement],
    *,
    json: str | None,
    output: Path | None,
    quiet: bool,
    pictures: Pictures = _NO_PICTURES,
    mcap: Path | None = None,
    look: FigureStyle = PLAIN,
) -> None:
    """Write and print an evaluation; exit with status 1 if a requirement is not met.

    Args:
        outcome: What was found.
        requirements: To hold for every run.
        json: File for the result, `-` for stdout.
        output: Folder for everything.
        quiet: Print nothing.
        pictures: For Rerun.
        mcap: File for the errors as ROS 2 messages.
        look: Of the figures in the folder.
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
            _write_folder(output, result, outcome, look)
    pictures.write(runs)
    if mcap is not None:
        from trajeval_ros.io.results.error_recording import write_error_recording

        write_error_recording(mcap, outcome)
    if json == "-":
        with may_break():
            sys.stdout.write(json_text(result, indent=2))
    elif json is not None:
        write_text(Path(json), json_text(result, indent=2), follow_link=True)
    if not quiet and json != "-":
        with may_break():
            _print(outcome, output)
        _tell("warning", failed)
    else:
        # Missing data are reported even with --quiet.
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
    """Refuse to overwrite an input, before anything is read.

    Raises:
        InputError: An output is an input.
    """
    inputs = [str(parse_source(source).path) for source in sources]
    for output in filter(None, outputs):
        for path in inputs:
            with contextlib.suppress(OSError):  # a URL, or nothing there yet
                if output.samefile(path):
                    raise InputError(f"output {output} is also an input; choose another output")


def _write_folder(
    folder: Path, result: dict[str, object], outcome: Outcome, look: FigureStyle
) -> None:
    """Write all files under temporary names first; the folder never has partial files.

    result.json is removed first and written last: if it exists, all files are from one evaluation.
    """
    runs = outcome.runs
    folder.parent.mkdir(parents=True, exist_ok=True)
    # An existing folder may be a mount point, and the only writable place.
    beside = folder if folder.is_dir() else folder.parent
    # A first run that was killed has left temporary files next to the folder.
    collect_leftovers(folder.parent)
    with temporary_folder(folder.name, beside) as temporary:
        for name, write in error_files(outcome).items():
            write(temporary / name)
        if _HAVE_FIGURES:
            # Hide matplotlib's warning about a home folder that is not writable.
            logging.getLogger("matplotlib").setLevel(logging.ERROR)
            from trajeval_ros.report.figures import write_figures

            write_figures([run.evaluation for run in runs], temporary, look)
            for place, run in enumerate(runs, start=1):
                named = run.estimate.name, f"_{place}" if len(runs) > 1 else ""
                if run.consistency is not None:
                    from trajeval_ros.report.consistency_figure import write_consistency

                    write_consistency(run.evaluation, run.consistency, temporary, *named, look)
                if run.integrity is not None:
                    from trajeval_ros.report.stanford_figure import write_stanford

                    write_stanford(run.integrity, temporary, *named, look)
            likely = _assessments(runs)
            if likely:
                from trajeval_ros.report.probabilistic_figures import write_probabilistic

                write_probabilistic(list(likely.values()), temporary, list(likely), look)
        (temporary / _RESULT).write_text(json_text(result, indent=2), encoding="utf-8")
        folder.mkdir(exist_ok=True)
        (folder / _RESULT).unlink(missing_ok=True)
        # Remove files of an earlier evaluation.
        (folder / TABLE).unlink(missing_ok=True)
        if not any(folder.glob(f"*{SUFFIX}")):  # that of a live run was drawn by the node
            (folder / PICTURE).unlink(missing_ok=True)
        for old in folder.iterdir():
            if _OURS.fullmatch(old.name):
                old.unlink()
        for file in sorted(temporary.iterdir(), key=lambda file: file.name == _RESULT):
            file.replace(folder / file.name)


def _assessments(runs: Sequence[RunOutcome]) -> dict[str, Assessment]:
    return {run.estimate.name: run.likelihood for run in runs if run.likelihood is not None}


def _print(outcome: Outcome, output: Path | None) -> None:
    from trajeval_ros.report import tables
    from trajeval_ros.report.calibration_lines import calibration_lines
    from trajeval_ros.report.console import console, show
    from trajeval_ros.report.diagnosis_lines import diagnosis_lines

    runs = outcome.runs
    evaluations = [run.evaluation for run in runs]
    terminal = console()
    for run in runs:
        headline, *rest = tables.verdict(run.evaluation)
        for line in (headline, *diagnosis_lines(run), *rest):
            terminal.print(line, soft_wrap=True)
        if run.own_error is not None:
            terminal.print(tables.own_error_line(run.own_error), soft_wrap=True)
    if outcome.request.gauge_is_default:
        terminal.print(
            f"  gauge {evaluations[0].protocol.gauge.value} by default; set the sensors with "
            "--modality (mono, stereo, stereo-inertial, ...)",
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
    _print_integrity(terminal, runs)
    if output is not None:
        terminal.print(f"\n{_contents(output)}", soft_wrap=True)
    terminal.file.flush()
    remarks = console(sys.stderr)
    for trajectory in (evaluations[0].groundtruth, *(each.estimate for each in evaluations)):
        if trajectory.notes:
            remarks.print(
                f"note: {trajectory.name}: {'; '.join(trajectory.notes)}", soft_wrap=True
            )
    for run in runs:
        told = {each.text for each in run.diagnosis.findings}  # under the headline
        for warning in run.evaluation.warnings:
            if warning not in told:
                remarks.print(f"warning: {run.estimate.name}: {warning}", soft_wrap=True)


def _print_integrity(terminal: Console, runs: Sequence[RunOutcome]) -> None:
    asked = {run.estimate.name: run.integrity for run in runs if run.integrity is not None}
    if not asked:
        return
    from trajeval_ros.report import integrity_lines
    from trajeval_ros.report.console import add_rows, new_table, show

    table = new_table("", integrity_lines.INTEGRITY_WORDS, integrity_lines.INTEGRITY_NUMBERS)
    for name, integrity in asked.items():
        add_rows(table, integrity_lines.integrity_rows(name, integrity))
    terminal.print()
    show(terminal, table)
    for name, integrity in asked.items():
        for line in integrity_lines.integrity_lines(name, integrity):
            terminal.print(line, soft_wrap=True)


def _contents(folder: Path) -> str:
    """Return the folder's contents, and which package optional contents need."""
    files, hints = ["result.json", ARCHIVE], []
    if (folder / TABLE).exists():
        files.append(TABLE)
    else:
        hints.append(f"{TABLE} needs pyarrow, install it: {pyarrow_command()}")
    if _HAVE_FIGURES:
        files.append("figures")
    else:
        hints.append(f"figures need matplotlib, install it: {extra_command('plot')}")
    said = f"{', '.join(files[:-1])} and {files[-1]} are in {folder}"
    return "; ".join([said, *hints])
