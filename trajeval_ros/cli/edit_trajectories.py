"""`trajeval trajectory`: print, transform and convert trajectories."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import figure_options, options, plotting
from trajeval_ros.cli.pipes import may_break
from trajeval_ros.cli.progress import progress
from trajeval_ros.cli.source_names import names_of
from trajeval_ros.cli.unused_options import require_used
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.io.describe import summarize
from trajeval_ros.io.requests.hand_eye_file import read_similarity
from trajeval_ros.io.requests.request_words import request_from
from trajeval_ros.io.save_trajectories import MESSAGES, files_of, save_trajectories
from trajeval_ros.io.sources import each_topic, read_many
from trajeval_ros.io.text.hints import TextHints
from trajeval_ros.metrics.editing import Edited, Editing, edit
from trajeval_ros.report.figure_style import FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory

_HERE = Path()
FRAMES, FEWER = "Frames", "Fewer poses"


def trajectory(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...",
            help="PATH, BAG:TOPIC, BAG:/tf:PARENT.CHILD, or BAG for all its topics with poses.",
            show_default=False,
        ),
    ],
    reference: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="Reference for alignment and synchronisation; --start counts from its first "
            "timestamp.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    columns: options.ColumnsOption = None,
    frame_rate: options.FrameRateOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    merge: Annotated[
        bool,
        typer.Option(
            "--merge",
            help="Concatenation of all sources into one trajectory.",
            rich_help_panel=options.INPUT,
        ),
    ] = False,
    world_axes: Annotated[
        str | None,
        typer.Option(
            metavar="ros|optical",
            help="Axes of the fixed frame after conversion: ros (x forward, y left, z up) or "
            "optical (x right, y down, z forward).",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    body_axes: Annotated[
        str | None,
        typer.Option(
            metavar="ros|optical",
            help="Axes of the body frame after conversion, as --world-axes.",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    transform_right: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Transformation to multiply all poses by on the right: another point of the "
            "body, such as the camera in the IMU frame. A TransformStamped in YAML, as for "
            "--hand-eye.",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    transform_left: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Transformation to multiply all poses by on the left: another fixed frame. Same "
            "format; a line `scale: 2.0` makes it a Sim(3).",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    gauge: Annotated[
        str | None,
        typer.Option(
            help="Alignment to the reference: none, translation, yaw, planar, se3 or sim3.",
            rich_help_panel=options.ALIGN,
        ),
    ] = None,
    modality: Annotated[
        str | None,
        typer.Option(
            help="Alignment to the reference with the gauge of these sensors, such as "
            "stereo-inertial.",
            rich_help_panel=options.ALIGN,
        ),
    ] = None,
    align_states: options.AlignStatesOption = None,
    align_with: options.AlignWithOption = None,
    synchronise: Annotated[
        bool,
        typer.Option(
            "--synchronise",
            help="Keep only poses paired with the reference, and save the paired reference with "
            "the same number of rows.",
            rich_help_panel=options.PAIR,
        ),
    ] = False,
    association: Annotated[
        str | None,
        typer.Option(
            help="Pairing method: linear (default) interpolates the reference at a source's "
            "timestamps; nearest pairs timestamps one to one.",
            rich_help_panel=options.PAIR,
        ),
    ] = None,
    max_time_difference: options.MaxTimeDifferenceOption = None,
    max_gap: options.MaxGapOption = None,
    project: Annotated[
        str | None,
        typer.Option(
            metavar="xy|xz|yz",
            help="Plane to project on. Only rotations about its normal are kept.",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    motion_filter: Annotated[
        str | None,
        typer.Option(
            metavar="M,DEG",
            help="Motion filter: keep a pose if it differs from the last kept pose by M metres "
            "or DEG degrees.",
            rich_help_panel=FEWER,
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ", help="Rate to thin the poses to, in Hz.", rich_help_panel=FEWER
        ),
    ] = None,
    poses: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Number of poses to keep, evenly spaced by index.",
            rich_help_panel=FEWER,
        ),
    ] = None,
    save_as: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Output format. tum, kitti, euroc: one text file per trajectory. mcap: one file "
            "for all. rosbag2: one folder (sqlite3) for all.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    message: Annotated[
        str | None,
        typer.Option(
            metavar="TYPE",
            help=f"Message type in a bag: {', '.join(MESSAGES)}. Default: PoseStamped.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER",
            help="Output folder. Existing trajectories are never overwritten; figures are "
            "replaced.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = _HERE,
    plot: plotting.PlotOption = None,
    colour_by: plotting.ColourByOption = None,
    map_file: plotting.MapOption = None,
    map_bounds: plotting.MapBoundsOption = None,
    figure_format: figure_options.FigureFormatOption = None,
    figure_width: figure_options.FigureWidthOption = None,
    style: figure_options.StyleOption = None,
    strict: options.StrictOption = False,
    quiet: options.QuietOption = False,
) -> None:
    r"""Prints trajectories, transforms them and saves them in other formats.

    Compare the trajectories of a bag and a file:

        trajeval trajectory flight.mcap groundtruth.csv

    Convert all topics of a bag to TUM files:

        trajeval trajectory flight.mcap --save-as tum --output texts

    Align to groundtruth, and keep only paired poses:

        trajeval trajectory vio.txt --reference gt.csv --gauge yaw --synchronise \
            --save-as tum

    Convert one minute at 10 Hz for Foxglove:

        trajeval trajectory vio.txt --start 30 --end +60 --rate 10 --save-as mcap

    Draw the trajectory and the groundtruth, with the path coloured by error:

        trajeval trajectory vio.txt --reference gt.csv --gauge yaw \
            --plot xy,xyz --colour-by error

    Convert a camera trajectory (KITTI) to ROS axes:

        trajeval trajectory 00.txt --world-axes ros --body-axes ros \
            --save-as tum --output ros

    Read a table without a header (docs/trajectory.md lists the column names):

        trajeval trajectory odom.csv --columns 't_ns _ x y yaw_deg' --save-as tum

    Operations are applied in this order: time span, merge, axes, transform on the right and on the
    left, align, synchronise, project, motion filter, rate, number of poses.
    """
    if message is not None and save_as not in ("mcap", "rosbag2"):
        raise SettingsError(
            "--message applies to bags only; add --save-as mcap or --save-as rosbag2"
        )
    aligns = gauge is not None or modality is not None
    if not aligns and (align_states is not None or align_with is not None):
        raise SettingsError(
            "the options of the alignment need --gauge or --modality; add one of them"
        )
    pairing = (association, max_time_difference, max_gap)
    if not aligns and not synchronise and any(each is not None for each in pairing):
        raise SettingsError(
            "the options of the association need --synchronise, --gauge or "
            "--modality; add one of them"
        )
    if association == "continuous":
        raise SettingsError(
            "association continuous computes likelihoods only; use linear or nearest"
        )
    protocol = request_from(
        {
            "gauge": gauge,
            "modality": modality,
            "align_states": align_states,
            "align_with": align_with,
            "association": association,
            "max_time_difference": max_time_difference,
            "max_gap": max_gap,
        }
    ).protocol
    editing = Editing(
        time_span=TimeSpan.parse(start, end),
        merge=merge,
        world_axes=world_axes,
        body_axes=body_axes,
        right=None if transform_right is None else read_similarity(transform_right),
        left=None if transform_left is None else read_similarity(transform_left),
        align=protocol if aligns else None,
        synchronise=protocol.association if synchronise else None,
        plane=project,
        motion=None if motion_filter is None else parse_motion(motion_filter),
        rate_hz=rate,
        poses=poses,
    )
    plots = plotting.Plotting.parse(
        plot,
        colour_by,
        map_file,
        map_bounds,
        FigureStyle.parse(figure_format, figure_width, style, has_titles=True),
    )
    if save_as is not None:
        files_of(output, ["any"], save_as)  # raises an error for an unknown format before reading
    if save_as is None and plot is None and output != _HERE:
        raise SettingsError("--output needs --save-as or --plot; add one of them")
    placed = (start, end, plot)  # times and figures have the reference, too
    if reference is not None and not aligns and not synchronise and placed == (None, None, None):
        raise SettingsError(
            "--reference needs an operation; add --gauge, --modality, --synchronise, --start, "
            "--end or --plot"
        )
    hints = TextHints.of(columns, frame_rate)
    wanted = [each for source in sources for each in each_topic(source)]
    if merge and len(wanted) == 1:
        raise SettingsError("--merge needs several sources; give more, or remove it")
    # One call reads all sources of a bag in one pass.
    others = [] if reference is None else [reference]
    names = [*names_of(wanted), *("reference" for _ in others)]
    every_hint = [*[hints] * len(wanted), *[hints.of_reference] * len(others)]
    read = _read([*wanted, *others], names, every_hint, strict=strict)
    require_used(hints, (note for each in read for note in each.notes))
    edited = edit(read[: len(wanted)], None if reference is None else read[-1], editing)
    everything = _with_references(edited)
    paths: list[Path] = []
    if save_as is not None:
        paths = save_trajectories(output, everything, save_as, message or "PoseStamped")
    paths += plots.write(
        output,
        [each.trajectory for each in edited],
        None if reference is None else read[-1].in_order(),
    )
    if not quiet:
        with may_break():
            _print(everything, paths)
    _remark(read, edited, quiet=quiet)


def parse_motion(text: str) -> tuple[float, float]:
    """Parse "0.1,5", metres and degrees; return metres and radians.

    Raises:
        SettingsError: The text is not two numbers.
    """
    try:
        distance_m, angle_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(
            f"--motion-filter {text!r} is not valid; give metres and degrees, as in 0.1,5"
        ) from None
    return distance_m, math.radians(angle_deg)


def _read(
    sources: Sequence[str], names: Sequence[str], hints: Sequence[TextHints], *, strict: bool
) -> list[Trajectory]:
    with progress(f"reading {', '.join(names)}") as advance:
        found = read_many(sources, advance=advance, strict=strict, hints=hints)
    return [dataclasses.replace(each, name=name) for each, name in zip(found, names, strict=True)]


def _with_references(edited: Sequence[Edited]) -> list[Trajectory]:
    """Return the trajectories to print and save, with the references of synchronised ones."""
    found: list[Trajectory] = []
    for each in edited:
        found.append(each.trajectory)
        if each.reference is not None:
            name = f"{each.trajectory.name}_reference"
            found.append(dataclasses.replace(each.reference, name=name, source=""))
    return found


def _print(trajectories: Sequence[Trajectory], paths: Sequence[Path]) -> None:
    from trajeval_ros.report.console import console, show_fitting

    terminal = console()
    numbers = ("poses", "s", "Hz", "path m", "mean m/s", "max m/s", "gaps > 0.5 s", "longest s")
    hidden_first = ("mean m/s", "longest s", "max m/s")
    show_fitting(
        terminal, ("trajectory",), numbers, [_row(each) for each in trajectories], hidden_first
    )
    for path in paths:
        terminal.print(f"saved {path}", soft_wrap=True)


def _row(trajectory: Trajectory) -> tuple[str, ...]:
    summary = summarize(trajectory.source, trajectory)
    path = f"{summary.path_length_m:.3f}"
    if not trajectory.stamped:
        return (trajectory.name, str(summary.poses), "", "", path, "", "", "", "")
    return (
        trajectory.name,
        str(summary.poses),
        f"{trajectory.duration_s:.3f}",
        f"{summary.rate_hz:.1f}",
        path,
        f"{summary.mean_speed_mps:.3f}",
        f"{summary.largest_speed_mps:.3f}",
        str(summary.gaps),
        f"{summary.longest_gap_s:.3f}",
    )


def _remark(read: Sequence[Trajectory], edited: Sequence[Edited], *, quiet: bool) -> None:
    """Print notes and warnings on stderr; with `quiet` only warnings of missing data."""
    from trajeval_ros.report.console import console

    remarks = console(sys.stderr)
    for each in () if quiet else edited:
        for note in each.trajectory.notes:
            remarks.print(f"note: {each.trajectory.name}: {note}", soft_wrap=True)
        if each.alignment is not None and each.alignment.untrustworthy:
            why = each.alignment.untrustworthy
            remarks.print(f"warning: {each.trajectory.name}: {why}", soft_wrap=True)
    for trajectory in read:
        for line in (*trajectory.damage, *trajectory.conflicts):
            remarks.print(f"warning: {trajectory.name}: {line}", soft_wrap=True)
