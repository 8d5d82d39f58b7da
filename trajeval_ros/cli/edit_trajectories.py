"""`trajeval trajectory`: look at trajectories, change them, save them in another format."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import options
from trajeval_ros.cli.pipes import may_break
from trajeval_ros.cli.progress import progress
from trajeval_ros.cli.source_names import names_of
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.io.describe import summarize
from trajeval_ros.io.requests.hand_eye_file import read_similarity
from trajeval_ros.io.requests.request_words import request_from
from trajeval_ros.io.save_trajectories import FORMATS, MESSAGES, files_of, save_trajectories
from trajeval_ros.io.sources import each_topic, read_many
from trajeval_ros.metrics.editing import Edited, Editing, edit

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory

FRAMES, FEWER = "Frames", "Fewer poses"


def trajectory(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...",
            help="PATH, BAG:TOPIC, BAG:/tf:PARENT.CHILD, or BAG for all of its topics with poses.",
            show_default=False,
        ),
    ],
    reference: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="What to align and synchronise to, and whose first stamp --start counts from.",
            rich_help_panel=options.INPUT,
        ),
    ] = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    merge: Annotated[
        bool,
        typer.Option("--merge", help="Make one of all sources.", rich_help_panel=options.INPUT),
    ] = False,
    world_axes: Annotated[
        str | None,
        typer.Option(
            metavar="ros|optical",
            help="Turn the fixed frame to ROS's axes (x forward, y left, z up) from a camera's "
            "(x right, y down, z forward), or the other way.",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    body_axes: Annotated[
        str | None,
        typer.Option(
            metavar="ros|optical", help="The same for the body's axes.", rich_help_panel=FRAMES
        ),
    ] = None,
    transform_right: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Multiply each pose by this one on the right: another point of the body, such as "
            "the camera in the IMU. A TransformStamped in YAML, as --hand-eye takes it.",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    transform_left: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Multiply by this one on the left: another fixed frame. The same format; a line "
            "`scale: 2.0` makes it a Sim(3).",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    gauge: Annotated[
        str | None,
        typer.Option(
            help="Align to the reference; what alignment may change, by name: none, translation, "
            "yaw, planar, se3, sim3.",
            rich_help_panel=options.ALIGN,
        ),
    ] = None,
    modality: Annotated[
        str | None,
        typer.Option(
            help="Align to the reference as these sensors need it, such as stereo-inertial.",
            rich_help_panel=options.ALIGN,
        ),
    ] = None,
    align_states: options.AlignStatesOption = None,
    align_with: options.AlignWithOption = None,
    synchronise: Annotated[
        bool,
        typer.Option(
            "--synchronise",
            help="Keep what pairs with the reference, and save its states in the same rows, too.",
            rich_help_panel=options.PAIR,
        ),
    ] = False,
    association: Annotated[
        str | None,
        typer.Option(
            help="linear (default) interpolates the reference at a source's stamps; nearest pairs "
            "stamps one to one.",
            rich_help_panel=options.PAIR,
        ),
    ] = None,
    max_time_difference: options.MaxTimeDifferenceOption = None,
    max_gap: options.MaxGapOption = None,
    project: Annotated[
        str | None,
        typer.Option(
            metavar="xy|xz|yz",
            help="Project on a plane; of rotations the turn about its normal is left.",
            rich_help_panel=FRAMES,
        ),
    ] = None,
    motion_filter: Annotated[
        str | None,
        typer.Option(
            metavar="M,DEG",
            help="Keep a pose when it is so many metres from the one kept before it, or turned by "
            "so many degrees.",
            rich_help_panel=FEWER,
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Keep so many poses a second.", rich_help_panel=FEWER),
    ] = None,
    poses: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Keep N poses, evenly spread by count.", rich_help_panel=FEWER
        ),
    ] = None,
    save_as: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(FORMATS),
            help="Save what the table shows: a text file for each trajectory, or one MCAP file or "
            "one rosbag2 folder (sqlite3) for all.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    message: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(MESSAGES),
            help="Type of the messages in a bag (PoseStamped).",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER",
            help="Where to save; what exists there is never overwritten.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path(),
    strict: options.StrictOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Look at trajectories, change them, and save them in another format.

    What is in a bag and a file, side by side:

        trajeval trajectory flight.mcap groundtruth.csv

    All topics of a bag as TUM files:

        trajeval trajectory flight.mcap --save-as tum --output texts

    Aligned to groundtruth, and only where it has poses:

        trajeval trajectory vio.txt --reference gt.csv --gauge yaw --synchronise --save-as tum

    A minute of it, 10 poses a second, for Foxglove:

        trajeval trajectory vio.txt --start 30 --end +60 --rate 10 --save-as mcap

    A camera's trajectory (KITTI) in ROS's axes:

        trajeval trajectory 00.txt --world-axes ros --body-axes ros --save-as tum --output ros

    Whatever is asked for happens in this order: cut by time, merge, axes, transform on the right
    and on the left, align, synchronise, project, motion filter, rate, number of poses.
    """
    if message is not None and save_as not in ("mcap", "rosbag2"):
        raise SettingsError("--message is for bags; add --save-as mcap or --save-as rosbag2")
    aligns = gauge is not None or modality is not None
    if not aligns and (align_states is not None or align_with is not None):
        raise SettingsError("nothing is aligned; add --gauge or --modality")
    pairing = (association, max_time_difference, max_gap)
    if not aligns and not synchronise and any(each is not None for each in pairing):
        raise SettingsError("nothing is paired; add --synchronise, --gauge or --modality")
    if association == "continuous":
        raise SettingsError("association continuous is for likelihoods; use linear or nearest")
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
    if save_as is not None:
        files_of(output, ["any"], save_as)  # a format that is none is told before reading
    wanted = [each for source in sources for each in each_topic(source)]
    # In one call, which opens a bag once for all that is in it.
    others = [] if reference is None else [reference]
    names = [*names_of(wanted), *("reference" for _ in others)]
    read = _read([*wanted, *others], names, strict=strict)
    edited = edit(read[: len(wanted)], None if reference is None else read[-1], editing)
    everything = _with_references(edited)
    paths: list[Path] = []
    if save_as is not None:
        paths = save_trajectories(output, everything, save_as, message or "PoseStamped")
    if not quiet:
        with may_break():
            _print(everything, paths)
    _remark(read, edited, quiet=quiet)


