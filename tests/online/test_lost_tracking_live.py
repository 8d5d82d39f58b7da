"""A live evaluator reports a loss of tracking with its onset and the ATE until then."""

from __future__ import annotations

import numpy as np
import pytest
from state_rows import states, trajectory

from benchmarks.diagnosis_further import FURTHER
from benchmarks.diagnosis_runs import simulated
from trajeval_ros.diagnosis.diagnose import diagnose
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.alarms import about_loss
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings

DRONE = simulated(5000, "drone", "walk", 100.0)


def rows(trajectory: Trajectory) -> np.ndarray:
    return states(trajectory.positions, trajectory.quaternions)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "code", "text"),
    [
        ("frozen until the end", "frozen", "the estimate repeats its pose since"),
        ("diverging, 3 m/s2", "diverged", "the estimate diverges from the groundtruth since"),
    ],
)
def test_live_and_recorded_report_the_same_loss(name: str, code: str, text: str) -> None:
    pair = FURTHER[name].make(DRONE)
    protocol = Protocol(gauge=Gauge.YAW, lengths=())
    live = OnlineEvaluator(OnlineSettings(protocol))
    told, truth, estimate = [], rows(pair.truth), rows(pair.estimate)
    passed = 0
    for row in range(0, len(estimate), 10):
        part = slice(row, row + 10)
        until = int(pair.truth.stamps.searchsorted(pair.estimate.stamps[part][-1])) + 1
        live.add_groundtruth(trajectory(pair.truth.stamps[passed:until], truth[passed:until]))
        passed = until
        live.add_estimate(trajectory(pair.estimate.stamps[part], estimate[part]))
        live.update()
        told += about_loss(live.snapshot())
    levels = [item.level for item in told]
    assert {item.code for item in told} == {code}
    assert levels == sorted(levels)
    assert levels[-1] is Level.ERROR
    assert told[-1].text.startswith(text)
    assert len({item.text for item in told}) == 1  # the message does not change every second
    evaluation = evaluate(pair.truth, pair.estimate, protocol)
    (finding,) = diagnose(evaluation, pair.truth, pair.estimate)[1].findings
    assert finding.cause == code
    (loss,) = live.losses.events
    at_s = (loss.t_ns - pair.truth.stamps[0]) / 1e9
    assert finding.evidence["at_s"] == pytest.approx(at_s, abs=1e-6)
    tracked = pair.estimate.stamps <= loss.t_ns
    until = evaluate(pair.truth, pair.estimate[tracked], protocol).ate["position_m"]
    assert until is not None
    assert told[-1].values["ate_before_m"] == pytest.approx(until.rmse, rel=0.05)
    live.add_groundtruth(trajectory(pair.truth.stamps[passed:], truth[passed:]))
    live.update(at_end=True)
    covered = live.snapshot().coverage
    assert covered is not None
    assert covered.covered == pytest.approx(evaluation.association.coverage.covered, abs=1e-9)
