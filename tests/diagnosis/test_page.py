"""The page about diagnoses quotes what is printed today."""

from __future__ import annotations

import dataclasses
import os
import re

import numpy as np
import pytest
from paths import ROOT

from benchmarks.diagnosis import diagnosis_of
from benchmarks.diagnosis_discontinuities import DISCONTINUITIES
from benchmarks.diagnosis_further import FURTHER
from benchmarks.diagnosis_mistakes import MISTAKES
from benchmarks.diagnosis_runs import Pair, simulated
from benchmarks.diagnosis_users import USERS
from trajeval_ros import Request, run
from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.source_info import SourceInfo

PAGE = ROOT / "docs" / "diagnosis.md"
TEXT = PAGE.read_text("utf-8")
DRONE = simulated(5000, "drone", "walk", 100.0)
CAR = simulated(5004, "car", "walk", 100.0)
ROBOT = simulated(5006, "robot", "walk", 100.0)
ALL = {**MISTAKES, **FURTHER, **USERS, **DISCONTINUITIES}


def planar(pair: Pair) -> Pair:
    """Return a run that moves and turns in a plane, with noise."""
    sides = {}
    for side, seed in (("truth", 1), ("estimate", 2)):
        poses, random = getattr(pair, side), np.random.default_rng(seed)
        positions = poses.positions.copy()
        positions[:, 2] = random.normal(0.0, 1e-3, len(poses))
        rotations = random.normal(0.0, 1e-3, (len(poses), 3))
        rotations[:, 2] += lie.yaw(poses.quaternions)
        quaternions = lie.from_rotation_vector(rotations)
        sides[side] = dataclasses.replace(poses, positions=positions, quaternions=quaternions)
    return dataclasses.replace(pair, **sides)


PLANAR = planar(ROBOT)
# What shows a cause whose name is not the only one of a mistake, or that a drone does not show.
SHOWN_BY = {
    "convention_tie": ("transposed rotations", PLANAR),
    "xyzw": ("xyzw, estimate", DRONE),
    "frozen": ("frozen", DRONE),
    "frozen_at_start": ("frozen at the start", DRONE),
    "diverged_at_start": ("diverging from the start", DRONE),
    "diverged": ("diverging, 3 m/s2", DRONE),
    "inverse": ("inverse, estimate", DRONE),
    "mirrored": ("mirrored", DRONE),
    "groundtruth_up_axis": ("KITTI by yaw", CAR),
    "up_axis": ("camera axes", DRONE),
    "up_axis_or_mirrored": ("NED", PLANAR),
    "wxyz": ("wxyz, estimate", DRONE),
    "axes_mixed": ("positions in other axes", DRONE),
    "conventions": ("z and qz flipped", DRONE),
    "rotations": ("Euler order", DRONE),
    "tilted": ("world tilted by 25 deg", DRONE),
    "unit": ("estimate in mm", DRONE),
    "clock_drift": ("clock 1000 ppm", DRONE),
    "small_clock_offset": ("clock +0.2 s", DRONE),
    "body": ("marker", DRONE),
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
        one = dataclasses.replace(DRONE.estimate, reading=SourceInfo("vio.txt"))
        diagnosis = run(DRONE.truth, [one, one], Request(DRONE.protocol)).runs[1].diagnosis
    else:
        diagnosis = diagnosis_of(shown(cause))
    finding = diagnosis.named(cause)
    assert finding is not None, diagnosis.findings
    return finding.text


def without_numbers(text: str) -> str:
    """Return a message in one line; the digits depend on the recording and on the processor."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]\d+)?", "#", " ".join(text.split()))


def table() -> str:
    """Return the rows of the page's table: names, messages without evidence, and options."""
    rows: dict[tuple[str, str], list[str]] = {}
    for cause in CAUSES.values():
        # A colon outside of parentheses begins the evidence, if numbers follow.
        evident = re.fullmatch(r"((?:\([^)]*\)|(?!: )[^(])*): .*\{.*", cause.sentence)
        message = evident[1] if evident else cause.sentence
        message = re.sub(r"(?<=\w)(\{[^}]*\})+", "", message)  # additions to a word
        message = re.sub(r"\{[^}]*\}", "...", message)
        if message == "...":  # several sentences
            message = cause.name.replace("_", " ")
        options = dict.fromkeys(name.partition(".")[2] or name for name in cause.correction)
        named = ", ".join(f"`--{name.replace('_', '-')}`" for name in options)
        rows.setdefault((message, named), []).append(f"`{cause.name}`")
    return "".join(
        f"| {', '.join(names)} | {message} | {named} |\n"
        for (message, named), names in rows.items()
    )


def test_the_table_of_causes_is_generated() -> None:
    """With KEEP=1 in the environment, it is written again."""
    head = "|---|---|---|\n"
    before, _, rest = TEXT.partition(head)
    _, after = rest.split("\n\n", 1)
    page = f"{before}{head}{table()}\n{after}"
    if os.environ.get("KEEP"):
        PAGE.write_text(page, "utf-8")
        return
    assert page == TEXT


@pytest.mark.slow
@pytest.mark.parametrize("cause", CAUSES)
def test_a_message_states_what_is_wrong_and_what_to_do(cause: str) -> None:
    text, _, advice = printed(cause).rpartition("; ")
    assert len(text) > 20
    assert len(advice) > 10
    assert "{" not in text + advice


def test_the_examples_are_as_they_are_printed() -> None:
    lines = re.findall(r"^  diagnosis: (.*)$", TEXT, re.M)
    for line, cause in zip(lines, ("unit", "wxyz"), strict=True):
        assert without_numbers(line) == without_numbers(printed(cause))