def parse_motion(text: str) -> tuple[float, float]:
    """Read "0.1,5": metres and degrees, and return metres and radians.

    Raises:
        SettingsError: It isn't two numbers.
    """
    try:
        distance_m, angle_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(
            f"can't read the motion filter {text!r}; write metres and degrees, as in 0.1,5"
        ) from None
    return distance_m, math.radians(angle_deg)


def _read(sources: Sequence[str], names: Sequence[str], *, strict: bool) -> list[Trajectory]:
    with progress(f"reading {', '.join(names)}") as advance:
        found = read_many(sources, advance=advance, strict=strict)
    return [dataclasses.replace(each, name=name) for each, name in zip(found, names, strict=True)]


def _with_references(edited: Sequence[Edited]) -> list[Trajectory]:
    """Return what is shown and saved: trajectories, and the reference's states in their rows."""
    found: list[Trajectory] = []
    for each in edited:
        found.append(each.trajectory)
        if each.reference is not None:
            name = f"{each.trajectory.name}_reference"
            found.append(dataclasses.replace(each.reference, name=name, source=""))
    return found


def _print(trajectories: Sequence[Trajectory], paths: Sequence[Path]) -> None:
    from trajeval_ros.report.console import add_rows, console, new_table, show

    terminal = console()
    numbers = ("poses", "s", "Hz", "path m", "mean m/s", "max m/s", "gaps > 0.5 s", "longest s")
    table = new_table("", ("trajectory",), numbers)
    add_rows(table, [_row(each) for each in trajectories])
    show(terminal, table)
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
    """Print on stderr what the user must know, and with `quiet` only what is missing."""
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
