"""`trajeval info`: what is in this bag or file, and what could be evaluated in it?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from rich.console import Console

    from trajeval_ros.io.describe import Description, TrajectorySummary

Row = tuple[str, ...]


def info(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A trajectory file, a bag, BAG:TOPIC, or BAG:/tf:PARENT.CHILD.",
        ),
    ],
) -> None:
    """Tell what a bag or a file holds, and what could be evaluated in it.

    All topics of a bag, with rates, stamps and frames, and the TF tree:

        trajeval info flight.mcap

    One topic, or the pose of one TF frame in another:

        trajeval info flight.mcap:/odometry

        trajeval info flight.mcap:/tf:map.base_link

    A text file; whether it is TUM, KITTI, EuRoC, OpenVINS or VINS-Mono shows in its content:

        trajeval info groundtruth.csv
    """
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.describe import describe
    from trajeval_ros.report.console import console

    with progress(f"reading {source}") as advance:
        description = describe(source, advance=advance)
    terminal = console()
    terminal.print(f"{description.path}", soft_wrap=True)
    for note in description.notes:
        terminal.print(f"note: {note}", soft_wrap=True)
    if len(description.trajectories) == 1:
        _print_table(terminal, ("", ""), _details(description.trajectories[0]))
    elif description.trajectories:
        header = (
            "topic",
            "type",
            "poses",
            "Hz",
            "first s",
            "last s",
            "path m",
            "frame",
            "could be",
        )
        _print_table(terminal, header, [_row(each) for each in description.trajectories])
        _print_remarks(terminal, description.trajectories)
    _print_edges(terminal, description)
    if description.others:
        _print_table(
            terminal,
            ("no poses", "type", "messages"),
            [(name, kind, str(count)) for name, kind, count in description.others],
        )
    _print_next_step(terminal, description)


def _row(summary: TrajectorySummary) -> Row:
    """Return a trajectory as a row of the table."""
    topic = summary.source.rpartition(":")[2]
    if summary.problem:
        kind = summary.kind.rpartition("/")[2]
        return (topic, kind, str(summary.poses), "", "", "", "", "", "nothing, see below")
    return (
        topic,
        summary.kind.rpartition("/")[2],
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
        ("format", summary.kind),
        ("poses", str(summary.poses)),
        ("rate", f"{summary.rate_hz:.1f} Hz" if summary.rate_hz else "unknown: no stamps"),
        ("stamps", f"{_seconds(summary.first_ns)} to {_seconds(summary.last_ns)} s"),
        ("duration", f"{(summary.last_ns - summary.first_ns) / NANOSECONDS:.3f} s"),
        ("gaps over 0.5 s", _gaps(summary)),
        ("path length", f"{summary.path_length_m:.3f} m"),
        ("frames", _frames(summary) or "unnamed"),
        ("holds", ", ".join(("position", *summary.holds))),
        ("could be", summary.could_be),
    ]
    return [*rows, *(("note", note) for note in summary.notes)]


def _gaps(summary: TrajectorySummary) -> str:
    """Return how many gaps there are, and the longest."""
    return f"{summary.gaps}, the longest {summary.longest_gap_s:.2f} s" if summary.gaps else "none"


def _frames(summary: TrajectorySummary) -> str:
    """Return the frames as parent -> child."""
    return f"{summary.frame} -> {summary.child_frame}" if summary.child_frame else summary.frame


def _seconds(stamp: int) -> str:
    """Return a stamp in seconds, cut to milliseconds."""
    sign = "-" if stamp < 0 else ""
    whole, rest = divmod(abs(stamp), NANOSECONDS)
    return f"{sign}{whole}.{rest // 1_000_000:03d}"


def _print_remarks(terminal: Console, summaries: Sequence[TrajectorySummary]) -> None:
    """Print what the tables of several trajectories have no column for."""
    for summary in summaries:
        topic = summary.source.rpartition(":")[2]
        remarks = [summary.problem] if summary.problem else list(summary.notes)
        if summary.gaps:
            remarks.append(f"gaps over 0.5 s: {_gaps(summary)}")
        for remark in remarks:
            terminal.print(f"{topic}: {remark}", soft_wrap=True)


def _print_edges(terminal: Console, description: Description) -> None:
    """Print the TF tree."""
    if description.edges:
        _print_table(
            terminal,
            ("transforms", "parent", "child", "kind", "stamps", "Hz"),
            [
                (
                    edge.topic,
                    edge.parent,
                    edge.child,
                    "static" if edge.is_static else "moving",
                    str(edge.count),
                    f"{edge.rate_hz:.1f}" if edge.rate_hz else "",
                )
                for edge in description.edges
            ],
        )


def _print_next_step(terminal: Console, description: Description) -> None:
    """Print the command that evaluates what looks like a pair, if one does."""
    usable = [each for each in description.trajectories if not each.problem]
    truths = [each for each in usable if each.could_be == "groundtruth"]
    others = [each for each in usable if each.could_be != "groundtruth"]
    if len(truths) == 1 and others:
        terminal.print(
            f"\ntrajeval evaluate -g {truths[0].source} -e {others[0].source}", soft_wrap=True
        )


def _print_table(terminal: Console, words: Row, rows: Sequence[Row]) -> None:
    from trajeval_ros.report.console import add_rows, new_table, show

    table = new_table("", words)
    add_rows(table, rows)
    show(terminal, table)
