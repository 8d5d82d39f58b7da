"""The last lines of `trajeval compare`: evaluated runs, downloaded bytes and failures."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.cli.pipes import may_break
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted, data_size

if TYPE_CHECKING:
    from trajeval_ros.batch.comparison import Progress
    from trajeval_ros.batch.comparison_summary import ComparisonSummary
    from trajeval_ros.batch.shards import Shard


def print_shard(shard: Shard, progress: Progress, folder: Path, *, quiet: bool) -> None:
    """Print the number of evaluated runs of a shard, and on stderr the number of failed ones."""
    if progress.failed:
        print(
            f"warning: {progress.failed} of {progress.total} runs of shard {shard} failed; the "
            "tables after --merge list the reasons",
            file=sys.stderr,
        )
    if not quiet:
        with may_break():
            print(
                f"shard {shard}: {counted(progress.new, 'run')} evaluated, {progress.kept} "
                f"unchanged{_fetched(progress)}: {folder}"
            )


def print_verdict(summary: ComparisonSummary, progress: Progress, folder: Path) -> None:
    """Print the tables and the number of evaluated runs, and on stderr the failed runs."""
    from trajeval_ros.batch.comparison_summary import failures
    from trajeval_ros.batch.results_table import OK
    from trajeval_ros.batch.summary_tables import matrices
    from trajeval_ros.report.console import console, show
    from trajeval_ros.report.matrix import to_terminal

    with may_break():
        terminal = console()
        for each in matrices(summary):
            show(terminal, to_terminal(each))
            terminal.print(f"{each.caption}\n", style="dim")
        evaluated = sum(trial.status == OK for trial in summary.trials)
        unchanged, failed = evaluated - progress.new, len(summary.trials) - evaluated
        kept = f", {unchanged} unchanged" if unchanged else ""
        kept += f", {failed} failed or missing" if failed else ""
        terminal.print(
            f"{counted(progress.new, 'run')} evaluated{kept}{_fetched(progress)}; report.html, "
            f"tables and runs.parquet: {folder}",
            soft_wrap=True,
        )
        terminal.file.flush()
        remarks = console(sys.stderr)
        for line in failures(summary):
            remarks.print(f"warning: {line}", soft_wrap=True)


def require_numbers(summary: ComparisonSummary, folder: Path) -> None:
    """Refuse a comparison without any number. Its tables and report state the reasons.

    Raises:
        InputError: No run could be evaluated.
    """
    from trajeval_ros.batch.comparison_summary import failures

    lost = failures(summary)
    if len(lost) == len(summary.trials):
        raise InputError(
            f"all runs failed or are missing, first {lost[0]}; see {folder / 'tables.md'} for "
            "the reasons"
        )


def _fetched(progress: Progress) -> str:
    count = progress.fetched_bytes
    return f", {data_size(count)} read from remote stores" if count else ""
