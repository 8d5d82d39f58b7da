"""What gates say: of single numbers, of all together, and of failed runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.relabelling import Size

WORSE, NO_WORSE, UNDECIDED = "worse", "no worse", "undecided"
NOT_ALONE, LOST, NEW, FAILED = "not judged alone", "lost", "new", "failed"
MORE_FAILURES = "more failures"
ADVISED = (10, 3)  # trials of the baseline and of a change


@dataclass(frozen=True)
class NumberVerdict:
    """What became of a number of one algorithm on one sequence.

    Attributes:
        algorithm, sequence: Whose.
        before, now: Medians over the trials, infinite where half of them failed; None without.
        trials: Of the baseline, and of this comparison; copies of a run count once.
        noticeable: Relative change that would have been noticed in it alone; None if none.
        p: Chance of such a largest change of any number, without a change beyond the margin; None
            where single numbers aren't tested.
        level: What p is compared with; None likewise.
        verdict: `worse`, `no worse`, `undecided`; `not judged alone`: too few trials; `lost`: it
            had numbers and has none; `new`: the other way; `failed`: without numbers in either.
        reason: What was lost, or why a worse one doesn't count.
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
        """Whether it is a regression."""
        return self.verdict in (WORSE, LOST)

    @property
    def change(self) -> float | None:
        """The relative change of the medians; None where there is none."""
        if not self.before or self.now is None or math.isinf(self.before + self.now):
            return None
        return (self.now - self.before) / self.before


@dataclass(frozen=True)
class PooledVerdict:
    """What is said of all numbers of a gate together.

    Attributes:
        count: Of numbers.
        verdict: `worse`, `no worse` or `undecided`.
        change: Common change, as a fraction of the baseline's.
        bounds: Of the change, the lower one first; None where nothing can be said.
        noticeable: Relative change that would have been noticed; None if none.
        p: Chance of such numbers without a change beyond the margin.
        level: What p is compared with.
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
    """What a gate says.

    Attributes:
        gate: Which.
        pooled: Of all numbers together; None of an untested gate, or without numbers.
        numbers: Of single ones.
        copies: Trials that were left out as copies of others.
        paired: Whether trials of a name were pairs; what is noticed is then not known.
        advised: What would be noticed with the advised trials, together and in the best and the
            worst number alone; None where the advice isn't needed or spreads aren't known.
    """

    gate: Gate
    pooled: PooledVerdict | None
    numbers: tuple[NumberVerdict, ...]
    copies: int
    paired: bool = False
    advised: tuple[float, float, float] | None = None

    @property
    def verdict(self) -> str:
        """`worse` or `lost` if anything is; else `no worse` or `undecided`."""
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
        """Whether anything is worse or lost."""
        return self.verdict in (WORSE, LOST)

    @property
    def is_no_worse(self) -> bool:
        """Whether it is shown that nothing got worse."""
        return self.verdict == NO_WORSE


@dataclass(frozen=True)
class Failures:
    """Whether more runs fail than in the baseline.

    Attributes:
        before, now: Failed runs and all runs, of what both comparisons have.
        p: Chance of such numbers if runs fail as often as before.
        level: What p is compared with.
    """

    before: Size
    now: Size
    p: float
    level: float

    @property
    def fails(self) -> bool:
        """Whether there are more."""
        return self.p <= self.level

    @property
    def verdict(self) -> str:
        """`more failures` or `undecided`: that there are no more isn't tested."""
        return MORE_FAILURES if self.fails else UNDECIDED


@dataclass(frozen=True)
class Judgement:
    """What all gates say.

    Attributes:
        gates: Each of them.
        failures: Of the runs.
        false_alarms: Chance of a false alarm that the gates share.
    """

    gates: tuple[GateVerdict, ...]
    failures: Failures
    false_alarms: float

    @property
    def verdict(self) -> str:
        """`worse`, `lost` or `more failures`; else `no worse` if all gates are, or `undecided`."""
        words = [each.verdict for each in self.gates]
        for word in (WORSE, LOST):
            if word in words:
                return word
        if self.failures.fails:
            return MORE_FAILURES
        return NO_WORSE if all(word == NO_WORSE for word in words) else UNDECIDED

    @property
    def fails(self) -> bool:
        """Whether there is a regression."""
        return self.verdict in (WORSE, LOST, MORE_FAILURES)

    @property
    def is_no_worse(self) -> bool:
        """Whether it is shown that there is none."""
        return self.verdict == NO_WORSE
