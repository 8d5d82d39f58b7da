"""Parts of the tests of clocks: rates of motion, outliers, slopes, limits of offset and rate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trajeval_ros.diagnosis.clock_tests import (
    ClockMatch,
    MotionRates,
    _RateFit,
    _slope,
    clock_offset,
    clock_rate,
    match_clocks,
    offsets_of_parts,
    other_rate,
    tamed,
)

from trajeval_ros.diagnosis import clock_tests
from trajeval_ros.diagnosis.findings import Examined
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.geometry.arrays import Floats


@pytest.mark.parametrize("oriented", [True, False])
def test_rates_are_speeds_over_the_window(*, oriented: bool) -> None:
    """Along x with 0.5 m/s, and about an axis with 0.3 rad/s; and quaternions of either sign."""
    seconds = 3.0 + np.arange(0.0, 10.0, 0.1)
    turned = Rotation.from_rotvec(np.outer(0.3 * seconds, [0.6, 0.0, -0.8])).as_quat()
    turned *= (-1.0) ** np.arange(len(seconds))[:, None]
    poses = TimedPoses(
        seconds, np.outer(0.5 * seconds, [1.0, 0.0, 0.0]), turned if oriented else None
    )
    found = MotionRates.of(poses, 0.05, 0.4, 2.0)
    assert found.start == 20
    assert len(found.known) == int(9.9 / 0.05)
    assert found.rates.shape == (1 + oriented, len(found.known))
    # Four cells before and after have poses.
    assert found.known.tolist() == [0.0] * 4 + [1.0] * (len(found.known) - 7) + [0.0] * 3
    inside = found.known > 0.0
    np.testing.assert_allclose(found.rates[0, inside], 0.5, rtol=1e-9)
    if oriented:
        np.testing.assert_allclose(found.rates[1, inside], 0.3, rtol=1e-6)


@pytest.mark.parametrize(("missing", "is_known"), [(3, True), (4, False)])
def test_rates_are_known_across_four_steps(missing: int, *, is_known: bool) -> None:
    seconds = 0.125 * np.arange(80)
    kept = np.delete(seconds, np.arange(50, 50 + missing))
    found = MotionRates.of(TimedPoses(kept, np.outer(kept, np.ones(3))), 0.05, 0.4, 0.0)
    assert bool(found.known[125:129].all()) == is_known


def test_tamed_rates_have_no_outliers_mean_zero_and_deviation_one() -> None:
    generator = np.random.default_rng(3)
    rate = generator.exponential(size=(3, 200))
    rate[:, [5, 70]] = 1e3
    known = np.ones((3, 200))
    known[1, 20:90] = 0.0
    known[2] = 0.0
    found = tamed(rate, known)
    for row in range(2):
        here = known[row] > 0.0
        clipped = np.minimum(rate[row, here], np.quantile(rate[row, here], 0.98))
        expected = (clipped - clipped.mean()) / clipped.std()
        np.testing.assert_allclose(found[row, here], expected, rtol=1e-9)
        assert not found[row, ~here].any()
    assert not found[2].any()
    assert not tamed(np.full(9, 2.0), np.ones(9)).any()


def test_slopes_are_medians() -> None:
    times = np.array([0.0, 1.0, 3.0, 4.0, 8.0])
    assert _slope(times, 2.0 * times + 5.0) == pytest.approx(2.0)
    offsets = np.array([0.0, 2.0, 5.0, 80.0, 17.0])
    pairs = [
        (offsets[j] - offsets[i]) / (times[j] - times[i])
        for i in range(5)
        for j in range(i + 1, 5)
    ]
    assert _slope(times, offsets) == pytest.approx(np.median(pairs))


def wandering(seed: int = 0, span_s: float = 60.0, step_s: float = 0.05) -> TimedPoses:
    """Return a body with irregular speed and angular speed."""
    generator = np.random.default_rng(seed)
    seconds = np.arange(0.0, span_s, step_s)
    rates = [
        1.5
        + np.interp(
            seconds, np.arange(0.0, span_s + 1.0), generator.uniform(-1.4, 1.4, int(span_s) + 1)
        )
        for _ in range(2)
    ]
    along, angle = (np.cumsum(each) * step_s for each in rates)
    turned = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0])).as_quat()
    return TimedPoses(seconds, np.outer(along, [0.6, 0.8, 0.0]), turned)


@pytest.mark.parametrize("offset_s", [0.0, 2.5, -7.13])
def test_an_offset_of_clocks_is_found_(offset_s: float) -> None:
    true = wandering()
    own = true[100:1000].shifted(-offset_s)
    match = match_clocks(true, own)
    assert match is not None
    assert match.offset_s == pytest.approx(offset_s, abs=0.01)
    assert match.peak > 0.97
    assert match.is_alone
    assert match.is_usable
    assert match.overlap_s == pytest.approx(45.0, abs=1.0)
    assert match.turning > 0.97
    assert match.speed > 0.97
    assert match.cell_s == 0.05
    assert (match.zero > 0.97) == (offset_s == 0.0)
    middles, offsets = offsets_of_parts(match, match.offset_s, 3)
    np.testing.assert_allclose(offsets, offset_s, atol=0.02)
    np.testing.assert_allclose(middles, np.array([7.5, 22.5, 37.5]), atol=0.15)


@pytest.mark.parametrize(
    ("away_s", "is_found"), [(2.95, True), (-2.95, True), (3.0, False), (-3.0, False)]
)
def test_a_peak_of_a_part_is_within_three_seconds(away_s: float, *, is_found: bool) -> None:
    """The last cell has no neighbour, so that it can be the slope of a peak beyond."""
    true = wandering()
    match = match_clocks(true, true[100:1000].shifted(-2.5))
    assert match is not None
    _, offsets = offsets_of_parts(match, match.offset_s - away_s, 3)
    np.testing.assert_allclose(offsets, [2.5] * 3 * is_found, atol=0.02)


@pytest.mark.parametrize(("span_s", "is_compared"), [(8.6, True), (7.9, False)])
def test_eight_seconds_of_common_time_are_needed(span_s: float, *, is_compared: bool) -> None:
    own = wandering(span_s=20.0)
    part = own[: round(span_s / 0.05)]
    assert (match_clocks(own, part) is not None) == is_compared
    assert np.isfinite(_RateFit.of(own, part, 0.0, 0.0).sigma) == is_compared


def test_one_side_may_be_shorter_than_a_cell_of_the_other() -> None:
    """A run of three hours by one wrong timestamp has cells of three seconds."""
    own = wandering(span_s=2.0)
    seconds = own.seconds.copy()
    seconds[-1] += 1e4
    long = TimedPoses(seconds, own.positions, own.quaternions)
    assert match_clocks(own, long) is None
    assert match_clocks(long, own) is None
    assert _RateFit.of(own, long, 0.0, 0.0).sigma == np.inf


@pytest.mark.parametrize("rate", [0.5, 1.37, 1.907, 2.116])
def test_a_rate_of_clocks_is_found_between_all_steps_of_the_search(rate: float) -> None:
    """Two refinements of four times the length; the last steps allow a shift of 0.7 s."""
    true = wandering(span_s=500.0)
    own = true[200:9800].shifted(0.0, 1.0 / rate - 1.0)
    found, match = other_rate(true, own, None)
    assert abs(np.log(found / rate)) < 0.7 / (480.0 / rate)
    assert match is not None
    assert match.peak > 0.95


def test_the_rate_of_a_fast_motion_is_refined_to_a_part_of_its_last_step() -> None:
    slow = wandering(span_s=400.0)
    true = TimedPoses(slow.seconds / 6.0, slow.positions, slow.quaternions)
    for rate in (0.83, 1.2, 1.213):
        found, match = other_rate(true, true[60:7800].shifted(0.0, 1.0 / rate - 1.0), None)
        assert abs(np.log(found / rate)) < 1.4 / 8.0 / (64.5 / rate)
        assert match is not None
        assert match.peak > 0.9


def match_of(**changed: Any) -> ClockMatch:
    nothing: Any = None
    usual: dict[str, Any] = {
        "offset_s": 2.0, "peak": 0.9, "zero": 0.2, "second": 0.3, "overlap_s": 30.0,
        "turning": 0.9, "speed": 0.9, "cell_s": 0.05, "sides": nothing,
    }  # fmt: skip
    return ClockMatch(**{**usual, **changed})


@pytest.mark.parametrize(
    ("changed", "is_alone", "is_usable"),
    [
        ({}, True, True),
        ({"peak": 0.61, "zero": 0.0}, True, False),
        ({"peak": 0.6}, False, False),
        ({"second": 0.76}, True, True),
        ({"second": 0.77}, False, False),
        ({"peak": 0.81}, True, True),
        ({"peak": 0.8}, True, False),
        ({"zero": 0.874}, True, True),
        ({"zero": 0.876}, True, False),
        ({"zero": 0.876, "offset_s": -0.24}, True, True),
        ({"zero": 0.876, "offset_s": -0.26}, True, False),
    ],
)
def test_an_offset_is_usable_if_its_peak_is_high_alone_and_better(
    changed: dict[str, float], *, is_alone: bool, is_usable: bool
) -> None:
    match = match_of(**changed)
    assert (match.is_alone, match.is_usable) == (is_alone, is_usable)


@pytest.mark.parametrize(
    ("changed", "rate", "is_seen"),
    [
        ({}, 1.0, True),
        ({}, 1.01, False),
        ({"offset_s": -0.26}, 1.0, True),
        ({"offset_s": -0.24}, 1.0, False),
        ({"zero": 0.876}, 1.0, False),
        ({"second": 0.77}, 1.0, False),
    ],
)
def test_a_clock_offset_is_large_and_better(
    changed: dict[str, float], rate: float, *, is_seen: bool
) -> None:
    match = match_of(**changed)
    found = clock_offset(match, 1.5, rate)
    assert found.scores == {
        "offset_s": match.offset_s, "peak": 0.9, "as_stamped": match.zero,
        "second": match.second, "usable_from": 0.8, "cell_s": 0.05,
    }  # fmt: skip
    assert [each.cause for each in found.seen] == ["clock_offset"] * is_seen
    for seen in found.seen:
        assert seen.explained == pytest.approx(1.0 - 0.1 / 0.8)
        assert dict(seen.values) == {
            "offset_s": match.offset_s, "total_s": 1.5 + match.offset_s, "known_as": "",
            "peak": 0.9, "as_stamped": 0.2,
        }  # fmt: skip


@pytest.mark.parametrize(
    ("offset_s", "known_as"),
    [
        (18.29, " (GPS time without leap seconds)"),
        (-17.71, " (GPS time without leap seconds)"),
        (18.31, ""),
        (18.69, ""),
        (18.71, " (GPS against TAI)"),
        (-37.0, " (TAI against UTC)"),
        (20.0, ""),
    ],
)
def test_leap_seconds_are_known(offset_s: float, known_as: str) -> None:
    [seen] = clock_offset(match_of(offset_s=offset_s), 0.0, 1.0).seen
    assert seen.values["known_as"] == known_as


@pytest.mark.parametrize(
    ("overlap_s", "cell_s", "offsets", "is_seen"),
    [
        (36.0, 0.05, [], True),  # too short for thirds
        (36.1, 0.05, [], False),
        (36.1, 0.05, [2.0], False),
        (36.1, 0.05, [2.0, 2.09], True),
        (36.1, 0.05, [2.0, 1.89], False),
        (36.1, 0.2, [2.0, 1.81, 2.0], True),
        (36.1, 0.2, [2.0, 1.79, 2.0], False),
    ],
)
def test_a_clock_offset_is_that_of_all_thirds(
    overlap_s: float,
    cell_s: float,
    offsets: list[float],
    monkeypatch: pytest.MonkeyPatch,
    *,
    is_seen: bool,
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(
        clock_tests,
        "offsets_of_parts",
        lambda *each: given.append(each[1:]) or (None, np.array(offsets)),
    )
    found = clock_offset(match_of(overlap_s=overlap_s, cell_s=cell_s), 0.0, 1.0)
    assert bool(found.seen) == is_seen
    assert given == [(2.0, 3)] * (overlap_s > 36.0)
    assert bool(found.why_not) != is_seen


def rate_found(
    monkeypatch: pytest.MonkeyPatch,
    offsets: Floats,
    *,
    sigmas: float = 1e3,
    span_s: float = 120.0,
    count: int = 2400,
    found_rate: float = 1.0,
    rest: float = 0.9,
    **changed: Any,
) -> Examined:
    """Return the test of a rate, from the offsets of parts of a run and the rate's deviation."""
    estimate = TimedPoses(np.linspace(0.0, span_s, count), np.zeros((count, 3)))
    times = np.linspace(0.0, span_s, len(offsets))
    monkeypatch.setattr(clock_tests, "offsets_of_parts", lambda *_: (times, offsets))

    def unchanged(_: object, __: object, rate: float, level: float) -> _RateFit:
        return _RateFit(rate, level, abs(rate) / sigmas, rest if rate else 1.0)

    monkeypatch.setattr(clock_tests._RateFit, "of", unchanged)
    return clock_rate(estimate, estimate, match_of(**changed), 0.7, 0.2, found_rate)


