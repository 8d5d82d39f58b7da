"""`trajeval trajectory`: print, transform and convert trajectories."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import (
    OUTPUT,
    argument,
    option,
    refuse_format,
    require_used,
    settings_options,
    shared_options,
)
from trajeval_ros.cli.plotting import PLOT_OPTIONS, Plotting
from trajeval_ros.cli.programs import may_break
from trajeval_ros.cli.progress import read_shown, report_dropped
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.pose_conventions import ORDERS, POSES, ROTATIONS, Conventions
from trajeval_ros.geometry.source_info import FORMAT
from trajeval_ros.io.describe import summarize
from trajeval_ros.io.hand_eye_file import read_similarity
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.setting import INPUT, PAIR, TRAJECTORY, two_numbers
from trajeval_ros.io.save_trajectories import MESSAGES, files_of, save_trajectories
from trajeval_ros.io.source_names import names_with, split_name
from trajeval_ros.io.sources import each_topic
from trajeval_ros.io.text.hints import SideHints
from trajeval_ros.metrics.editing import Edited, Editing, edit, reference_of
from trajeval_ros.report.figure_style import FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory

_HERE = Path()
_MESSAGE = "PoseStamped"
CONVENTIONS, FRAMES, FEWER = "Conventions of the sources", "Frames", "Fewer poses"


_PARAMETERS = (
    argument("sources", metavar="SOURCE...", count=-1,
        help="PATH, BAG:TOPIC, BAG:/tf:PARENT.CHILD, or BAG for all its topics with poses. "
        "NAME=SOURCE names one."),
    option("--reference", metavar="SOURCE", panel=INPUT, is_common=True,
        help="Reference for alignment and synchronisation; --start counts from its first "
        "timestamp."),
    *shared_options(TRAJECTORY),
    *settings_options(TRAJECTORY),
    option("--merge", kind=bool, panel=INPUT,
        help="Concatenation of all sources into one trajectory."),
    option("--scale", kind=float, metavar="METRES", default=Conventions.scale, panel=CONVENTIONS,
        help="Metres per unit of the positions: 0.001 for millimetres."),
    option("--quaternion-order", metavar="|".join(ORDERS), default=Conventions.quaternion_order,
        panel=CONVENTIONS,
        help="Order of the columns of quaternions, which are read as xyzw."),
    option("--inverse", metavar=f"{POSES}|{ROTATIONS}", panel=CONVENTIONS,
        help="Poses, or only rotations, to invert: world in body instead of body in world."),
    option("--axes", metavar="AXES", default=Conventions.axes, panel=CONVENTIONS,
        help="Permutation and signs of the axes, as in x,-y,z. With positions=y,z,x or "
        "rotations=y,z,x, only these change."),
    option("--clock-rate", kind=float, metavar="PPM", default=Conventions.clock_rate,
        panel=CONVENTIONS,
        help="Rate correction of the clock, in parts per million, from the first timestamp."),
    option("--world-axes", metavar="ros|optical", panel=FRAMES, is_common=True,
        help="Axes of the fixed frame after conversion: ros (x forward, y left, z up) or "
        "optical (x right, y down, z forward)."),
    option("--body-axes", metavar="ros|optical", panel=FRAMES, is_common=True,
        help="Axes of the body frame after conversion, as --world-axes."),
    option("--transform-right", kind=Path, metavar="FILE", panel=FRAMES,
        help="Transformation to multiply all poses by on the right: another point of the body, "
        "such as the camera in the IMU frame. A TransformStamped in YAML, as for --hand-eye."),
    option("--transform-left", kind=Path, metavar="FILE", panel=FRAMES,
        help="Transformation to multiply all poses by on the left: another fixed frame. Same "
        "format; a line `scale: 2.0` makes it a Sim(3)."),
    option("--synchronise", kind=bool, panel=PAIR, is_common=True,
        help="Keep only poses paired with the reference, and save the paired reference with the "
        "same number of rows."),
    option("--project", metavar="xy|xz|yz", panel=FRAMES,
        help="Plane to project on. Only rotations about its normal are kept."),
    option("--motion-filter", metavar="M,DEG", panel=FEWER,
        help="Motion filter: keep a pose if it differs from the last kept pose by M metres or "
        "DEG degrees."),
    option("--rate", kind=float, metavar="HZ", panel=FEWER, is_common=True,
        help="Rate to thin the poses to, in Hz."),
    option("--poses", kind=int, metavar="N", panel=FEWER,
        help="Number of poses to keep, evenly spaced by index."),
    option("--save-as", metavar="FORMAT", panel=OUTPUT, is_common=True,
        help="Output format. tum, kitti, euroc: one text file per trajectory. mcap: one file "
        "for all. rosbag2: one folder (sqlite3) for all."),
    option("--message", metavar="TYPE", panel=OUTPUT,
        help=f"Message type in a bag: {', '.join(MESSAGES)}. Default: {_MESSAGE}."),
    option("--output", kind=Path, metavar="FOLDER", default=_HERE, panel=OUTPUT, is_common=True,
        help="Output folder. Existing trajectories are never overwritten; figures are "
        "replaced."),
    *PLOT_OPTIONS,
)  # fmt: skip


@verb(*_PARAMETERS)
def trajectory(
    sources: Sequence[str],
    reference: str | None,
    columns: tuple[str, ...],
    frame_rate: float | None,
    strict: bool,
    quiet: bool,
    merge: bool,
    scale: float,
    quaternion_order: str,
    inverse: str | None,
    axes: str,
    clock_rate: float,
    world_axes: str | None,
    body_axes: str | None,
    transform_right: Path | None,
    transform_left: Path | None,
    synchronise: bool,
    project: str | None,
    motion_filter: str | None,
    rate: float | None,
    poses: int | None,
    save_as: str | None,
    message: str | None,
    output: Path,
    plot: str | None,
    colour_by: str | None,
    colour_max: float | None,
    figure_format: str | None,
    figure_width: str | None,
    style: Path | None,
    **settings: Any,
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

    Convert a file in millimetres whose poses are inverse:

        trajeval trajectory vio.txt --scale 0.001 --inverse poses --save-as tum

    Operations are applied in this order: conventions, time offset, hand-eye, time span, merge,
    axes, transform on the right and on the left, align, synchronise, project, motion filter,
    rate, number of poses.
    """
    if message is not None and save_as not in ("mcap", "rosbag2"):
        raise SettingsError(
            "--message applies to bags only; add --save-as mcap or --save-as rosbag2"
        )
    given = {name for name, value in settings.items() if value is not None}
    aligns = bool(given & {"gauge", "modality"})
    if not aligns and given & {"align_states", "align_with"}:
        raise SettingsError(
            "the options of the alignment need --gauge or --modality; add one of them"
        )
    pairing = {"association", "max_time_difference", "max_gap"}
    if not aligns and not synchronise and given & pairing:
        raise SettingsError(
            "the options of the association need --synchronise, --gauge or "
            "--modality; add one of them"
        )
    if settings["association"] == "continuous":
        raise SettingsError(
            "association continuous computes likelihoods only; use linear or nearest"
        )
    refuse_format(sources, "trajectory SOURCE...")
    request = request_from(settings)
    calibration = request.calibration
    if calibration.offset or calibration.hand_eye:
        raise SettingsError(
            "trajectory applies known values only; estimate them with trajeval evaluate "
            "--time-offset auto or --hand-eye auto, and give the result"
        )
    offset_s = request.protocol.association.time_offset_s
    # The trajectories are shifted, so their association has no offset.
    association = dataclasses.replace(request.protocol.association, time_offset_s=0.0)
    protocol = dataclasses.replace(request.protocol, association=association)
    editing = Editing(
        conventions=Conventions(scale, quaternion_order, inverse or "", axes, clock_rate),
        time_offset_s=offset_s,
        hand_eye=calibration.known,
        time_span=request.time_span,
        merge=merge,
        world_axes=world_axes,
        body_axes=body_axes,
        right=None if transform_right is None else read_similarity(transform_right),
        left=None if transform_left is None else read_similarity(transform_left),
        align=protocol if aligns else None,
        synchronise=association if synchronise else None,
        plane=project,
        motion=None if motion_filter is None else parse_motion(motion_filter),
        rate_hz=rate,
        poses=poses,
    )
    plots = Plotting.parse(
        plot,
        colour_by,
        colour_max,
        FigureStyle.parse(figure_format, figure_width, style, has_titles=True),
    )
    if save_as is not None:
        files_of(output, ["any"], save_as)  # raises an error for an unknown format before reading
    if save_as is None and plot is None and output != _HERE:
        raise SettingsError("--output needs --save-as or --plot; add one of them")
    # Times and figures have the reference, too.
    is_used = aligns or synchronise or plot is not None or request.time_span is not None
    if reference is not None and not is_used:
        raise SettingsError(
            "--reference needs an operation; add --gauge, --modality, --synchronise, --start, "
            "--end or --plot"
        )
    hints = SideHints.of(columns, frame_rate)
    split = [(name, item) for name, source in map(split_name, sources)
             for item in each_topic(source)]  # fmt: skip
    every_source = [source for _, source in split]
    if merge and len(every_source) == 1:
        raise SettingsError("--merge needs several sources; give more, or remove it")
    # One call reads all sources of a bag in one pass.
    others = [] if reference is None else [reference]
    names = [
        *names_with([name for name, _ in split], every_source),
        *("reference" for _ in others),
    ]
    every_hint = [*[hints.estimate] * len(every_source), *[hints.groundtruth] * len(others)]
    read = read_shown([*every_source, *others], names, strict=strict, hints=every_hint)
    require_used(list(zip(every_hint, read, strict=True)))
    edited = edit(read[: len(every_source)], None if reference is None else read[-1], editing)
    everything = _with_references(edited)
    paths: list[Path] = []
    if save_as is not None:
        paths = save_trajectories(output, everything, save_as, message or _MESSAGE)
    paths += plots.write(
        output,
        [item.trajectory for item in edited],
        None if reference is None else reference_of(read[-1], editing),
    )
    if not quiet:
        with may_break():
            _print(everything, paths)
    _remark(read, edited, quiet=quiet)
    report_dropped(read)


