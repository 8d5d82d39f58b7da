"""Discontinuities of one side: outliers, flips, steps, frozen positions and clock steps."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.diagnosis_mistakes import Make, Mistake, change, quaternions_of
from benchmarks.diagnosis_runs import Pair
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans

_AT, _EXCURSION_S, _FROZEN_S = 0.4, 0.3, 8.0  # place, of the run; durations
_SIZE_M, _CLOCK_STEP_NS = 200.0, -4_000_000_000
_HALF_ROTATION = lie.from_rotation_vector(np.array([math.pi, 0.0, 0.0]))


def _inside(pair: Pair, side: str, duration_s: float) -> Booleans:
    one, estimate = getattr(pair, side), pair.estimate
    seconds = (one.stamps - estimate.stamps[0]) / 1e9 - _AT * estimate.duration_s
    rows: Booleans = (seconds >= 0.0) & (seconds < duration_s)
    return rows


def _moved(side: str, duration_s: float) -> Make:
    def make(pair: Pair) -> Pair:
        positions = getattr(pair, side).positions.copy()
        positions[_inside(pair, side, duration_s)] += _SIZE_M * np.array([0.6, 0.8, 0.0])
        return change(pair, side, positions=positions)

    return make


def _rotated(side: str, duration_s: float) -> Make:
    def make(pair: Pair) -> Pair:
        quaternions = quaternions_of(getattr(pair, side)).copy()
        rows = _inside(pair, side, duration_s)
        quaternions[rows] = lie.multiply(quaternions[rows], _HALF_ROTATION)
        return change(pair, side, quaternions=quaternions)

    return make


def _held(pair: Pair) -> Pair:
    positions, rows = pair.estimate.positions.copy(), _inside(pair, "estimate", _FROZEN_S)
    positions[rows] = positions[rows.argmax()]
    return change(pair, "estimate", positions=positions)


def _rotation_held(side: str) -> Make:
    def make(pair: Pair) -> Pair:
        rows = _inside(pair, side, math.inf)
        quaternions = quaternions_of(getattr(pair, side)).copy()
        quaternions[rows] = quaternions[rows.argmax()]
        return change(pair, side, quaternions=quaternions)

    return make


def _clock(*sides: str) -> Make:
    def make(pair: Pair) -> Pair:
        for side in sides:
            stamps = getattr(pair, side).stamps.copy()
            stamps[_inside(pair, side, math.inf)] += _CLOCK_STEP_NS
            pair = change(pair, side, stamps=stamps)
        return pair

    return make


DISCONTINUITIES: dict[str, Mistake] = {
    "groundtruth outlier": Mistake(_moved("truth", _EXCURSION_S), ("groundtruth_outlier",)),
    "outlier": Mistake(_moved("estimate", _EXCURSION_S), ("outlier",)),
    "groundtruth step": Mistake(_moved("truth", math.inf), ("groundtruth_step",)),
    "step": Mistake(_moved("estimate", math.inf), ("step",)),
    "groundtruth flip": Mistake(_rotated("truth", _EXCURSION_S), ("groundtruth_flip",)),
    "flip": Mistake(_rotated("estimate", _EXCURSION_S), ("flip",)),
    "groundtruth flip stays": Mistake(_rotated("truth", math.inf), ("groundtruth_flip_stays",)),
    "flip stays": Mistake(_rotated("estimate", math.inf), ("flip_stays",)),
    "position held": Mistake(_held, ("frozen_position",)),
    "groundtruth rotation held": Mistake(
        _rotation_held("truth"), ("groundtruth_frozen_rotation",)
    ),
    "rotation held": Mistake(_rotation_held("estimate"), ("frozen_rotation",)),
    "clock step": Mistake(_clock("estimate"), ("clock_step",)),
    "clock steps of both": Mistake(_clock("truth", "estimate"), ("both_clocks_step",)),
}
