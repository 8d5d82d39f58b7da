"""Correction of a finding by the options that it names (`--fix`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.evidence import Seen
from trajeval_ros.diagnosis.findings import Diagnosis, Finding
from trajeval_ros.diagnosis.mends import Mends
from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.metrics.input_summary import InputSummary

if TYPE_CHECKING:
    from trajeval_ros.calibration.calibrated import Ate
    from trajeval_ros.calibration.calibration_request import CalibrationRequest
    from trajeval_ros.metrics.protocol import Protocol

SUGGESTED = "suggested"


@dataclass(frozen=True)
class Mended:
    """A finding that was corrected on request.

    Attributes:
        finding: Finding without the correction.
        before: Errors without the correction.
        after: Errors with the correction.
    """

    finding: Finding
    before: Ate
    after: Ate


def require_fix(fix: str) -> None:
    """Refuse an unknown cause.

    Raises:
        SettingsError: It is neither `suggested` nor a cause that an option corrects.
    """
    known = [name for name, cause in CAUSES.items() if cause.mend]
    require_one_of(fix, [SUGGESTED, *known], "cause to fix")


def finding_to_mend(diagnosis: Diagnosis, fix: str) -> Finding | None:
    """Return the finding to correct; None for `suggested` without findings.

    Args:
        diagnosis: Diagnosis without the correction.
        fix: A cause, or `suggested` for the most severe finding.

    Raises:
        InputError: The cause was not found, or no option corrects the finding.
    """
    if fix == SUGGESTED:
        found = diagnosis.suggested
        if found is not None and not found.mend:
            raise InputError(f"no option corrects the finding: {found.text}; remove --fix")
        return found
    found = diagnosis.named(fix)
    if found is None:
        causes = ", ".join(each.cause for each in diagnosis.findings) or "nothing"
        raise InputError(
            f"{fix} not found in the recording (found: {causes}); remove --fix, or give the "
            "option of the correction"
        )
    return found


def changes_by(
    words: Mapping[str, str],
    *,
    protocol: Protocol,
    calibration: CalibrationRequest,
    mends: Mends,
    time_span: TimeSpan | None,
) -> dict[str, Any]:
    """Return the changed attributes of a request by name, for the options of a correction."""
    changes: dict[str, Any] = {}
    rule = protocol.association
    if "gauge" in words:
        protocol = dataclasses.replace(protocol, gauge=Gauge.of(words["gauge"]), modality=None)
    if "max_gap" in words:
        rule = dataclasses.replace(rule, max_gap_s=float(words["max_gap"]))
    if words.get("time_offset") == "auto":
        calibration = dataclasses.replace(calibration, offset=True)
    elif "time_offset" in words:
        rule = dataclasses.replace(rule, time_offset_s=float(words["time_offset"]))
    if "hand_eye" in words:
        calibration = dataclasses.replace(calibration, hand_eye=True)
    if "up" in words:
        truth, _, estimate = words["up"].partition(",")
        changes["up"] = (truth, estimate)
    if "end" in words:
        until = TimeSpan.parse(None, words["end"])
        assert until is not None
        changes["time_span"] = until if time_span is None else _shorter(time_span, until)
    return {
        **changes,
        "protocol": dataclasses.replace(protocol, association=rule),
        "calibration": calibration,
        "mends": mends.changed(words),
    }


def _shorter(span: TimeSpan, until: TimeSpan) -> TimeSpan:
    """Return a span that ends earlier, relative to its start."""
    assert until.end_ns is not None
    end_ns = (span.start_ns or 0) + until.end_ns
    return dataclasses.replace(span, end_ns=end_ns, absolute_end=span.absolute_start)


def same_estimate(estimate: InputSummary, others: Sequence[InputSummary]) -> Finding | None:
    """Return the finding about an estimate with the same poses as another one; else None."""
    for other in others:
        if other.fingerprint == estimate.fingerprint:
            name = other.source or other.name or "another one"
            return Finding.of(Seen("same_estimate", 1.0, {"other": name}))
    return None