def parse_motion(text: str) -> tuple[float, float]:
    """Parse "0.1,5", metres and degrees; return metres and radians."""
    mistake = f"--motion-filter {text!r} is not valid; give metres and degrees, as in 0.1,5"
    distance_m, angle_deg = two_numbers(text, mistake)
    return distance_m, math.radians(angle_deg)


def _with_references(edited: Sequence[Edited]) -> list[Trajectory]:
    """Return the trajectories to print and save, with the references of synchronised ones."""
    trajectories: list[Trajectory] = []
    for item in edited:
        trajectories.append(item.trajectory)
        if item.reference is not None:
            name = f"{item.trajectory.name}_reference"
            reading = dataclasses.replace(item.reference.reading, source="")
            trajectories.append(dataclasses.replace(item.reference, name=name, reading=reading))
    return trajectories


def _print(trajectories: Sequence[Trajectory], paths: Sequence[Path]) -> None:
    from trajeval_ros.report.console import console, show_fitting

    terminal = console()
    numbers = ("poses", "s", "Hz", "path m", "mean m/s", "max m/s", "gaps > 0.5 s", "longest s")
    hidden_first = ("mean m/s", "longest s", "max m/s")
    show_fitting(
        terminal, ("trajectory",), numbers, [_row(item) for item in trajectories], hidden_first
    )
    for path in paths:
        terminal.print(f"saved {path}", soft_wrap=True)


def _row(trajectory: Trajectory) -> tuple[str, ...]:
    summary = summarize(trajectory.reading.source, trajectory)
    path = f"{summary.path_length_m:.3f}"
    if not trajectory.reading.stamped:
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
    """Print notes and warnings on stderr; with `quiet` only those of missing data."""
    from trajeval_ros.report.console import WARNING, console

    remarks = console(sys.stderr)
    for item in () if quiet else edited:
        for remark in item.trajectory.reading.remarks:
            if remark.level < Level.ERROR and remark.code != FORMAT:
                kind = remark.level.name.lower()
                remarks.remark(kind, f"{item.trajectory.name}: {remark.text}")
        why = "" if item.alignment is None else item.alignment.why_rotation_withheld
        if why:
            remarks.remark(WARNING, f"{item.trajectory.name}: {why}")
    for trajectory in read:
        for line in trajectory.reading.messages(Level.ERROR):
            remarks.remark(WARNING, f"{trajectory.name}: {line}")
