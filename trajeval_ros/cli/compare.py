"""`trajeval compare`: algorithms x sequences x trials, and tests against a baseline."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import figure_options, gating, options
from trajeval_ros.cli.comparison_verdict import print_shard, print_verdict, require_numbers
from trajeval_ros.cli.progress import progress as drawing
from trajeval_ros.cli.progress import progress_of_runs
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.report.figure_style import FORMATS, PLAIN, FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.batch.executors import Pool

WORK = "Work"


def compare(
    targets: Annotated[
        list[str],
        typer.Argument(
            metavar="CONFIG.yaml|RUNS.csv|DIR",
            help="YAML configuration, manifest (RUNS.csv or RUNS.parquet, also a URL; "
            "docs/compare.md), or a folder in the layout of ov_eval or "
            "rpg_trajectory_evaluation; with --merge the output folders of all shards.",
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
            "(seconds), 10%,20% (of the groundtruth path, the same for all algorithms) or none.",
            rich_help_panel=options.MEASURE,
        ),
    ] = None,
    covariance: options.CovarianceOption = None,
    rotation_covariance_frame: options.RotationCovarianceFrameOption = None,
    integrity: options.IntegrityOption = False,
    alert_limit: options.AlertLimitOption = None,
    risk: options.RiskOption = None,
    up: options.UpOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    columns: options.ColumnsOption = None,
    frame_rate: options.FrameRateOption = None,
    common_time_span: Annotated[
        bool | None,
        typer.Option(
            "--common-time-span/--whole-runs",
            help="Time span to evaluate: the span that all runs of a sequence cover, or all of "
            "every run (default).",
            show_default=False,
            rich_help_panel=options.MEASURE,
        ),
    ] = None,
    allow_remote: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL",
            help="Host that URLs in CONFIG.yaml or in the manifest may use, as in s3://bucket. "
            "Repeatable.",
            rich_help_panel=WORK,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Number of worker processes on this machine. Default: one per core.",
            rich_help_panel=WORK,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Scheduler of a Dask cluster that evaluates the runs, tcp://HOST:PORT.",
            rich_help_panel=WORK,
        ),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="Part of the runs to evaluate, the I-th of N, for example in a job array. "
            "--merge combines the parts.",
            rich_help_panel=WORK,
        ),
    ] = None,
    merge: Annotated[
        bool,
        typer.Option(
            "--merge",
            help="Tables and report of all shards. The arguments are their output folders.",
            rich_help_panel=WORK,
        ),
    ] = False,
    baseline: gating.BaselineOption = None,
    fail_if: gating.FailIfOption = None,
    undecided: gating.UndecidedOption = gating.UNDECIDED,
    false_alarms: gating.FalseAlarmsOption = gating.FALSE_ALARMS,
    paired: gating.PairedOption = False,
    output: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Output folder. Runs that it already contains are evaluated again only if their "
            "inputs or settings have changed.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path("comparison"),
    dataset: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Parquet dataset of many comparisons, to which the tables are appended "
            "(docs/dataset.md).",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    label: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Label of this comparison in the dataset, such as a commit.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait",
            help="Waiting for another comparison that writes to the same folder, instead of an "
            "error.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    figure_format: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="File formats of figures in DIR/figures, separated by commas: "
            f"{','.join(FORMATS)}. PGF needs LaTeX.",
            rich_help_panel=figure_options.FIGURES,
        ),
    ] = None,
    figure_width: figure_options.FigureWidthOption = None,
    no_title: figure_options.NoTitleOption = False,
    style: figure_options.StyleOption = None,
    transpose: Annotated[
        bool,
        typer.Option(
            "--transpose",
            help="Rows are sequences and columns are algorithms in tables.tex.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet", "-q", help="No tables on the terminal.", rich_help_panel=options.OUTPUT
        ),
    ] = False,
) -> None:
    r"""Compares many runs: algorithms x sequences x trials, in tables and one report.

    Options override the settings in CONFIG.yaml.

    Evaluate the runs in euroc.yaml, on all cores:

        trajeval compare euroc.yaml --output comparison

    Evaluate the runs that a table lists, one per row:

        trajeval compare runs.csv --modality mono-inertial

    Evaluate a folder in the layout of ov_eval or rpg_trajectory_evaluation:

        trajeval compare results --gauge yaw

    Evaluate a part in every job of a job array, and combine the parts:

        trajeval compare euroc.yaml --shard 3/16 --output shards/3

        trajeval compare --merge shards/* --output comparison

    Check for regressions. gates.md is for pull requests, gates.json is for programs:

        trajeval compare euroc.yaml --baseline main.parquet \
            --fail-if 'ate.position_m.rmse worse than 5 %'
    """
    from trajeval_ros.batch.compare_runs import write_tables
    from trajeval_ros.batch.comparison import Progress, run_plan
    from trajeval_ros.batch.comparison_summary import summary_of
    from trajeval_ros.batch.config import plan_of
    from trajeval_ros.batch.dataset import append_to_dataset
    from trajeval_ros.batch.executors import local_pool
    from trajeval_ros.batch.figure_files import write_figure_files
    from trajeval_ros.batch.output_lock import only_writer
    from trajeval_ros.batch.page import is_drawn, write_report
    from trajeval_ros.batch.record_store import RECORDS
    from trajeval_ros.batch.shards import Shard, merged, write_merged

    look = FigureStyle.parse(figure_format, figure_width, style, has_titles=not no_title)
    look.check()
    if look != PLAIN and figure_format is None:
        raise SettingsError("the options of figures need --figure-format; add --figure-format pdf")
    if workers is not None and cluster is not None:
        raise SettingsError(
            "--workers (this machine) and --cluster exclude each other; give one of them"
        )
    if not merge and len(targets) > 1:
        raise SettingsError(
            "more than one configuration; give one, or add --merge if they are shards"
        )
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
        "integrity": integrity or None,
        "alert_limit": alert_limit,
        "risk": risk,
        "up": up,
        "start": start,
        "end": end,
    }
    if (dataset is None) != (not label):
        raise SettingsError(
            "--dataset needs --label, such as a commit, and --label needs --dataset; give both"
        )
    part = None if shard is None else Shard.parse(shard)
    if part is not None and (
        merge or baseline or fail_if or figure_format or dataset or transpose
    ):
        raise SettingsError(
            "--shard evaluates runs only; give --merge, --baseline, --fail-if, --figure-format, "
            "--dataset and --transpose to the command that merges the shards"
        )
    if merge:
        given: list[object] = list(said.values())
        given += [columns, frame_rate, common_time_span, workers, cluster, allow_remote]
        if any(each is not None for each in given):
            raise SettingsError(
                "--merge uses the settings of the shards; remove the options of the evaluation"
            )
        folders = [Path(each) for each in targets]
        finished = merged(folders)
        settings = finished.settings
    else:
        plan = plan_of(
            targets[0],
            said,
            columns=columns,
            frame_rate=frame_rate,
            common_time_span=common_time_span,
            allow_remote=allow_remote or (),
        )
        settings = plan.settings
    # The baseline may be the table in the output folder, so it is read before anything is written.
    gates = gating.gates_of(
        baseline, fail_if or [], undecided, false_alarms, settings, paired=paired
    )
    with only_writer(output, RECORDS, _tell_of_waiting if wait else None):
        progress = Progress()
        if merge:
            write_merged(finished, folders, output)
        else:
            with progress_of_runs() as tell:
                progress = run_plan(plan, output, lambda: _pool(workers, cluster), tell, part)
        if part is not None:
            print_shard(part, progress, output, quiet=quiet)
            return
        summary = summary_of(output)
        write_tables(output, summary, transpose=transpose)
        if dataset is not None and label:
            append_to_dataset(output, summary.title, dataset, label)
        if not is_drawn(output):
            with drawing("writing the report") as advance:
                write_report(output, summary, advance)
        if figure_format is not None:
            with drawing("drawing figures") as advance:
                write_figure_files(output, summary, look, local_pool(workers), advance)
        if not quiet:
            print_verdict(summary, progress, output)
        if gates is not None:
            gating.judge(gates, output, summary.title, quiet=quiet)
        require_numbers(summary, output)


def _tell_of_waiting(held: str) -> None:
    print(f"waiting: {held}", file=sys.stderr, flush=True)


def _pool(workers: int | None, cluster: str | None) -> Pool:
    from trajeval_ros.batch.executors import dask_pool, local_pool

    return local_pool(workers) if cluster is None else dask_pool(cluster)
