"""Errors as vectors: as long as the offline errors, and in the frames that are stated."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import make_estimate, make_groundtruth, seeds

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.metrics.absolute_errors import absolute_errors
from trajeval_ros.metrics.premises import Doubts, Premise
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.pairing import PairedStates


def lengths(vectors: np.ndarray | None) -> np.ndarray:
    assert vectors is not None
    return np.linalg.norm(vectors, axis=1)


@given(seed=seeds, axis=st.sampled_from(sorted(UP_AXES)))
def test_vectors_are_as_long_as_the_offline_errors(seed: int, axis: str) -> None:
    up = UpAxis(axis)
    groundtruth = dataclasses.replace(make_groundtruth(seed, 50), up=up)
    estimate = make_estimate(groundtruth, seed + 1)
    groundtruth = groundtruth[: len(estimate)]
    rotation = lie.to_matrix(lie.from_rotation_vector(np.array([0.1, -0.2, 0.3])))
    alignment = Similarity(rotation, np.array([1.0, 2.0, 3.0]), 1.1)
    expected = absolute_errors(groundtruth, alignment.trajectory(estimate))
    estimate = dataclasses.replace(estimate, stamps=groundtruth.stamps)
    result = PairErrors(PairedStates(groundtruth, estimate), alignment, Doubts())
    near = {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(lengths(result.position), expected.position_m, **near)
    np.testing.assert_allclose(lengths(result.along_cross_vertical), expected.position_m, **near)
    np.testing.assert_allclose(lengths(result.rotation_vector_deg), expected.rotation_deg, **near)
    if expected.velocity_mps is not None:
        np.testing.assert_allclose(lengths(result.velocity), expected.velocity_mps, **near)
    assert result.yaw_deg is not None
    assert result.attitude_deg is not None
    np.testing.assert_allclose(np.abs(result.yaw_deg), expected.yaw_deg, **near)
    np.testing.assert_allclose(result.tilt_deg, expected.tilt_deg, **near)
    # The part of the attitude error along the up axis is yaw, the rest is tilt.
    above = up.matrix[2]
    np.testing.assert_allclose(result.attitude_deg @ above, result.yaw_deg, **near)
    across = result.attitude_deg - np.outer(result.yaw_deg, above)
    np.testing.assert_allclose(lengths(across), expected.tilt_deg, **near)


def test_along_is_where_the_body_heads() -> None:
    rotated = lie.from_rotation_vector(np.array([[0.0, 0.0, np.pi / 2.0]]))  # faces y
    groundtruth = Trajectory(np.array([5]), np.array([[1.0, 2.0, 3.0]]), rotated)
    # Half a metre behind, and below.
    estimate = dataclasses.replace(groundtruth, positions=np.array([[1.0, 1.5, 2.9]]))
    pairs = PairedStates(groundtruth, estimate)
    result = PairErrors(pairs, Similarity.identity(), Doubts())
    assert result.along_cross_vertical is not None
    assert result.along_cross_vertical[0] == pytest.approx([0.5, 0.0, 0.1], abs=1e-12)
    assert result.velocity is None  # nobody measures one


def test_what_is_not_measured_or_not_determined_is_withheld() -> None:
    places = np.ones((4, 3))
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
    moving = np.array([[1.0, 0.0, 0.0]] * 3 + [[0.0, 0.0, 0.0]])
    stamps = np.arange(4)
    full, points = Trajectory(stamps, places, rotations, moving), Trajectory(stamps, places)
    without = PairErrors(PairedStates(points, full), Similarity.identity(), Doubts())
    assert without.rotation_deg is without.yaw_deg is without.tilt_deg is None
    assert without.rotation_vector_deg is without.attitude_deg is None
    assert without.along_cross_vertical is without.velocity is None
    reasons = dict.fromkeys((Premise.ALIGNMENT_ROTATION, Premise.BODY_ROTATION), "a line")
    opened = PairErrors(PairedStates(full, full), Similarity.identity(), Doubts(reasons))
    assert opened.rotation_deg is opened.attitude_deg is opened.velocity is None
    assert opened.along_cross_vertical is not None
    both = PairErrors(PairedStates(full, full), Similarity.identity(), Doubts())
    assert both.velocity is not None
    assert np.isnan(both.velocity).any(axis=1).tolist() == [False, False, False, True]
