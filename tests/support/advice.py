"""What holds for the advice of every diagnosis."""

from __future__ import annotations

from trajeval_ros.diagnosis.findings import Diagnosis


def assert_no_advice_is_worse(diagnosis: Diagnosis) -> None:
    """Check that every correction that was tried makes the ATE smaller."""
    for finding in diagnosis.findings:
        if finding.tried is not None:
            assert finding.is_confirmed_by(finding.tried)
