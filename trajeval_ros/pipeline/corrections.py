"""Corrections of findings: conventions of both sides, and the finding that --correct selects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.geometry.pose_conventions import Conventions

if TYPE_CHECKING:
    from trajeval_ros.diagnosis.findings import Diagnosis, Finding

SUGGESTED = "suggested"  # value of --correct: the most severe finding, and then the next ones


@dataclass(frozen=True)
class Corrections:
    """Conventions of both sides that differ from those that were read; by default none."""

    groundtruth: Conventions = field(default_factory=Conventions)
    estimate: Conventions = field(default_factory=Conventions)
    then: Corrections | None = None  # corrections of what these leave; None for none

    def changed(self, correction: Mapping[str, str]) -> Corrections:
        """Return these corrections and then those of a finding, such as `estimate.scale`."""
        if self.then is not None:
            return dataclasses.replace(self, then=self.then.changed(correction))
        sides: dict[str, dict[str, float | str]] = {"groundtruth": {}, "estimate": {}}
        for name, text in correction.items():
            side, _, attribute = name.partition(".")
            if attribute:
                sides[side][attribute] = type(getattr(Conventions(), attribute))(text)
        if not any(sides.values()):
            return self
        return dataclasses.replace(
            self,
            then=Corrections(**{side: Conventions(**of) for side, of in sides.items()}),  # type: ignore[arg-type]
        )


def require_correctable(cause: str) -> None:
    """Refuse a name that is neither `suggested` nor a cause with a correction."""
    known = [name for name, item in CAUSES.items() if item.correction]
    require_one_of(cause, [SUGGESTED, *known], "cause to correct")


def finding_to_correct(diagnosis: Diagnosis, cause: str, *, is_first: bool) -> Finding | None:
    """Return the finding to correct; None for `suggested` without findings.

    After the first correction, it is None if nothing is left to correct.
    """
    left = [finding for finding in diagnosis.findings if cause in (SUGGESTED, finding.cause)]
    correctable = next((item for item in left if item.correction), None)
    if correctable is not None or not is_first:
        return correctable
    if cause == SUGGESTED:
        if left:
            raise InputError(f"no option corrects the finding: {left[0].text}; remove --correct")
        return None
    finding = diagnosis.named(cause)
    if finding is None:
        causes = ", ".join(item.cause for item in diagnosis.findings) or "nothing"
        raise InputError(
            f"{cause} not found in the recording (found: {causes}); remove --correct, or convert "
            "the file with trajeval trajectory"
        )
    raise InputError(f"no option corrects {cause}: {finding.text}; remove --correct")