@pytest.mark.parametrize(
    ("growth_s", "changed", "is_seen"),
    [
        (0.061, {}, True),
        (-0.061, {}, True),
        (0.059, {}, False),
        # One step of the estimate.
        (0.099, {"count": 1201}, False),
        (0.101, {"count": 1201}, True),
        (0.3, {"sigmas": 5.1}, True),
        (0.3, {"sigmas": 4.9}, False),
        # By speeds.
        (0.41, {"sigmas": 5.1, "turning": np.nan}, True),
        (0.39, {"turning": np.nan}, False),
        # A rate that was found already.
        (0.01, {"found_rate": 1.5}, True),
        (-40.0, {"found_rate": 1.5}, False),  # it was wrong
    ],
)
def test_a_clock_rate_is_significant(
    growth_s: float, changed: dict[str, Any], monkeypatch: pytest.MonkeyPatch, *, is_seen: bool
) -> None:
    offsets = np.linspace(0.5, 0.5 + growth_s, 10)
    found = rate_found(monkeypatch, offsets, **changed)
    assert [each.cause for each in found.seen] == ["clock_drift"] * is_seen
    ratio, rate = changed.get("found_rate", 1.0), growth_s / 120.0
    total = ratio * (1.0 + rate) - 1.0
    if found.scores:
        expected = {"ppm": 1e6 * rate, "growth_s": total * 120.0 / ratio, "offset_s": 0.5}
        expected |= {"rate": ratio, "sigmas": changed.get("sigmas", 1e3) * abs(total / rate)}
        assert dict(found.scores) == pytest.approx(expected)
    for seen in found.seen:
        assert dict(seen.values) == pytest.approx(
            {
                "ppm": 1e6 * total,
                "growth_ms": 1e3 * total * 120.0 / ratio,
                "offset_s": 0.5,
                "total_s": 0.7,
            }
        )
        assert seen.explained == 1.0 - found.scores["sigmas"] ** -2


