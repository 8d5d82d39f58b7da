"""The values of the topics of an estimate: which pairs have them, and their numbers."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from state_rows import states, trajectory

from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.coverage import Coverage
from trajeval_ros.metrics.premises import Doubts, Premise
from trajeval_ros.metrics.statistics import Statistics, statistics_of
from trajeval_ros.metrics.stream_health import StreamHealth
from trajeval_ros.online.error_topics import (
    DIAGNOSTIC_LEVELS,
    NUMBERS,
    STREAM_NUMBERS,
    VECTORS,
    by_part,
    integrity_numbers,
    nees_numbers,
    relative_error_topic,
    status_texts,
    status_values,
    stream_values,
    vectors_of,
    window_ate,
)
from trajeval_ros.online.live_relative_errors import RunningErrors
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.reports import Snapshot, Update, united

BY_UP = {"stamped/attitude_error", "stamped/heading_error", "yaw_error", "tilt_error"}
EMPTY = Snapshot(
    pairs=0,
    stamp=None,
    warming_up="no pairs yet",
    alignment=None,
    position_rmse_m=None,
    window_position_rmse_m=None,
    ate={},
    window_pairs=0,
    relative={},
    estimate_coverage=None,
    coverage=None,
    dropped={},
    waiting=0,
)


def errors_of(*doubted: Premise, count: int = 6, still: tuple[int, ...] = ()) -> PairErrors:
    """Return errors of pairs; the estimate of the rows `still` has no velocity."""
    rng = np.random.default_rng(count)
    sides = []
    for _ in range(2):
        velocities = rng.normal(size=(count, 3))
        velocities[list(still)] = 0.0
        stamps = 1000 + 7 * np.arange(count, dtype=np.int64)
        rows = states(rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), velocities)
        sides.append(trajectory(stamps, rows))
    return PairErrors(
        PairedStates(*sides), Similarity.identity(), Doubts(dict.fromkeys(doubted, "why"))
    )


@pytest.mark.parametrize("topic", VECTORS)
def test_vectors_have_the_stamps_of_the_pairs_by_the_estimates_clock(topic: str) -> None:
    errors = errors_of()
    stamps, vectors = vectors_of(errors, topic, 300)
    np.testing.assert_array_equal(stamps, errors.stamps - 300)
    np.testing.assert_array_equal(vectors, VECTORS[topic](errors))
    assert vectors.shape == (6, 3)


def test_pairs_without_the_error_have_no_vector() -> None:
    errors = errors_of(still=(1, 4))
    stamps, vectors = vectors_of(errors, "stamped/velocity_error", -50)
    kept = [0, 2, 3, 5]
    np.testing.assert_array_equal(stamps, errors.stamps[kept] + 50)
    assert errors.velocity is not None
    np.testing.assert_array_equal(vectors, errors.velocity[kept])


@pytest.mark.parametrize("topic", [*VECTORS, *NUMBERS])
def test_what_is_about_gravity_needs_a_known_up_axis(topic: str) -> None:
    errors = errors_of(Premise.UP_AXIS)
    if topic in NUMBERS:
        assert (NUMBERS[topic](errors) is None) == (topic in BY_UP)
        assert NUMBERS[topic](errors_of()) is not None
        return
    stamps, vectors = vectors_of(errors, topic, 0)
    assert len(stamps) == len(vectors) == (0 if topic in BY_UP else 6)
    assert vectors.shape[1:] == (3,)
    assert stamps.dtype == np.int64


def test_errors_that_are_withheld_have_no_vectors() -> None:
    errors = errors_of(Premise.ALIGNMENT_ROTATION)
    for topic in VECTORS:
        stamps, vectors = vectors_of(errors, topic, 3)
        present = topic in ("stamped/position_error", "stamped/heading_error")
        assert len(stamps) == (6 if present else 0)
        assert vectors.shape == (len(stamps), 3)
    assert NUMBERS["rotation_error"](errors) is None


def test_metres_and_degrees_have_topics_of_their_own() -> None:
    result = by_part("x", np.array([1.5, 2.5]), np.array([10.0, 20.0]))
    assert list(result) == ["x/position", "x/rotation"]
    np.testing.assert_array_equal(result["x/position"], [[1.5, 0.0, 0.0], [2.5, 0.0, 0.0]])
    np.testing.assert_array_equal(result["x/rotation"], [[10.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    [(topic, vectors)] = by_part("x", 0.5, None).items()
    assert (topic, vectors.tolist()) == ("x/position", [[0.5, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("length", "topic"), [("8m", "8m"), ("0.5s", "0_5s"), ("10%", "10_percent"), ("7f", "7f")]
)
def test_a_length_names_its_topic(length: str, topic: str) -> None:
    assert relative_error_topic(length) == f"stamped/relative_error/length_{topic}"


def test_the_window_s_ate_needs_an_alignment() -> None:
    rotation = statistics_of(np.array([3.0, 4.0]))
    assert window_ate(EMPTY) == {}
    only = dataclasses.replace(EMPTY, window_position_rmse_m=0.25)
    [(topic, alone)] = window_ate(only).items()
    assert (topic, alone.tolist()) == ("stamped/ate/position", [[0.25, 0.0, 0.0]])
    both = dataclasses.replace(only, ate={"rotation_deg": rotation})
    result = window_ate(both)["stamped/ate/rotation"]
    np.testing.assert_allclose(result, [[np.sqrt(12.5), 0.0, 0.0]], rtol=1e-15)


def test_tests_that_are_not_asked_for_have_no_numbers() -> None:
    assert nees_numbers(EMPTY) == {}
    assert integrity_numbers(EMPTY) == {}


def test_numbers_of_the_tests_are_of_the_newest_pair_and_the_window() -> None:
    position, rotation = (SimpleNamespace(mean=value) for value in (1.5, 2.5))
    per_pose = SimpleNamespace(mean=1.25, position=position, rotation=rotation)
    parts = [
        SimpleNamespace(part=name, levels=np.array([9.0, value]))
        for name, value in (("horizontal", 1.0), ("vertical", 2.0), ("heading", 3.0))
    ]
    snapshot = dataclasses.replace(
        EMPTY,
        consistency=cast("Any", SimpleNamespace(per_pose=per_pose)),
        integrity=cast("Any", SimpleNamespace(parts=parts)),
    )
    assert nees_numbers(snapshot) == {"nees": 1.25, "nees_position": 1.5, "nees_rotation": 2.5}
    assert integrity_numbers(snapshot) == {
        "protection_level": 1.0,
        "protection_level_vertical": 2.0,
        "protection_level_heading": 3.0,
    }


def test_the_levels_are_those_of_the_message() -> None:
    assert [DIAGNOSTIC_LEVELS[item] for item in (Level.NOTE, Level.WARNING, Level.ERROR)] == [
        *range(3)
    ]


def test_every_value_of_a_stream_has_its_own_name() -> None:
    numbers = {name: float(place) for place, name in enumerate(StreamHealth.__annotations__)}
    health = StreamHealth(**cast("Any", numbers))
    named = {
        "rate [Hz]": "rate_hz",
        "jitter [s]": "jitter_s",
        "largest gap [s]": "largest_gap_s",
        "arrival after stamp, p50 [s]": "arrival_p50_s",
        "arrival after stamp, p95 [s]": "arrival_p95_s",
        "arrival after stamp, max [s]": "arrival_max_s",
        "messages from the future": "from_future",
    }
    expected = {f"groundtruth {words}": numbers[name] for words, name in named.items()}
    assert stream_values(health, "groundtruth ") == expected
    assert stream_values(health) == {words: numbers[name] for words, name in named.items()}
    assert set(STREAM_NUMBERS.values()) <= set(numbers)


def test_a_status_has_what_is_known_and_nothing_else() -> None:
    known = {"pairs": "0", "window pairs": "0"}
    assert status_texts(status_values(EMPTY, Update())) == known
    errors = errors_of()
    assert errors.rotation_deg is not None
    alignment = Alignment(Similarity(np.eye(3), np.zeros(3), 1.25), 17)
    rotation = statistics_of(np.array([3.0, 4.0]))
    assert isinstance(rotation, Statistics)
    snapshot = dataclasses.replace(
        EMPTY,
        pairs=12,
        window_pairs=9,
        alignment=alignment,
        position_rmse_m=0.123456789,
        window_position_rmse_m=0.2,
        ate={"rotation_deg": rotation},
        relative={"8m": RunningErrors(3, 0.5, 1.0), "16m": RunningErrors()},
        estimate_coverage=0.75,
        coverage=Coverage(0.5, 0.875),
    )
    assert status_texts(status_values(snapshot, Update(6, 5, (errors,)))) == {
        "pairs": "12",
        "window pairs": "9",
        "position error [m]": f"{errors.position_m[-1]:.6g}",
        "rotation error [deg]": f"{errors.rotation_deg[-1]:.6g}",
        "ATE position, window [m]": "0.2",
        "ATE rotation, window [deg]": "3.53553",
        "ATE position, whole run [m]": "0.123457",
        "RE 8m, mean [m]": "0.5",
        "alignment": "17 states",
        "scale": "1.25",
        "estimate coverage": "0.75",
        "groundtruth coverage": "0.5",
        "groundtruth from first to last pair": "0.875",
    }


def test_updates_are_united_in_order() -> None:
    first, second = errors_of(2), errors_of(3)
    several = [Update(2, 10, (first,)), Update(3, 20, (second,)), Update()]
    result = united(several)
    assert (result.pairs, result.stamp, result.errors) == (5, 20, (first, second))
    assert result.position_m == second.position_m[-1]
    assert second.rotation_deg is not None
    assert result.rotation_deg == second.rotation_deg[-1]
    nothing = united([Update(), Update()])
    assert (nothing.pairs, nothing.stamp, nothing.position_m) == (0, None, None)
    assert nothing.rotation_deg is None
