"""The page about diagnoses quotes what is printed today."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from benchmarks.diagnosis import found
from benchmarks.diagnosis_further import FURTHER
from benchmarks.diagnosis_mistakes import MISTAKES
from benchmarks.diagnosis_runs import Pair, simulated
from trajeval_ros import Request, run
from trajeval_ros.diagnosis.causes import CAUSES

PAGE = Path(__file__).resolve().parent.parent / "docs" / "diagnosis.md"
QUOTED = dict(
    re.findall(r"^#### `(\w+)`\n\n```text\n(.*?)\n```$", PAGE.read_text("utf-8"), re.M | re.S)
)
DRONE = simulated(5000, "drone", "walk", 100.0)
CAR = simulated(5004, "car", "walk", 100.0)
ROBOT = simulated(5006, "robot", "walk", 100.0)
ALL = {**MISTAKES, **FURTHER}
# What shows a cause whose name is not the only one of a mistake, or that a drone does not show.
SHOWN_BY = {
    "convention_tie": ("transposed rotations", CAR),
    "inverse": ("inverse, estimate", DRONE),
    "mirrored": ("mirrored", DRONE),
    "truth_up_axis": ("KITTI by yaw", CAR),
    "up_axis": ("camera axes", DRONE),
    "up_axis_or_mirrored": ("NED", ROBOT),
    "wxyz": ("wxyz, estimate", DRONE),
}


def shown(cause: str) -> Pair:
    """Return a recording with the mistake."""
    if cause == "other_run":
        return dataclasses.replace(DRONE, truth=simulated(5400, "drone", "walk", 100.0).truth)
    names = [name for name, mistake in ALL.items() if mistake.causes == (cause,)]
    name, pair = SHOWN_BY.get(cause) or (names[0], DRONE)
    return ALL[name].make(pair)


def printed(cause: str) -> str:
    """Return the message of a cause."""
    if cause == "same_estimate":
        one = dataclasses.replace(DRONE.estimate, source="vio.txt")
        diagnosis = run(DRONE.truth, [one, one], Request(DRONE.protocol)).runs[1].diagnosis
    else:
        diagnosis = found(shown(cause))
    finding = diagnosis.named(cause)
    assert finding is not None, diagnosis.findings
    return finding.text


def without_numbers(text: str) -> str:
    """Return a message in one line; the digits depend on the recording and on the processor."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]\d+)?", "#", " ".join(text.split()))


def test_every_cause_has_an_entry() -> None:
    assert QUOTED.keys() == CAUSES.keys()


@pytest.mark.parametrize("cause", CAUSES)
def test_a_message_is_quoted_as_it_is_printed(cause: str) -> None:
    assert without_numbers(QUOTED[cause]) == without_numbers(printed(cause))


def test_the_example_at_the_top_is_as_it_is_printed() -> None:
    (line,) = re.findall(r"^  diagnosis: (.*)$", PAGE.read_text("utf-8"), re.M)
    assert without_numbers(line) == without_numbers(printed("estimate_mm"))
