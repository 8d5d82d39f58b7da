"""The tests of a gate for a spread of trials that the user gives: z-tests of normal logarithms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from trajeval_ros.batch.common_change import Change
from trajeval_ros.batch.gate_tests import GateOutcome, Levels, levels_when_known, mean_change
from trajeval_ros.batch.noticeable import POWER
from trajeval_ros.batch.relabelling import Size
from trajeval_ros.geometry.arrays import Floats


class KnownSpread:
    """The tests of one comparison with a known standard deviation.

    Attributes:
        sizes: Numbers of old and new trials, by number.
        levels: Significance levels.
        errors: Standard deviations of the mean changes of the numbers, (numbers,).
    """

    def __init__(self, deviation: float, sizes: Sequence[Size], total: float) -> None:
        """Create the tests.

        Args:
            deviation: Standard deviation of the logarithm of a trial.
            sizes: Numbers of old and new trials, by number.
            total: Probability of a false alarm.
        """
        self.sizes = sizes
        self.levels: Levels = levels_when_known(len(sizes), total)
        self.errors = deviation * np.sqrt([1.0 / old + 1.0 / new for old, new in sizes])
        self._weights = self.errors**-2
        self._pooled_error = float(self._weights.sum() ** -0.5)

    def compare(self, numbers: Sequence[Floats], direction: float = 1.0) -> GateOutcome:
        """Test as `gate_tests.compare` does, with Sidak's adjustment for single numbers."""
        changes = direction * self._changes(numbers)
        each = ndtr(-changes / self.errors)
        pooled = ndtr(-changes @ self._weights * self._pooled_error)
        return GateOutcome(self.levels, pooled, 1.0 - (1.0 - each) ** len(self.sizes))

    def common_change(self, numbers: Sequence[Floats]) -> Change:
        """Return the common change and its bounds, as `common_change.common_change` does."""
        estimate = float((self._changes(numbers) @ self._weights)[0]) * self._pooled_error**2
        reach = -float(ndtri(self.levels.pooled)) * self._pooled_error
        return estimate, estimate - reach, estimate + reach

    def noticeable(self, margin: float) -> tuple[float, Floats]:
        """Return the noticeable worsening as logarithms, as `noticeable` defines it.

        Args:
            margin: Logarithm of the margin.

        Returns:
            The common worsening of all numbers, and the worsening of single numbers (numbers,).
        """
        power = float(ndtri(POWER))
        alone = self.levels.numbers or self.levels.total
        single = power - float(ndtri(alone / len(self.sizes)))
        pooled = power - float(ndtri(self.levels.pooled))
        return margin + pooled * self._pooled_error, margin + single * self.errors

    def _changes(self, numbers: Sequence[Floats]) -> Floats:
        pairs = zip(numbers, self.sizes, strict=True)
        return np.stack([mean_change(z, size) for z, size in pairs], axis=1)
