"""The text next to a picture."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest
from state_rows import states, trajectory

from trajeval_ros import Protocol, evaluate, run, simulate
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.protocol import PROTOCOLS, metres
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.report.verdict_lines import verdict
from trajeval_ros.viewer.appearance import ErrorScale
from trajeval_ros.viewer.text_panel import of_evaluations, of_snapshots


def test_runs_without_covariances_have_no_verdict() -> None:
    flight = simulate(seed=1, duration_s=20.0)
    evaluation = run(flight.groundtruth, [flight.estimate]).runs[0].evaluation
    other: Any = SimpleNamespace(verdict="overconfident", per_pose=None)
    text = of_evaluations([evaluation] * 2, [None, other], ["a", "b"], ErrorScale.of(1.0, 9.0), [])
    lines = [line.split("|") for line in text.splitlines() if "|" in line]
    cells = {line[1].strip(): [item.strip() for item in line[2:-1]] for line in lines}
    assert cells["Consistency"] == ["-", "overconfident"]
    assert cells["NEES / dof"] == ["-", "-"]


def test_kitti_has_its_ranking_as_in_the_first_line() -> None:
    flight = simulate(seed=1, duration_s=120.0)
    protocol = dataclasses.replace(
        PROTOCOLS["kitti"], lengths=metres(20, 40), association="linear"
    )
    evaluation = evaluate(flight.groundtruth, flight.estimate, protocol)
    assert evaluation.kitti_ranking.endswith("deg/100 m (KITTI, 20 to 40 m)")
    assert evaluation.kitti_ranking in verdict(evaluation)[0]
    assert evaluation.kitti_ranking in of_evaluations(
        [evaluation], [None], ["a"], ErrorScale.of(1.0, 9.0), []
    )


@pytest.mark.parametrize("lengths", [(), ("4m", "2s", "400m")])
def test_a_live_run_without_long_parts_has_no_drift(lengths: tuple[str, ...]) -> None:
    flight = simulate(seed=1, duration_s=20.0)
    estimate, groundtruth = flight.estimate, flight.groundtruth
    assert estimate.quaternions is not None
    assert groundtruth.quaternions is not None
    live = OnlineEvaluator(OnlineSettings(Protocol(gauge="none", lengths=lengths)))
    live.add_groundtruth(
        trajectory(groundtruth.stamps, states(groundtruth.positions, groundtruth.quaternions))
    )
    live.add_estimate(
        trajectory(estimate.stamps, states(estimate.positions, estimate.quaternions))
    )
    live.update()
    text = of_snapshots([live.snapshot()], ["a"], Gauge.NONE, None, is_growing=True)
    [drift] = [line.split("|")[2].strip() for line in text.splitlines() if "| Drift" in line]
    assert (drift == "-") if not lengths else drift.endswith(" m in 4m")
