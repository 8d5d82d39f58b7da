"""What a diagnosis says: causes in words, the gravest first, and what was looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trajeval_ros.diagnosis.causes import CAUSES, Cause
from trajeval_ros.diagnosis.evidence import Examined, Seen


@dataclass(frozen=True)
class Finding:
    """A mistake that the recording shows.

    Attributes:
        cause: Its name, one of `CAUSES`.
        sentence: What is wrong, and how it is seen.
        advice: What to do.
        mend: Words of the command line that mend it; empty where none does.
        explained: Share of what doesn't fit that goes away with it, 0 to 1.
        confidence: `exact`, `correlated` or `fitted`.
        evidence: The numbers behind it, by name.
    """

    cause: str
    sentence: str
    advice: str
    mend: Mapping[str, str]
    explained: float
    confidence: str
    evidence: Mapping[str, float]

    @classmethod
    def of(cls, seen: Seen) -> Finding:
        """Put what a test has seen into words."""
        cause = CAUSES[seen.cause]
        words = {**seen.values, "owner": _owner(seen)}
        return cls(
            cause.name,
            cause.sentence.format(**words),
            cause.advice.format(**words),
            {name: text.format(**words) for name, text in cause.mend.items()},
            seen.explained,
            cause.confidence,
            {name: value for name, value in seen.values.items() if isinstance(value, float)},
        )

    @property
    def option(self) -> str:
        """What to type; "" where no option mends it."""
        return " ".join(
            f"--{name.replace('_', '-')}" + (f"={text}" if text.startswith("-") else f" {text}")
            if text
            else f"--{name.replace('_', '-')}"
            for name, text in self.mend.items()
        )

    @property
    def text(self) -> str:
        """The sentence, the advice and the option, in one line."""
        said = f"{self.sentence}; {self.advice}"
        named = not self.option or self.option.split()[0] in self.advice
        return said if named else f"{said}: {self.option}"

    @property
    def rank(self) -> float:
        """The larger, the graver."""
        return CAUSES[self.cause].rank


@dataclass(frozen=True)
class Diagnosis:
    """Everything that was looked at, and what it shows.

    Attributes:
        findings: The gravest first; empty where nothing is wrong that a recording shows.
        examined: Each test with its scores, in the order in which they were made.
    """

    findings: tuple[Finding, ...] = ()
    examined: tuple[Examined, ...] = ()

    @classmethod
    def of(cls, examined: list[Examined]) -> Diagnosis:
        """Rank what tests have seen: by certainty, then by the share that is explained."""
        findings = [Finding.of(seen) for each in examined for seen in each.seen]
        return cls(_ranked(findings), tuple(examined))

    def with_others(self, others: Sequence[Finding]) -> Diagnosis:
        """Return it with more findings, in their places."""
        return Diagnosis(_ranked([*self.findings, *others]), self.examined)

    @property
    def suggested(self) -> Finding | None:
        """The gravest finding; None if there is none."""
        return self.findings[0] if self.findings else None

    def of_conventions(self) -> Finding | None:
        """Return the finding that poses mean something else than was read; None without one."""
        return next((each for each in self.findings if _cause(each).of_conventions), None)

    def named(self, cause: str) -> Finding | None:
        """Return the finding of a cause; None without it."""
        return next((each for each in self.findings if each.cause == cause), None)


def _ranked(findings: list[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(findings, key=lambda each: (-each.rank, -each.explained)))


def _cause(finding: Finding) -> Cause:
    return CAUSES[finding.cause]


def _owner(seen: Seen) -> str:
    """Return the side of a finding as a possessive: "the estimate's"."""
    side = str(seen.values.get("side", ""))
    return {"both": "both sides'", "one side": "one side's"}.get(side, f"the {side}'s")
