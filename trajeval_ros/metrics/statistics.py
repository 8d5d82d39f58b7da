"""Named statistics of a set of errors. A number without its name is not a result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats


@dataclass(frozen=True, repr=False)
class Statistics:
    """Statistics of errors that are never negative; each has the unit of the errors.

    `std` is the population's (ddof 0), as in the authors' toolbox and in evo; `p95` is the
    sample's 95th percentile (linear between order statistics), not a normal distribution's.

    Example:
        >>> from trajeval_ros import Statistics
        >>> Statistics(rmse=5.0, mean=4.0, median=4.0, std=3.0, min=1.0, max=7.0, p95=6.7, count=2)
        <Statistics rmse 5, mean 4, median 4, std 3, min 1, max 7, p95 6.7, count 2>
    """

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    p95: float
    count: int

    def __repr__(self) -> str:
        """Return a line to read; `dataclasses.asdict` has all digits."""
        names = ("rmse", "mean", "median", "std", "min", "max", "p95")
        values = ", ".join(f"{name} {getattr(self, name):.4g}" for name in names)
        return f"<Statistics {values}, count {self.count}>"

    def scaled(self, factor: float) -> Statistics:
        """Return the statistics of the same errors in another unit, `factor` > 0 times as many."""
        return Statistics(
            self.rmse * factor,
            self.mean * factor,
            self.median * factor,
            self.std * factor,
            self.min * factor,
            self.max * factor,
            self.p95 * factor,
            self.count,
        )


def statistics_of(errors: Floats | None) -> Statistics | None:
    """Return the statistics of (N,) errors; None, never zeros, where there are no errors.

    The root mean square is eq. (24) of the tutorial.
    """
    if errors is None or len(errors) == 0:
        return None
    ordered = np.sort(errors)
    mean = float(ordered.mean())
    return Statistics(
        rmse=float(np.sqrt(np.mean(np.square(ordered)))),
        mean=mean,
        median=float(quantile(ordered, 0.5)),
        std=float(np.sqrt(np.mean(np.square(ordered - mean)))),
        min=float(ordered[0]),
        max=float(ordered[-1]),
        p95=float(quantile(ordered, 0.95)),
        count=len(ordered),
    )


def round_below(value: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that a value > 0 holds."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value))


def quantile(ordered: Floats, share: float) -> float:
    """Return a quantile of sorted values (N,), interpolated linearly: numpy's default."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))
