"""The limits of a divergence, on displacements whose difference from the groundtruth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.metrics.divergence import Divergence
from trajeval_ros.metrics.tracking_loss import DIVERGED, Loss

STEP_S, BEFORE = 0.5, 80  # of the displacements that are compared, and how many agree at first
HALF = round(STEP_S * 1e9)
BEGIN = 3 * 10**9
# Between the frames: a displacement in the estimate's frame is R^T d / s.
TURN, SCALE = Rotation.from_rotvec([0.4, -1.0, 0.3]), 2.5


def _paths(speed_mps: float, odd: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return a curve, and an estimate of it whose last displacements differ.

    `odd` holds, for each of the last displacements, what is added along and across, metres.
    """
    angles = 0.3 * np.arange(BEFORE + len(odd))
    along = np.column_stack([np.cos(angles), np.sin(angles), 0.3 * np.cos(2.0 * angles)])
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = np.cross(along, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across, axis=1)[:, None]
    added = np.vstack([np.zeros((BEFORE, 2)), np.reshape(odd, (-1, 2))])
    true = speed_mps * STEP_S * along
    own = TURN.inv().apply(true + added[:, :1] * along + added[:, 1:] * across) / SCALE
    return tuple(np.vstack([np.zeros(3), np.cumsum(item, axis=0)]) for item in (true, own))


def _by_excess(speed_mps: float, excess: float, of_lengths: float) -> tuple[float, float]:
    """Return what to add along and across, so that differences exceed what is explained.

    Explained are 0.3 of the distance and 0.1 m/s; above 2 m/s all is in proportion to the speed.
    """
    true_m, unit = speed_mps * STEP_S, max(1.0, speed_mps / 2.0)
    explained_m = 0.3 * true_m + 0.1 * STEP_S
    apart_m, longer_m = explained_m + unit * excess, explained_m + unit * of_lengths
    # |own|^2 = (t + l)^2 = (t + a)^2 + b^2 and apart^2 = a^2 + b^2.
    a = ((true_m + longer_m) ** 2 - true_m**2 - apart_m**2) / (2.0 * true_m)
    return a, math.sqrt(apart_m**2 - a**2)


def _losses(true: np.ndarray, own: np.ndarray) -> list[list[Loss]]:
    """Return the losses after each of the displacements, which come one by one."""
    divergence, after = Divergence(), []
    for row in range(len(true)):
        stamps = np.array([BEGIN + row * HALF])
        divergence.add(stamps, true[row : row + 1], own[row : row + 1])
        after.append(list(divergence.losses))
        summing = divergence._sum_m > 0.0
        is_lost = bool(after[-1]) and not after[-1][-1].is_over
        assert divergence.is_clear == (not summing and not is_lost)
    return after[1:]


def _first(after: list[list[Loss]], attribute: str = "cause") -> int | None:
    """Return after how many odd displacements there is a loss, or it has an attribute."""
    found = [row for row, losses in enumerate(after) if losses and getattr(losses[-1], attribute)]
    return found[0] + 1 - BEFORE if found else None


@pytest.mark.parametrize("speed_mps", [1.0, 2.0, 9.0])
@pytest.mark.parametrize(
    ("excess", "of_lengths", "odd"),
    [
        (0.13, 0.12, 4),  # 0.52 m is a warning, 0.39 m after three is none
        (0.16, 0.15, 4),
        (0.30, 0.11, 4),  # of lengths, the smallest of three in a row: 0.22 m after four
        (0.30, 0.21, 3),
        (0.90, 0.21, 3),  # at most 0.4 m count of one displacement
    ],
)
def test_a_divergence_begins_at_half_a_metre(
    speed_mps: float, excess: float, of_lengths: float, odd: int
) -> None:
    true, own = _paths(speed_mps, [_by_excess(speed_mps, excess, of_lengths)] * 5)
    after = _losses(true, own)
    assert _first(after) == odd
    [loss] = after[BEFORE + odd - 1]
    step_m = speed_mps * STEP_S
    assert (loss.cause, loss.begin_ns) == (DIVERGED, BEGIN + BEFORE * HALF)
    assert loss.end_ns == BEGIN + (BEFORE + odd) * HALF
    assert loss.true_m == pytest.approx(odd * step_m)
    longer_m = 0.3 * step_m + 0.1 * STEP_S + max(1.0, speed_mps / 2.0) * of_lengths
    assert loss.moved_m == pytest.approx(odd * (step_m + longer_m), rel=1e-6)
    assert not loss.is_over
    assert not loss.true_deg


@pytest.mark.parametrize(
    ("excess", "of_lengths", "odd"),
    [(0.13, 0.12, 8), (0.15, 0.14, 7), (0.35, 0.11, 6), (0.35, 0.15, 5), (0.9, 0.85, 3)],
)
def test_it_is_an_error_at_a_metre_and_of_lengths_at_less(
    excess: float, of_lengths: float, odd: int
) -> None:
    """0.13 n and 0.15 n reach 1 m; of lengths 0.11 (n - 2) and 0.15 (n - 2) reach 0.4 m."""
    true, own = _paths(1.0, [_by_excess(1.0, excess, of_lengths)] * 9)
    assert _first(_losses(true, own), "is_error") == odd


@pytest.mark.parametrize(
    ("step_m", "agreeing"),
    [(0.5, 6), (0.09, 6), (0.07, 8)],  # six in a row, and half a metre
)
def test_it_ends_after_six_displacements_that_agree(step_m: float, agreeing: int) -> None:
    odd = [_by_excess(1.0, 0.2, 0.18)] * 6
    true, own = _paths(1.0, [*odd, *[(0.0, 0.0)] * 12])
    steps = np.diff(true, axis=0), np.diff(own, axis=0)
    for step in steps:
        step[BEFORE + len(odd) :] *= step_m / 0.5
    true, own = (np.vstack([np.zeros(3), np.cumsum(step, axis=0)]) for step in steps)
    after = _losses(true, own)
    assert _first(after, "is_over") == len(odd) + agreeing
    assert after[-1][0].end_ns == BEGIN + (BEFORE + len(odd) + agreeing) * HALF


@pytest.mark.parametrize(
    "odd",
    [
        [(40.0, 0.0)],  # a jump
        [(40.0, 0.0), (-40.0, 0.0)],  # an outlier
        [_by_excess(1.0, -0.01, -0.02)] * 40,  # drift
        [(-0.5, 0.5)] * 30,  # a quarter of a turn, at the same speed
    ],
    ids=["jump", "outlier", "drift", "directions"],
)
def test_jumps_outliers_and_drift_are_no_divergence(odd: list[tuple[float, float]]) -> None:
    after = _losses(*_paths(1.0, odd))
    assert not after[-1]


def test_a_hover_does_not_make_the_fit_forget() -> None:
    """Only motion is forgotten by time: 200 s of 0.04 m/s leave what 40 m have shown."""
    true, own = _paths(1.0, [_by_excess(1.0, 0.13, 0.12)] * 5)
    steps, odd = [np.diff(item, axis=0) for item in (true, own)], 5
    hovers = [np.vstack([step[:-odd], np.tile(0.04 * step[:1], (400, 1))]) for step in steps]
    paths = [
        np.vstack([np.zeros(3), np.cumsum(np.vstack([hover, step[-odd:]]), axis=0)])
        for hover, step in zip(hovers, steps, strict=True)
    ]
    assert _first(_losses(*paths)) == 400 + 4
