"""What gates say: of single numbers, of all together, and of failed runs."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.relabelling import Size

WORSE, NO_WORSE, UNDECIDED = "worse", "no worse", "undecided"
NOT_ALONE, LOST, NEW, FAILED = "not judged alone", "lost", "new", "failed"
ADVISED = (10, 3)  # trials of the baseline and of a change


@dataclass(frozen=True)
class NumberVerdict:
    """What became of a number of one algorithm on one sequence.

    Attributes:
        algorithm, sequence: Whose.
        before, now: Medians over the trials, infinite where half of them failed; None without.
        trials: Of the baseline, and of this comparison; copies of a run count once.
        noticeable: Relative change that would have been noticed in it alone; None if none.
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

    @property
    def fails(self) -> bool:
        """Whether it is a regression."""
        return self.verdict in (WORSE, LOST)


@dataclass(frozen=True)
class PooledVerdict:
    """What is said of all numbers of a gate together.

    Attributes:
        count: Of numbers.
        verdict: `worse`, `no worse` or `undecided`.
        change: Common change, as a fraction of the baseline's.
        bounds: Of the change, from better to worse; infinite where nothing can be said.
        noticeable: Relative change that would have been noticed; None if none.
        p: Chance of such numbers without a change beyond the margin.
        level: What p is compared with.
    """

    count: int
    verdict: str
    change: float
    bounds: tuple[float, float]
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
        advised: What would be noticed with the advised trials, together and in the best and the
            worst number alone; None where the advice isn't needed or spreads aren't known.
    """

    gate: Gate
    pooled: PooledVerdict | None
    numbers: tuple[NumberVerdict, ...]
    copies: int
    advised: tuple[float, float, float] | None = None

    @property
    def fails(self) -> bool:
        """Whether anything is worse or lost."""
        together = self.pooled is not None and self.pooled.verdict == WORSE
        return together or any(each.fails for each in self.numbers)

    @property
    def is_no_worse(self) -> bool:
        """Whether it is shown that nothing got worse."""
        if self.fails:
            return False
        if self.pooled is not None:
            return self.pooled.verdict == NO_WORSE
        return any(each.verdict == NO_WORSE for each in self.numbers)


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
    def fails(self) -> bool:
        """Whether there is a regression."""
        return self.failures.fails or any(each.fails for each in self.gates)

    @property
    def is_no_worse(self) -> bool:
        """Whether it is shown that there is none."""
        return not self.fails and all(each.is_no_worse for each in self.gates)
