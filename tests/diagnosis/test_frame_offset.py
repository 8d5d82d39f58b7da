"""Frames that are apart: offsets that explain the error of an evaluation without alignment."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros.diagnosis.evaluation_tests import (
    frame_offset,
)
from trajeval_ros.diagnosis.findings import TestResult
from trajeval_ros.geometry.gauge import Gauge


def offset_of(
    mean: Any, share: float = 1.0, count: int = 40, gauge: Gauge = Gauge.NONE, axis: int = 2
) -> TestResult:
    """Return the test of errors of which the mean explains a share of the squares."""
    mean = np.asarray(mean, dtype=float)
    noise = np.zeros((count, 3))
    noise[:, 0] = (-1.0) ** np.arange(count)
    if count % 2:
        noise[-1] = 0.0
    noise *= np.sqrt((mean @ mean) * (1.0 / share - 1.0) / np.mean(noise[:, 0] ** 2))
    truth = np.random.default_rng(1).normal(size=(count, 3))
    evaluation: Any = SimpleNamespace(
        protocol=SimpleNamespace(gauge=gauge),
        association=SimpleNamespace(groundtruth=SimpleNamespace(positions=truth)),
        aligned=SimpleNamespace(positions=truth - mean - noise),
        groundtruth=SimpleNamespace(up=SimpleNamespace(matrix=np.roll(np.eye(3), 2 - axis, 0))),
    )
    return frame_offset(evaluation)


@pytest.mark.parametrize(
    ("length", "share", "count", "is_seen"),
    [
        (2.0, 0.995, 40, True),
        (0.1, 0.995, 40, False),
        (2.0, 0.8, 40, False),
        (2.0, 0.995, 5, False),
    ],
)
def test_an_offset_explains_nearly_all_of_the_error(
    length: float, share: float, count: int, *, is_seen: bool
) -> None:
    mean = length * np.array([0.48, 0.64, -0.6])
    result = offset_of(mean, share, count)
    assert result.scores == pytest.approx({"offset_m": length, "share": share})
    assert [item.cause for item in result.seen] == ["frames_apart"] * is_seen
    for seen in result.seen:
        values = dict(seen.values)
        assert values.pop("offset") == ", ".join(f"{item:.2f}" for item in mean)
        assert values.pop("kind") == ""
        assert values == pytest.approx({"offset_m": length, "percent": 100.0 * share})
    assert not offset_of(mean, share, count, Gauge.YAW).scores
    assert offset_of(np.zeros(3), 1.0).scores == {"offset_m": 0.0, "share": 0.0}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [1, 2])
@pytest.mark.parametrize(
    ("level", "height", "is_geoid"),
    [
        (0.0, 45.0, True),
        (0.0, 2.0, False),
        (0.0, 400.0, False),
        (0.1, 45.0, True),
        (20.0, 45.0, False),
    ],
)
def test_a_vertical_offset_may_be_of_the_geoid(
    level: float, height: float, sign: float, axis: int, *, is_geoid: bool
) -> None:
    mean = np.zeros(3)
    mean[axis], mean[0] = sign * height, -level
    [seen] = offset_of(mean, axis=axis).seen
    kind = ": probably heights above the ellipsoid and above the geoid"
    assert seen.values["kind"] == (kind if is_geoid else "")
