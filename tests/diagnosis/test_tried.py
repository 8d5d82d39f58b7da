"""Errors before and after a correction: when a correction helps, and what is stated."""

from __future__ import annotations

import math

import pytest

from trajeval_ros.calibration.apply import Ate
from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.findings import (
    Corrections,
    Diagnosis,
    Examined,
    Finding,
    Seen,
    Tried,
)


@pytest.mark.parametrize(
    ("cause", "position", "rotation", "helps"),
    [
        # Of the position, not of conventions: any decrease, unless rotations grow.
        ("scale", 0.998, 1.04, True),
        ("scale", 0.9995, 1.0, False),
        ("scale", 0.998, 1.06, False),
        ("scale", 0.49, 1.06, True),
        ("scale", 0.51, 1.06, False),
        # Of conventions: by a tenth.
        ("inverse", 0.89, 1.0, True),
        ("inverse", 0.91, 1.0, False),
        # Of the rotation.
        ("wxyz", 1.0, 0.89, True),
        ("wxyz", 1.0, 0.91, False),
        ("wxyz", 1.04, 0.5, True),
        ("wxyz", 1.06, 0.5, False),
        ("wxyz", 0.5, 1.0, False),
        ("body", 1.0, 0.998, True),
        ("body", 1.0, 0.9995, False),
        # Of either.
        ("clock_offset", 0.998, 1.04, True),
        ("clock_offset", 1.04, 0.998, True),
        ("clock_offset", 0.998, 1.06, False),
        ("clock_offset", 1.0, 1.0, False),
    ],
)
def test_a_correction_helps_if_its_error_falls_and_the_other_hardly_grows(
    cause: str, position: float, rotation: float, *, helps: bool
) -> None:
    tried = Tried(Ate(2.0, 8.0), Ate(2.0 * position, 8.0 * rotation))
    assert tried.ratios == pytest.approx((position, rotation))
    assert tried.helps(cause) == helps


def test_withheld_rotations_are_half_a_turn() -> None:
    assert Tried(Ate(2.0, None), Ate(1.0, 9.0)).ratios == (0.5, 0.05)
    assert Tried(Ate(2.0, 90.0), Ate(1.0, None)).ratios == (0.5, 2.0)
    assert Tried(Ate(2.0, None), Ate(1.0, None)).ratios == (0.5, 1.0)
    assert Tried(None, Ate(1.0, 9.0)).ratios == (0.0, 1.0)
    # Without rotations after it, those before do not count.
    assert Tried(Ate(2.0, 90.0), Ate(1.9, None)).helps("scale")
    assert Tried(Ate(0.0, 0.0), Ate(0.0, 1.0)).ratios == (1.0, 2.0)


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
def test_the_rotation_is_stated_if_it_falls_more(
    position: float, rotation: float, *, of_rotation: bool
) -> None:
    tried = Tried(Ate(2.0, 10.0), Ate(2.0 * position, 10.0 * rotation), is_next=True, then="Y")
    text = tried.text("X")
    assert text.startswith("then rotation ATE 10 deg, " if of_rotation else "then ATE 2 m, ")
    assert ", with X and Y " in text


def seen_of(cause: str, explained: float = 0.5, **values: str | float) -> Seen:
    class Anything(dict[str, str | float]):
        def __missing__(self, name: str) -> float:
            return math.pi

    filled = Anything(values)
    names = {"side", "owner", *values}
    for text in (CAUSES[cause].sentence, CAUSES[cause].advice, *CAUSES[cause].correction.values()):
        names |= {part.partition(":")[0].partition("}")[0] for part in text.split("{")[1:]}
    return Seen(cause, explained, {name: filled[name] for name in sorted(names - {"owner"})})


def test_findings_are_sorted_by_severity_and_then_by_what_they_explain() -> None:
    seen = (
        seen_of("scale", 0.9, gauge="sim3", or_feet="", or_convert=""),
        seen_of("tilted", 0.4),
        seen_of("wxyz", 0.3, side="estimate"),
        seen_of("inverse", 0.6, side="groundtruth"),
    )
    found = Diagnosis.of([Examined("one", seen=seen[:2]), Examined("other", seen=seen[2:])])
    assert [each.cause for each in found.findings] == ["inverse", "wxyz", "tilted", "scale"]
    assert found.suggested == found.findings[0]
    assert [each.rank for each in found.findings] == [6.0, 6.0, 5.7, 5.5]
    more = found.with_others([Finding.of(seen_of("identical", 1.0, where="here"))])
    assert [each.cause for each in more.findings][:2] == ["identical", "inverse"]
    assert found.of_conventions() == found.findings[0]
    assert found.named("tilted") == found.findings[2]
    # Another convention of poses in its place is a similar finding.
    assert not found.findings[1].is_gone(Diagnosis((found.findings[0],)))
    assert found.findings[1].is_gone(Diagnosis((found.findings[2],)))
    assert found.findings[2].is_gone(Diagnosis((found.findings[0],)))
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
    drift = Finding.of(seen_of("clock_drift", ppm=31.26, total_s=0.25))
    assert (drift.option, drift.conversion) == ("--correct clock_drift", "--clock-rate 31.3")
    steps = Corrections().changed(both.correction).changed(one.correction)
    assert steps.then is not None
    assert steps.then.groundtruth.quaternion_order == "wxyz"
    assert steps.then.estimate.inverse != "poses"
    assert steps.then.then is not None
    assert steps.then.then.estimate.inverse == "poses"
    assert steps.then.then.groundtruth.quaternion_order != "wxyz"
    assert Corrections().changed(offset.correction) == Corrections()
