"""Events that repeat: the first three are reported, and then a count."""

from __future__ import annotations

from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.ros.status_topics import RepeatedRemarks


def jump(number: int, subject: str = "") -> Remark:
    return warning("jump", f"jump {number}", subject, {"stamp_ns": number})


def test_a_flood_is_three_remarks_and_a_count_in_ten_seconds() -> None:
    repeated = RepeatedRemarks()
    told = [repeated.may_report("vio", jump(index), 0.1 * index) for index in range(80)]
    assert told == [True] * 3 + [False] * 77
    assert repeated.counts(9.9) == []
    [(about, count)] = repeated.counts(10.0)
    assert about == "vio"
    assert count.text == "77 more events of this kind in 10 s; the newest: jump 79"
    assert count.values == {"stamp_ns": 79, "more": 77}


def test_other_kinds_and_sources_are_not_held_back() -> None:
    repeated = RepeatedRemarks()
    for index in range(10):
        repeated.may_report("vio", jump(index), 0.0)
    assert repeated.may_report("slam", jump(0), 0.0)
    assert repeated.may_report("vio", jump(0, "other"), 0.0)
    assert repeated.may_report("vio", warning("clock", "stepped"), 0.0)


def test_an_hour_of_jumps_leaves_room_for_the_events_that_came_first() -> None:
    repeated, reported = RepeatedRemarks(), 0
    for second in range(3600):
        reported += len(repeated.counts(float(second)))
        reported += sum(repeated.may_report("vio", jump(index), second) for index in range(10))
    assert reported < 50


def test_a_kind_that_ends_is_reported_at_once_when_it_returns() -> None:
    repeated = RepeatedRemarks()
    for index in range(10):
        repeated.may_report("vio", jump(index), 0.0)
    assert len(repeated.counts(10.0)) == 1
    assert repeated.counts(30.0) == []  # nothing more
    told = [repeated.may_report("vio", jump(index), 31.0) for index in range(4)]
    assert told == [True, True, True, False]
