"""`trajeval compare`: algorithms x sequences x trials, and tests against a baseline."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import (
    FIGURES,
    OUTPUT,
    argument,
    option,
    refuse_format,
    settings_options,
    shared_options,
)
from trajeval_ros.cli.programs import may_break
from trajeval_ros.cli.progress import progress as drawing
from trajeval_ros.cli.progress import progress_of_runs
from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.formatting.numbers import counted, data_size
from trajeval_ros.io.requests.setting import COMPARE, ERRORS
from trajeval_ros.io.writing import write_text

if TYPE_CHECKING:
    from trajeval_ros.batch.comparison import Progress
    from trajeval_ros.batch.comparison_summary import ComparisonSummary
    from trajeval_ros.batch.finished_results import FinishedResults
    from trajeval_ros.batch.gate import Gate, GateValues
    from trajeval_ros.batch.gates import Judgement
    from trajeval_ros.batch.plan import Plan

_WORK = "Work"
_MOST_FIGURES = 100  # runs with figures by default

_GATES = "Gates"
_FALSE_ALARMS = 2.5  # default

_GATE_OPTIONS = (
    option("--baseline", kind=Path, metavar="OLD.parquet", panel=_GATES, is_common=True,
        help="File runs.parquet of another comparison with the same settings."),
    option("--fail-if", metavar="GATE", panel=_GATES, is_common=True, is_repeatable=True,
        help="Gate, such as 'ate.position_m.rmse worse than 5 %'. The exit status is 1 if a "
        "value is worse than in the baseline by more than the margin, with statistical "
        "significance. Repeatable."),
    option("--undecided", metavar="pass|fail", panel=_GATES,
        help="Verdict of a gate whose test is inconclusive: pass or fail. By default it passes, "
        "but a gate that cannot fail, with too few trials, is an error: exit status 2."),
    option("--false-alarms", kind=float, metavar="PERCENT", default=_FALSE_ALARMS, panel=_GATES,
        help="Probability of a false alarm over all gates, in percent."),
    option("--paired", kind=bool, panel=_GATES,
        help="Paired test, for trials that share seeds with the trials of the same name in the "
        "baseline."),
)  # fmt: skip


_PARAMETERS = (
    argument("targets", metavar="CONFIG.yaml|RUNS.csv|DIR|GROUNDTRUTH ESTIMATE...|RESULT...",
        count=-1,
        help="YAML configuration, manifest (RUNS.csv or RUNS.parquet, also a URL; "
        "docs/compare.md), folder in the layout of ov_eval or rpg_trajectory_evaluation, "
        "groundtruth and estimates, or output folders of evaluate and of live runs. "
        "NAME=ESTIMATE and NAME=RESULT name one."),
    *shared_options(COMPARE),
    *settings_options(COMPARE),
    option("--common-time-span/--whole-runs", kind=bool, panel=ERRORS,
        help="Time span to evaluate: the span that all runs of a sequence cover, or all of "
        "every run (default)."),
    option("--allow-remote", metavar="URL", panel=_WORK, is_repeatable=True,
        help="Host that URLs in CONFIG.yaml or in the manifest may use, as in s3://bucket. "
        "Repeatable."),
    option("--workers", kind=click.IntRange(min=1), metavar="N", panel=_WORK, is_common=True,
        help="Number of worker processes on this machine. Default: one per core."),
    option("--cluster", metavar="ADDRESS", panel=_WORK,
        help="Scheduler of a Dask cluster that evaluates the runs, tcp://HOST:PORT."),
    *_GATE_OPTIONS,
    option("--output", kind=Path, metavar="DIR", default=Path("comparison"), panel=OUTPUT,
        is_common=True,
        help="Output folder. Runs that it already contains are evaluated again only if their "
        "inputs or settings have changed."),
    option("--wait", kind=bool, panel=OUTPUT,
        help="Waiting for another comparison that writes to the same folder, instead of an "
        "error."),
    option("--figures", kind=click.IntRange(min=0), metavar="N", default=_MOST_FIGURES,
        panel=FIGURES,
        help="Largest number of runs with figures, the largest errors first; 0 for "
        "none."),
    option("--transpose", kind=bool, panel=OUTPUT,
        help="Rows are sequences and columns are algorithms in tables.tex."),
)  # fmt: skip


@verb(*_PARAMETERS)
def compare(
    targets: Sequence[str],
    quiet: bool,
    allow_remote: Sequence[str],
    workers: int | None,
    cluster: str | None,
    baseline: Path | None,
    fail_if: Sequence[str],
    undecided: str | None,
    false_alarms: float,
    paired: bool,
    output: Path,
    wait: bool,
    figures: int,
    figure_format: str | None,
    transpose: bool,
    **settings: Any,
) -> None:
    r"""Compares many runs: algorithms x sequences x trials, in tables and one report.

    Options override the settings in CONFIG.yaml.

    Evaluate the runs in euroc.yaml, on all cores:

        trajeval compare euroc.yaml --output comparison

    Evaluate the runs that a table lists, one per row:

        trajeval compare runs.csv --modality mono-inertial

    Evaluate estimates of one groundtruth, or show finished results together:

        trajeval compare groundtruth.txt vio.txt Ours=slam.txt --gauge yaw
        trajeval compare result_vio result_slam

    Evaluate a folder in the layout of ov_eval or rpg_trajectory_evaluation:

        trajeval compare results --gauge yaw

    Check for regressions. gates.md is for pull requests, gates.json is for programs:

        trajeval compare euroc.yaml --baseline main.parquet \
            --fail-if 'ate.position_m.rmse worse than 5 %'
    """
    from trajeval_ros.batch.compare_runs import only_writer, write_tables
    from trajeval_ros.batch.comparison import run_plan
    from trajeval_ros.batch.comparison_report import is_drawn, write_report
    from trajeval_ros.batch.comparison_summary import summary_of
    from trajeval_ros.batch.executors import dask_pool, local_pool
    from trajeval_ros.batch.finished_results import FinishedResults
    from trajeval_ros.batch.planned_figures import FigureChoice
    from trajeval_ros.batch.results_table import load_pyarrow
    from trajeval_ros.report.comparison_page import require_jinja2
    from trajeval_ros.report.console import WARNING, console
    from trajeval_ros.report.figure_style import FigureStyle

    refuse_format(targets, "compare GROUNDTRUTH ESTIMATE...")
    load_pyarrow()
    require_jinja2()
    if workers is not None and cluster is not None:
        raise SettingsError(
            "--workers (this machine) and --cluster exclude each other; give one of them"
        )
    style = FigureStyle.parse(figure_format or "svg", None, None, has_titles=False)
    choice = FigureChoice(figures, style.formats)
    if figures:
        style.check()
    chosen = _comparison_of(targets, settings, allow_remote)
    start_pool = partial(dask_pool, cluster) if cluster else partial(local_pool, workers)
    # The baseline may be the table in the output folder, so it is read before anything is written.
    gates = _gates_of(baseline, fail_if, undecided, false_alarms, chosen.settings, paired=paired)

    def report_waiting(held: str) -> None:
        print(f"waiting: {held}", file=sys.stderr, flush=True)

    with only_writer(output, report_waiting if wait else None):
        if isinstance(chosen, FinishedResults):
            progress = chosen.write_tables(output)
        else:
            with progress_of_runs() as report:
                progress = run_plan(chosen, output, start_pool, report)
        summary = summary_of(output)
        write_tables(output, summary, transpose=transpose)
        if not is_drawn(output, choice):
            with drawing("writing the report") as advance:
                write_report(output, summary, start_pool, choice, advance)
        if not quiet:
            _print_verdict(summary, progress, output)
            if isinstance(chosen, FinishedResults) and chosen.advice:
                console(sys.stderr).remark(WARNING, chosen.advice)
        if gates is not None:
            _judge(gates, output, summary.title, quiet=quiet)
        _require_numbers(summary, output)


def _comparison_of(
    targets: Sequence[str], settings: dict[str, Any], allow_remote: Sequence[str]
) -> Plan | FinishedResults:
    """Return the runs to evaluate, or finished results, which have their own settings."""
    from trajeval_ros.batch.config import plan_of, plan_of_sources
    from trajeval_ros.batch.finished_comparison import RESULT
    from trajeval_ros.batch.finished_results import FinishedResults, is_result

    results = [target for target in targets if is_result(target)]
    if not results:
        if len(targets) > 1:
            return plan_of_sources(targets, settings)
        return plan_of(targets[0], settings, allow_remote=allow_remote)
    others = [target for target in targets if not is_result(target)]
    if others:
        raise InputError(
            f"{results[0]} has finished results, and {others[0]} has none; give folders with "
            f"{RESULT}, or groundtruth and estimates"
        )
    given = [name for name, value in settings.items() if value not in (None, (), [])]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise SettingsError(
            f"finished results are not evaluated again, so {option} has no effect; remove it, or "
            "give groundtruth and estimates"
        )
    return FinishedResults(targets)


@dataclass(frozen=True)
class Gates:
    """Gates and their baseline."""

    gates: list[Gate]
    baseline: GateValues  # of the older comparison
    undecided: str | None  # verdict of an inconclusive gate; None: `pass` if it could fail
    false_alarms: float  # probability
    paired: bool  # whether trials of the same name have the same seed


def _gates_of(
    path: Path | None,
    texts: Sequence[str],
    undecided: str | None,
    false_alarms: float,
    settings: dict[str, Any],
    *,
    paired: bool,
) -> Gates | None:
    """Return the gates and their baseline; None without gates."""
    from trajeval_ros.batch.gate import Gate, GateValues, require_same_settings
    from trajeval_ros.batch.results_table import ResultsTable

    if (path is None) != (not texts):
        raise SettingsError("--baseline and --fail-if belong together; give both")
    require_one_of(undecided or "pass", ("pass", "fail"), "value of --undecided")
    if not 0.0 < false_alarms <= 20.0:
        raise SettingsError(
            f"--false-alarms {false_alarms:g} is out of range; give a percentage above 0 and up "
            "to 20, such as 2.5"
        )
    if path is None:
        if paired or undecided is not None or false_alarms != _FALSE_ALARMS:
            raise SettingsError(
                "--paired, --undecided and --false-alarms need --baseline and --fail-if; give both"
            )
        return None
    gates = [Gate.parse(text) for text in texts]
    values = GateValues(ResultsTable(path))
    require_same_settings(values, settings, gates)
    for gate in gates:
        values.find(gate.path)
    return Gates(gates, values, undecided, false_alarms / 100.0, paired)


def _judge(given: Gates, folder: Path, title: str, *, quiet: bool) -> None:
    """Write and print the verdicts; exit with status 1 if the gates fail."""
    from trajeval_ros.batch import gates
    from trajeval_ros.batch.finished_comparison import GATES as GATES_FILE
    from trajeval_ros.batch.finished_comparison import GATES_JSON, RUNS
    from trajeval_ros.batch.gate import GateValues, remarks_on
    from trajeval_ros.batch.gates_output import to_json, to_markdown
    from trajeval_ros.batch.results_table import ResultsTable
    from trajeval_ros.report.console import WARNING, console

    now = GateValues(ResultsTable(folder / RUNS))
    judgement = gates.judge(
        given.gates, given.baseline, now, given.false_alarms, paired=given.paired
    )
    remarks = remarks_on(given.baseline, now)
    text = to_markdown(judgement, title, remarks)
    write_text(folder / GATES_FILE, text)
    write_text(folder / GATES_JSON, to_json(judgement, title, remarks))
    if not quiet:
        with may_break():
            print(f"\n{text}", end="")
    if not judgement.fails:
        _require_decided(given, judgement)
        if given.undecided != "fail" or judgement.verdict == gates.NO_WORSE:
            return
        console(sys.stderr).remark(
            WARNING, "a gate is inconclusive, which fails by --undecided fail: exit status 1"
        )
    raise click.exceptions.Exit(1)


def _require_decided(given: Gates, judgement: Judgement) -> None:
    """Refuse a gate that cannot fail, unless inconclusive gates pass by request."""
    if given.undecided == "pass":
        return
    for verdict in judgement.gates:
        reason = verdict.why_it_cannot_fail(given.false_alarms)
        if reason:
            raise SettingsError(
                f"the gate '{verdict.gate}' cannot fail: {reason}, or accept it with "
                "--undecided pass"
            )


def _print_verdict(summary: ComparisonSummary, progress: Progress, folder: Path) -> None:
    """Print the tables and the number of evaluated runs, and on stderr the failed runs."""
    from trajeval_ros.batch.comparison_summary import dropped_poses, failures
    from trajeval_ros.batch.results_table import OK
    from trajeval_ros.batch.summary_tables import matrices
    from trajeval_ros.report.console import WARNING, console, show
    from trajeval_ros.report.matrix import to_terminal

    with may_break():
        terminal = console()
        tables = matrices(summary)
        for table in tables:
            show(terminal, to_terminal(table))
            terminal.print()
        for note in dict.fromkeys(note for table in tables for note in table.notes):
            terminal.print(note, style="dim")
        terminal.print()
        evaluated = sum(trial.status == OK for trial in summary.trials)
        unchanged, failed = evaluated - progress.new, len(summary.trials) - evaluated
        kept = f", {unchanged} unchanged" if unchanged else ""
        kept += f", {failed} failed or missing" if failed else ""
        fetched = progress.fetched_bytes
        kept += f", {data_size(fetched)} read from remote stores" if fetched else ""
        terminal.print(
            f"{counted(progress.new, 'run')} evaluated{kept}; report.html, "
            f"tables and runs.parquet: {folder}",
            soft_wrap=True,
        )
        terminal.file.flush()
        remarks = console(sys.stderr)
        for line in [*dropped_poses(summary), *failures(summary)]:
            remarks.remark(WARNING, line)


def _require_numbers(summary: ComparisonSummary, folder: Path) -> None:
    """Refuse a comparison without any number. Its tables and report state the reasons."""
    from trajeval_ros.batch.comparison_summary import failures

    lost = failures(summary)
    if len(lost) == len(summary.trials):
        raise InputError(
            f"all runs failed or are missing, first {lost[0]}; see {folder / 'tables.md'} for "
            "the reasons"
        )