@pytest.mark.parametrize(("noise_s", "is_seen"), [(0.04, True), (0.045, False)])
def test_a_rate_of_speeds_grows_beyond_the_noise_of_parts(
    noise_s: float, monkeypatch: pytest.MonkeyPatch, *, is_seen: bool
) -> None:
    wave = noise_s * np.array([1.0, -1.0, 1.0, -1.0, 0.0, 0.0, -1.0, 1.0, -1.0, 1.0])
    offsets = np.linspace(0.5, 1.0, 10) + wave
    for turning in (np.nan, 0.9):
        found = rate_found(monkeypatch, offsets, turning=turning)
        assert bool(found.seen) == (is_seen or turning == 0.9)


def test_a_rate_that_fits_worse_than_none_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    found = rate_found(monkeypatch, np.linspace(0.5, 0.8, 10), rest=1.1)
    assert not found.seen
    assert (found.scores["ppm"], found.scores["offset_s"]) == (0.0, 2.0)


def test_four_parts_determine_a_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    for count, why_not in ((4, ""), (3, "too few parts of the run determine an offset")):
        assert rate_found(monkeypatch, np.linspace(0.0, 0.5, count)).why_not == why_not


def test_the_deviation_of_a_rate_is_that_of_repeated_runs() -> None:
    """Angular speeds with errors of 0.2 rad/s, of which one in fifty is ten times as large."""
    true, times = wandering(span_s=100.0), np.arange(0.0, 100.0, 0.05)
    found = []
    for seed in range(40):
        generator = np.random.default_rng(seed)
        errors = generator.normal(0.0, 0.01, len(times))
        errors *= np.where(generator.random(len(times)) < 0.02, 10.0, 1.0)
        noise = Rotation.from_rotvec(np.outer(errors, [0.0, 0.0, 1.0]))
        assert true.quaternions is not None
        own = (noise * Rotation.from_quat(true.quaternions)).as_quat()
        estimate = TimedPoses(true.seconds, true.positions, own).shifted(0.03, 4e-4)
        found.append(_RateFit.of(true, estimate, 0.0, 0.0))
    rates, offsets, sigmas, rests = np.array(found).T
    assert 0.02 < rests.mean() < 0.06
    # The mean of 40 runs has a deviation of a sixth of that of one.
    assert abs(rates.mean() + 4e-4) < 0.5 * sigmas.mean()
    assert offsets.mean() == pytest.approx(-0.03, abs=0.005)
    assert 0.7 < rates.std() / sigmas.mean() < 1.4
    assert sigmas.mean() < 1e-4


