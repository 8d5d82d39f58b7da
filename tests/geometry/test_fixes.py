"""Usable GNSS fixes, their frame and their standard deviations, in cases worked out by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.fixes import Fixes, quality_of


def fixes(**changed: Any) -> Fixes:
    given: dict[str, Any] = {
        "places": np.array([[47.0, 8.0, 400.0], [47.001, 8.001, 401.0], [47.002, 8.0, 402.0]]),
        "status": np.array([0, 1, 2]),
        "covariance_types": np.array([2, 2, 3]),
        "covariances": np.array([np.diag(np.square([1.0, s, 5.0])) for s in (2.0, 0.5, 3.0)]),
    }
    return Fixes(**{**given, **changed})


def test_fixes_have_standard_deviations_if_known() -> None:
    some = fixes(covariance_types=np.array([2, 0, 3]))
    np.testing.assert_allclose(some.sigma_level_m, [2.0, np.nan, 3.0])
    np.testing.assert_allclose(some.sigma_up_m, [5.0, np.nan, 5.0])
    zero = some.covariances.copy()
    zero[0, 2, 2], zero[2, 0, 1] = 0.0, np.nan
    assert dataclasses.replace(some, covariances=zero).known.tolist() == [False, False, False]
    correlated = fixes(
        covariances=np.tile(np.array([[2.0, 1, 0], [1, 2, 0], [0, 0, 9]]), (3, 1, 1))
    )
    np.testing.assert_allclose(correlated.sigma_level_m, np.sqrt(3.0))
    np.testing.assert_allclose(correlated.sigma_up_m, 3.0)
    text = quality_of(some)
    assert "1 of status 0, 1 of status 1, 1 of status 2; standard deviation of 2 of them" in text
    assert "2 to 3 m horizontal, 5 to 5 m vertical, covariance diagonal and known" in text


@pytest.mark.parametrize(
    ("changed", "rule", "dropped"),
    [
        ({}, {}, {}),
        ({"status": np.array([-1, 0, 0])}, {}, {"no_fix": [0]}),
        ({"status": np.array([-2, 0, 0])}, {}, {}),
        (
            {"status": np.array([-2, 0, 0]), "covariance_types": np.array([0, 0, 0])},
            {},
            {"no_fix": [0]},
        ),
        ({}, {"min_status": 0}, {}),
        ({}, {"min_status": 1}, {"below_fix_status": [0]}),
        ({}, {"min_status": 2}, {"below_fix_status": [0, 1]}),
        ({}, {"max_sigma_m": 2.0}, {"fix_sigma_above_limit": [2]}),
        ({}, {"max_sigma_m": 1.0}, {"fix_sigma_above_limit": [0, 2]}),
        (
            {"covariance_types": np.array([2, 0, 3])},
            {"max_sigma_m": 9.0},
            {"fix_sigma_unknown": [1]},
        ),
        (
            {"places": np.array([[90.0, 360.0, 1.0], [-90.1, 0.1, 1.0], [1.0, -360.1, 1.0]])},
            {},
            {"not_finite": [1, 2]},
        ),
        (
            {"places": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [np.nan, 0.0, 1.0]])},
            {},
            {"no_fix": [0], "not_finite": [2]},
        ),
        (
            {"places": np.array([[1.0, 0.0, np.nan], [1.0, 1.0, np.inf], [1.0, 0.0, 1.0]])},
            {},
            {"no_height": [0], "not_finite": [1]},
        ),
    ],
)
def test_fixes_that_are_usable(
    changed: dict[str, Any], rule: dict[str, Any], dropped: dict[str, list[int]]
) -> None:
    kept, counts = FixRule(**rule).usable(fixes(**changed), level=False)
    rows = sorted(row for item in dropped.values() for row in item)
    assert np.flatnonzero(~kept).tolist() == rows
    assert {name: n for name, n in counts.items() if n} == {k: len(v) for k, v in dropped.items()}
    level, _ = FixRule(**rule).usable(fixes(**changed), level=True)
    rows = sorted(row for name, item in dropped.items() if name != "no_height" for row in item)
    assert np.flatnonzero(~level).tolist() == rows
