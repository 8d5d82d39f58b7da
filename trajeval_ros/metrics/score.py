"""Scores by points per surveyed position; missing positions have no points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.association import Association


@dataclass(frozen=True)
class PointTable:
    """Points per position error, constant between bounds."""

    bounds_m: tuple[float, ...]  # increasing bounds; an error below the first has the first points
    # Points, as many as bounds; an error of at least the last bound has none.
    points: tuple[float, ...]
    best: float = 100.0  # score of a run without errors
    dimensions: int = 3  # 3, or 2 for horizontal errors

    def __post_init__(self) -> None:
        _require_dimensions(self.dimensions)
        if len(self.bounds_m) != len(self.points) or not self.points:
            raise SettingsError(
                "a score needs one number of points per bound, and at least one bound"
            )
        if self.bounds_m[0] <= 0.0 or not (np.diff(self.bounds_m) > 0.0).all():
            raise SettingsError("the bounds of a score must be positive and increase")
        if not (self.points[0] > 0.0 and self.best > 0.0):
            raise SettingsError("the first points and the best score must be positive")

    def score(self, errors_m: Floats, references: int) -> Score:
        """Return the score from the errors (N,), metres, of the points that have an estimate."""
        worth = np.array([*self.points, 0.0])
        place = np.searchsorted(np.array(self.bounds_m), errors_m, side="right")
        total = float(worth[place].sum())
        return Score(
            value=self.best * total / (self.points[0] * references),
            best=self.best,
            bounds_m=self.bounds_m,
            counts=tuple(int(count) for count in np.bincount(place, minlength=len(worth))),
            missing=references - len(errors_m),
            references=references,
        )


@dataclass(frozen=True)
class KnotTable:
    """Points per position error, linear between knots and zero beyond the last.

    Two knots with points 1 and 0 give the area under the recall curve up to the last knot.
    """

    knots_m: tuple[float, ...]  # errors, increasing from 0, metres
    points: tuple[float, ...]  # points, as many as knots, not increasing
    best: float = 100.0  # score of a run without errors
    dimensions: int = 3  # 3, or 2 for horizontal errors

    def __post_init__(self) -> None:
        _require_dimensions(self.dimensions)
        if len(self.knots_m) != len(self.points) or len(self.points) < 2:
            raise SettingsError(
                "a score needs one number of points per knot, and at least two knots"
            )
        if self.knots_m[0] != 0.0 or not (np.diff(self.knots_m) > 0.0).all():
            raise SettingsError("the knots of a score must start at 0 and increase")
        worth = np.array(self.points)
        if not (worth[0] > 0.0 and (np.diff(worth) <= 0.0).all() and worth[-1] >= 0.0):
            raise SettingsError("the points of knots must be positive at 0 m and not increase")
        if not self.best > 0.0:
            raise SettingsError("the best score must be positive")

    def score(self, errors_m: Floats, references: int) -> Score:
        """Return the score from the errors (N,), metres, of the points that have an estimate."""
        worth = np.interp(errors_m, self.knots_m, self.points, right=0.0)
        bounds = self.knots_m[1:]
        place = np.searchsorted(np.array(bounds), errors_m, side="right")
        return Score(
            value=self.best * float(worth.sum()) / (self.points[0] * references),
            best=self.best,
            bounds_m=bounds,
            counts=tuple(int(count) for count in np.bincount(place, minlength=len(self.points))),
            missing=references - len(errors_m),
            references=references,
        )


@dataclass(frozen=True)
class RecallRule:
    """Error bounds within which a point counts as found."""

    bounds_m: tuple[float, ...]  # bounds in metres, inclusive
    dimensions: int = 3  # 3, or 2 for horizontal errors

    def __post_init__(self) -> None:
        _require_dimensions(self.dimensions)
        if not self.bounds_m or min(self.bounds_m) <= 0.0:
            raise SettingsError("recall bounds must be greater than 0, in metres")

    def recall(self, errors_m: Floats, references: int) -> Recall:
        """Return the percentage of all points with an error within every bound."""
        within = (
            100.0 * np.count_nonzero(errors_m <= bound) / references for bound in self.bounds_m
        )
        return Recall(self.bounds_m, self.dimensions, tuple(within))


@dataclass(frozen=True)
class Recall:
    """Percentages of the groundtruth's points that are found."""

    bounds_m: tuple[float, ...]  # error bounds, metres
    dimensions: int  # 3, or 2 for horizontal errors
    # Percentage of all points within every bound; missing points are not found.
    percent: tuple[float, ...]


@dataclass(frozen=True)
class Score:
    """The score of a run."""

    value: float  # from 0 to `best`
    best: float  # score of a run without errors
    bounds_m: tuple[float, ...]  # error bounds, metres
    counts: tuple[int, ...]  # number of points below every bound, and beyond the last one
    missing: int  # number of points without an estimate; they have no points
    references: int  # number of all points


def _require_dimensions(dimensions: int) -> None:
    if dimensions not in (2, 3):
        raise SettingsError(f"dimensions must be 2 (horizontal) or 3, not {dimensions}")


def point_errors(
    pairs: Association, groundtruth: Trajectory, absolute: AbsoluteErrors, dimensions: int
) -> Floats:
    """Return the position errors of the groundtruth states in a pair, (K,), metres."""
    errors = absolute.horizontal_m if dimensions == 2 else absolute.position_m
    assert errors is not None
    return errors[_nearest_of_each_point(pairs, groundtruth)]


def _nearest_of_each_point(pairs: Association, groundtruth: Trajectory) -> NDArray[np.int64]:
    """Return, for every groundtruth state in a pair, the row of the pair closest in time, (K,)."""
    points = pairs.groundtruth_rows
    assert points is not None
    apart = np.abs(groundtruth.stamps[points] - pairs.estimate.stamps)
    closest_first = np.lexsort((apart, points))
    return closest_first[np.unique(points[closest_first], return_index=True)[1]]
