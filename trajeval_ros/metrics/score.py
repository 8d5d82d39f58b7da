"""A score by points: the closer to a surveyed point, the more, and nothing for a missing one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats


@dataclass(frozen=True)
class PointTable:
    """How many points an error is worth.

    Attributes:
        bounds_m: Increasing, metres; an error under the first is worth the first of `points`.
        points: As many; an error of the last bound or more is worth nothing.
        best: The score of a run that is right everywhere.
        dimensions: Of the errors: 3, or 2 for their level part.
    """

    bounds_m: tuple[float, ...]
    points: tuple[float, ...]
    best: float = 100.0
    dimensions: int = 3

    def __post_init__(self) -> None:
        """Refuse tables that can't be meant."""
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
        """Score a run.

        Args:
            errors_m: (N,), of the points that were found.
            references: How many there are in all.
        """
        worth = np.array([*self.points, 0.0])
        place = np.searchsorted(np.array(self.bounds_m), errors_m, side="right")
        total = float(worth[place].sum())
        return Score(
            value=self.best * total / (self.points[0] * references),
            best=self.best,
            bounds_m=self.bounds_m,
            found=tuple(int(each) for each in np.bincount(place, minlength=len(worth))),
            missing=references - len(errors_m),
            references=references,
        )


@dataclass(frozen=True)
class KnotTable:
    """How many points an error is worth, linearly between knots and nothing beyond the last.

    Two knots, worth 1 and 0, give the area under the curve of recall up to the last knot.

    Attributes:
        knots_m: Increasing from 0, metres.
        points: As many, not increasing.
        best: The score of a run that is right everywhere.
        dimensions: Of the errors: 3, or 2 for their level part.
    """

    knots_m: tuple[float, ...]
    points: tuple[float, ...]
    best: float = 100.0
    dimensions: int = 3

    def __post_init__(self) -> None:
        """Refuse tables that can't be meant."""
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
        """Score a run, as `PointTable.score` does."""
        worth = np.interp(errors_m, self.knots_m, self.points, right=0.0)
        bounds = self.knots_m[1:]
        place = np.searchsorted(np.array(bounds), errors_m, side="right")
        return Score(
            value=self.best * float(worth.sum()) / (self.points[0] * references),
            best=self.best,
            bounds_m=bounds,
            found=tuple(int(each) for each in np.bincount(place, minlength=len(self.points))),
            missing=references - len(errors_m),
            references=references,
        )


@dataclass(frozen=True)
class RecallRule:
    """Up to which errors a point counts as found.

    Attributes:
        bounds_m: Metres, themselves included.
        dimensions: Of the errors: 3, or 2 for their level part.
    """

    bounds_m: tuple[float, ...]
    dimensions: int = 3

    def __post_init__(self) -> None:
        """Refuse bounds that can't be meant."""
        _require_dimensions(self.dimensions)
        if not self.bounds_m or min(self.bounds_m) <= 0.0:
            raise SettingsError("recall bounds must be greater than 0, in metres")

    def recall(self, errors_m: Floats, references: int) -> Recall:
        """Return the shares of all references with an error within the bounds, in percent."""
        within = (
            100.0 * np.count_nonzero(errors_m <= each) / references for each in self.bounds_m
        )
        return Recall(self.bounds_m, self.dimensions, tuple(within))


@dataclass(frozen=True)
class Recall:
    """How many of the groundtruth's points an estimate finds.

    Attributes:
        bounds_m: As in the rule.
        dimensions: As in the rule.
        percent: For each bound, of all points; missing ones are not found.
    """

    bounds_m: tuple[float, ...]
    dimensions: int
    percent: tuple[float, ...]


@dataclass(frozen=True)
class Score:
    """The score of a run.

    Attributes:
        value: From 0 to `best`.
        best: What can be had.
        bounds_m: As in the table.
        found: Number of points under each bound, and of those beyond the last.
        missing: Points without an estimate: they are worth nothing.
        references: All points.
    """

    value: float
    best: float
    bounds_m: tuple[float, ...]
    found: tuple[int, ...]
    missing: int
    references: int


def _require_dimensions(dimensions: int) -> None:
    if dimensions not in (2, 3):
        raise SettingsError(f"dimensions must be 2 (horizontal) or 3, not {dimensions}")
