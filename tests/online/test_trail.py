"""The trail: bounded, a subsequence of the run, evenly spread, and up to the newest pair."""

from __future__ import annotations

from unittest import mock

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online import whole_run
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.whole_run import ThinnedRun


def numbered(first: int, count: int) -> PairedStates:
    """Return pairs whose columns all are their numbers."""
    stamps = np.arange(first, first + count, dtype=np.int64)
    rows = np.repeat(stamps[:, None].astype(float), 3, axis=1)
    return PairedStates(Trajectory(stamps, rows), Trajectory(stamps, -rows))


@given(most=st.integers(2, 40), batches=st.lists(st.integers(0, 120), max_size=30))
def test_a_trail_is_every_kth_pair_and_the_newest(most: int, batches: list[int]) -> None:
    assert whole_run.MOST_POSES == 2000
    with mock.patch.object(whole_run, "MOST_POSES", most):
        check(ThinnedRun(), most, batches)


def check(trail: ThinnedRun, most: int, batches: list[int]) -> None:
    first = 0
    for count in batches:
        trail.add(numbered(first, count))
        first += count
        pairs = trail.pairs()
        stamps, groundtruth = pairs.stamps, pairs.groundtruth.positions
        estimate = pairs.estimate.positions
        assert len(trail) <= most
        assert len(stamps) == len(groundtruth) == len(estimate) <= most + 1
        np.testing.assert_array_equal(groundtruth[:, 0], stamps)
        np.testing.assert_array_equal(estimate, -groundtruth)
        if not first:
            assert not len(stamps)
            continue
        assert stamps[-1] == first - 1
        assert (np.diff(stamps) > 0).all()
        steps = np.diff(stamps[: len(trail)])
        assert stamps[0] == 0
        assert len(set(steps.tolist())) <= 1
        assert len(trail) >= min(first, most // 2)
