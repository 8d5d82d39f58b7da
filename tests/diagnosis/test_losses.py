"""Losses of tracking in a diagnosis: which are certain, large or of the start, and their texts."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros import AssociationRule, Protocol, evaluate, simulate
from trajeval_ros.diagnosis.lost_tracking_tests import (
    begins_at_start,
    is_certain,
    is_large,
    losses_in,
    lost_tracking,
)
from trajeval_ros.metrics.discontinuities.events import DIVERGED, ESTIMATE, FROZEN, Loss

SECOND = 1_000_000_000
BEGIN = 1000 * SECOND


def loss_of(cause: str, begin_s: float, end_s: float, **changed: Any) -> Loss:
    begin, end = (BEGIN + round(item * SECOND) for item in (begin_s, end_s))
    usual = Loss(cause, ESTIMATE, begin, end, m=4.0, deg=30.0, s=end_s - begin_s, moved_m=9.0)
    return dataclasses.replace(usual, **changed)


def pairs_of(true: Any, own: Any) -> Any:
    """Return pairs along a line, one per second."""
    stamps = BEGIN + SECOND * np.arange(len(true))
    sides = (
        SimpleNamespace(
            stamps=stamps,
            positions=np.outer(item, [0.6, 0.0, -0.8]),
            duration_s=float(len(true) - 1),
        )
        for item in (true, own)
    )
    return SimpleNamespace(groundtruth=next(sides), estimate=next(sides))


@pytest.mark.parametrize("unit", [1.0, 0.001])
@pytest.mark.parametrize(
    ("before", "size", "is_over", "expected"),
    [
        (12, 3.01, False, True),
        (11, 3.01, False, False),
        (12, 2.99, False, False),
        (12, 3.01, True, False),
    ],
)
def test_a_divergence_over_three_times_the_whole_path_is_certain(
    before: int, size: float, unit: float, *, is_over: bool, expected: bool
) -> None:
    """From pairs before the loss, of both, the unit of the estimate is known."""
    true = np.arange(before + 11.0)
    own = true.copy()
    # The first pair of the loss, and the last one, which is not the last pair of the run.
    own[before : before + 9], own[before + 9] = 50.0, 50.0 + size * true[-1]
    own[before + 10] = 1e4
    loss = loss_of(DIVERGED, before - 1, before + 9, is_over=is_over)
    assert is_certain(loss, pairs_of(true, own / unit)) == expected
    assert is_certain(dataclasses.replace(loss, kind=FROZEN), pairs_of(true, own))


@pytest.mark.parametrize(
    ("end_s", "moved_m", "is_over", "expected"),
    [
        (30.1, 6.1, True, True),
        (30.1, 1.3, True, True),
        (30.0, 6.1, True, False),
        (30.1, 6.0, True, False),
        (30.1, 1.4, True, False),
        (11.0, 6.1, False, True),
        (11.0, 6.0, False, False),
    ],
)
def test_a_large_loss_lasts_or_is_long_and_moves_unlike_drift(
    end_s: float, moved_m: float, *, is_over: bool, expected: bool
) -> None:
    """A fifth of a run of 100 s, and one and a half times the 4 m of the groundtruth, or less."""
    loss = loss_of(DIVERGED, 10.0, end_s, moved_m=moved_m, is_over=is_over)
    assert is_large(loss, pairs_of(np.zeros(101), np.zeros(101))) == expected


@pytest.mark.parametrize(("begin_s", "is_at_start"), [(0.999, True), (1.0, False)])
def test_a_loss_within_a_second_is_one_of_the_start(begin_s: float, *, is_at_start: bool) -> None:
    pairs = pairs_of(np.zeros(9), np.zeros(9))
    assert begins_at_start(loss_of(FROZEN, begin_s, 5.0), pairs) == is_at_start


def told(*losses: Loss) -> list[Any]:
    """Return the values of what is seen, with the cause."""
    pairs = pairs_of(np.zeros(200), np.zeros(200))
    examined = lost_tracking(losses, pairs, BEGIN - 5 * SECOND)
    assert examined.test == "lost tracking"
    assert examined.scores == {"losses": float(len(losses))}
    return [{"cause": item.cause, **item.values} for item in examined.seen]


def test_a_divergence_is_told_from_its_first_begin() -> None:
    first = loss_of(DIVERGED, 20.0, 26.5, is_over=True)
    values = {
        "cause": "diverged",
        "at_s": 25.0,
        "after_s": 31.5,
        "lost_s": 6.5,
        "until": " for 6.5 s",
        "number": "",
        "true_m": 4.0,
        "true_deg": 30.0,
        "moved_m": 9.0,
    }
    assert told(first) == [values]
    assert told(first, loss_of(DIVERGED, 40.0, 90.0)) == [values]


def test_the_longest_of_frozen_poses_is_told() -> None:
    short, long = loss_of(FROZEN, 20.0, 26.5), loss_of(FROZEN, 40.0, 49.0, m=7.0)
    [values] = told(short, long, short)
    assert values == {
        "cause": "frozen",
        "at_s": 45.0,
        "after_s": 54.0,
        "lost_s": 9.0,
        "until": " (longest of 3 times)",
        "number": " (longest of 3 times)",
        "true_m": 7.0,
        "true_deg": 30.0,
        "moved_m": 9.0,
    }
    both = told(short, loss_of(DIVERGED, 60.0, 99.0))
    assert [item["cause"] for item in both] == ["diverged", "frozen"]


@pytest.mark.parametrize(
    ("cause", "is_over", "name"),
    [
        (DIVERGED, True, "diverged_at_start"),
        (DIVERGED, False, "diverged_at_start"),
        (FROZEN, True, "frozen_at_start"),
        (FROZEN, False, "frozen"),
    ],
)
def test_a_loss_of_the_start_has_another_name(cause: str, name: str, *, is_over: bool) -> None:
    """An estimate that is frozen from the start to the end has no part after it."""
    [values] = told(loss_of(cause, 0.5, 12.0, is_over=is_over))
    assert values["cause"] == name


def test_pairs_by_row_have_no_losses() -> None:
    """They have no times in which an estimate could be frozen."""
    truth = simulate(seed=4, duration_s=30.0).groundtruth[::20]
    positions = truth.positions.copy()
    positions[40:] = positions[40]
    assert truth.quaternions is not None
    quaternions = truth.quaternions.copy()
    quaternions[40:] = quaternions[40]
    estimate = dataclasses.replace(truth, positions=positions, quaternions=quaternions)
    for method, causes in (("nearest", [FROZEN]), ("index", [])):
        protocol = Protocol(association=AssociationRule(method), lengths=())
        pairs = evaluate(truth, estimate, protocol).association
        assert [loss.kind for loss in losses_in(pairs)] == causes
