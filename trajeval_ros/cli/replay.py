"""`trajeval replay`: a recorded bag as live ROS 2 traffic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.escaping import visible
from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from trajeval_ros.io.bags.pacing import PlaybackResult
    from trajeval_ros.io.bags.playback import Channel, Playback

_LATE_S = 0.1
_ROS_ARGUMENTS = "--ros-args"


class RosCommand(TyperCommand):
    """A command that hands what follows `--ros-args` to ROS, as `ros2 run` has it."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the ROS arguments in the context; the others are the command's."""
        cut = args.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in args else len(args)
        ctx.obj = args[cut:]
        return super().parse_args(ctx, args[:cut])


def replay(
    context: typer.Context,
    bag: Annotated[
        str,
        typer.Argument(
            metavar="BAG", help="A rosbag2 folder, an MCAP or sqlite3 file, a ROS 1 bag."
        ),
    ],
    topic: Annotated[
        list[str] | None,
        typer.Option(
            "--topic", metavar="TOPIC", help="Play this topic only; repeat it for several."
        ),
    ] = None,
    rate: Annotated[
        float,
        typer.Option(metavar="R", help="Seconds of the bag per second: 1 as recorded, 10 faster."),
    ] = 1.0,
    start: Annotated[
        float, typer.Option(metavar="S", help="Begin so many seconds after the bag's beginning.")
    ] = 0.0,
    end: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="End so many seconds after the bag's beginning.",
            show_default="its end",
        ),
    ] = None,
    wait_for_subscribers: Annotated[
        float,
        typer.Option(
            metavar="S",
            help="Wait until every topic has a subscriber, so many seconds at the most, and begin "
            "then anyway; nodes need a second or two to find each other.",
        ),
    ] = 3.0,
    no_clock: Annotated[
        bool, typer.Option("--no-clock", help="Don't publish the bag's time on /clock.")
    ] = False,
) -> None:
    """Publish what a bag recorded as live ROS 2 traffic, with /clock.

    Messages go out byte by byte as they were recorded, at their log times; those of ROS 1 are
    encoded anew. Publishers are reliable, so that every subscriber can connect; what subscribers
    need `use_sim_time` for is on /clock. A message is kept until reliable subscribers have it:
    where they are too slow, the replay waits for them and says so. What a subscriber's own queue
    is too short for is lost there. Ctrl-C ends it in order.

    All topics at five times the speed, as soon as each has a subscriber:

        trajeval replay flight --rate 5 --wait-for-subscribers 60

    One topic, 20 s of it, under another name; repeat `--topic` for several:

        trajeval replay flight --topic /odom --start 10 --end 30 --ros-args -r /odom:=/vio
    """
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.bags.bag import Bag
    from trajeval_ros.io.bags.playback import Playback
    from trajeval_ros.io.sources import parse_source
    from trajeval_ros.ros.bag_publisher import replay as play_back
    from trajeval_ros.ros.message_types import is_installed, require_ros

    source = parse_source(bag)
    if source.topic:
        raise InputError(f"name the topic apart from its bag, as in --topic {source.topic}")
    _check(rate, wait_for_subscribers)
    with Bag(source.path) as opened:
        require_ros()
        playback = Playback(
            opened, is_installed, topic or (), start_s=start, end_s=end, with_clock=not no_clock
        )
        _print_notes([*opened.notes, *playback.notes])
        noted = len(opened.notes)
        if wait_for_subscribers:
            names = _names(playback.channels)
            print(
                f"waiting {wait_for_subscribers:g} s at most for subscribers to {names}",
                flush=True,
            )

        def begin(alone: Sequence[Channel]) -> None:
            if alone:
                _print_notes([f"nobody has subscribed to {_names(alone)} yet"])
            print(f"playing {playback.duration_s:.1f} s at rate {rate:g}", flush=True)

        with progress(f"{opened.path}, {playback.duration_s:.0f} s at rate {rate:g}") as advance:
            played = play_back(
                playback,
                rate,
                patience_s=wait_for_subscribers,
                with_clock=not no_clock,
                arguments=context.obj or (),
                begin=begin,
                advance=advance,
            )
        _print_notes([*opened.notes[noted:], *opened.damage])
    _print_summary(playback, played, rate)


def _check(rate: float, patience_s: float) -> None:
    """Raise SettingsError if a number means nothing."""
    if not (math.isfinite(rate) and rate > 0.0):
        raise SettingsError(f"--rate {rate:g} is no speed; give a positive number, 1 as recorded")
    if not (math.isfinite(patience_s) and patience_s >= 0.0):
        raise SettingsError(f"--wait-for-subscribers {patience_s:g} is no time in seconds")


def _names(channels: Sequence[Channel]) -> str:
    return visible(", ".join(channel.name for channel in channels))


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {visible(note)}", flush=True)


def _print_summary(playback: Playback, played: PlaybackResult[Channel], rate: float) -> None:
    """Print what was played, in one line."""
    counts = [f"{played.counts[each]} on {visible(each.name)}" for each in playback.channels]
    bag_time = (played.reached_ns - playback.begin_ns) / NANOSECONDS
    if played.worst_lag_s > _LATE_S:
        lag = f"fell behind by {played.worst_lag_s:.2f} s: a lower --rate keeps the times"
    else:
        lag = f"at most {played.worst_lag_s * 1e3:.1f} ms late"
    if played.waited_s:
        lag += f", after {played.waited_s:.1f} s of waiting for subscribers that are slower"
    damaged = f"; {playback.damaged} damaged ones passed over" if playback.damaged else ""
    print(
        f"{'replayed' if played.is_complete else 'stopped after'} {bag_time:.1f} s of the bag in "
        f"{played.took_s:.1f} s (rate {rate:g}), {lag}; messages: {', '.join(counts)}{damaged}",
        flush=True,
    )
