"""As-available accuracy of a live run: what `finish` computes is that of a recording."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live, batches
from ros_bags import (
    ODOM,
    PATH,
    POSE,
    STORE,
    TRANSFORMS,
    Message,
    messages_of,
    path_message,
    transforms_message,
    write_messages,
)  # fmt: skip
from ros_processes import GROUNDTRUTH as TRUTH
from ros_processes import ODOMETRY, Peer, assert_same, evaluating, offline

from trajeval_ros import Trajectory, simulate
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.io.bags.pose_messages import decode_poses, decode_transforms
from trajeval_ros.io.live.state_file import read_states
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.online.alarms import AlarmLimits
from trajeval_ros.online.live_availability import received_poses
from trajeval_ros.ros.diagnostics import remarks_about

FLIGHT = simulate(seed=5, duration_s=20.0)
TF = "/tf:map.base"
CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
LIMITS = dict.fromkeys(("rate_hz", "coverage"), AlarmLimits())
OPTIONS = ("--gauge", "yaw", "--lengths", "2,4", "--as-available")


def received(estimate: list[Message], seed: int = 0) -> list[Message]:
    """Return messages with receive times, over 5 % of them after newer ones."""
    random = np.random.default_rng(seed)
    delays = 30_000_000 + (random.exponential(0.03, len(estimate)) * 1e9).astype(int)
    times = [message[2] + int(delay) for message, delay in zip(estimate, delays, strict=True)]
    return [(*item[:2], at, item[3]) for item, at in zip(estimate, times, strict=True)]


def twisting(flight: Trajectory, rate: float = 0.3) -> Trajectory:
    """Return a trajectory with velocities and turn rates that are about right."""
    rates = rate * np.sin(np.arange(3 * len(flight)).reshape(-1, 3) / 7.0)
    reading = SourceInfo(receive_times=ReceiveTimes(flight.stamps, body_rates=rates))
    velocities = np.gradient(flight.positions, flight.stamps / 1e9, axis=0)
    return replace(flight, velocities=velocities, reading=reading)


def corrected(flight: Trajectory, topic: str, seed: int) -> list[Message]:
    """Return a trajectory as transforms of odom to base, and rare ones of map to odom.

    Corrections have timestamps over a second apart and, as those of AMCL, in the future. One
    timestamp of the others is isolated. No message arrives after a newer one, because the pairs
    of a live run are without such transforms.
    """
    assert flight.quaternions is not None
    random = np.random.default_rng(seed)
    rows = zip(flight.stamps.tolist(), flight.positions, flight.quaternions, strict=True)
    transforms = [(at, ("odom", "base", at, *pose)) for at, *pose in rows]
    begin, end = flight.stamps[[0, -1]].tolist()
    rotations = lie.from_rotation_vector(random.normal(scale=0.05, size=(20, 3)))
    for row, at in enumerate(range(begin, end, 1_600_000_000)):
        moved = random.normal(scale=0.5, size=3)
        transforms.append((at + 20_000_000, ("map", "odom", at + 10**9, moved, rotations[row])))
    at, (*frames, stamp, moved, rotation) = transforms[len(flight) // 2]
    transforms[len(flight) // 2] = at, (*frames, stamp + 10**16, moved, rotation)
    transforms = sorted(transforms, key=lambda transform: transform[0])
    times = sorted(
        random.integers(15_000_000, 150_000_000, len(transforms)) + [a for a, _ in transforms]
    )
    rows = zip(times, transforms, strict=True)
    return [(topic, TRANSFORMS, int(at), transforms_message(item)) for at, (_, item) in rows]


def feed_of(kind: str) -> list[Message]:
    truth = messages_of(FLIGHT.groundtruth, GROUNDTRUTH, POSE)
    if kind == TRANSFORMS:
        return sorted([*truth, *corrected(FLIGHT.estimate, ESTIMATE, seed=3)], key=lambda m: m[2])
    if kind != PATH:
        estimate = messages_of(twisting(FLIGHT.estimate), ESTIMATE, kind)
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
    return sorted([*truth, *received(estimate)], key=lambda item: item[2])


# Every kind of message and every motion; others of their pairs are evaluated over DDS below.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "motion"),
    [(ODOM, "twist"), (POSE, "constant"), (PATH, "hold"), (TRANSFORMS, "hold")],
)
def test_finish_has_the_numbers_of_a_recording(kind: str, motion: str, tmp_path: Path) -> None:
    feed = feed_of(kind)
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", kind, available=AvailabilityRule(motion))
    # Each message of the estimate arrives alone, with the groundtruth since the one before.
    ends = [row + 1 for row, (topic, *_) in enumerate(feed) if topic == ESTIMATE]
    for batch in batches(feed, ends):
        live.feed(batch)
    live.end()
    estimate = f"{ESTIMATE}:map.base" if kind == TRANSFORMS else ESTIMATE
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [estimate], *OPTIONS, motion)
    [run], [recorded] = live.result["runs"], expected["runs"]
    result, required = run["as_available"], recorded["as_available"]
    assert (result.pop("received"), required.pop("received")) == ("node", "log")
    assert_same(result, required)
    assert required["why_withheld"] == ""
    if kind == TRANSFORMS:
        assert required["corrections"]["age_s"]["mean"] > 0.5
    elif kind != PATH:
        assert required["late_messages"] > 0.05 * len(FLIGHT.estimate)


@pytest.mark.slow
@pytest.mark.parametrize("size", [77, 300])
def test_transforms_of_a_restart_do_not_mix_with_those_before(size: int, tmp_path: Path) -> None:
    """Also where a batch has the end of one run and the start of the next."""
    live = Live(tmp_path / "live", TRANSFORMS, available=AvailabilityRule("hold"))
    feed = feed_of(TRANSFORMS)
    for begin in range(0, 2 * len(feed), size):
        live.feed([*feed, *feed][begin : begin + size])
    live.end()
    _, second = (
        received_poses(read_states(folder / "vio.states").received) for folder in live.folders
    )
    assert second.stamps[0] < FLIGHT.estimate.stamps[0] + 10**9
    steps = np.diff(np.concatenate([[0], second.stamps, FLIGHT.estimate.stamps[-1:]]))
    assert (steps >= 0).all()
    assert second.reading.receive_times is not None
    assert second.reading.receive_times.times.max() <= feed[-1][2]
    assert len(np.unique(second.stamps)) > len(FLIGHT.estimate) / size


@pytest.mark.parametrize("kind", [POSE, ODOM])
def test_without_a_twist_one_sentence_withholds_the_numbers(kind: str, tmp_path: Path) -> None:
    """Also of odometry with zeros, as of drivers that measure none."""
    live = Live(tmp_path / "live", kind, available=AvailabilityRule("twist"))
    truth = messages_of(FLIGHT.groundtruth, GROUNDTRUTH, POSE)
    still = replace(FLIGHT.estimate, velocities=None)
    feed = [*truth, *received(messages_of(still, ESTIMATE, kind))]
    live.feed(sorted(feed, key=lambda item: item[2])[:1200])
    estimate = live.run.estimates[0]
    errors, alignment = estimate.availability, estimate.evaluator.alignment
    assert errors is not None
    assert alignment is not None
    assert errors.update(alignment.similarity) is None
    assert errors.numbers == {}
    now = remarks_about(live.run, estimate, estimate.snapshot(), {}, LIMITS)
    [told] = [item for item in now if item.code == "receive_clock"]
    text = "the messages have no twist; use --as-available constant"
    assert told.text == f"as available: {text}"
    live.end()
    [run] = live.result["runs"]
    assert run["as_available"]["why_withheld"] == text
    assert run["as_available"]["position_m"] is None


def test_without_the_setting_nothing_is_written(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    live.feed(feed_of(ODOM)[:400])
    assert live.run.estimates[0].availability is None
    live.end()
    assert not len(read_states(live.folder / "vio.states").received)
    assert live.result["runs"][0]["as_available"] is None


TICK_NS, PAUSE_NS = 10_000_000, 750_000_000


def with_clock(feed: list[Message], pause_ns: int) -> list[Message]:
    """Return messages behind /clock at 100 Hz, in the order of wall time.

    At a simulated time the simulation pauses: /clock repeats it, and then is silent as long.
    """
    begin, end = min(item[2] for item in feed), max(item[2] for item in feed)
    ticks = np.arange(begin, end + 2 * TICK_NS, TICK_NS).tolist()
    repeated = range(pause_ns + TICK_NS, pause_ns + PAUSE_NS, TICK_NS)
    all_of_them: list[Message] = [(CLOCK, CLOCK_TYPE, at, clock_message(at)) for at in ticks]
    all_of_them += feed  # of equal times the clock is the first
    shifted = [
        (*item[:2], item[2] + 2 * PAUSE_NS * (item[2] > pause_ns), item[3]) for item in all_of_them
    ]
    shifted += [(CLOCK, CLOCK_TYPE, at, clock_message(pause_ns)) for at in repeated]
    return sorted(shifted, key=lambda item: item[2])


def clock_message(at: int) -> bytes:
    time = STORE.types["builtin_interfaces/msg/Time"](*divmod(at, 10**9))
    return STORE.serialize_cdr(STORE.types[CLOCK_TYPE](time), CLOCK_TYPE).tobytes()


def as_stored(sent: list[Message], poses: Trajectory) -> list[Message]:
    """Return messages with the receive times that a run has stored.

    Corrections have stored receive times in their order, and other messages that of the first
    pose of their timestamp. Transforms before the first correction have none, nor has the isolated
    one.
    """
    receive_times = poses.reading.receive_times
    assert receive_times is not None
    first = dict(zip(poses.stamps[::-1].tolist(), receive_times.times[::-1].tolist(), strict=True))
    later = [] if receive_times.corrected is None else np.unique(receive_times.corrected).tolist()
    result: list[Message] = []
    for topic, kind, _, payload in sent[::-1]:  # the first correction may be missing
        parent, stamp = "", 0
        if kind == TRANSFORMS:
            [((parent, _), columns)] = decode_transforms([payload])[0].items()
            stamp = int(columns.stamps[0])
        else:
            stamp = int(decode_poses([payload], kind).stamps[0])
        at = first.get(stamp)
        if parent == "map":
            at = later.pop() if later else None
        if at is not None:
            result.append((topic, kind, at, payload))
    assert not later
    return result[::-1]


@pytest.mark.ros
@pytest.mark.parametrize(("source", "motion"), [(ODOMETRY, "hold"), (TF, "constant")])
def test_over_dds_the_stored_receptions_give_the_numbers_of_a_recording(
    source: str, motion: str, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    """With a pause and a restart of the simulated time.

    One thread publishes /clock and the messages. Their order is therefore that of the bag, and
    every receive time is between two ticks of the clock, however late the processes run.
    """
    from geometry_msgs.msg import Vector3Stamped
    from std_msgs.msg import Float64

    topic, name = source.partition(":")[0], source[1:].translate(str.maketrans("/:.", "___"))
    if source == TF:
        pytest.importorskip("tf2_msgs", reason="`make test-ros` builds it with a compiler")
    truth = messages_of(FLIGHT.groundtruth[::2], TRUTH, POSE)
    if source == TF:
        sent = corrected(FLIGHT.estimate, topic, seed=4)
    else:
        sent = received(messages_of(twisting(FLIGHT.estimate), topic, ODOM))
    begin = min(item[2] for item in truth)
    feed = with_clock([*truth, *sent], begin + 800 * TICK_NS)
    write_messages(tmp_path / "played", feed)
    below = f"/evaluator/{name}/available"
    ages = peer.hear(f"{below}/age", Float64)
    errors = peer.hear(f"{below}/stamped/position_error", Vector3Stamped)
    folders = [tmp_path / "live", tmp_path / "live_2"]
    values = {"gauge": "none", "use_sim_time": True, "as_available": motion}
    with evaluating(folders[0], environment, estimates=[source], **values) as evaluator:
        for _ in folders:
            subscribers = {TRUTH: 1, topic: 1, CLOCK: 2}
            peer.play(tmp_path / "played", subscribers, ["evaluator"], rate=8.0)
        peer.until(lambda: ages and errors, "as-available errors")
        evaluator.wait_for(f"results of {folders[0]} are complete")
        assert evaluator.end() == 0
    options = ("--gauge", "none", "--as-available", motion)
    for number, folder in enumerate(folders):
        assert len(read_states(folder / "groundtruth.states").states.stamps) == len(truth)
        poses = received_poses(read_states(folder / f"{name}.states").received)
        messages, logged = as_stored(sent, poses), {payload: at for _, _, at, payload in sent}
        write_messages(tmp_path / f"bag_{number}", [*truth, *messages])
        if source == TF:
            del messages[0]  # it was received before the first correction, with which it is stored
        after_tick = np.array([(logged[message[3]] - begin) % TICK_NS for message in messages])
        since_tick = (
            np.array([message[2] - logged[message[3]] for message in messages]) + after_tick
        )
        assert -1 <= since_tick.min() <= since_tick.max() <= TICK_NS + 1
        recorded: Any = offline(tmp_path / f"bag_{number}", tmp_path, TRUTH, [source], *options)
        result = json.loads((folder / "result.json").read_text())["runs"][0]["as_available"]
        expected = recorded["runs"][0]["as_available"]
        assert result["why_withheld"] == ""
        assert (result.pop("received"), expected.pop("received")) == ("node", "log")
        assert_same(result, expected)
        if source == ODOMETRY:
            assert result["late_messages"] > 0.05 * len(poses)
        else:
            # From its timestamp on, it would be over a second younger.
            assert result["corrections"]["age_s"]["mean"] > 0.5
