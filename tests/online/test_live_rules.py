"""Rules of the live evaluation: open starts, levers and snapshots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feeding import make_pair, rows_of
from numpy.typing import NDArray
from state_rows import states, trajectory
from strategies import make_groundtruth, seeds

from trajeval_ros import Gauge, Protocol
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_frames import LiveFrames
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.online.window import PairStore

Array = NDArray[Any]


def source_rows(seed: int) -> tuple[Trajectory, Array]:
    source = make_groundtruth(seed, 15)
    rows = states(source.positions, source.quaternions, source.velocities)
    rows[4, 3:7] = np.nan
    return source, rows


def test_a_lever_arm_makes_the_groundtruth_points_and_leaves_out_velocities() -> None:
    source, _ = source_rows(1)
    with_arm = LiveFrames(OnlineSettings(Protocol(gauge="se3", lever_m=(0.1, 0.0, 0.0))))
    plain = LiveFrames(OnlineSettings(Protocol(gauge="se3")))
    assert plain.of_groundtruth(source) is source
    points = with_arm.of_groundtruth(source)
    assert points.quaternions is points.velocities is None
    assert plain.of_estimate(points) is points
    with pytest.raises(InputError, match="no lever arm can be applied"):
        with_arm.of_estimate(points)
    assert with_arm.of_estimate(source) is source


def all_pairs(pairing: Pairing, sides: list[tuple[Array, Array]], cut: int, size: int) -> Any:
    """Return the pairs of two streams; a second pairing takes over at a batch."""
    result, batches = [], range(0, len(sides[0][0]), size)
    for begin in batches:
        if begin // size == cut:
            border, at_groundtruth = pairing.unused_from, pairing.at_groundtruth
            pairing = Pairing(pairing.rule)
            for row, (add, (stamps, rows)) in enumerate(zip(adds_of(pairing), sides, strict=True)):
                known, first = stamps[:begin], border
                if row == at_groundtruth:  # interpolated: the state before the border, too
                    first = known[known <= border].max(initial=NEVER)
                part = known >= first
                add(trajectory(known[part], rows[:begin][part]))
        for add, (stamps, rows) in zip(adds_of(pairing), sides, strict=True):
            add(trajectory(stamps[begin : begin + size], rows[begin : begin + size]))
        result.append(pairing.made())
        pairing.forget()
    result.append(pairing.made(at_end=True))
    store = PairStore()
    for pairs in result:
        if pairs is not None:
            store.add(pairs)
    return store.pairs(slice(None)), sum(0 if pairs is None else len(pairs) for pairs in result)


def adds_of(pairing: Pairing) -> tuple[Any, Any]:
    return pairing.add_groundtruth, pairing.add_estimate


@pytest.mark.slow
@settings(max_examples=20)
@given(
    seed=seeds,
    cut=st.integers(1, 12),
    size=st.integers(3, 12),
    delay=st.integers(0, 30),
    at_groundtruth=st.booleans(),
)
def test_a_run_that_follows_begins_at_the_first_state_that_was_not_used(
    seed: int, cut: int, size: int, delay: int, *, at_groundtruth: bool
) -> None:
    """Both runs together make the pairs of one, none twice."""
    groundtruth, estimate = make_pair(seed, 100)
    count = min(len(groundtruth), len(estimate)) - delay
    sides = [
        (groundtruth.stamps[delay : delay + count], rows_of(groundtruth)[delay : delay + count]),
        (estimate.stamps[:count], rows_of(estimate)[:count]),
    ]
    rule = AssociationRule("groundtruth-stamps" if at_groundtruth else "linear")
    whole, _ = all_pairs(Pairing(rule), sides, -1, size)
    parts, made = all_pairs(Pairing(rule), sides, cut, size)
    np.testing.assert_array_equal(parts.stamps, whole.stamps)
    assert made == len(whole)
    for name in ("groundtruth", "estimate"):
        result, expected = (rows_of(getattr(pairs, name)) for pairs in (parts, whole))
        np.testing.assert_allclose(result, expected, atol=1e-12)


def test_a_snapshot_needs_the_alignment_of_enough_states() -> None:
    groundtruth, estimate = make_pair(3, 60)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.SE3)))
    assert evaluator.snapshot().warming_up == "no pairs yet"
    evaluator.add_groundtruth(trajectory(groundtruth.stamps, rows_of(groundtruth)))
    seen = []
    for row in range(5):
        part = slice(row, row + 1)
        evaluator.add_estimate(trajectory(estimate.stamps[part], rows_of(estimate)[part]))
        evaluator.update()
        seen.append((evaluator.pairs, evaluator.snapshot().warming_up))
    selected = Gauge.SE3.minimum_states
    for pairs, text in seen:
        if 0 < pairs < selected:
            assert text == f"{pairs} of {selected} states for the alignment"
    assert max(pairs for pairs, _ in seen) >= selected