@pytest.mark.parametrize(
    ("gain", "is_known"), [(0.45, False), (0.55, True), (1.9, True), (2.1, False)]
)
def test_other_angular_speeds_determine_no_rate(gain: float, *, is_known: bool) -> None:
    true = wandering()
    angles = np.unwrap(Rotation.from_quat(true.quaternions).as_euler("ZYX")[:, 0])
    turned = Rotation.from_rotvec(np.outer(gain * angles, [0.0, 0.0, 1.0])).as_quat()
    found = _RateFit.of(true, TimedPoses(true.seconds, true.positions, turned), 0.0, 0.0)
    assert np.isfinite(found.sigma) == is_known


def test_without_common_time_a_rate_has_no_deviation() -> None:
    own = wandering(span_s=20.0)
    assert _RateFit.of(own, own.shifted(15.0), 0.1, 0.2) == _RateFit(0.1, 0.2, np.inf)


@pytest.mark.parametrize("ppm", [-36_000.0, 1000.0, 37_344.0])
def test_a_rate_is_refined_by_the_clock_that_has_it(ppm: float) -> None:
    """Within a part of twelve seconds, the offset grows by more than the width of a peak."""
    fast = wandering(span_s=25.0, step_s=0.0125)
    true = TimedPoses(4.0 * fast.seconds, fast.positions, fast.quaternions)
    own = true.shifted(0.0, 1.0 / (1.0 + 1e-6 * ppm) - 1.0)
    match = match_clocks(true, own)
    assert match is not None
    [seen] = clock_rate(true, own, match, match.offset_s, 0.0, 1.0).seen
    assert seen.values["ppm"] == pytest.approx(ppm, abs=200.0)  # 20 ms over the run
    assert seen.values["offset_s"] == pytest.approx(0.0, abs=0.01)
