"""`trajeval replay`: publish a recorded bag as live ROS 2 messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.cli.command import RosCommand, ros_arguments, verb
from trajeval_ros.cli.options import argument, option
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.escaping import visible
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from trajeval_ros.io.bags.playback import Channel, Playback, PlaybackResult

_LATE_S = 0.1


_PARAMETERS = (
    argument("bag", metavar="BAG", help="Rosbag2 folder, MCAP or sqlite3 file, or ROS 1 bag."),
    option("--topic", metavar="TOPIC", is_repeatable=True,
        help="Topic to play; repeatable. Default: all topics."),
    option("--rate", kind=float, metavar="R", default=1.0,
        help="Playback speed, as a factor of the recorded speed."),
    option("--start", kind=float, metavar="S", default=0.0,
        help="Start, in seconds after the start of the bag."),
    option("--end", kind=float, metavar="S",
        help="End, in seconds after the start of the bag. Default: its end."),
    option("--wait-for-subscribers", kind=float, metavar="S", default=3.0,
        help="Longest wait for subscribers to all topics with poses, in seconds; then playback "
        "starts. "
        "Nodes need one to two seconds for discovery."),
    option("--no-clock", kind=bool, help="No messages on /clock."),
)  # fmt: skip


@verb(*_PARAMETERS, kind=RosCommand)
def replay(
    bag: str,
    topic: Sequence[str],
    rate: float,
    start: float,
    end: float | None,
    wait_for_subscribers: float,
    no_clock: bool,
) -> None:
    r"""Publishes a recorded bag as live ROS 2 messages, with /clock.

    Messages are published unchanged at their log times; ROS 1 messages are converted. Publishers
    are reliable. Subscribers with `use_sim_time` use /clock. The replay waits for slow reliable
    subscribers, and reports it. A subscriber with a queue that is too short can still lose
    messages. Stop with Ctrl-C.

    Play all topics at five times the speed, as soon as all topics with
    poses have subscribers:

        trajeval replay flight --rate 5 --wait-for-subscribers 60

    Play 20 s of one topic under another name. Repeat `--topic` for several topics:

        trajeval replay flight --topic /odom --start 10 --end 30 \
            --ros-args -r /odom:=/vio
    """
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.bags.bag import Bag
    from trajeval_ros.io.bags.playback import Playback
    from trajeval_ros.io.sources import parse_source
    from trajeval_ros.ros.bag_publisher import replay as play_back
    from trajeval_ros.ros.message_types import is_installed, require_ros

    source = parse_source(bag)
    if source.topic:
        raise InputError(
            f"replay takes a bag without a topic; give the topic as --topic {source.topic}"
        )
    _check(rate, wait_for_subscribers)
    with Bag(source.path) as opened:
        require_ros()
        playback = Playback(
            opened, is_installed, topic, start_s=start, end_s=end, with_clock=not no_clock
        )
        _print_notes([*opened.notes, *playback.notes])
        noted = len(opened.notes)
        if wait_for_subscribers:
            names = _names(playback.awaited)
            print(
                f"waiting up to {wait_for_subscribers:g} s for subscribers to {names}", flush=True
            )

        def begin(alone: Sequence[Channel]) -> None:
            if alone:
                _print_notes([f"no subscribers to {_names(alone)} yet"])
            print(f"playing {playback.duration_s:.1f} s at rate {rate:g}", flush=True)

        with progress(f"{opened.path}, {playback.duration_s:.0f} s at rate {rate:g}") as advance:
            played = play_back(
                playback,
                rate,
                patience_s=wait_for_subscribers,
                with_clock=not no_clock,
                arguments=ros_arguments(),
                begin=begin,
                advance=advance,
            )
        _print_notes([*opened.notes[noted:], *opened.damage])
    _print_summary(playback, played, rate)


def _check(rate: float, patience_s: float) -> None:
    """Raise SettingsError if a number is out of range."""
    if not (math.isfinite(rate) and rate > 0.0):
        raise SettingsError(
            f"--rate {rate:g} is out of range; give a positive number, such as 1 "
            "for the recorded speed"
        )
    if not (math.isfinite(patience_s) and patience_s >= 0.0):
        raise SettingsError(
            f"--wait-for-subscribers {patience_s:g} is out of range; give 0 or more seconds"
        )


def _names(channels: Sequence[Channel]) -> str:
    return visible(", ".join(channel.name for channel in channels))


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {visible(note)}", flush=True)


def _print_summary(playback: Playback, played: PlaybackResult[Channel], rate: float) -> None:
    """Print a summary of the playback in one line."""
    counts = [
        f"{played.counts[channel]} on {visible(channel.name)}" for channel in playback.channels
    ]
    bag_time = (played.reached_ns - playback.begin_ns) / NANOSECONDS
    if played.worst_lag_s > _LATE_S:
        lag = f"late by up to {played.worst_lag_s:.2f} s: use a lower --rate"
    else:
        lag = f"late by at most {played.worst_lag_s * 1e3:.1f} ms"
    if played.waited_s:
        lag += f", with {played.waited_s:.1f} s of waiting for slow subscribers"
    damaged = (
        f"; {counted(playback.damaged, 'damaged message')} skipped" if playback.damaged else ""
    )
    print(
        f"{'replayed' if played.is_complete else 'stopped after'} {bag_time:.1f} s of the bag in "
        f"{played.took_s:.1f} s (rate {rate:g}), {lag}; messages: {', '.join(counts)}{damaged}",
        flush=True,
    )
