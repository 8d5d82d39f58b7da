"""Paths without the details that nobody can see."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.report.line_thinning import MOST_POINTS, simplified, thinned

is_gap = AssociationRule().is_gap


@given(
    arrays.arrays(float, st.tuples(st.integers(1, 80), st.just(3)), elements=st.floats(-9.0, 9.0)),
    st.floats(0.001, 3.0),
    st.sets(st.integers(0, 78), max_size=4),
)
def test_a_simplified_path_stays_within_its_tolerance(
    path: Floats, tolerance_m: float, gaps: set[int]
) -> None:
    steps = np.where(np.isin(np.arange(len(path)), list(gaps)), 10**10, 10**8)
    stamps = np.cumsum(steps)
    left = simplified(path, stamps, is_gap, tolerance_m)
    pieces = np.split(path, np.flatnonzero(np.diff(stamps) > 10**9) + 1)
    ends = np.flatnonzero(np.isnan(left[:, 0]))
    result = [piece[np.isfinite(piece[:, 0])] for piece in np.split(left, ends)]
    assert len(result) == len(pieces)
    for piece, rows in zip(pieces, result, strict=True):
        np.testing.assert_array_equal(rows[[0, -1]], piece[[0, -1]])
        assert (rows[:, None] == piece[None]).all(axis=2).any(axis=1).all()
        assert distances_to_line(piece[:, :2], rows[:, :2]).max() <= tolerance_m * (1.0 + 1e-9)


def test_only_lines_of_more_rows_than_allowed_are_thinned() -> None:
    line = np.random.default_rng(2).normal(size=(101, 2))
    stamps = 10**8 * np.arange(len(line))
    np.testing.assert_array_equal(thinned(line[:100], stamps[:100], is_gap, most=100), line[:100])
    rows = thinned(line, stamps, is_gap, most=100)
    assert len(rows) <= 100
    np.testing.assert_array_equal(rows[[0, -1]], line[[0, -1]])
    assert {*line.argmin(axis=0), *line.argmax(axis=0)} <= {
        int(np.flatnonzero((line == row).all(axis=1))[0]) for row in rows
    }


def test_a_thinned_line_has_nearly_as_many_rows_as_allowed() -> None:
    line = np.random.default_rng(3).normal(size=(10_000, 2))
    rows = thinned(line, 10**8 * np.arange(len(line)), is_gap, most=1000)
    assert 900 < len(rows) <= 1002


@pytest.mark.slow
def test_a_simplified_path_has_few_rows() -> None:
    rotations = np.linspace(0.0, 2.0 * np.pi, 20_000)
    circle = np.stack([np.cos(rotations), np.sin(rotations), rotations], axis=1)
    # A chord of a circle is at most 1 - cos(a / 2) away from it.
    rows = simplified(circle, 10**7 * np.arange(len(circle)), is_gap, 1e-4)
    assert 2.0 * np.pi / np.arccos(1.0 - 1e-4) / 2.0 <= len(rows) <= 4.0 * np.pi / 0.0141
    # Small, since a tolerance of zero becomes the least one and is doubled from there.
    noise = 1e-12 * np.random.default_rng(1).normal(size=(25_000, 3))
    assert len(simplified(noise, 10**7 * np.arange(25_000), is_gap, 0.0)) <= MOST_POINTS


def distances_to_line(points: Floats, line: Floats) -> Floats:
    """Return the distances (N,) of points (N, 2) from a line of M vertices (M, 2)."""
    start, along = line[:-1], np.diff(line, axis=0)
    if not len(along):
        alone: Floats = np.hypot(*(points - line[0]).T)
        return alone
    beside = points[:, None] - start
    share = (beside * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    away: Floats = np.linalg.norm(
        beside - np.clip(share, 0.0, 1.0)[..., None] * along, axis=2
    ).min(axis=1)
    return away
