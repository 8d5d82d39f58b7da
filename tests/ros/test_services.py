"""~/start, ~/stop and ~/pause over the network."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, evaluating
from waiting import until

from trajeval_ros.io.live.metrics_file import NAME as METRICS
from trajeval_ros.io.live.state_file import read_states
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

SUBSCRIBERS = {GROUNDTRUTH: 1, ODOMETRY: 1}


def test_runs_start_pause_and_stop_when_asked(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_srvs.srv import Trigger

    def ask(service: str) -> str:
        answer = peer.ask(f"/evaluator/{service}", Trigger)
        assert answer.success, answer.message
        return str(answer.message)

    flown = simulate(9, 40.0)
    messages = [
        *messages_of(flown.groundtruth[::2], GROUNDTRUTH, POSE),
        *messages_of(flown.estimate, ODOMETRY, ODOM),
    ]
    begin = int(flown.groundtruth.stamps[0])
    for part in range(4):
        since, until_s = begin + part * 10 * 10**9, begin + (part + 1) * 10 * 10**9
        write_messages(tmp_path / f"{part}", [m for m in messages if since <= m[2] < until_s])
    folder = tmp_path / "live"
    options = {"gauge": "yaw", "lengths": "2", "label": "one", "metadata": ["operator=Ann"]}
    with evaluating(folder, environment, **options) as live:

        def play(part: int) -> None:
            peer.play(tmp_path / f"{part}", SUBSCRIBERS, ["evaluator"], rate=8.0)

        play(0)
        assert not peer.ask("/evaluator/start", Trigger).success  # it is active
        assert "is paused" in ask("pause")
        assert not peer.ask("/evaluator/pause", Trigger).success
        play(1)
        assert "continues" in ask("start")
        play(2)
        [refused] = peer.set("/evaluator", metadata=["no fact"])
        assert "parameter metadata must be facts as in operator=Ann" in refused.reason
        peer.set("/evaluator", label="two", metadata=["site=hall 2", "operator=Bo"])
        assert ask("stop") == str(folder / "result.json")
        first = json.loads((folder / "result.json").read_text())
        play(1)
        assert f"new results in {tmp_path / 'live_2'}" in ask("start")
        play(3)
        until((tmp_path / "live_2" / METRICS).exists, "there are metrics")
        assert live.end() == 0
    result = json.loads((folder / "result.json").read_text())
    assert result["runs"][0]["association"] == first["runs"][0]["association"]
    seconds = (read_states(folder / "vio_odometry.states").states.stamps - begin) / 1e9
    assert (seconds < 10.1).any()
    assert (seconds > 19.9).any()
    assert not ((seconds > 10.1) & (seconds < 19.9)).any()
    assert seconds.max() < 30.1
    [run] = result["runs"]
    assert (run["live"]["label"], run["live"]["metadata"]) == ("one", {"operator": "Ann"})
    assert run["events"] == []
    assert run["live"]["streams"]["estimate"]["messages"] == run["estimate"]["poses"]
    seconds = (
        read_states(tmp_path / "live_2" / "vio_odometry.states").states.stamps - begin
    ) / 1e9
    assert seconds.min() > 29.9
    [run] = json.loads((tmp_path / "live_2" / "result.json").read_text())["runs"]
    assert run["live"]["label"] == "two"
    assert run["live"]["metadata"] == {"site": "hall 2", "operator": "Bo"}
    metrics = (folder / METRICS).read_text()
    assert metrics.endswith("# EOF\n")
    assert 'trajeval_pairs{estimate="vio_odometry"} ' in metrics
    assert 'trajeval_groundtruth_rate_hz{estimate="vio_odometry"} ' in metrics
