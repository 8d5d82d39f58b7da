"""The data of a comparison's figures, for pages and for files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis

_MOST_POINTS = 20  # dots at a box; more hide it


@dataclass(frozen=True)
class Box:
    """A distribution: whiskers, quartiles and median, and the values if they are few.

    A single value is drawn as a dot without a box.
    """

    low: float
    first: float
    median: float
    third: float
    high: float
    points: tuple[float, ...] = ()

    @classmethod
    def of(cls, values: Sequence[float]) -> Box:
        """Return the box of values, with whiskers at the extremes."""
        low, first, median, third, high = np.percentile(values, [0, 25, 50, 75, 100]).tolist()
        points = tuple(values) if len(values) <= _MOST_POINTS else ()
        return cls(low, first, median, third, high, points)


@dataclass(frozen=True)
class BoxPlot:
    """Boxes by algorithm and group.

    Attributes:
        groups: Labels below the boxes: sequences or lengths.
        series: Name and boxes (one per group, or None) of every algorithm.
        axis: Label of the groups; "" if it is evident.
        label: The quantity with its unit.
    """

    groups: Sequence[str]
    series: Sequence[tuple[str, Sequence[Box | None]]]
    axis: str
    label: str


@dataclass(frozen=True, eq=False)
class PathsPlot:
    """Aligned paths and groundtruth, seen from above.

    Attributes:
        up: Up axis of the groundtruth's frame.
        truth: (M, 3), metres, height last.
        paths: Name and positions (M, 3) by position of the algorithm, which determines the colour.
    """

    up: UpAxis
    truth: Floats
    paths: Mapping[int, tuple[str, Floats]]


@dataclass(frozen=True, eq=False)
class ErrorsPlot:
    """Errors of algorithms over time.

    Attributes:
        series: Name and errors (M, 3) by position of the algorithm: time (s), position (m),
            rotation (deg, NaN if withheld).
    """

    series: Mapping[int, tuple[str, Floats]]
