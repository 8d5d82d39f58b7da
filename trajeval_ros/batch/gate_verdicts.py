"""Verdicts of gates: on single numbers, on all numbers together, and on failed runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.relabelling import Size

WORSE, NO_WORSE, UNDECIDED = "worse", "no worse", "undecided"
NOT_ALONE, LOST, NEW, FAILED = "not judged alone", "lost", "new", "failed"
MORE_FAILURES = "more failures"
ADVISED = (10, 3)  # recommended trials: of the baseline, of the new comparison


@dataclass(frozen=True)
class NumberVerdict:
    """The verdict on a number of one algorithm on one sequence.

    Attributes:
        algorithm: Name of the algorithm.
        sequence: Name of the sequence.
        before: Median over the trials of the baseline; inf if half of them failed, None without
            trials.
        now: Median over the trials of this comparison, likewise.
        trials: Numbers of trials in the baseline and in this comparison; identical runs count
            once.
        noticeable: Relative change of this number alone that is detected with a probability of
            80 %; None if no change is.
        verdict: `worse`, `no worse` or `undecided`. `not judged alone`: too few trials. `lost`:
            values in the baseline only. `new`: values in this comparison only. `failed`: no
            values in either.
        reason: Why the values are lost, or why a statistically significant change is not counted.
        p: p-value, adjusted for multiple testing; None if single numbers are not tested.
        level: Significance level of p; None likewise.
    """

    algorithm: str
    sequence: str
    before: float | None
    now: float | None
    trials: Size
    noticeable: float | None
    verdict: str
    reason: str = ""
    p: float | None = None
    level: float | None = None

    @property
    def fails(self) -> bool:
        """Whether this is a regression."""
        return self.verdict in (WORSE, LOST)

    @property
    def change(self) -> float | None:
        """The relative change of the medians; None if it can't be computed."""
        if not self.before or self.now is None or math.isinf(self.before + self.now):
            return None
        return (self.now - self.before) / self.before


@dataclass(frozen=True)
class PooledVerdict:
    """The verdict on all numbers of a gate together.

    Attributes:
        count: How many numbers there are.
        verdict: `worse`, `no worse` or `undecided`.
        change: Common relative change, 0.05 for 5 %.
        bounds: Lower and upper confidence bound of the change; None if there are too few trials.
        noticeable: Common relative change that is detected with a probability of 80 %; None if no
            change is.
        p: p-value of a change that is larger than the margin.
        level: Significance level of p.
    """

    count: int
    verdict: str
    change: float
    bounds: tuple[float, float] | None
    noticeable: float | None
    p: float
    level: float


@dataclass(frozen=True)
class GateVerdict:
    """The verdicts of a gate.

    Attributes:
        gate: The gate.
        pooled: Verdict on all numbers together; None for an untested gate or without numbers.
        numbers: Verdicts on single numbers.
        copies: Number of omitted trials: their poses are identical to those of another trial.
        paired: Whether trials of the same name were pairs; noticeable changes are then not known.
        advised: Noticeable relative changes with the recommended trials: common, smallest and
            largest of single numbers. None if single numbers have enough trials, or if there is
            only one, trials are pairs, or spreads are not known.
    """

    gate: Gate
    pooled: PooledVerdict | None
    numbers: tuple[NumberVerdict, ...]
    copies: int
    paired: bool = False
    advised: tuple[float, float, float] | None = None

    @property
    def verdict(self) -> str:
        """`worse` or `lost` if a number or all together are; else `no worse` or `undecided`."""
        words = [each.verdict for each in self.numbers]
        together = None if self.pooled is None else self.pooled.verdict
        if WORSE in (together, *words):
            return WORSE
        if LOST in words:
            return LOST
        is_no_worse = NO_WORSE in words if together is None else together == NO_WORSE
        return NO_WORSE if is_no_worse else UNDECIDED

    @property
    def fails(self) -> bool:
        """Whether the verdict is `worse` or `lost`."""
        return self.verdict in (WORSE, LOST)

    @property
    def is_no_worse(self) -> bool:
        """Whether the verdict is `no worse`."""
        return self.verdict == NO_WORSE


@dataclass(frozen=True)
class Failures:
    """The test whether more runs fail than in the baseline.

    Attributes:
        before: Failed runs and all runs of the baseline, for algorithms and sequences that both
            comparisons have.
        now: Failed runs and all runs of this comparison, likewise.
        p: p-value; the null hypothesis is that runs do not fail more often than before.
        level: Significance level of p.
    """

    before: Size
    now: Size
    p: float
    level: float

    @property
    def fails(self) -> bool:
        """Whether statistically significantly more runs fail."""
        return self.p <= self.level

    @property
    def verdict(self) -> str:
        """`more failures` or `undecided`; there is no test for "not more"."""
        return MORE_FAILURES if self.fails else UNDECIDED


@dataclass(frozen=True)
class Judgement:
    """The verdicts of all gates.

    Attributes:
        gates: Verdicts by gate.
        failures: The test of failed runs.
        false_alarms: Probability of a false alarm of all gates together.
    """

    gates: tuple[GateVerdict, ...]
    failures: Failures
    false_alarms: float

    @property
    def verdict(self) -> str:
        """`worse`, `lost` or `more failures`; else `no worse` (all gates) or `undecided`."""
        words = [each.verdict for each in self.gates]
        for word in (WORSE, LOST):
            if word in words:
                return word
        if self.failures.fails:
            return MORE_FAILURES
        return NO_WORSE if all(word == NO_WORSE for word in words) else UNDECIDED

    @property
    def fails(self) -> bool:
        """Whether the verdict is a regression."""
        return self.verdict in (WORSE, LOST, MORE_FAILURES)

    @property
    def is_no_worse(self) -> bool:
        """Whether the verdict is `no worse`."""
        return self.verdict == NO_WORSE
