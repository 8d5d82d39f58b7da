"""Conventions in which a source writes poses: what is refused, and what a correction changes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from trajeval_ros import Request, run, simulate
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.pose_conventions import Conventions
from trajeval_ros.pipeline.request import Corrections

FLIGHT = simulate(seed=1, duration_s=30.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"scale": 0.0}, "greater than zero"),
        ({"scale": float("nan")}, "greater than zero"),
        ({"quaternion_order": "wzyx"}, "quaternion order"),
        ({"inverse": "positions"}, "kind of inversion"),
        ({"axes": "x,y"}, "axes"),
        ({"axes": "x,x,z"}, "axes"),
        ({"clock_rate": -1e6}, "clock rate"),
        ({"axes": "rotations=x,-y,z"}, "left-handed"),
    ],
)
def test_conventions_that_do_not_exist_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Conventions(**wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"inverse": "poses"}, "only positions"), ({"quaternion_order": "wxyz"}, "no orientations")],
)
def test_positions_have_no_conventions_of_orientations(
    wrong: dict[str, Any], message: str
) -> None:
    bare = dataclasses.replace(FLIGHT.estimate, quaternions=None)
    with pytest.raises(InputError, match=message):
        Conventions(**wrong).corrected(bare)


@pytest.mark.parametrize("wrong", [{"inverse": "poses"}, {"axes": "x,-y,z"}])
def test_corrections_undo_themselves(wrong: dict[str, Any]) -> None:
    conventions = Conventions(**wrong)
    twice = conventions.corrected(conventions.corrected(FLIGHT.estimate))
    np.testing.assert_allclose(twice.positions, FLIGHT.estimate.positions, atol=1e-9)
    assert twice.quaternions is not None
    assert FLIGHT.estimate.quaternions is not None
    np.testing.assert_allclose(twice.quaternions, FLIGHT.estimate.quaternions, atol=1e-12)


def test_a_clock_rate_stretches_from_the_first_stamp_on() -> None:
    longer = Conventions(clock_rate=1000.0).corrected(FLIGHT.estimate)
    before, after = FLIGHT.estimate.stamps, longer.stamps
    assert after[0] == before[0]
    assert after[-1] - after[0] == pytest.approx(1.001 * (before[-1] - before[0]), abs=0.5)


def test_a_request_corrects_both_sides() -> None:
    larger = Conventions(scale=2.0)
    one = run(FLIGHT.groundtruth, [FLIGHT.estimate]).runs[0].evaluation.ate["position_m"]
    request = Request(corrections=Corrections(larger, larger))
    two = run(FLIGHT.groundtruth, [FLIGHT.estimate], request).runs[0].evaluation.ate["position_m"]
    assert one is not None
    assert two is not None
    assert two.rmse == pytest.approx(2.0 * one.rmse, rel=1e-9)
