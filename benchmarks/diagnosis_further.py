"""More mistakes, of which some only a part of the recordings can show."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.diagnosis_mistakes import (
    CAMERA,
    NED,
    Make,
    Mistake,
    change,
    in_axes,
    shifted,
    transposed,
    w_first,
)
from benchmarks.diagnosis_runs import Pair
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import evaluate


def _still(pair: Pair) -> Pair:
    return change(pair, "estimate", positions=0.0 * pair.estimate.positions)


def _names_swapped(pair: Pair) -> Pair:
    pair = change(pair, "truth", reading=SourceInfo("run/vio_odometry.txt"))
    return change(pair, "estimate", reading=SourceInfo("run/groundtruth.txt"))


def _positions_converted(pair: Pair) -> Pair:
    """Take positions to other axes, and forget the rotations."""
    return change(pair, "estimate", positions=pair.estimate.positions[:, [1, 2, 0]])


def _w_first_and_transposed(pair: Pair) -> Pair:
    return w_first("estimate")(transposed(pair))


def _heights_of_ellipsoid(pair: Pair) -> Pair:
    """Give both sides one frame, but for 47 m of height, and align nothing."""
    up = pair.truth.up.matrix[2]
    evaluation = evaluate(pair.truth, pair.estimate, pair.protocol)
    estimate = evaluation.alignment.similarity.trajectory(pair.estimate)
    estimate = dataclasses.replace(estimate, positions=estimate.positions + 47.0 * up)
    return dataclasses.replace(pair, estimate=estimate, gauge=Gauge.NONE)


def _covariances(pair: Pair, *, exchanged: bool, unit: float) -> Pair:
    """Give covariances of about the errors' size, where there are rotation errors."""
    ate = evaluate(pair.truth, pair.estimate, pair.protocol).ate
    position, rotation = ate["position_m"], ate["rotation_deg"]
    if position is None or rotation is None:
        return pair
    sigmas = np.repeat([position.median, unit * np.radians(rotation.median)], 3) / np.sqrt(3.0)
    sigmas = np.roll(sigmas, 3) if exchanged else sigmas
    covariances = np.linspace(1.0, 1.001, len(pair.estimate))[:, None, None] * np.diag(sigmas**2)
    return change(pair, "estimate", covariances=covariances)


def _tilted(pair: Pair) -> Pair:
    rotation = lie.to_matrix(lie.from_rotation_vector(np.radians([25.0, 0.0, 0.0])))
    return in_axes(rotation, "estimate")(pair)


def _frozen(begin: float, end: float) -> Make:
    """Repeat a pose during a part of the run; bounds are shares of it."""

    def make(pair: Pair) -> Pair:
        rows = np.arange(len(pair.estimate))
        first, last = (int(share * len(rows)) for share in (begin, end))
        return dataclasses.replace(
            pair,
            estimate=_repeated(
                pair.estimate, np.where((rows > first) & (rows < last), first, rows)
            ),
        )

    return make


def _repeated(estimate: Trajectory, rows: Indices) -> Trajectory:
    """Return poses of other rows (N,) at the same timestamps."""
    rotations = estimate.quaternions
    return dataclasses.replace(
        estimate,
        positions=estimate.positions[rows],
        quaternions=None if rotations is None else rotations[rows],
    )


def _diverging(mps2: float, begin: float, growth: float = 0.0) -> Make:
    """Accelerate in one direction; from the start, the scale grows exponentially instead."""

    def make(pair: Pair) -> Pair:
        seconds = pair.estimate.seconds - pair.estimate.seconds[0]
        unit = np.linalg.norm(np.ptp(pair.estimate.positions, axis=0))
        unit /= np.linalg.norm(np.ptp(pair.truth.positions, axis=0))
        since = np.clip(seconds - begin * seconds[-1], 0.0, None)
        away = unit * 0.5 * mps2 * since**2
        steps = np.diff(pair.estimate.positions, axis=0, prepend=pair.estimate.positions[:1])
        moved = np.cumsum(np.exp(growth * np.minimum(seconds, 30.0))[:, None] * steps, axis=0)
        positions = pair.estimate.positions[:1] + moved + np.outer(away, [0.6, 0.8, 0.0])
        return change(pair, "estimate", positions=positions)

    return make


FURTHER: dict[str, Mistake] = {
    "frozen": Mistake(_frozen(0.6, 0.8), ("frozen",)),
    "frozen until the end": Mistake(_frozen(0.5, 1.1), ("frozen",)),
    "frozen at the start": Mistake(_frozen(0.0, 0.15), ("frozen_at_start", "frozen")),
    "diverging, 0.3 m/s2": Mistake(_diverging(0.3, 0.5), ("diverged",)),
    "diverging, 3 m/s2": Mistake(_diverging(3.0, 0.4), ("diverged",)),
    "diverging from the start": Mistake(
        _diverging(0.0, 0.0, 0.5), ("diverged_at_start", "diverged")
    ),
    "stands still": Mistake(_still, ("stands_still",)),
    "sides swapped": Mistake(_names_swapped, ("swapped",)),
    "groundtruth in camera axes": Mistake(
        in_axes(CAMERA, "truth"), ("up_axis", "groundtruth_up_axis"), "yaw"
    ),
    "groundtruth in NED": Mistake(
        in_axes(NED, "truth"), ("up_axis", "up_axis_or_mirrored"), "yaw"
    ),
    "world tilted by 25 deg": Mistake(_tilted, ("tilted",), "yaw"),
    "positions in other axes": Mistake(_positions_converted, ("axes_mixed",)),
    "wxyz and transposed": Mistake(_w_first_and_transposed, ("wxyz_transposed",)),
    "clock +0.2 s": Mistake(shifted(0.2), ("small_clock_offset", "clock_offset")),
    "heights of the ellipsoid": Mistake(_heights_of_ellipsoid, ("frames_apart",)),
    "covariances, rotation first": Mistake(
        lambda pair: _covariances(pair, exchanged=True, unit=1.0), ("covariance_order",)
    ),
    "covariances in square degrees": Mistake(
        lambda pair: _covariances(pair, exchanged=False, unit=180.0 / np.pi),
        ("covariance_degrees",),
    ),
}
