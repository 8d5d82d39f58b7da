"""Losses of tracking in a diagnosis: which are certain, large or of the start, and their texts."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros import AssociationRule, Protocol, evaluate, simulate
from trajeval_ros.diagnosis import lost_tracking_tests
from trajeval_ros.diagnosis.findings import Finding
from trajeval_ros.diagnosis.lost_tracking_tests import (
    begins_at_start,
    is_certain,
    is_large,
    losses_in,
    lost_tracking,
)
from trajeval_ros.metrics.tracking_loss import DIVERGED, FROZEN, Loss

SECOND = 1_000_000_000
BEGIN = 1000 * SECOND


def loss_of(cause: str, begin_s: float, end_s: float, **changed: Any) -> Loss:
    begin, end = (BEGIN + round(each * SECOND) for each in (begin_s, end_s))
    usual = Loss(cause, begin, end, 4.0, 30.0, 9.0, is_error=True, is_over=False)
    return dataclasses.replace(usual, **changed)


def pairs_of(true: Any, own: Any) -> Any:
    """Return pairs along a line, one per second."""
    stamps = BEGIN + SECOND * np.arange(len(true))
    sides = (
        SimpleNamespace(
            stamps=stamps,
            positions=np.outer(each, [0.6, 0.0, -0.8]),
            duration_s=float(len(true) - 1),
        )
        for each in (true, own)
    )
    return SimpleNamespace(groundtruth=next(sides), estimate=next(sides))


@pytest.mark.parametrize("unit", [1.0, 0.001])
@pytest.mark.parametrize(
    ("before", "size", "is_over", "expected"),
    [
        (10, 3.01, False, True),
        (9, 3.01, False, False),
        (10, 2.99, False, False),
        (10, 3.01, True, False),
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
    assert is_certain(dataclasses.replace(loss, cause=FROZEN), pairs_of(true, own))


@pytest.mark.parametrize(
    ("end_s", "moved_m", "is_over", "expected"),
    [
        (30.1, 6.1, True, True),
        (30.0, 6.1, True, False),
        (11.0, 6.1, False, True),
        (30.1, 6.0, True, False),
        (11.0, 6.0, False, False),
    ],
)
def test_a_large_loss_is_long_and_moves_more_than_drift(
    end_s: float, moved_m: float, *, is_over: bool, expected: bool
) -> None:
    """A fifth of a run of 100 s, and one and a half times the 4 m of the groundtruth."""
    loss = loss_of(DIVERGED, 10.0, end_s, moved_m=moved_m, is_over=is_over)
    assert is_large(loss, pairs_of(np.zeros(101), np.zeros(101))) == expected


@pytest.mark.parametrize(("begin_s", "is_at_start"), [(0.999, True), (1.0, False)])
def test_a_loss_within_a_second_is_one_of_the_start(begin_s: float, *, is_at_start: bool) -> None:
    pairs = pairs_of(np.zeros(9), np.zeros(9))
    assert begins_at_start(loss_of(FROZEN, begin_s, 5.0), pairs) == is_at_start


def told(monkeypatch: pytest.MonkeyPatch, *losses: Loss, ate: float | None = 0.25) -> list[Any]:
    """Return the values of what is seen, with the cause, for this ATE before the loss."""
    begins: list[int] = []
    monkeypatch.setattr(
        lost_tracking_tests, "_ate_before", lambda begin, *_: begins.append(begin) or ate
    )
    pairs = pairs_of(np.zeros(200), np.zeros(200))
    examined = lost_tracking(losses, pairs, Protocol(), BEGIN - 5 * SECOND)
    assert examined.test == "lost tracking"
    assert examined.scores == {"losses": float(len(losses))}
    assert set(begins) <= {losses[0].begin_ns}
    assert all(each.explained == 1.0 for each in examined.seen)
    return [{"cause": each.cause, **each.values} for each in examined.seen]


def test_a_divergence_is_told_from_its_first_begin(monkeypatch: pytest.MonkeyPatch) -> None:
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
        "before": "; the ATE until then is 0.25 m",
        "ate_before_m": 0.25,
    }
    assert told(monkeypatch, first) == [values]
    values["number"] = " (longest of 2 times)"
    assert told(monkeypatch, first, loss_of(DIVERGED, 40.0, 90.0)) == [values]


def test_the_longest_of_frozen_poses_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    short, long = loss_of(FROZEN, 20.0, 26.5), loss_of(FROZEN, 40.0, 49.0, true_m=7.0)
    [values] = told(monkeypatch, short, long, short, ate=None)
    assert values == {
        "cause": "frozen",
        "at_s": 45.0,
        "after_s": 54.0,
        "lost_s": 9.0,
        "until": "",
        "number": " (longest of 3 times)",
        "true_m": 7.0,
        "true_deg": 30.0,
        "moved_m": 9.0,
        "before": "",
    }
    both = told(monkeypatch, short, loss_of(DIVERGED, 60.0, 99.0))
    assert [each["cause"] for each in both] == ["diverged", "frozen"]


@pytest.mark.parametrize(
    ("cause", "is_over", "name"),
    [
        (DIVERGED, True, "diverged_at_start"),
        (DIVERGED, False, "diverged_at_start"),
        (FROZEN, True, "frozen_at_start"),
        (FROZEN, False, "frozen"),
    ],
)
def test_a_loss_of_the_start_has_no_ate_before_it(
    cause: str, name: str, monkeypatch: pytest.MonkeyPatch, *, is_over: bool
) -> None:
    """An estimate that is frozen from the start to the end has no part after it."""
    [values] = told(monkeypatch, loss_of(cause, 0.5, 12.0, is_over=is_over))
    assert values["cause"] == name
    assert ("ate_before_m" in values) == (name == "frozen")


@pytest.mark.parametrize("rows", [9, 10, 60])
def test_the_ate_before_a_loss_is_of_the_pairs_until_it(rows: int) -> None:
    truth = simulate(seed=4, duration_s=30.0).groundtruth[::50]
    noise = np.random.default_rng(1).normal(scale=0.3, size=truth.positions.shape)
    estimate = dataclasses.replace(truth, positions=truth.positions + noise)
    protocol = Protocol(gauge="yaw", lengths=("5m",))
    pairs = evaluate(truth, estimate, protocol).association
    begin_ns = int(pairs.estimate.stamps[rows - 1])
    loss = dataclasses.replace(loss_of(DIVERGED, 0.0, 0.0), begin_ns=begin_ns, end_ns=2 * begin_ns)
    [seen] = lost_tracking([loss], pairs, protocol, int(truth.stamps[0])).seen
    assert seen.values["at_s"] == pytest.approx((begin_ns - truth.stamps[0]) / SECOND)
    assert seen.cause == "diverged"
    if rows < 10:
        assert "ate_before_m" not in seen.values
        return
    part = evaluate(truth[:rows], estimate[:rows], Protocol(gauge="yaw", lengths=()))
    assert len(part.association) == rows
    assert seen.values["ate_before_m"] == pytest.approx(part.ate["position_m"].rmse, rel=1e-9)
    assert "; the ATE until then is " in Finding.of(seen).sentence


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
        assert [each.cause for each in losses_in(pairs)] == causes
