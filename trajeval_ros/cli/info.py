"""`trajeval info`: contents of a bag or file, and the likely role of every topic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import argument, require_used, shared_options
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.gauge import MODALITIES
from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from trajeval_ros.io.describe import Description, TrajectorySummary
    from trajeval_ros.report.console import Console

Row = tuple[str, ...]
_COLUMNS = ("topic", "type", "poses", "Hz", "first s", "last s", "path m", "frame", "likely role")
# Columns that are omitted on a narrow terminal, in this order. A single topic has all of them.
_HIDDEN_FIRST = ("last s", "first s", "frame", "path m", "type")


_PARAMETERS = (
    argument("source", metavar="SOURCE",
        help="Trajectory file, bag, BAG:TOPIC, BAG:/tf:PARENT.CHILD or folder."),
    *shared_options("info"),
)  # fmt: skip


@verb(*_PARAMETERS)
def info(source: str, columns: tuple[str, ...], frame_rate: float | None) -> None:
    """Prints the contents of a bag or file, and the likely roles of its topics.

    List all topics of a bag with rates, timestamps and frames, and the TF tree:

        trajeval info flight.mcap

    Show one topic, or the pose of one TF frame in another:

        trajeval info flight.mcap:/odometry

        trajeval info flight.mcap:/tf:map.base_link

    Show a text file. Its format (TUM, KITTI, EuRoC, OpenVINS, VINS-Mono) is detected:

        trajeval info groundtruth.csv

    Name the columns of a table that has no header (docs/trajectory.md has the names):

        trajeval info odom.csv --columns 't_ns _ x y yaw_deg'

    List the bags and trajectory files in a folder:

        trajeval info recordings
    """
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.bags.bag_folder import holds_bag
    from trajeval_ros.io.describe import describe
    from trajeval_ros.io.text.hints import NO_HINTS, SideHints
    from trajeval_ros.report.console import console, show_fitting

    hints = SideHints.of(columns, frame_rate).estimate
    folder = Path(source)
    if folder.is_dir() and not holds_bag(folder):
        if hints != NO_HINTS:
            raise SettingsError(
                "--columns and --frame-rate are of one text file, not of a folder; name the file"
            )
        _list_folder(folder)
        return
    with progress(f"reading {source}") as advance:
        description = describe(source, advance=advance, hints=hints)
    require_used([(hints, trajectory) for trajectory in description.trajectories])
    terminal = console()
    terminal.print(f"{description.path}", soft_wrap=True)
    for remark in description.remarks:
        terminal.remark("note", remark.text)
    if len(description.trajectories) == 1:
        _print_table(terminal, ("", ""), _details(description.trajectories[0]))
    elif description.trajectories:
        rows = [_row(trajectory) for trajectory in description.trajectories]
        show_fitting(terminal, _COLUMNS, (), rows, _HIDDEN_FIRST)
        _print_remarks(terminal, description.trajectories)
    _print_edges(terminal, description)
    if description.others:
        _print_others(terminal, description)
    _print_next_step(terminal, description)


def _list_folder(folder: Path) -> None:
    """Print the sources in a folder, and the skipped files."""
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.find_sources import find_sources
    from trajeval_ros.report.console import console

    with progress(f"searching {folder}") as advance:
        contents = find_sources(folder, advance)
    left_out = "; ".join(contents.left_out)
    if not contents.sources:
        more = f"; skipped: {left_out}" if left_out else ""
        raise InputError(
            f"no readable bag or trajectory in {folder} "
            f"({counted(contents.others, 'other file')}){more}"
        )
    terminal = console()
    rows = [
        (str(source.path), source.kind, source.problem or ", ".join(source.topics))
        for source in contents.sources
    ]
    _print_table(terminal, ("source", "format", "topics with poses or transforms"), rows)
    if contents.others:
        terminal.print(f"other files: {contents.others}", soft_wrap=True)
    if left_out:
        terminal.print(f"skipped: {left_out}", soft_wrap=True)


def _row(summary: TrajectorySummary) -> Row:
    """Return a trajectory as a row of the table."""
    kind = summary.kind.rpartition("/")[2]
    if summary.problem:
        return (summary.topic, kind, str(summary.poses), "", "", "", "", "", "none, see below")
    return (
        summary.topic,
        kind,
        str(summary.poses),
        f"{summary.rate_hz:.1f}",
        _seconds(summary.first_ns),
        _seconds(summary.last_ns),
        f"{summary.path_length_m:.2f}",
        _frames(summary),
        summary.could_be,
    )


def _details(summary: TrajectorySummary) -> list[Row]:
    """Return a single trajectory as rows of name and value."""
    if summary.problem:
        return [("problem", summary.problem)]
    rows: list[Row] = [
        *([("topic", summary.topic)] if "/msg/" in summary.kind else []),
        ("format", summary.kind),
        *([("columns", summary.columns)] if summary.columns else []),
        ("poses", str(summary.poses)),
        *(_times(summary) if summary.timed else [("timestamps", "none")]),
        ("path length", f"{summary.path_length_m:.3f} m"),
        ("frames", _frames(summary) or "unnamed"),
        ("data", ", ".join(("position", *summary.holds))),
        ("likely role", summary.could_be),
    ]
    return [*rows, *(("note", text) for text in summary.messages)]


def _times(summary: TrajectorySummary) -> list[Row]:
    """Return the rows of a trajectory with timestamps."""
    return [
        ("rate", f"{summary.rate_hz:.1f} Hz" if summary.rate_hz else "unknown"),
        ("timestamps", f"{_seconds(summary.first_ns)} to {_seconds(summary.last_ns)} s"),
        ("duration", f"{(summary.last_ns - summary.first_ns) / NANOSECONDS:.3f} s"),
        ("gaps over 0.5 s", _gaps(summary)),
    ]


def _gaps(summary: TrajectorySummary) -> str:
    """Return the number of gaps and the longest gap."""
    return f"{summary.gaps}, longest {summary.longest_gap_s:.2f} s" if summary.gaps else "none"


def _frames(summary: TrajectorySummary) -> str:
    """Return the frames as parent -> child."""
    return f"{summary.frame} -> {summary.child_frame}" if summary.child_frame else summary.frame


def _seconds(stamp: int) -> str:
    """Return a timestamp in seconds, truncated to milliseconds."""
    sign = "-" if stamp < 0 else ""
    whole, rest = divmod(abs(stamp), NANOSECONDS)
    return f"{sign}{whole}.{rest // 1_000_000:03d}"


def _print_remarks(terminal: Console, summaries: Sequence[TrajectorySummary]) -> None:
    """Print the remarks that have no column in the table."""
    for summary in summaries:
        remarks = [summary.problem] if summary.problem else list(summary.messages)
        if summary.gaps:
            remarks.append(f"gaps over 0.5 s: {_gaps(summary)}")
        for remark in remarks:
            terminal.print(f"{summary.topic}: {remark}", soft_wrap=True)


def _print_edges(terminal: Console, description: Description) -> None:
    """Print the moving transforms of the TF tree, and the number of static ones."""
    moving = [edge for edge in description.edges if not edge.is_static]
    if moving:
        rows = [
            (edge.topic, edge.parent, edge.child, str(edge.count),
                f"{edge.rate_hz:.1f}" if edge.rate_hz else "")
            for edge in moving
        ]  # fmt: skip
        _print_table(terminal, ("transforms", "parent", "child", "timestamps", "Hz"), rows)
    for edge in moving:
        if not (edge.parent or edge.child):
            terminal.print(
                f"transforms without frames are sources by their number: "
                f"{description.path}:{edge.topic}[0]",
                soft_wrap=True,
            )
    static = len(description.edges) - len(moving)
    if static:
        terminal.print(f"and {counted(static, 'static transform')}", soft_wrap=True)


def _print_others(terminal: Console, description: Description) -> None:
    """Print the topics of types that are no poses, and the fields with poses in them."""
    inside = [row for row in description.others if row[-1]]
    header: Row = ("no poses", "type", "messages")
    rows: list[Row] = [(name, kind, str(count)) for name, kind, count, _ in description.others]
    if inside:
        header = ("other topics", *header[1:], "poses inside")
        rows = [(*row, other[-1]) for row, other in zip(rows, description.others, strict=True)]
    _print_table(terminal, header, rows)
    if inside:
        name, _, _, fields = inside[0]
        field = fields.split(", ")[0].replace("itself", "")
        source = f"\nA pose inside a message is a source, too: {description.path}:{name}{field}"
        order = " (state the order of the quaternion)" if field.endswith("xyz]") else ""
        terminal.print(source + order, soft_wrap=True)


def _print_next_step(terminal: Console, description: Description) -> None:
    """Print the commands that evaluate the likely estimates, with placeholders for what lacks."""
    from trajeval_ros.io.roles import LikelyEvaluation, likely_evaluations

    usable = [summary for summary in description.trajectories if not summary.problem]
    for summary in usable:
        system = summary.system
        if system is not None and summary.could_be != "groundtruth":
            text = f"{summary.topic}: looks like {system.name}: {system.trap}"
            terminal.print(text, soft_wrap=True)
    likely = likely_evaluations(description)
    moving = [edge for edge in description.edges if not edge.is_static]
    if moving and not usable:
        edge = moving[0]
        source = f"{description.path}:{edge.topic}:{edge.parent}.{edge.child}"
        likely = [LikelyEvaluation("", (source,), "")]
    for evaluation in likely:
        command = evaluation.command("GROUNDTRUTH", "SENSORS")
        terminal.print(f"\n{command}", soft_wrap=True)
    if not all(evaluation.groundtruth for evaluation in likely):
        terminal.print("GROUNDTRUTH: another file or BAG:TOPIC of the same run", soft_wrap=True)
    if not all(evaluation.modality for evaluation in likely):
        terminal.print(f"SENSORS: {', '.join(MODALITIES)}", soft_wrap=True)


def _print_table(terminal: Console, header: Row, rows: Sequence[Row]) -> None:
    from trajeval_ros.report.console import Table, show

    show(terminal, Table("", header, rows=rows))
