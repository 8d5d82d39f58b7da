"""Live detection of restarts and large corrections of an estimate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.travelled import StepDifferences
from trajeval_ros.online.state_rows import POSITION, QUATERNION, Pairs

_MEMORY = 200.0  # steps in the running means of usual steps


@dataclass(frozen=True)
class Jump:
    """A step of the estimate that is no motion of the robot."""

    stamp: int  # timestamp of the first pair after it, nanoseconds
    position_m: float  # difference between the distances of estimate and groundtruth
    rotation_deg: float  # difference between the angles of estimate and groundtruth
    declared: bool = False  # whether the estimator declares it


class JumpDetector:
    """Examines the steps between pairs as they arrive."""

    def __init__(self) -> None:
        self.count = 0  # number of jumps so far
        self._newest: Pairs | None = None
        self._typical_m = self._typical_deg = 0.0
        self._weight = 0.0
        self._were_jumps = np.zeros(2, dtype=bool)  # the newest steps
        self._declared: list[int] = []  # timestamps of resets that no step has passed yet

    def skip(self) -> None:
        """Do not examine the step to the next pair."""
        self._newest = None

    def declare(self, stamps: Iterable[int]) -> None:
        """Take the timestamps of the first poses after declared resets, nanoseconds."""
        self._declared += stamps

    def update(self, pairs: Pairs, scale: float) -> list[Jump]:
        """Return the jumps among new pairs, in order of time; late pairs are ignored."""
        newest = self._newest
        if newest is not None:
            new = pairs.stamps > newest.stamps[0]
            pairs = Pairs(
                np.concatenate([newest.stamps, pairs.stamps[new]]),
                np.concatenate([newest.groundtruth, pairs.groundtruth[new]]),
                np.concatenate([newest.estimate, pairs.estimate[new]]),
            )
        if not len(pairs.stamps):
            return []
        self._newest = pairs.picked(slice(-1, None))
        groundtruth, estimate = pairs.groundtruth, pairs.estimate
        turned = pairs.have_rotations
        steps = StepDifferences.between(
            groundtruth[:, POSITION],
            estimate[:, POSITION],
            groundtruth[:, QUATERNION] if turned else None,
            estimate[:, QUATERNION] if turned else None,
            scale,
        )
        found = self._alone(steps.jumps(self._typical_m, self._typical_deg), len(steps.true_m))
        declared = self._declared_steps(pairs.stamps)
        jumps = np.union1d(found, declared)
        self._learn(steps, jumps)
        self.count += len(jumps)
        return [
            Jump(
                int(pairs.stamps[row + 1]),
                float(steps.position_m[row]),
                float(steps.rotation_deg[row]),
                row in declared,
            )
            for row in jumps.tolist()
        ]

    def _declared_steps(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the steps between pairs (N,) in which a reset was declared."""
        due = [each for each in self._declared if each <= stamps[-1]]
        self._declared = [each for each in self._declared if each > stamps[-1]]
        ends = np.searchsorted(stamps, np.array(due, dtype=np.int64))
        steps: NDArray[np.int64] = np.unique(ends[ends > 0] - 1)
        return steps

    def _alone(self, jumps: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Return the jumps among `count` new steps that do not follow two others.

        Three in a row are a property of the estimate, such as a unit of millimetres.
        """
        are_jumps = np.concatenate([self._were_jumps, np.zeros(count, dtype=bool)])
        are_jumps[jumps + 2] = True
        self._were_jumps = are_jumps[count:]
        alone: NDArray[np.int64] = jumps[~(are_jumps[jumps] & are_jumps[jumps + 1])]
        return alone

    def _learn(self, steps: StepDifferences, jumps: NDArray[np.int64]) -> None:
        usual = np.ones(len(steps.true_m), dtype=bool)
        usual[jumps] = False
        new = int(np.count_nonzero(usual))
        if not new:
            return
        self._weight = min(self._weight, _MEMORY) + new
        share = new / self._weight
        self._typical_m += share * (float(steps.position_m[usual].mean()) - self._typical_m)
        self._typical_deg += share * (float(steps.rotation_deg[usual].mean()) - self._typical_deg)
