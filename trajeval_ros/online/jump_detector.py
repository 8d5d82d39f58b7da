"""Restarts and large corrections of an estimate, noticed as they happen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.diagnosis.jumps import Steps
from trajeval_ros.online.state_rows import POSITION, QUATERNION, Pairs

_MEMORY = 200.0  # steps over which a usual step is known


@dataclass(frozen=True)
class Jump:
    """A step that is no motion of the robot.

    Attributes:
        stamp: Of the first pair behind it, nanoseconds.
        position_m: By how much the distance moved differs from the groundtruth's.
        rotation_deg: By how much the angle turned differs from the groundtruth's.
    """

    stamp: int
    position_m: float
    rotation_deg: float


class JumpDetector:
    """Looks at the steps between pairs as they come.

    Attributes:
        count: Number of jumps so far.
    """

    def __init__(self) -> None:
        """Create it; a usual step is not known yet."""
        self.count = 0
        self._newest: Pairs | None = None
        self._typical_m = self._typical_deg = 0.0
        self._weight = 0.0
        self._were_jumps = np.zeros(2, dtype=bool)  # the newest steps

    def update(self, pairs: Pairs, scale: float) -> list[Jump]:
        """Return the jumps among new pairs, sorted by stamp; late ones are passed over."""
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
        truth, estimate = pairs.groundtruth, pairs.estimate
        turned = not np.isnan(truth[0, 3] + estimate[0, 3])
        steps = Steps.between(
            truth[:, POSITION],
            estimate[:, POSITION],
            truth[:, QUATERNION] if turned else None,
            estimate[:, QUATERNION] if turned else None,
            scale,
        )
        found = self._alone(steps.jumps(self._typical_m, self._typical_deg), len(steps.true_m))
        self._learn(steps, found)
        self.count += len(found)
        return [
            Jump(
                int(pairs.stamps[row + 1]),
                float(steps.position_m[row]),
                float(steps.rotation_deg[row]),
            )
            for row in found.tolist()
        ]

    def _alone(self, jumps: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Return which jumps among so many new steps don't follow two others.

        The third in a row is how the estimate moves, such as one in millimetres.
        """
        are_jumps = np.concatenate([self._were_jumps, np.zeros(count, dtype=bool)])
        are_jumps[jumps + 2] = True
        self._were_jumps = are_jumps[count:]
        alone: NDArray[np.int64] = jumps[~(are_jumps[jumps] & are_jumps[jumps + 1])]
        return alone

    def _learn(self, steps: Steps, jumps: NDArray[np.int64]) -> None:
        """Take the other steps into running means."""
        usual = np.ones(len(steps.true_m), dtype=bool)
        usual[jumps] = False
        new = int(np.count_nonzero(usual))
        if not new:
            return
        self._weight = min(self._weight, _MEMORY) + new
        share = new / self._weight
        self._typical_m += share * (float(steps.position_m[usual].mean()) - self._typical_m)
        self._typical_deg += share * (float(steps.rotation_deg[usual].mean()) - self._typical_deg)
