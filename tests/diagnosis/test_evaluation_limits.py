"""Tests of a finished evaluation: offsets, delays and covariances of exactly known errors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros.diagnosis import evaluation_tests
from trajeval_ros.diagnosis.evaluation_tests import (
    _late,
    covariance_blocks,
    few_pairs,
    frame_offset,
    small_clock_offset,
)
from trajeval_ros.diagnosis.findings import Examined
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
) -> Examined:
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
        (0.501, 0.981, 10, True),
        (0.499, 0.981, 10, False),
        (0.501, 0.979, 10, False),
        (0.501, 0.981, 9, False),
    ],
)
def test_an_offset_explains_nearly_all_of_the_error(
    length: float, share: float, count: int, *, is_seen: bool
) -> None:
    mean = length * np.array([0.48, 0.64, -0.6])
    found = offset_of(mean, share, count)
    assert found.scores == pytest.approx({"offset_m": length, "share": share})
    assert [each.cause for each in found.seen] == ["frames_apart"] * is_seen
    for seen in found.seen:
        assert seen.explained == pytest.approx(share)
        values = dict(seen.values)
        assert values.pop("offset") == ", ".join(f"{each:.2f}" for each in mean)
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


def delayed(
    late_s: float, across: float = 0.0, count: int = 80, gap: float = 1.0, fixed: bool = False
) -> tuple[Any, Any]:
    """Return pairs and aligned poses that are late, on parabolas, with an error across."""
    steps = np.full(count - 1, 0.1)
    steps[30] *= gap
    seconds = np.concatenate([[0.0], np.cumsum(steps)])
    stamps = np.rint(seconds * SECOND).astype(np.int64)
    truth = np.column_stack([seconds**2, 0.5 * seconds**2 + seconds, np.zeros(count)])
    velocity = np.column_stack([2.0 * seconds, seconds + 1.0, np.zeros(count)])
    if fixed:
        truth, velocity = np.zeros((2, count, 3))
    own = truth + late_s * velocity + [3.0, -2.0, 1.0]
    inner = velocity[1:-1] - velocity[1:-1].mean(axis=0)
    wave = (-1.0) ** np.arange(count)
    own[:, 2] += across * np.abs(late_s) * np.sqrt(np.square(inner).sum() / (count - 2)) * wave
    if gap != 1.0:
        own[30:32] += 1e3  # beside the long step
    pairs: Any = SimpleNamespace(
        groundtruth=SimpleNamespace(stamps=stamps, positions=truth),
        estimate=SimpleNamespace(stamps=stamps, duration_s=float(seconds[-1])),
        rule=SimpleNamespace(method="linear", time_offset_s=0.0, max_time_difference_s=0.02),
    )
    return pairs, SimpleNamespace(positions=own)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("late_s", "across", "count", "is_found"),
    [
        (0.0201, 0.0, 80, True),
        (0.0199, 0.0, 80, False),
        (0.3, 0.99, 80, True),
        (0.3, 1.01, 80, False),
        (0.3, 0.0, 52, True),
        (0.3, 0.0, 51, False),
    ],
)
def test_a_delay_explains_half_of_the_squared_error(
    late_s: float, across: float, count: int, sign: float, *, is_found: bool
) -> None:
    """On a parabola, central differences are exact; an error across it explains the rest."""
    found = _late(*delayed(sign * late_s, across, count))
    assert (found is not None) == is_found
    if found is not None:
        assert found == pytest.approx(sign * late_s)


@pytest.mark.parametrize(("gap", "is_left_out"), [(1.99, False), (2.01, True)])
def test_velocities_beside_a_long_step_are_left_out(gap: float, *, is_left_out: bool) -> None:
    found = _late(*delayed(0.3, gap=gap))
    assert (found == pytest.approx(0.3)) == is_left_out


def test_a_body_at_rest_has_no_delay() -> None:
    assert _late(*delayed(0.3, fixed=True)) is None


def clocks_of(monkeypatch: pytest.MonkeyPatch, guess: Any, **changed: Any) -> Examined:
    """Return the test for a guess, or by the positions if it is not usable."""
    count, late_s = changed.pop("count", 101), changed.pop("late_s", 0.3)
    rule = {"method": "linear", "time_offset_s": 0.0, "max_time_difference_s": 0.02, **changed}
    pairs, aligned = delayed(late_s, count=count)
    pairs.rule = SimpleNamespace(**rule)
    monkeypatch.setattr(evaluation_tests, "_guess", lambda _: guess)

    class Pairs(SimpleNamespace):
        def __len__(self) -> int:
            return count

    evaluation: Any = SimpleNamespace(association=Pairs(**vars(pairs)), aligned=aligned)
    return small_clock_offset(evaluation)


def guess_of(offset_s: float, signal: str, *, is_usable: bool = True) -> Any:
    return SimpleNamespace(offset_s=offset_s, peak=0.9, signal=signal, is_usable=is_usable)


@pytest.mark.parametrize(
    ("offset_s", "signal", "changed", "is_seen"),
    [
        (0.051, "angular rate", {}, True),  # half of a step of 0.1 s
        (-0.051, "angular rate", {}, True),
        (0.049, "angular rate", {}, False),
        (0.151, "speed", {}, True),
        (0.149, "speed", {}, False),
        (0.26, "speed", {"method": "nearest", "max_time_difference_s": 0.25}, True),
        (0.24, "speed", {"method": "nearest", "max_time_difference_s": 0.25}, False),
        (0.24, "speed", {"method": "linear", "max_time_difference_s": 0.25}, True),
    ],
)
def test_an_offset_of_rates_is_beyond_their_resolution(
    offset_s: float,
    signal: str,
    changed: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    *,
    is_seen: bool,
) -> None:
    found = clocks_of(monkeypatch, guess_of(offset_s, signal), **changed)
    assert found.scores.items() >= {"offset_s": offset_s, "peak": 0.9}.items()
    assert [each.cause for each in found.seen] == ["small_clock_offset"] * is_seen
    for seen in found.seen:
        assert seen.explained == 0.5
        assert dict(seen.values) == {
            "offset_ms": 1e3 * offset_s, "how": f"the {signal}s match best", "more": "",
        }  # fmt: skip


def test_without_usable_rates_the_error_along_the_velocity_decides(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    guess = guess_of(0.4, "speed", is_usable=False)
    [seen] = clocks_of(monkeypatch, guess, time_offset_s=0.1).seen
    assert seen.values["offset_ms"] == pytest.approx(300.0)
    assert seen.values["how"] == "the position error is proportional to the speed, as"
    assert seen.values["more"] == "more "
    assert not clocks_of(monkeypatch, guess, late_s=0.01).seen


def test_offsets_need_timestamps_states_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    guess = guess_of(0.4, "speed")
    assert clocks_of(monkeypatch, guess, count=82).seen  # 8.1 s
    assert clocks_of(monkeypatch, guess, count=80).why_not  # 7.9 s
    assert clocks_of(monkeypatch, guess, method="index").why_not


def test_the_middle_ten_minutes_are_correlated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of at least 50 different timestamps."""

    class Side:
        def __init__(self, stamps: Any) -> None:
            self.stamps = stamps

        def __getitem__(self, rows: Any) -> Any:
            return self.stamps[rows] / SECOND

    monkeypatch.setattr(evaluation_tests, "guess_offset", lambda *sides: sides)
    seconds = np.arange(1000.0, 2501.0)
    sides: Any = [Side(np.rint(each * SECOND).astype(np.int64)) for each in (seconds + 9, seconds)]
    pairs: Any = SimpleNamespace(groundtruth=sides[0], estimate=sides[1])
    true, own = evaluation_tests._guess(pairs)
    assert own.tolist() == np.arange(1450.0, 2051.0).tolist()
    assert true.tolist() == np.arange(1459.0, 2060.0).tolist()
    for count in (50, 49):
        few = Side(np.repeat(np.arange(count), 2) * SECOND)
        found: Any = evaluation_tests._guess(SimpleNamespace(groundtruth=few, estimate=few))  # type: ignore[arg-type]
        assert isinstance(found, tuple) == (count == 50)


def blocks_of(
    position: float, rotation: float, errors: tuple[float, float] = (1.0, 0.1), **changed: Any
) -> Examined:
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
    assert [each.cause for each in found.seen] == ["covariance_order"] * is_exchanged
    for seen in found.seen:
        spread = abs(2.0 * apart + second - first)
        assert seen.explained == pytest.approx(1.0 - abs(first - second) / spread)
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
    assert [each.cause for each in found.seen] == ["covariance_degrees"] * is_degrees
    for seen in found.seen:
        assert seen.explained == 1.0
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
