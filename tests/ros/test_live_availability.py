"""As-available accuracy of a live run: what `finish` computes is that of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from ros_bags import ODOM, PATH, POSE, Message, messages_of, path_message, write_messages
from ros_processes import GROUNDTRUTH as TRUTH
from ros_processes import ODOMETRY, Peer, assert_same, evaluating, offline, replay

from trajeval_ros import simulate
from trajeval_ros.geometry.up_axis import Z_UP
from trajeval_ros.io.live.reception_file import read_received
from trajeval_ros.metrics.as_available import AvailabilityRule

FLIGHT = simulate(seed=5, duration_s=20.0)
OPTIONS = ("--gauge", "yaw", "--lengths", "2,4", "--as-available")


def received(estimate: list[Message], seed: int = 0) -> list[Message]:
    """Return messages with times of reception, over 5 % of them after newer ones."""
    random = np.random.default_rng(seed)
    delays = 30_000_000 + (random.exponential(0.03, len(estimate)) * 1e9).astype(int)
    times = [message[2] + int(delay) for message, delay in zip(estimate, delays, strict=True)]
    return [(*each[:2], at, each[3]) for each, at in zip(estimate, times, strict=True)]


def feed_of(kind: str) -> list[Message]:
    truth = messages_of(FLIGHT.groundtruth, GROUNDTRUTH, POSE)
    if kind == ODOM:
        estimate = messages_of(FLIGHT.estimate, ESTIMATE, ODOM)
    else:
        stamps = FLIGHT.estimate.stamps.tolist()
        columns = FLIGHT.estimate.positions, FLIGHT.estimate.quaternions
        estimate = [
            (
                ESTIMATE,
                PATH,
                stamps[end - 1],
                path_message(stamps[:end], *(c[:end] for c in columns)),
            )
            for end in range(5, len(stamps) + 1, 5)
        ]
    return sorted([*truth, *received(estimate)], key=lambda each: each[2])


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "motion"), [(ODOM, "hold"), (ODOM, "constant"), (PATH, "hold")])
def test_finish_has_the_numbers_of_a_recording(kind: str, motion: str, tmp_path: Path) -> None:
    feed = feed_of(kind)
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", kind, available=AvailabilityRule(motion))
    for each in feed:
        live.feed([each])
    live.end()
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *OPTIONS, motion)
    [run], [recorded] = live.result["runs"], expected["runs"]
    found, wanted = run["as_available"], recorded["as_available"]
    assert (found.pop("received"), wanted.pop("received")) == ("node", "log")
    assert_same(found, wanted)
    if kind == ODOM:
        assert wanted["late_messages"] > 0.05 * len(FLIGHT.estimate)


def test_without_the_setting_nothing_is_written(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    live.feed(feed_of(ODOM)[:400])
    live.end()
    assert not list(live.folder.glob("*.received"))
    assert live.result["runs"][0]["as_available"] is None


@pytest.mark.ros
def test_over_dds_the_stored_receptions_give_the_numbers_of_a_recording(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from geometry_msgs.msg import Vector3Stamped
    from std_msgs.msg import Float64

    truth = messages_of(FLIGHT.groundtruth[::2], TRUTH, POSE)
    estimate = received(messages_of(FLIGHT.estimate, ODOMETRY, ODOM))
    write_messages(tmp_path / "played", [*truth, *estimate])
    below = "/evaluator/vio_odometry/available"
    ages = peer.hear(f"{below}/age", Float64)
    errors = peer.hear(f"{below}/stamped/position_error", Vector3Stamped)
    with evaluating(
        tmp_path / "live", environment, gauge="none", use_sim_time=True, as_available="hold"
    ) as evaluator:
        replay(tmp_path / "played", environment, "--rate", "4")
        peer.until(lambda: ages and errors, "as-available errors")
        assert evaluator.end() == 0
    groundtruth, poses = read_received(tmp_path / "live/vio_odometry.received", [Z_UP, Z_UP])
    assert len(groundtruth) == len(truth)
    times = poses.reading.receptions
    assert times is not None
    stored = messages_of(poses, ODOMETRY, ODOM)
    stored = [(*each[:2], int(at), each[3]) for each, at in zip(stored, times.times, strict=True)]
    write_messages(tmp_path / "bag", [*truth, *stored])
    options = ("--gauge", "none", "--as-available", "hold")
    recorded: Any = offline(tmp_path / "bag", tmp_path, TRUTH, [ODOMETRY], *options)
    found = evaluator.result["runs"][0]["as_available"]
    wanted = recorded["runs"][0]["as_available"]
    assert found["why_withheld"] == ""
    assert (found.pop("received"), wanted.pop("received")) == ("node", "log")
    assert_same(found, wanted)
    assert found["late_messages"] > 0.05 * len(poses)
