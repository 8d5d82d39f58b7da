"""As-available errors of a live estimate: equal to those of a recording, in bounded memory."""

from __future__ import annotations

import numpy as np
import pytest

from tests.metrics.test_as_available import IDENTITY, rough
from trajeval_ros.metrics.as_available import AvailabilityRule, as_available
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_availability import LiveAvailability


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["hold", "constant"])
@pytest.mark.parametrize("every", [1, 7, 40])
def test_live_errors_equal_recorded_ones(motion: str, every: int) -> None:
    truth, estimate = rough(3)
    rule = AvailabilityRule(motion)
    expected = as_available(truth, estimate, IDENTITY, rule, 0.5)
    assert expected.samples is not None
    assert expected.messages is not None
    assert expected.messages.late > 0.05 * len(estimate)
    receptions = estimate.reading.receptions
    assert receptions is not None
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    live, found = LiveAvailability(rule, 0.5, 10.0), []
    # Everything in the order of its reception; groundtruth arrives 3 ms after its timestamp.
    events = [(int(at) + 3_000_000, 0, row) for row, at in enumerate(truth.stamps)]
    events += [(int(at), 1, row) for row, at in enumerate(receptions.times)]
    truth_rows = np.hstack([truth.positions, truth.quaternions])
    rows = np.hstack([estimate.positions, estimate.quaternions])
    most = 0
    for number, (_, kind, row) in enumerate(sorted(events)):
        part = slice(row, row + 1)
        if kind:
            live.add_estimate(estimate.stamps[part], receptions.times[part], rows[part])
        else:
            live.add_groundtruth(truth.stamps[part], truth_rows[part])
        if number % every == 0 and (samples := live.update(IDENTITY)) is not None:
            found.append(samples)
            assert set(live.numbers) >= {"available/age", "available/latency"}
        most = max(most, sum(len(each[0]) for each in live._messages))
    stamps = np.concatenate([each.stamps for each in found])
    rows_of = expected.samples.stamps.searchsorted(stamps)
    assert len(stamps) > 0.95 * len(expected.samples.stamps)
    np.testing.assert_array_equal(expected.samples.stamps[rows_of], stamps)
    for name in ("ages", "position", "rotation"):
        parts = np.concatenate([getattr(each, name) for each in found], axis=1)
        wanted = getattr(expected.samples, name)[:, rows_of]
        np.testing.assert_allclose(parts, wanted, atol=1e-12, err_msg=name)
    assert most < 100
    missed = expected.numbers.missed_deadlines
    assert missed is not None
    assert abs(live.missed - missed.count) <= 1
    assert live.age_p95_s is not None


def test_nothing_is_reported_from_impossible_clocks_or_unknown_receptions() -> None:
    truth, estimate = rough(4)
    assert truth.quaternions is not None
    assert estimate.quaternions is not None
    rows = np.hstack([estimate.positions, estimate.quaternions])
    for times, verdict in (
        (estimate.stamps - 50_000_000, "impossible"),
        (np.full(len(estimate), UNKNOWN), None),
    ):
        live = LiveAvailability(AvailabilityRule("hold"), 0.5, 10.0)
        live.add_groundtruth(truth.stamps, np.hstack([truth.positions, truth.quaternions]))
        live.add_estimate(estimate.stamps, times, rows)
        assert live.update(IDENTITY) is None
        assert live.numbers == {}
        assert live.values["reception clock"] == verdict
