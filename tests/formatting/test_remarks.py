"""Remarks have their numbers, and the most severe are first."""

from __future__ import annotations

from trajeval_ros.formatting.remarks import damaged, most_severe_first, note, warning


def test_a_warning_has_its_numbers() -> None:
    assert warning("clock_step", "a step", "odom", {"step_s": 1.5}).values == {"step_s": 1.5}
    assert warning("clock_step", "a step").values == {}


def test_the_most_severe_remarks_are_first() -> None:
    given = [
        note("a", "a note"),
        warning("b", "a warning"),
        damaged("a chunk"),
        note("c", "another"),
    ]
    assert [item.text for item in most_severe_first(given)] == [
        "a chunk", "a warning", "a note", "another",
    ]  # fmt: skip
