"""The result of a diagnosis: tests with statistics, findings by severity, and corrections."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.causes import CAUSES, FLAG
from trajeval_ros.formatting.numbers import four_digits
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.metrics.discontinuities.parts import together_m

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Ate
    from trajeval_ros.metrics.evaluation import Evaluation

Value = float | str


@dataclass(frozen=True)
class Detection:
    """A cause that a test detected."""

    cause: str  # its name in `CAUSES`
    # Values of the format strings of the cause; numbers are evidence.
    values: Mapping[str, Value] = field(default_factory=dict)

    @classmethod
    def of(cls, cause: str, **values: Value) -> Detection:
        """Return a detected cause with the values of its texts."""
        return cls(cause, values)


@dataclass(frozen=True)
class TestResult:
    """A test and its results."""

    test: str
    scores: Mapping[str, float] = field(default_factory=dict)  # statistics by name
    seen: tuple[Detection, ...] = ()  # detected causes
    why_not: str = ""  # reason why the test is not applicable; "" if it is


_FITTED = "--hand-eye auto could not determine it; apply this pose, which fits short motions"
_IMPOSSIBLE = "its correction is not possible on this data"
_USELESS = "its correction does not reduce the ATE, of which other errors are the larger part"
# By side of a finding, if it is not only the groundtruth or only the estimate.
_OWNERS = {"both": "both sides'", "one side": "one side's"}
_CORRECTED_SIDES = {"both": ("groundtruth", "estimate"), "one side": ("estimate",)}
WITHHELD_DEG = 180.0  # rotations are withheld where they disagree with positions, so by much
# Ratios of errors: a decrease beyond rounding, and an increase by the drift in both errors.
_FALLS, _GROWS = 0.999, 1.05
_CLEARLY = 0.5  # ratio of decreases, from which on the rotation is stated in place of the position
_LARGE_RATE_PPM = 1500.0  # clocks differ by less, times from a wrong frame rate by more


@dataclass(frozen=True)
class Verification:
    """Errors without and with the correction of a finding."""

    # The position errors are those of the parts between restarts together, if there are parts.
    before: Ate | None  # None if nothing can be evaluated without it
    after: Ate
    then: tuple[str, ...] = ()  # options that correct the other findings, in `after`
    # Rotation errors to compare, deg: with an alignment by orientations, if they are withheld only
    # because the positions determine the alignment's rotation poorly.
    rotations_deg: tuple[float | None, float | None] = (None, None)
    of_parts: bool = False

    @classmethod
    def of(
        cls, before: Evaluation | None, after: Evaluation, then: tuple[str, ...] = ()
    ) -> Verification:
        """Return the errors of two evaluations, or of one if there is none before."""
        from trajeval_ros.calibration.apply import Ate

        if before is None:
            return cls(None, Ate.of(after), then)
        ates, of_parts = [Ate.of(before), Ate.of(after)], together_m(after.parts) is not None
        if of_parts:
            ates = [
                dataclasses.replace(ate, position_m=together_m(one.parts) or ate.position_m)
                for ate, one in zip(ates, (before, after), strict=True)
            ]
        rotations = _by_orientations(before), _by_orientations(after)
        return cls(ates[0], ates[1], then, rotations, of_parts)

    @property
    def name(self) -> str:
        """The name of the position errors."""
        return "ATE of the parts" if self.of_parts else "ATE"

    @property
    def _rotations(self) -> list[float | None]:
        """Rotation errors before and after, deg."""
        of_ate = [None if ate is None else ate.rotation_deg for ate in (self.before, self.after)]
        both = zip(of_ate, self.rotations_deg, strict=True)
        return [other if one is None else one for one, other in both]

    @property
    def ratios(self) -> tuple[float, float]:
        """Errors after over errors before, of positions and of rotations; 1 without rotations."""
        if self.before is None:
            return 0.0, 1.0
        position = _ratio(self.after.position_m, self.before.position_m)
        if self._rotations == [None, None]:
            return position, 1.0
        before, after = (WITHHELD_DEG if deg is None else deg for deg in self._rotations)
        return position, _ratio(after, before)

    def text(self, option: str) -> str:
        """Return both numbers: of the position, or of the rotation if that decreases more."""
        (position, rotation), before, after_deg = self.ratios, self.before, self._rotations[1]
        options = option, *self.then
        if sum(one.startswith("--correct") for one in options) > 1:
            options = ("--correct suggested",)  # it corrects all of them
        option = " and ".join((*options, *("--on-restart split",) * self.of_parts))
        with_it = f"with {option} {four_digits(self.after.position_m)} m"
        if before is None:
            return f"ATE {with_it}"
        is_about_rotation = rotation < _CLEARLY * position or rotation < _FALLS <= position
        if before.rotation_deg is None and position < _CLEARLY:
            is_about_rotation = False  # a number that fell says more than a withheld one
        if after_deg is None or not is_about_rotation:
            return f"{self.name} {four_digits(before.position_m)} m, {with_it}"
        size = before.rotation_deg
        without = "withheld" if size is None else f"{four_digits(size)} deg"
        how = " aligned by orientations" if self.after.rotation_deg is None else ""
        return f"rotation ATE {without}, with {option} {four_digits(after_deg)} deg{how}"


def _by_orientations(evaluation: Evaluation) -> float | None:
    """Return the rotation error of an alignment by orientations, deg.

    None without orientations, or if they disagree with the positions.
    """
    freedom = evaluation.alignment.freedom
    if freedom is None or freedom.orientations is None or freedom.disagrees:
        return None
    return freedom.orientations.least_deg


def _ratio(after: float, before: float) -> float:
    return after / before if before > 0.0 else float(after > 0.0) + 1.0


@dataclass(frozen=True)
class Finding:
    """A mistake that was detected, with its texts."""

    cause: str  # name of the cause, a key of `CAUSES`
    sentence: str  # the mistake and its evidence
    advice: str  # instruction for the user
    # What corrects it, by option of `evaluate` or by attribute of `Corrections`; empty if neither
    # does.
    correction: Mapping[str, str]
    evidence: Mapping[str, float]  # statistics by name
    tried: Verification | None = None  # None if there is no correction, or no trial of it

    @classmethod
    def of(cls, seen: Detection) -> Finding:
        """Return the finding of a detected cause."""
        cause, side = CAUSES[seen.cause], str(seen.values.get("side", ""))
        values = {**seen.values, "owner": _OWNERS.get(side, f"the {side}'s")}
        return cls(
            cause.name,
            cause.sentence.format(**values),
            cause.advice.format(**values),
            {
                name.format(side=corrected): value
                for name, text in cause.correction.items()
                for corrected in _CORRECTED_SIDES.get(side, (side,))
                if (value := text.format(**values))
            },
            {name: value for name, value in seen.values.items() if isinstance(value, float)},
        )

    def is_confirmed_by(self, tried: Verification) -> bool:
        """Return whether the errors with its correction do not contradict it.

        The error that it is about may grow by the drift in it. A correction that decreases the
        rotation error clearly is right, whatever the drift is. A large rate of a clock makes most
        of an error; otherwise a step in the run looks like it.
        """
        position, rotation = tried.ratios
        is_rate = abs(self.evidence.get("ppm", 0.0)) > _LARGE_RATE_PPM
        if is_rate and min(position, rotation) > _CLEARLY:
            return False
        if CAUSES[self.cause].of_error == "rotation" and rotation > _GROWS:
            return False
        return position <= _GROWS or rotation <= _CLEARLY

    def without_advice(self, *, is_possible: bool) -> Finding:
        """Return the finding for a correction that does not help, or that is not possible."""
        advice = _USELESS if is_possible else _IMPOSSIBLE
        return dataclasses.replace(self, advice=advice, correction={}, tried=None)

    @property
    def option(self) -> str:
        """The option of `evaluate` that corrects it; "" without a correction."""
        return f"--correct {self.cause}" if self.conversion else _options(self.correction)

    @property
    def conversion(self) -> str:
        """The options of `trajectory` that correct a file; "" if it is not converted."""
        names = (name.partition(".") for name in self.correction)
        return _options(
            {of_side: self.correction[side + dot + of_side] for side, dot, of_side in names if dot}
        )

    @property
    def text(self) -> str:
        """The sentence, the advice and the option, in one line."""
        text, option = f"{self.sentence}; {self.advice}", self.option
        if self.tried is not None:
            text = f"{text}: {self.tried.text(option)}"
        elif not option or option.split()[0] in self.advice:
            return text
        else:
            text = f"{text}: {option}"
        conversion = self.conversion
        return text + (conversion and f", or trajeval trajectory SOURCE {conversion}")

    @property
    def remark(self) -> Remark:
        """The finding as a warning, with the cause as its code."""
        return warning(self.cause, self.text)

    @property
    def rank(self) -> float:
        """Severity; findings are sorted by it."""
        return CAUSES[self.cause].rank

    @property
    def is_of_conventions(self) -> bool:
        """Whether the poses have another convention than the reader assumed."""
        return CAUSES[self.cause].of_conventions


@dataclass(frozen=True)
class Diagnosis:
    """All tests and findings."""

    # Findings, the most severe one first; empty if no mistake was detected.
    findings: tuple[Finding, ...] = ()
    examined: tuple[TestResult, ...] = ()  # all tests with their statistics, in their order

    @classmethod
    def of(cls, examined: Sequence[TestResult]) -> Diagnosis:
        """Return all findings of tests, sorted by severity."""
        findings = [Finding.of(seen) for test in examined for seen in test.seen]
        return cls((), tuple(examined)).with_others(findings)

    def without(self, cause: str, why_not: str) -> Diagnosis:
        """Return the diagnosis without a cause, whose test is not applicable."""
        gone = {
            test.test: dataclasses.replace(test, seen=(), why_not=why_not)
            for test in self.examined
            if any(seen.cause == cause for seen in test.seen)
        }
        return Diagnosis.of([gone.get(test.test, test) for test in self.examined])

    def with_others(self, others: Sequence[Finding]) -> Diagnosis:
        """Return the diagnosis with more findings, sorted."""
        findings = sorted((*self.findings, *others), key=lambda finding: -finding.rank)
        return Diagnosis(tuple(findings), self.examined)

    @property
    def suggested(self) -> Finding | None:
        """The most severe finding; None without findings."""
        return self.findings[0] if self.findings else None

    def after_hand_eye_calibration(self) -> Diagnosis:
        """Return the diagnosis of a calibrated run, without the advice to calibrate it.

        A finding about the body remains if the calibration was too uncertain to be applied. It
        requires more motion, since it assumes nothing about the size of the lever arm.
        """
        findings = (
            dataclasses.replace(finding, advice=_FITTED)
            if "hand_eye" in finding.correction
            else finding
            for finding in self.findings
        )
        return dataclasses.replace(self, findings=tuple(findings))

    def of_conventions(self) -> Finding | None:
        """Return the finding about a convention; None without one."""
        return next((finding for finding in self.findings if finding.is_of_conventions), None)

    def named(self, cause: str) -> Finding | None:
        """Return the finding of a cause; None without it."""
        return next((finding for finding in self.findings if finding.cause == cause), None)

    def names_any(self, causes: Collection[str]) -> bool:
        """Return whether there is a finding of any of some causes."""
        return any(finding.cause in causes for finding in self.findings)


def _options(values: Mapping[str, str]) -> str:
    return " ".join(
        f"--{name.replace('_', '-')}"
        + (f"={text}" if text.startswith("-") else f" {text}".removesuffix(f" {FLAG}"))
        for name, text in values.items()
    )
