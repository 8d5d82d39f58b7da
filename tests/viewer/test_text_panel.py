"""The text next to a picture."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from trajeval_ros import run, simulate
from trajeval_ros.viewer.appearance import ErrorScale
from trajeval_ros.viewer.text_panel import of_evaluations


def test_runs_without_covariances_have_no_verdict() -> None:
    flight = simulate(seed=1, duration_s=20.0)
    evaluation = run(flight.groundtruth, [flight.estimate]).runs[0].evaluation
    other: Any = SimpleNamespace(verdict="overconfident", per_pose=None)
    text = of_evaluations([evaluation] * 2, [None, other], ["a", "b"], ErrorScale.of(1.0, 9.0), [])
    lines = [line.split("|") for line in text.splitlines() if "|" in line]
    cells = {line[1].strip(): [each.strip() for each in line[2:-1]] for line in lines}
    assert cells["Consistency"] == ["-", "overconfident"]
    assert cells["NEES / dof"] == ["-", "-"]
