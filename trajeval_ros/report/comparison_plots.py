"""What the figures of a comparison show, whether they are drawn for a page or as files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis

_MOST_POINTS = 20  # beside a box; more of them hide it


@dataclass(frozen=True)
class Box:
    """A distribution: whiskers, quartiles and median, and the points themselves if few.

    A single point is drawn as one, without a box.
    """

    low: float
    first: float
    median: float
    third: float
    high: float
    points: tuple[float, ...] = ()

    @classmethod
    def of(cls, values: Sequence[float]) -> Box:
        """Return the box of values, with whiskers at the least and the largest."""
        low, first, median, third, high = np.percentile(values, [0, 25, 50, 75, 100]).tolist()
        points = tuple(values) if len(values) <= _MOST_POINTS else ()
        return cls(low, first, median, third, high, points)


@dataclass(frozen=True)
class BoxPlot:
    """A box for each algorithm in each group.

    Attributes:
        groups: What stands below the boxes: sequences or lengths.
        series: Name and boxes, group by group, of each algorithm.
        axis: What the groups are; "" if their names say it.
        label: What is measured, with its unit.
    """

    groups: Sequence[str]
    series: Sequence[tuple[str, Sequence[Box | None]]]
    axis: str
    label: str


@dataclass(frozen=True, eq=False)
class PathsPlot:
    """Aligned paths over the groundtruth, from above.

    Attributes:
        up: Which axis of the groundtruth's frame points up.
        truth: (M, 3), with height last.
        paths: Name and positions (M, 3) by place of the algorithm, which decides the colour.
    """

    up: UpAxis
    truth: Floats
    paths: Mapping[int, tuple[str, Floats]]


@dataclass(frozen=True, eq=False)
class ErrorsPlot:
    """Errors of each algorithm over time.

    Attributes:
        series: Name and errors (M, 3) by place of the algorithm: time (s), position (m), rotation
            (deg, NaN where withheld).
    """

    series: Mapping[int, tuple[str, Floats]]
