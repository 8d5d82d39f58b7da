"""`trajeval compare`: algorithms x sequences x trials, and today against yesterday."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trajeval_ros.cli import gating, options
from trajeval_ros.cli.pipes import may_break
from trajeval_ros.cli.progress import progress as drawing
from trajeval_ros.exceptions import SettingsError

if TYPE_CHECKING:
    from trajeval_ros.batch.comparison import Progress
    from trajeval_ros.batch.comparison_summary import ComparisonSummary
    from trajeval_ros.batch.executors import Pool

WORK = "Work"


def compare(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG.yaml|DIR",
            help="What to compare, as docs/compare.md describes it; or a folder of ov_eval's or "
            "rpg_trajectory_evaluation's layout.",
            show_default=False,
        ),
    ],
    protocol: options.ProtocolOption = None,
    modality: options.ModalityOption = None,
    gauge: options.GaugeOption = None,
    align_states: options.AlignStatesOption = None,
    align_with: options.AlignWithOption = None,
    association: options.AssociationOption = None,
    time_offset: options.TimeOffsetOption = None,
    hand_eye: options.HandEyeOption = None,
    continuous_model: options.ContinuousModelOption = None,
    groundtruth_noise: options.GroundtruthNoiseOption = None,
    lengths: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Sub-trajectory lengths for the relative error: 8,16,24 (metres), 1s,5s "
            "(seconds), 10%,20% (of the groundtruth's path, the same for all algorithms) or none.",
            rich_help_panel=options.MEASURE,
        ),
    ] = None,
    covariance: options.CovarianceOption = None,
    rotation_covariance_frame: options.RotationCovarianceFrameOption = None,
    up: options.UpOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    common_time_span: Annotated[
        bool | None,
        typer.Option(
            "--common-time-span/--whole-runs",
            help="Evaluate only the time that all runs of a sequence have: a tracker that died "
            "early can't win.",
            show_default=False,
            rich_help_panel=options.MEASURE,
        ),
    ] = None,
    allow_remote: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL",
            help="A host that URLs in CONFIG.yaml may be of, as in s3://bucket; repeatable.",
            rich_help_panel=WORK,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Processes of this machine; by default one for each core.",
            rich_help_panel=WORK,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Evaluate on the workers of a Dask cluster: its scheduler, tcp://HOST:PORT.",
            rich_help_panel=WORK,
        ),
    ] = None,
    baseline: gating.BaselineOption = None,
    fail_if: gating.FailIfOption = None,
    undecided: gating.UndecidedOption = "pass",
    false_alarms: gating.FalseAlarmsOption = 2.5,
    paired: gating.PairedOption = False,
    output: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Results, kept run by run: what is there and unchanged isn't evaluated again.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path("comparison"),
    wait: Annotated[
        bool,
        typer.Option(
            "--wait",
            help="Wait while another comparison writes to the same folder, instead of refusing.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    quiet: Annotated[
        bool,
        typer.Option("--quiet", "-q", help="Print no tables.", rich_help_panel=options.OUTPUT),
    ] = False,
) -> None:
    """Compare many runs: algorithms x sequences x trials, in tables and one report.

    Settings given here override those of the file.

    What euroc.yaml describes, on all cores:

        trajeval compare euroc.yaml --output comparison

    A folder as ov_eval or rpg_trajectory_evaluation want it:

        trajeval compare results --gauge yaw

    Today against yesterday; gates.md is for the pull request, gates.json for programs:

        trajeval compare euroc.yaml --baseline main.parquet
        --fail-if 'ate.position_m.rmse worse than 5 %'
    """
    from trajeval_ros.batch.compare_runs import write_tables
    from trajeval_ros.batch.comparison import RECORDS, run_plan
    from trajeval_ros.batch.comparison_summary import summary_of
    from trajeval_ros.batch.config import plan_of
    from trajeval_ros.batch.executors import local_pool
    from trajeval_ros.batch.output_lock import only_writer
    from trajeval_ros.batch.page import is_drawn, write_report

    if workers is not None and cluster is not None:
        raise SettingsError("--workers is of this machine and --cluster of others; give one")
    said = {
        "protocol": protocol,
        "modality": modality,
        "gauge": gauge,
        "align_states": align_states,
        "align_with": align_with,
        "association": association,
        "time_offset": time_offset,
        "hand_eye": hand_eye,
        "continuous_model": continuous_model,
        "groundtruth_noise": groundtruth_noise,
        "lengths": lengths,
        "covariance": covariance,
        "rotation_covariance_frame": rotation_covariance_frame,
        "up": up,
        "start": start,
        "end": end,
    }
    plan = plan_of(
        target, said, common_time_span=common_time_span, allow_remote=allow_remote or ()
    )
    # Read before anything is written: it may be the table of the same folder.
    gates = gating.gates_of(baseline, fail_if or [], undecided, false_alarms, plan, paired=paired)
    with only_writer(output, RECORDS, _tell_of_waiting if wait else None):
        with _progress_bar() as tell:
            progress = run_plan(plan, output, lambda: _pool(workers, cluster), tell)
        summary = summary_of(output)
        write_tables(output, summary)
        if not is_drawn(output):
            with drawing("drawing the report") as advance:
                write_report(output, summary, local_pool(workers), advance)
        if not quiet:
            with may_break():
                _print(summary, progress, output)
        if gates is not None:
            gating.judge(gates, output, summary.title, quiet=quiet)


def _tell_of_waiting(held: str) -> None:
    print(f"waiting: {held}", file=sys.stderr, flush=True)


def _pool(workers: int | None, cluster: str | None) -> Pool:
    from trajeval_ros.batch.executors import dask_pool, local_pool

    return local_pool(workers) if cluster is None else dask_pool(cluster)


def _print(summary: ComparisonSummary, progress: Progress, folder: Path) -> None:
    from trajeval_ros.batch.comparison_summary import failures
    from trajeval_ros.batch.results_table import OK
    from trajeval_ros.batch.summary_tables import matrices
    from trajeval_ros.report.console import console, show
    from trajeval_ros.report.matrix import to_terminal

    terminal = console()
    for each in matrices(summary):
        show(terminal, to_terminal(each))
        terminal.print(f"{each.caption}\n", style="dim")
    unchanged = sum(trial.status == OK for trial in summary.trials) - progress.new
    kept = f", {unchanged} unchanged" if unchanged else ""
    terminal.print(
        f"{progress.new} runs evaluated{kept}; report.html, tables and runs.parquet: {folder}",
        soft_wrap=True,
    )
    terminal.file.flush()
    remarks = console(sys.stderr)
    for line in failures(summary):
        remarks.print(f"warning: {line}", soft_wrap=True)


@contextmanager
def _progress_bar() -> Iterator[Callable[[Progress], None]]:
    """Yield what shows how many runs are done, how many failed, and which are being evaluated."""
    if not sys.stderr.isatty():
        yield lambda progress: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    from trajeval_ros.formatting.escaping import visible

    columns: list[Any] = [
        MofNCompleteColumn(),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}[dim]{task.fields[running]}"),
    ]
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        line = bar.add_task("runs", total=None, failed="", running="reading inputs")

        def tell(progress: Progress) -> None:
            bar.update(
                line,
                total=progress.total or None,
                completed=progress.kept + progress.done + progress.failed,
                failed=f"[red]{progress.failed} failed[/] " if progress.failed else "",
                running=escape(visible(", ".join(progress.running))),
            )

        yield tell
