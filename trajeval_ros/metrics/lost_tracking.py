"""Frozen and diverging estimates, detected in pairs in order of time, at a constant cost per pair.

Live and offline evaluation share this code, so that they report the same times.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.divergence import Divergence
from trajeval_ros.metrics.repeated_poses import MOVED_M, MOVED_OF_FIXES_M, RepeatedPoses
from trajeval_ros.metrics.tracking_loss import Loss

_BATCH = 8192  # pairs that are copied at a time


class LostTracking:
    """Detects losses in batches of pairs of any size."""

    def __init__(self, *, of_fixes: bool = False) -> None:
        """Create it before the first pair.

        Divergence from fixes and points is not detected: they are too few or too noisy.
        """
        self._repeats = RepeatedPoses(MOVED_OF_FIXES_M if of_fixes else MOVED_M)
        self._divergence = None if of_fixes else Divergence()

    def add(self, stamps: Stamps, groundtruth: Floats, estimate: Floats) -> None:
        """Take N pairs in order: stamps (N,), ns, and poses (N, 7 or more), NaN if unknown."""
        self._repeats.add(stamps, groundtruth, estimate)
        if self._divergence is not None:
            self._divergence.add(stamps, groundtruth[:, :3], estimate[:, :3])

    @property
    def losses(self) -> list[Loss]:
        """All losses so far, in order of their begin."""
        diverged = [] if self._divergence is None else self._divergence.losses
        return sorted((*self._repeats.losses, *diverged), key=lambda loss: loss.begin_ns)

    @property
    def present(self) -> Loss | None:
        """The loss that is not over, the earlier one of two; None if there is none."""
        return next((loss for loss in self.losses if not loss.is_over), None)

    @property
    def is_clear(self) -> bool:
        """Whether a loss that is detected later will begin at the newest pair or after it."""
        return self._repeats.is_clear and (self._divergence is None or self._divergence.is_clear)


def losses_of(groundtruth: Trajectory, estimate: Trajectory, *, of_fixes: bool) -> list[Loss]:
    """Return the losses in N pairs."""
    tracking = LostTracking(of_fixes=of_fixes)
    for batch in _batches(groundtruth, estimate):
        tracking.add(*batch)
    return tracking.losses


def frozen_ns(groundtruth: Trajectory, estimate: Trajectory, max_gap_s: float) -> int:
    """Return the time of frozen estimates in N pairs, nanoseconds, without longer steps."""
    repeats = RepeatedPoses(max_gap_s=max_gap_s)
    for batch in _batches(groundtruth, estimate):
        repeats.add(*batch)
    return repeats.time_ns


def _batches(
    groundtruth: Trajectory, estimate: Trajectory
) -> Iterator[tuple[Stamps, Floats, Floats]]:
    """Yield N pairs in order of time: stamps (n,), and poses (n, 7) of both sides."""
    stamps, order = estimate.stamps, None
    if (stamps[1:] < stamps[:-1]).any():
        order = np.argsort(stamps, kind="stable")
    for begin in range(0, len(stamps), _BATCH):
        rows: slice | Indices = slice(begin, begin + _BATCH)
        if order is not None:
            rows = order[rows]
        yield stamps[rows], _poses(groundtruth, rows), _poses(estimate, rows)


def _poses(trajectory: Trajectory, rows: slice | Indices) -> Floats:
    """Return some poses (n, 7) of a trajectory; without orientations, quaternions are NaN."""
    positions, turns = trajectory.positions[rows], trajectory.quaternions
    turns = np.full((len(positions), 4), np.nan) if turns is None else turns[rows]
    return np.hstack([positions, turns])
