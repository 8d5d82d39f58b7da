"""Findings: errors before and after a correction, order of severity, sides and corrections."""

from __future__ import annotations

import math

import pytest

from trajeval_ros.calibration.apply import Ate
from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.findings import Detection, Diagnosis, Finding, TestResult, Verification
from trajeval_ros.pipeline.request import Corrections


@pytest.mark.parametrize(
    ("cause", "position", "rotation", "grows"),
    [
        ("scale", 0.998, 1.0, False),
        ("scale", 1.04, 1.0, False),  # drift
        ("scale", 1.06, 1.0, True),
        ("scale", 1.06, 0.49, False),  # the rotation decreases clearly
        ("scale", 1.06, 0.51, True),
        ("inverse", 1.06, 1.0, True),
        # About rotations.
        ("wxyz", 1.0, 1.04, False),
        ("wxyz", 0.5, 1.06, True),
        ("body", 1.06, 0.4, False),
        # About either.
        ("clock_offset", 1.04, 0.998, False),
        ("clock_offset", 1.06, 1.0, True),
    ],
)
def test_a_correction_may_not_increase_the_error_that_it_is_about(
    cause: str, position: float, rotation: float, *, grows: bool
) -> None:
    tried = Verification(Ate(2.0, 8.0), Ate(2.0 * position, 8.0 * rotation))
    assert tried.ratios == pytest.approx((position, rotation))
    finding = Finding.of(seen_of(cause, side="estimate", gauge="sim3"))
    assert finding.is_confirmed_by(tried) != grows


def test_withheld_rotation_errors_count_as_180_deg() -> None:
    assert Verification(Ate(2.0, None), Ate(1.0, 9.0)).ratios == (0.5, 0.05)
    assert Verification(Ate(2.0, 90.0), Ate(1.0, None)).ratios == (0.5, 2.0)
    assert Verification(Ate(2.0, None), Ate(1.0, None)).ratios == (0.5, 1.0)
    assert Verification(None, Ate(1.0, 9.0)).ratios == (0.0, 1.0)
    assert Verification(Ate(0.0, 0.0), Ate(0.0, 1.0)).ratios == (1.0, 2.0)


@pytest.mark.parametrize(
    ("position", "rotation", "of_rotation"),
    [
        (0.8, 0.41, False),
        (0.8, 0.39, True),
        (0.999, 0.9985, True),
        (0.9985, 0.9985, False),
        (0.999, 0.9995, False),
    ],
)
def test_the_rotation_error_is_stated_if_it_decreases_more(
    position: float, rotation: float, *, of_rotation: bool
) -> None:
    text = Verification(Ate(2.0, 10.0), Ate(2.0 * position, 10.0 * rotation), then=("Y",)).text(
        "X"
    )
    assert text.startswith("rotation ATE 10 deg, " if of_rotation else "ATE 2 m, ")
    assert ", with X and Y " in text


def seen_of(cause: str, **values: str | float) -> Detection:
    """Return a detected cause, with a number for all values that are not given."""
    texts = (CAUSES[cause].sentence, CAUSES[cause].advice, *CAUSES[cause].correction.values())
    names = {
        part.partition(":")[0].partition("}")[0] for text in texts for part in text.split("{")[1:]
    }
    return Detection(cause, {**dict.fromkeys(names - {"owner"}, math.pi), **values})


def test_findings_are_sorted_by_severity() -> None:
    seen = (
        seen_of("scale", gauge="sim3", or_feet="", or_convert=""),
        seen_of("tilted"),
        seen_of("wxyz", side="estimate"),
        seen_of("groundtruth_frozen"),
    )
    diagnosis = Diagnosis.of(
        [TestResult("one", seen=seen[:2]), TestResult("other", seen=seen[2:])]
    )
    causes = [finding.cause for finding in diagnosis.findings]
    assert causes == ["groundtruth_frozen", "wxyz", "tilted", "scale"]
    assert diagnosis.suggested == diagnosis.findings[0]
    more = diagnosis.with_others([Finding.of(seen_of("identical", where="here"))])
    assert [finding.cause for finding in more.findings][:2] == ["identical", "groundtruth_frozen"]
    assert diagnosis.of_conventions() == diagnosis.findings[1]
    assert diagnosis.named("tilted") == diagnosis.findings[2]
    assert Diagnosis().suggested is None


def test_corrections_name_the_sides_and_follow_each_other() -> None:
    both = Finding.of(seen_of("wxyz", side="both"))
    assert dict(both.correction) == {
        "groundtruth.quaternion_order": "wxyz",
        "estimate.quaternion_order": "wxyz",
    }
    assert both.sentence.startswith("both sides' quaternions are in the order w, x, y, z")
    one = Finding.of(seen_of("inverse", side="one side"))
    assert dict(one.correction) == {"estimate.inverse": "poses"}
    assert (one.option, one.conversion) == ("--correct inverse", "--inverse poses")
    offset = Finding.of(seen_of("clock_offset", total_s=-2.5, known_as=""))
    assert (offset.option, offset.conversion) == ("--time-offset=-2.500", "")
    steps = Corrections().changed(both.correction).changed(one.correction)
    assert steps.then is not None
    assert steps.then.groundtruth.quaternion_order == "wxyz"
    assert steps.then.then is not None
    assert steps.then.then.estimate.inverse == "poses"
    assert Corrections().changed(offset.correction) == Corrections()
