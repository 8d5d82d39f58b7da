"""A live run and its recording are told the same at the end."""

from __future__ import annotations

from pathlib import Path

import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from ros_bags import POSE, messages_of, write_messages
from ros_processes import offline

from benchmarks.diagnosis_mistakes import MISTAKES
from benchmarks.diagnosis_runs import simulated

DRONE = simulated(5000, "drone", "walk", 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["estimate in mm", "wxyz, estimate", "clock +18 s", ""])
def test_finish_says_what_an_evaluation_of_the_bag_says(tmp_path: Path, name: str) -> None:
    pair = MISTAKES[name].make(DRONE) if name else DRONE
    feed = [
        *messages_of(pair.truth, GROUNDTRUTH, POSE),
        *messages_of(pair.estimate, ESTIMATE, POSE),
    ]
    feed.sort(key=lambda item: item[2])
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", POSE)
    for first in range(0, len(feed), 200):
        live.feed(feed[first : first + 200])
    live.end()
    expected = offline(
        tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], "--gauge", "yaw", "--lengths", "2,4"
    )
    (one,), (other,) = live.result["runs"], expected["runs"]
    causes = [[diagnosi["cause"] for diagnosi in run["diagnosis"]] for run in (one, other)]
    assert causes[0] == causes[1]
    assert causes[0][:1] == (list(MISTAKES[name].causes[:1]) if name else [])
