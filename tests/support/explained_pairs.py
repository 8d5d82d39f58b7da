"""Pairs of trajectories of a plain clone, and the values of all definitions for them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from paths import TESTS

from trajeval_ros import read_trajectory
from trajeval_ros.explanation.definition import Definition
from trajeval_ros.explanation.definition_values import values_of
from trajeval_ros.geometry.trajectory import Trajectory

PAIRS = TESTS / "data/parity/pairs"
REFERENCES = json.loads((TESTS / "data/parity/references.json").read_text(encoding="utf-8"))


def files(pair: str) -> tuple[Path, Path]:
    named = REFERENCES["pairs"][pair]
    return PAIRS / named["groundtruth"], PAIRS / named["estimate"]


@cache
def sides(pair: str) -> tuple[Trajectory, Trajectory]:
    truth, estimate = files(pair)
    return read_trajectory(str(truth)), read_trajectory(str(estimate))


@cache
def values(pair: str) -> tuple[dict[Definition, int], list[float]]:
    return values_of(*sides(pair))
