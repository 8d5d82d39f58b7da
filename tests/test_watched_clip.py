"""The description of a clip with the signals of a watch: what is read, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.write_clip import ABOUT, SCHEMA
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.live.watched_clip import WatchedClip, read_watched_clip
from trajeval_ros.io.requests.limits_file import limits_mapping
from trajeval_ros.io.results.watch_json import watch_json
from trajeval_ros.report.watch_lines import alarm_rows, evidence_line, seen_line, signal_rows
from trajeval_ros.watchdog.limits import HealthyValues, WatchLimits

LIMITS = WatchLimits(
    {"pair_m_1s": HealthyValues(0.02, 0.01), "speed": HealthyValues(1.0, 0.5)},
    0.1,
    {"estimate": "run.mcap:/odom"},
    "by eye",
)
ORIGIN = 1_700_000_000_000_000_000


def description() -> dict[str, Any]:
    """Return the fields of a clip with one alarm."""
    return {
        "schema": SCHEMA,
        "causes": [{"subject": "pair_m_1s", "stamp_ns": ORIGIN + 2_750_000_000}],
        "signals": {
            "second_0_ns": ORIGIN,
            "estimate": "/odom",
            "largest_by_second": {
                "speed": [[0.0, 0.5], [1.0, 0.6]],
                "pair_m_1s": [[0.0, 0.01], [1.0, 0.02], [2.5, 0.9]],
            },
            "factor": 2.0,
            "limits": limits_mapping(LIMITS),
        },
    }


def said_of(clip: WatchedClip) -> tuple[object, ...]:
    """Return all that is reported of a clip."""
    json_text(watch_json(clip.estimate, clip.seen, clip.book))
    return (
        alarm_rows(clip.book),
        signal_rows(clip.seen, clip.book),
        seen_line(clip.seen, clip.book),
        evidence_line(clip.book.limits, clip.book.factor),
    )


def read(folder: Path, about: dict[str, Any], factor: float | None = None) -> WatchedClip:
    (folder / ABOUT).write_text(json.dumps(about))
    return read_watched_clip(folder, factor)


def test_signals_and_alarms_of_a_clip(tmp_path: Path) -> None:
    clip = read(tmp_path, description())
    assert clip.estimate == f"{tmp_path}/clip.mcap:/odom"
    assert (clip.seen.origin, clip.seen.armed_s, clip.seen.end_s) == (ORIGIN, 0.0, 2.5)
    assert list(clip.seen.signals) == ["pair_m_1s", "speed"]  # in the order of all reports
    assert clip.seen.signals["pair_m_1s"].values.tolist() == [0.01, 0.02, 0.9]
    assert clip.book.limits == LIMITS
    (alarm,) = clip.book.alarms
    # The time of the cause is exact; signals have one value a second.
    assert (alarm.begin_s, alarm.last_s) == (2.75, 2.75)
    assert (alarm.peak, alarm.peak_s) == (0.9, 2.5)
    assert alarm.limit == 2.0 * 0.02
    assert len(said_of(clip)) == 4


@pytest.mark.parametrize(("later_ns", "begin_s"), [(-1, 2.5), (0, 2.5), (999_999_999, 3.499999999),
                                                   (1_000_000_000, 2.5)])  # fmt: skip
def test_a_cause_is_of_the_alarm_in_its_second(
    later_ns: int, begin_s: float, tmp_path: Path
) -> None:
    about = description()
    about["causes"][0]["stamp_ns"] = ORIGIN + 2_500_000_000 + later_ns
    assert read(tmp_path, about).book.alarms[0].begin_s == begin_s
    about["causes"][0] = {"subject": "speed", "stamp_ns": ORIGIN + 2_600_000_000}
    assert read(tmp_path, about).book.alarms[0].begin_s == 2.5


def test_another_factor_makes_other_limits(tmp_path: Path) -> None:
    clip = read(tmp_path, description(), 100.0)
    assert clip.book.factor == 100.0
    assert not clip.book.alarms
    assert seen_line(clip.seen, clip.book).startswith("0 alarms in 0.001 h (2 s): fewer than")


def test_a_clip_of_one_second_has_no_rate(tmp_path: Path) -> None:
    about = description()
    about["signals"]["largest_by_second"] = {"pair_m_1s": [[1.0, 0.9]]}
    clip = read(tmp_path, about, 100.0)
    assert seen_line(clip.seen, clip.book) == "0 alarms in 0.000 h (0 s), armed at 1.0 s"


Spoil = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda about: about.pop("causes"),
        lambda about: about["causes"][0].pop("subject"),
        lambda about: about["causes"].append(3),
        lambda about: about["causes"][0].update(stamp_ns="x"),
        *(lambda about, name=name: about["signals"].pop(name) for name in
          ("second_0_ns", "estimate", "largest_by_second", "factor", "limits")),
        lambda about: about["signals"].update(largest_by_second={}),
        lambda about: about["signals"].update(largest_by_second={"pair_m_1s": [[0.0]]}),
        lambda about: about["signals"].update(largest_by_second={"nothing": [[0.0, 1.0]]}),
        lambda about: about["signals"].update(largest_by_second={"speed": [[1e300, 1.0]]}),
        lambda about: about["signals"].update(largest_by_second={"speed": [[0.0, 1e300]]}),
        lambda about: about["signals"].update(second_0_ns=2**63 - 1),
        lambda about: about["signals"].update(factor=1e300),
        lambda about: about["signals"].update(factor="x"),
    ],
)  # fmt: skip
def test_a_damaged_description_is_refused(spoil: Spoil, tmp_path: Path) -> None:
    about = description()
    spoil(about)
    with pytest.raises(InputError, match=r"clip\.json is damaged; use another clip"):
        read(tmp_path, about)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda limits: limits["evidence"].update(hours=1e-9), "no healthy hours"),
        (lambda limits: limits["evidence"].update(hours=1e300), "must be a number from 0 to"),
        (lambda limits: limits["evidence"].update(sources=["imu"]), "has no sources"),
        (lambda limits: limits["healthy"].update(speed=1.0), "speed must be"),
    ],
)
def test_damaged_limits_are_refused(spoil: Spoil, said: str, tmp_path: Path) -> None:
    about = description()
    spoil(about["signals"]["limits"])
    with pytest.raises(InputError, match=said):
        read(tmp_path, about)
