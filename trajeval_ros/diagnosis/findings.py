"""The result of a diagnosis: findings in order of severity, and all tests."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trajeval_ros.diagnosis.causes import CAUSES, Cause
from trajeval_ros.diagnosis.evidence import Examined, Seen

_MEASURE = (
    "--hand-eye auto could not determine it; measure the transformation and give it with "
    "--hand-eye FILE"
)


@dataclass(frozen=True)
class Finding:
    """A mistake that was detected, with its texts.

    Attributes:
        cause: Name of the cause, a key of `CAUSES`.
        sentence: The mistake and its evidence.
        advice: Instruction for the user.
        mend: Options that correct it, values by name; empty without such an option.
        explained: Fraction of the mismatch that the correction removes, 0 to 1.
        confidence: `exact`, `correlated` or `fitted`.
        evidence: Statistics by name.
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
        """Return the finding of a detected cause."""
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
        """The options on the command line; "" without an option that corrects it."""
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
        """Severity; findings are sorted by it."""
        return CAUSES[self.cause].rank


@dataclass(frozen=True)
class Diagnosis:
    """All tests and findings.

    Attributes:
        findings: Findings, the most severe one first; empty if no mistake was detected.
        examined: All tests with their statistics, in their order.
    """

    findings: tuple[Finding, ...] = ()
    examined: tuple[Examined, ...] = ()

    @classmethod
    def of(cls, examined: list[Examined]) -> Diagnosis:
        """Return all findings of tests, sorted by severity and by the fraction explained."""
        findings = [Finding.of(seen) for each in examined for seen in each.seen]
        return cls(_ranked(findings), tuple(examined))

    def with_others(self, others: Sequence[Finding]) -> Diagnosis:
        """Return the diagnosis with more findings, sorted."""
        return Diagnosis(_ranked([*self.findings, *others]), self.examined)

    @property
    def suggested(self) -> Finding | None:
        """The most severe finding; None without findings."""
        return self.findings[0] if self.findings else None

    def after_hand_eye_calibration(self) -> Diagnosis:
        """Return the diagnosis of a calibrated run, without the advice to calibrate it.

        A finding about the body remains if the calibration was too uncertain to be applied.
        """
        findings = (
            dataclasses.replace(each, advice=_MEASURE, mend={})
            if "hand_eye" in each.mend
            else each
            for each in self.findings
        )
        return dataclasses.replace(self, findings=tuple(findings))

    def of_conventions(self) -> Finding | None:
        """Return the finding about a convention; None without one."""
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
