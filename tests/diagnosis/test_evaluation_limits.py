"""Tests of a finished evaluation: offsets, delays and covariances of exactly known errors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros.diagnosis.evaluation_tests import (
    covariance_blocks,
    few_pairs,
    frame_offset,
)
from trajeval_ros.diagnosis.findings import TestResult
from trajeval_ros.geometry.gauge import Gauge

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("gauge", "states", "enough"),
    [(Gauge.SE3, None, 6), (Gauge.YAW, None, 4), (Gauge.NONE, None, 2), (Gauge.SE3, 1, 2)],
)
def test_twice_the_states_of_an_alignment_are_enough_pairs(
    gauge: Gauge, states: int | None, enough: int
) -> None:
    protocol: Any = SimpleNamespace(
        gauge=gauge, align_states=states, enough_pairs=gauge.enough_pairs
    )
    few: Any = range(enough - 1)
    noun = "pair" if enough == 2 else "pairs"
    assert few_pairs(protocol, few) == f"{enough - 1} {noun}, too few for an ATE"
    enough_pairs: Any = range(enough)
    assert few_pairs(protocol, enough_pairs) == ""


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
        (0.501, 0.981, 12, True),
        (0.499, 0.981, 12, False),
        (0.501, 0.979, 12, False),
        (0.501, 0.981, 11, False),
    ],
)
def test_an_offset_explains_nearly_all_of_the_error(
    length: float, share: float, count: int, *, is_seen: bool
) -> None:
    mean = length * np.array([0.48, 0.64, -0.6])
    found = offset_of(mean, share, count)
    assert found.scores == pytest.approx({"offset_m": length, "share": share})
    assert [item.cause for item in found.seen] == ["frames_apart"] * is_seen
    for seen in found.seen:
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
        (0.0, 5.1, True),
        (0.0, 4.9, False),
        (0.0, 109.0, True),
        (0.0, 111.0, False),
        (0.99, 10.0, True),
        (1.01, 10.0, False),
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


def blocks_of(
    position: float, rotation: float, errors: tuple[float, float] = (1.0, 0.1), **changed: Any
) -> TestResult:
    """Return the test of standard deviations (all axes), of 1 m and 0.1 rad of errors."""
    count = changed.get("count", 60)
    vary = 1.0 + 1e-9 * np.arange(count)
    sigmas = np.repeat([position, rotation], 3) / np.sqrt(3.0)
    covariances = vary[:, None, None] * np.diag(sigmas**2)
    for row in range(changed.get("unusable", 0)):
        covariances[row, row % 6, row % 6] = (np.nan, 0.0)[row % 2]

    class Pairs(SimpleNamespace):
        def __len__(self) -> int:
            return count

    evaluation: Any = SimpleNamespace(
        association=Pairs(estimate=SimpleNamespace(covariances=covariances)),
        absolute=SimpleNamespace(
            position_m=np.full(count, errors[0]),
            rotation_deg=np.degrees(np.full(count, errors[1])),
        ),
    )
    return covariance_blocks(evaluation)


@pytest.mark.parametrize(
    ("apart", "first", "second", "is_exchanged"),
    [
        (0.51, 0.0, 0.0, True),
        (0.49, 0.0, 0.0, False),
        (1.0, 0.24, 0.0, True),
        (1.0, 0.0, 0.26, False),
        (1.0, 0.49, 0.4, True),
        (1.0, 0.51, 0.4, False),
        (1.0, -0.49, -0.4, True),
        (1.0, -0.4, -0.51, False),
    ],
)
def test_exchanged_blocks_fit_both_errors(
    apart: float, first: float, second: float, *, is_exchanged: bool
) -> None:
    """Decimal logarithms: of the errors' ratio, and of both ratios after the exchange."""
    errors = 10.0**apart, 1.0
    found = blocks_of(errors[1] / 10.0**second, errors[0] / 10.0**first, errors)
    as_read = 10.0 ** (apart + second), 10.0 ** (first - apart)
    exchanged = 10.0**first, 10.0**second
    assert found.scores == pytest.approx(
        {
            "position": as_read[0],
            "rotation": as_read[1],
            "position_if_exchanged": exchanged[0],
            "rotation_if_exchanged": exchanged[1],
        }
    )
    assert [item.cause for item in found.seen] == ["covariance_order"] * is_exchanged
    for seen in found.seen:
        assert dict(seen.values) == pytest.approx(
            {
                "as_read": as_read[0],
                "as_read_rotation": as_read[1],
                "exchanged": exchanged[0],
                "exchanged_rotation": exchanged[1],
            }
        )


@pytest.mark.parametrize(
    ("position", "rotation", "is_degrees"),
    [
        (0.24, 0.0, True),
        (-0.24, 0.0, True),
        (0.26, 0.0, False),
        (-0.26, 0.0, False),
        (0.0, 0.24, True),
        (0.0, 0.26, False),
        (0.0, -0.24, True),
        (0.0, -0.26, False),
    ],
)
def test_degrees_are_57_times_the_errors(
    position: float, rotation: float, *, is_degrees: bool
) -> None:
    """Up to decimal logarithms of 0.25."""
    times = 10.0**-rotation * 180.0 / np.pi
    found = blocks_of(10.0**-position, 0.1 * times)
    assert [item.cause for item in found.seen] == ["covariance_degrees"] * is_degrees
    for seen in found.seen:
        assert seen.values == pytest.approx({"times": times})


def test_fifty_covariances_are_needed() -> None:
    degrees = 0.1 * 180.0 / np.pi
    assert blocks_of(1.0, degrees, count=50).seen
    assert blocks_of(1.0, degrees, count=49).why_not == "no covariances in use, or too few pairs"
    assert blocks_of(1.0, degrees, unusable=10).seen
    assert blocks_of(1.0, degrees, unusable=11).why_not == "the covariances are not positive"
    assert blocks_of(1.0, 0.1, (0.0, 0.1)).why_not == "the errors are zero"
    assert blocks_of(1.0, 0.1).scores == pytest.approx(
        {
            "position": 1.0,
            "rotation": 1.0,
            "position_if_exchanged": 10.0,
            "rotation_if_exchanged": 0.1,
        }
    )
