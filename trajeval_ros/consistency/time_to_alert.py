"""Time to alert: from an error beyond the alert limit to an alert."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS


@dataclass(frozen=True)
class TimeToAlert:
    """Times from the start of episodes with errors beyond the alert limit to an alert.

    Attributes:
        seconds: Times of the episodes with an alert; negative if the alert came first.
        missed: Number of episodes without an alert.
    """

    seconds: tuple[float, ...]
    missed: int

    @property
    def median(self) -> float | None:
        """Median time of the episodes with an alert; None if there is none."""
        return float(np.median(self.seconds)) if self.seconds else None

    @property
    def worst(self) -> float | None:
        """Longest time of the episodes with an alert; None if there is none."""
        return max(self.seconds, default=None)


def times_to_alert(
    stamps: Stamps,
    errors: Floats,
    levels: Floats,
    limit: float,
    warnings: Sequence[tuple[int, int]] = (),
) -> TimeToAlert:
    """Return the times from the starts of errors beyond a limit to the alerts.

    An alert is a protection level beyond the limit, or another warning. An alert that is active
    when the errors start counts from its own start.

    Args:
        stamps: (N,), nanoseconds, increasing.
        errors: (N,), magnitudes.
        levels: (N,), protection levels.
        limit: Largest tolerable error, in the unit of the errors.
        warnings: First and last timestamps of other warnings, nanoseconds.
    """
    alerts = np.array([*_spans(stamps, levels > limit), *warnings], np.int64).reshape(-1, 2)
    seconds = []
    missed = 0
    for begin, end in _spans(stamps, errors > limit):
        during = (alerts[:, 0] <= end) & (alerts[:, 1] >= begin)
        if during.any():
            seconds.append(int(alerts[during, 0].min() - begin) / NANOSECONDS)
        else:
            missed += 1
    return TimeToAlert(tuple(seconds), missed)


def _spans(stamps: Stamps, holds: Booleans) -> list[tuple[int, int]]:
    """Return the first and the last timestamp of every uninterrupted period."""
    edges = np.diff(holds.astype(np.int8), prepend=0, append=0)
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return list(zip(stamps[begins].tolist(), stamps[ends].tolist(), strict=True))
