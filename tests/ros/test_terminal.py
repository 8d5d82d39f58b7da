"""The status line."""

from __future__ import annotations

import pytest
from state_rows import states, trajectory

from trajeval_ros import simulate
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.ros.terminal import summary


@pytest.mark.parametrize(
    ("unpaired_s", "expected"), [(0.5, "now 0.006 m"), (26.0, "last pair 26 s ago")]
)
def test_an_old_error_is_not_shown_as_the_present_one(unpaired_s: float, expected: str) -> None:
    flight, live = simulate(seed=1, duration_s=10.0), OnlineEvaluator()
    for add, side in (
        (live.add_groundtruth, flight.groundtruth),
        (live.add_estimate, flight.estimate),
    ):
        add(trajectory(side.stamps, states(side.positions, side.quaternions)))
    live.update(at_end=True)
    snapshot = live.snapshot()
    line = summary("vio", snapshot, "30s", 0.006, "", unpaired_s=unpaired_s)
    assert expected in line
    assert ("now" in line) == (unpaired_s < 1.0)
    assert line.startswith(f"vio: {snapshot.pairs} pairs, ATE ")
