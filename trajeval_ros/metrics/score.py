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
    """

    bounds_m: tuple[float, ...]
    points: tuple[float, ...]
    best: float = 100.0

    def __post_init__(self) -> None:
        """Refuse tables that can't be meant."""
        if len(self.bounds_m) != len(self.points) or not self.points:
            raise SettingsError("a score needs as many points as bounds, and at least one")
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
