"""Trajectories cut, merged, thinned, turned, aligned and synchronised."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import SAME_ROTATION_RAD, make_estimate, make_groundtruth, seeds

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.frame_axes import AXES, with_body_axes, with_world_axes
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import (
    PLANES,
    TimeSpan,
    at_rate,
    by_motion,
    evenly,
    every_nth,
    flattened,
    merged,
)
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.editing import Editing, edit
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import Protocol


def named(trajectory: Trajectory, name: str = "run") -> Trajectory:
    return dataclasses.replace(trajectory, name=name)


def the_only(trajectory: Trajectory, editing: Editing, reference: Trajectory | None = None):
    (edited,) = edit([named(trajectory)], reference, editing)
    return edited


def apart_rad(one: Trajectory, other: Trajectory) -> float:
    assert one.rotations is not None
    assert other.rotations is not None
    return float((one.rotations * other.rotations.inv()).magnitude().max())


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ("2", "3.5", (12_000_000_000, 13_500_000_000)),
        ("@11.000000001", None, (11_000_000_001, None)),
        (None, "@12", (None, 12_000_000_000)),
        ("@11", "+1", (11_000_000_000, 12_000_000_000)),
        ("1.5", "+1", (11_500_000_000, 12_500_000_000)),
        (None, "+2", (None, 12_000_000_000)),
        ("1", "@12", (11_000_000_000, 12_000_000_000)),
    ],
)
def test_times_as_they_are_said(start: str | None, end: str | None, expected: object) -> None:
    span = TimeSpan.parse(start, end)
    assert span is not None
    assert span.stamps(10_000_000_000) == expected


@pytest.mark.parametrize(
    ("start", "end"), [("x", None), ("-1", None), ("nan", None), ("5", "3"), ("1e12", None)]
)
def test_times_that_are_none(start: str, end: str | None) -> None:
    with pytest.raises(SettingsError, match=r"start '.*' is not valid|before start"):
        TimeSpan.parse(start, end)


@given(seeds, st.integers(0, 4 * 10**9), st.integers(2 * 10**8, 8 * 10**9))
def test_a_cut_keeps_what_is_within(seed: int, start: int, duration: int) -> None:
    truth = make_groundtruth(seed)
    cut = the_only(
        truth, Editing(time_span=TimeSpan.parse(f"{start}e-9", f"+{duration}e-9"))
    ).trajectory
    since = truth.stamps - truth.stamps[0]
    inside = (since >= start) & (since <= start + duration)
    np.testing.assert_array_equal(cut.stamps, truth.stamps[inside])


def test_a_cut_counts_from_the_references_start() -> None:
    truth = make_groundtruth(1)
    edited = the_only(truth[40:], Editing(time_span=TimeSpan.parse("5", None)), named(truth, "gt"))
    after = truth.stamps >= truth.stamps[0] + 5_000_000_000
    np.testing.assert_array_equal(edited.trajectory.stamps, truth.stamps[after])
    with pytest.raises(InputError, match=r"^run: no pose in the time span"):
        the_only(truth, Editing(time_span=TimeSpan.parse("1000", None)))


@given(seeds, st.integers(1, 118))
def test_parts_merge_to_the_whole(seed: int, place: int) -> None:
    truth = make_groundtruth(seed)
    whole = merged([truth[place:], truth[: place + 1]])
    for column in ("stamps", "positions", "quaternions", "velocities"):
        np.testing.assert_array_equal(getattr(whole, column), getattr(truth, column))
    assert whole.reading.dropped == {"duplicate_stamp": 1}


def test_what_is_not_in_one_frame_is_not_merged() -> None:
    truth = make_groundtruth(1)
    parts = [named(dataclasses.replace(truth, frame=frame), frame) for frame in ("map", "odom")]
    with pytest.raises(InputError, match=r"their frame differs, map and odom"):
        merged(parts)


@given(st.integers(1, 300), st.integers(1, 300))
def test_even_thinning(count: int, required: int) -> None:
    rows = evenly(count, required)
    assert len(rows) == min(count, required)
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    if len(rows) > 1:
        assert rows[-1] == count - 1
        assert np.ptp(np.diff(rows)) <= 1


@given(st.integers(0, 300), st.integers(1, 300))
def test_every_nth_takes_the_least_step_that_leaves_so_few(count: int, most: int) -> None:
    rows = np.arange(count)[every_nth(count, most)]
    if not count:
        assert not len(rows)
        return
    step = int(rows[1] - rows[0]) if len(rows) > 1 else count
    assert rows[0] == 0
    assert len(rows) <= most
    assert step == 1 or len(np.arange(count)[:: step - 1]) > most


def test_a_rate_that_divides_is_exact() -> None:
    stamps = 1_403_636_580_838_555_574 + 5_000_000 * np.arange(200_000)
    np.testing.assert_array_equal(at_rate(stamps, 20.0), np.arange(0, 200_000, 10))
    np.testing.assert_array_equal(at_rate(stamps, 1000.0), np.arange(200_000))


@given(seeds, st.floats(0.05, 3.0), st.floats(0.05, 3.0))
def test_the_motion_filter_is_its_definition(seed: int, distance: float, angle: float) -> None:
    truth = make_groundtruth(seed)
    rotations = truth.rotations
    assert rotations is not None
    kept = [0]
    for row in range(1, len(truth)):
        moved = np.linalg.norm(truth.positions[row] - truth.positions[kept[-1]])
        rotated = (rotations[kept[-1]].inv() * rotations[row]).magnitude()
        if moved >= distance or rotated >= angle:
            kept.append(row)
    assert by_motion(truth, distance, angle).tolist() == kept


@given(seeds, st.sampled_from(AXES))
def test_axes_there_and_back(seed: int, axes: str) -> None:
    truth = make_groundtruth(seed)
    other = AXES[1 - AXES.index(axes)]
    for rotation in (with_world_axes, with_body_axes):
        back = rotation(rotation(truth, other), axes)
        np.testing.assert_array_equal(back.positions, truth.positions)
        np.testing.assert_array_equal(back.velocities, truth.velocities)
        assert apart_rad(back, truth) <= SAME_ROTATION_RAD


def test_a_camera_that_drives_ahead() -> None:
    # Along its z axis, without turning: in ROS's axes along x, upright.
    stamps = np.arange(3) * 10**9
    ahead = Trajectory(
        stamps, np.outer(np.arange(3.0), [0.0, 0.0, 1.0]), np.tile([0, 0, 0, 1.0], (3, 1))
    )
    driven = the_only(ahead, Editing(world_axes="ros", body_axes="ros")).trajectory
    np.testing.assert_array_equal(driven.positions, np.outer(np.arange(3.0), [1.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.abs(driven.quaternions), ahead.quaternions, atol=1e-15)
    assert driven.up.name == "z"
    optical = with_world_axes(driven, "optical")
    with pytest.raises(InputError, match="already has optical axes"):
        with_world_axes(optical, "optical")


def transformation(seed: int, scale: float = 1.0) -> Similarity:
    random = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed % 2**31).as_matrix()
    return Similarity(rotation, random.normal(size=3), scale)


@given(seeds)
def test_transformations_are_products_of_matrices(seed: int) -> None:
    truth, left, right = (
        make_groundtruth(seed),
        transformation(seed, 1.7),
        transformation(seed + 1),
    )
    result = the_only(truth, Editing(left=left, right=right)).trajectory
    rotations = lie.to_matrix(np.asarray(truth.quaternions))
    moved = truth.positions + rotations @ right.translation
    np.testing.assert_allclose(result.positions, left.positions(moved), rtol=0, atol=1e-12)
    expected = left.rotation @ rotations @ right.rotation
    np.testing.assert_allclose(
        lie.to_matrix(np.asarray(result.quaternions)), expected, rtol=0, atol=1e-13
    )


@given(seeds, st.sampled_from(list(PLANES)))
def test_a_projection_is_flat_and_one(seed: int, plane: str) -> None:
    flat = flattened(make_groundtruth(seed), plane)
    normal = np.eye(3)[PLANES[plane]]
    assert not (flat.positions @ normal).any()
    rotated = lie.to_matrix(np.asarray(flat.quaternions)) @ normal
    np.testing.assert_allclose(rotated, np.tile(normal, (len(flat), 1)), atol=1e-15)
    again = flattened(flat, plane)
    np.testing.assert_array_equal(again.positions, flat.positions)
    assert apart_rad(again, flat) <= SAME_ROTATION_RAD


@pytest.mark.parametrize("gauge", list(Gauge))
def test_aligned_and_synchronised_as_an_evaluation_is(gauge: Gauge) -> None:
    truth = make_groundtruth(5)
    estimate = transformation(3).trajectory(make_estimate(truth, 6))
    protocol = Protocol(gauge=gauge)
    result = the_only(
        estimate, Editing(align=protocol, synchronise=protocol.association), named(truth, "gt")
    )
    expected = evaluate(truth, estimate, protocol)
    axes = 2 if gauge is Gauge.PLANAR else 3
    np.testing.assert_allclose(
        result.trajectory.positions[:, :axes], expected.aligned.positions[:, :axes], atol=1e-9
    )
    assert result.reference is not None
    np.testing.assert_array_equal(result.reference.stamps, expected.association.groundtruth.stamps)
    np.testing.assert_array_equal(result.trajectory.stamps, result.reference.stamps)


def test_thinning_keeps_rows_together() -> None:
    truth = make_groundtruth(5)
    editing = Editing(synchronise=AssociationRule(), motion=(0.5, 0.2), poses=7)
    result = the_only(make_estimate(truth, 6), editing, named(truth, "gt"))
    assert result.reference is not None
    np.testing.assert_array_equal(result.trajectory.stamps, result.reference.stamps)
    assert len(result.trajectory) == 7


@pytest.mark.parametrize(
    "wrong",
    [
        {"poses": 0},
        {"rate_hz": 0.0},
        {"rate_hz": float("nan")},
        {"motion": (0.0, 0.0)},
        {"motion": (-1.0, 1.0)},
        {"plane": "xx"},
        {"world_axes": "camera"},
        {"right": Similarity(np.eye(3), np.zeros(3), 2.0)},
    ],
)
def test_what_can_not_be_meant_is_refused(wrong: dict) -> None:
    with pytest.raises(SettingsError):
        Editing(**wrong)
