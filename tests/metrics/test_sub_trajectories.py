"""Which states make a sub-trajectory, against a search through all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import Array, seeds

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.metrics.sub_trajectories import (
    Length,
    Selection,
    nearest_ends,
    select,
    select_states,
    select_turns,
)

RULES = ("nearest", "toolbox", "first-past", "evo")


def by_search(along: Array, length: float, selection: Selection) -> list[tuple[int, int]]:
    """Return what the rules say, pair by pair."""
    result = []
    last = len(along) - 1
    for start in range(0, len(along), selection.every):
        target = along[start] + length
        if selection.rule == "first-past":
            past = [e for e in range(start, last + 1) if along[e] > target]
            result += [(start, past[0])] if past else []
            continue
        deviations = [abs(along[e] - target) for e in range(start, last + 1)]
        end = start + int(np.argmin(deviations))
        deviation = deviations[end - start]
        if selection.rule == "toolbox":
            accepted = deviation < 0.2 * length
        elif selection.rule == "evo":
            accepted = deviation <= selection.tolerance * length and end > start
        else:
            reached = [e for e in range(last + 1) if along[e] >= target] or [last]
            spacing = along[reached[0]] - along[max(reached[0] - 1, 0)]
            tolerance = min(max(0.01 * length, spacing / 2.0), 0.2 * length)
            accepted = deviation <= tolerance * (1.0 + 1e-9) and end > start
        if accepted:
            result.append((start, end))
    return result


def by_whole_columns(
    along: Array, starts: Any, length: Any, rule: str, share: float
) -> tuple[Any, Any]:
    """Return what `nearest_ends` does, without blocks and windows."""
    target = along[starts] + length
    within = np.minimum(np.searchsorted(along, target), len(along) - 1)
    reached, missed = along[within], along[np.maximum(within - 1, starts)]
    before = np.maximum(np.searchsorted(along, missed), starts)
    too_long, too_short = np.abs(reached - target), np.abs(missed - target)
    ends = np.where(too_long < too_short, within, before)
    deviation = np.minimum(too_long, too_short)
    if rule == "toolbox":
        return ends, deviation < 0.2 * length
    if rule == "evo":
        return ends, (deviation <= share * length) & (ends > starts)
    half = (reached - missed) / 2.0
    tolerance = np.minimum(np.maximum(0.01 * length, half), 0.2 * length)
    return ends, (deviation <= tolerance * (1.0 + 1e-9)) & (ends > starts)


@pytest.mark.parametrize("rule", ["nearest", "toolbox", "evo"])
@given(
    seed=seeds,
    count=st.sampled_from([1, 2, 60, 8192, 8193, 20_000]),
    every=st.sampled_from([1, 7]),
    rest=st.sampled_from([0.0, 0.3, 0.999]),
    single=st.booleans(),
)
def test_ends_found_by_blocks_are_those_of_whole_columns(
    rule: str, seed: int, count: int, every: int, rest: float, single: bool
) -> None:
    random = np.random.default_rng(seed)
    steps = random.exponential(0.05, count) * (random.random(count) >= rest)
    along = np.cumsum(np.round(steps, random.integers(1, 12)))
    starts = np.arange(0, count, every)
    starts = starts if single else random.permutation(np.repeat(starts, 2))
    length = 2.0 if single else random.uniform(0.05, 8.0, len(starts))
    ends, accepted = nearest_ends(along, starts, length, rule, 0.05)
    expected = by_whole_columns(along, starts, length, rule, 0.05)
    np.testing.assert_array_equal(ends, expected[0])
    np.testing.assert_array_equal(accepted, expected[1])
    assert ends.dtype.kind == "i"
    assert accepted.dtype == bool


@pytest.mark.parametrize("rule", ["nearest", "toolbox", "evo"])
def test_no_starts_have_no_ends(rule: str) -> None:
    ends, accepted = nearest_ends(np.arange(3.0), np.arange(0), 1.0, rule)
    assert (ends.shape, accepted.shape) == ((0,), (0,))


def pairs_of(along: Array, length: float, selection: Selection) -> list[tuple[int, int]]:
    starts, ends = select(along, length, selection)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("every", [1, 10])
@given(seed=seeds, length=st.floats(0.05, 20.0))
def test_selection_is_a_search_through_all_pairs(
    rule: str, every: int, seed: int, length: float
) -> None:
    random = np.random.default_rng(seed)
    steps = random.exponential(0.1, size=random.integers(1, 250))
    steps[random.uniform(size=len(steps)) < 0.2] = 0.0  # standing still
    steps[random.uniform(size=len(steps)) < 0.02] = random.uniform(1.0, 8.0)  # holes
    along = np.concatenate([[0.0], np.cumsum(steps)])
    selection = Selection(rule, every)
    assert pairs_of(along, length, selection) == by_search(along, length, selection)


@pytest.mark.parametrize("rule", RULES)
@given(numbers=st.lists(st.integers(0, 3), max_size=60), length=st.integers(1, 20))
def test_selection_decides_ties_as_the_search_does(
    rule: str, numbers: list[int], length: int
) -> None:
    # Half metres are exact in binary, so that ties are ties.
    along = np.concatenate([[0.0], np.cumsum(np.array(numbers, dtype=np.float64))]) / 2.0
    selection = Selection(rule)
    assert pairs_of(along, length / 2.0, selection) == by_search(along, length / 2.0, selection)


@pytest.mark.parametrize("rule", RULES)
@given(numbers=st.lists(st.integers(0, 3), max_size=60), length=st.integers(1, 20))
def test_consecutive_ones_are_those_of_all_that_follow_each_other(
    rule: str, numbers: list[int], length: int
) -> None:
    along = np.concatenate([[0.0], np.cumsum(np.array(numbers, dtype=np.float64))]) / 2.0
    if rule == "evo":  # of consecutive pairs it takes the first end at or beyond the length
        ends = [np.flatnonzero(along >= item + length / 2.0) for item in along]
        every = [(start, int(end[0])) for start, end in enumerate(ends) if len(end)]
    else:
        every = pairs_of(along, length / 2.0, Selection(rule))
    expected, at = [], 0
    for start, end in every:
        if start >= at and end > start:
            expected.append((start, end))
            at = end
    assert pairs_of(along, length / 2.0, Selection(rule, pairs="consecutive")) == expected


@given(count=st.integers(0, 50), length=st.integers(1, 60))
def test_frames_are_counted(count: int, length: int) -> None:
    everything = [(start, start + length) for start in range(max(count - length, 0))]
    result = [
        list(zip(*map(np.ndarray.tolist, select_states(count, length, selection)), strict=True))
        for selection in (Selection(), Selection("evo", pairs="consecutive"))
    ]
    assert result == [everything, everything[::length]]


@given(seed=seeds, angle=st.floats(0.05, 3.0), tolerance=st.floats(0.01, 0.5))
def test_orientations_that_far_apart_are_all_found(
    seed: int, angle: float, tolerance: float
) -> None:
    random = np.random.default_rng(seed)
    steps = lie.from_rotation_vector(random.normal(scale=0.3, size=(300, 3)))
    quaternions = lie.normalized(random.choice([-1.0, 1.0], size=(300, 1)) * steps)
    starts, ends = np.triu_indices(len(quaternions), 1)
    apart = lie.angle(lie.multiply(lie.conjugate(quaternions[starts]), quaternions[ends]))
    inside = np.abs(apart - angle) <= tolerance * angle
    expected = set(zip(starts[inside].tolist(), ends[inside].tolist(), strict=True))
    result = select_turns(quaternions, angle, tolerance)
    assert set(zip(*map(np.ndarray.tolist, result), strict=True)) == expected


@pytest.mark.parametrize(
    "wrong",
    [
        {"rule": "nearer"},
        {"pairs": "some"},
        {"path": "both"},
        {"every": 0},
        {"every": 2, "pairs": "consecutive"},
        {"tolerance": 0.0},
        {"tolerance": 1.0},
    ],
)
def test_selections_that_mean_nothing_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError):
        Selection(**wrong)


@given(seed=seeds, length=st.floats(1.0, 10.0))
def test_sub_trajectories_are_as_long_as_they_say(seed: int, length: float) -> None:
    along = np.cumsum(np.random.default_rng(seed).exponential(0.02, size=1500))
    starts, ends = select(along, length, Selection())
    lengths = along[ends] - along[starts]
    steps = np.diff(along).max()
    assert (np.abs(lengths - length) <= max(0.01 * length, steps / 2.0) + 1e-9).all()
    # All starts that have a full length ahead of them are used.
    assert len(starts) >= np.count_nonzero(along + length <= along[-1])


def test_the_toolbox_takes_short_ones_at_the_end_and_ours_does_not() -> None:
    along = np.arange(0.0, 100.0, 0.1)
    actual = select(along, 40.0, Selection())
    theirs = select(along, 40.0, Selection("toolbox"))
    assert (along[actual[1]] - along[actual[0]]).min() > 0.985 * 40.0
    assert (along[theirs[1]] - along[theirs[0]]).min() < 0.85 * 40.0


def test_a_hole_loses_its_starts_and_shifts_no_others() -> None:
    along = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(13.0, 25.0, 0.1)])
    for rule in ("nearest", "toolbox"):
        starts, ends = select(along, 5.0, Selection(rule))
        deviation = np.abs(along[ends] - along[starts] - 5.0)
        assert deviation.max() < 0.2 * 5.0 + 1e-9
        assert (deviation > 0.1).mean() < (0.2 if rule == "nearest" else 0.4)
    starts, ends = select(along, 5.0, Selection())
    assert len(starts) < np.count_nonzero(along + 5.0 <= along[-1])


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("along", [[0.0], [0.0, 0.0, 0.0], [0.0, 1.0]])
def test_no_motion_makes_no_sub_trajectory(rule: str, along: list[float]) -> None:
    starts, ends = select(np.array(along), 8.0, Selection(rule))
    assert len(starts) == len(ends) == 0


@pytest.mark.parametrize(
    ("text", "length"),
    [
        ("8", Length(8.0, "m")),
        ("8m", Length(8.0, "m")),
        (" 0.5 s ", Length(0.5, "s")),
        ("10%", Length(10.0, "%")),
        ("1f", Length(1, "f")),
        ("5deg", Length(5.0, "deg")),
        ("0.2 rad", Length(0.2, "rad")),
        ("1e2m", Length(100.0, "m")),
    ],
)
def test_lengths_are_read_and_written(text: str, length: Length) -> None:
    assert Length.parse(text) == length
    assert Length.parse(str(length)) == length


@pytest.mark.parametrize(
    "text", ["", "m", "-8", "0", "8km", "8 8", "1.5f", "1.2.3", "nan", "inf", "1e999"]
)
def test_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(SettingsError):
        Length.parse(text)
