"""Mistakes that users of evaluators reported: units, angles, clocks, half conversions of axes."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.diagnosis_mistakes import (
    CAMERA,
    NED,
    Make,
    Mistake,
    change,
    in_axes,
    quaternions_of,
    scaled,
    shifted,
    w_first,
)
from benchmarks.diagnosis_runs import Array, Pair
from trajeval_ros.geometry import lie

FRD = np.diag([1.0, -1.0, -1.0])
_METRES_PER_DEG = 111_320.0
# What a diagnosis may call rotations that no convention explains, or the axes of half a pose.
_ROTATIONS = ("rotations",)
_HALF = ("axes_mixed", "mirrored", "rotations", "body", "up_axis", "convention_tie")


def _rotated(world: Array, body: Array, *, positions: bool = False) -> Make:
    """Return what multiplies rotations (W R B), and positions (W p) if asked."""
    left, right = lie.from_matrix(world), lie.from_matrix(body)

    def make(pair: Pair) -> Pair:
        one = pair.estimate
        q = lie.multiply(lie.multiply(left, quaternions_of(one)), right)
        p = one.positions @ world.T if positions else one.positions
        return change(pair, "estimate", positions=p, quaternions=q)

    return make


def _by_angles(read: str, written: str = "ZYX", factor: float = 1.0, signs: object = 1.0) -> Make:
    """Return what writes Euler angles, and reads them in another order, unit or sign."""

    def make(pair: Pair) -> Pair:
        angles = Rotation.from_quat(quaternions_of(pair.estimate)).as_euler(written)
        rotated = Rotation.from_euler(read, factor * angles * np.asarray(signs))
        return change(pair, "estimate", quaternions=rotated.as_quat())

    return make


def _columns(order: list[int], signs: list[float], of_quaternions: list[float]) -> Make:
    """Return what exchanges and flips columns of positions, and flips those of quaternions."""

    def make(pair: Pair) -> Pair:
        one = pair.estimate
        q = quaternions_of(one) * of_quaternions
        return change(pair, "estimate", positions=one.positions[:, order] * signs, quaternions=q)

    return make


def _in_degrees(pair: Pair) -> Pair:
    """Write longitude and latitude as x and y."""
    one = pair.estimate
    north = _METRES_PER_DEG
    level = one.positions / [north * np.cos(np.radians(47.4)), north, 1.0]
    return change(pair, "estimate", positions=level + [8.5, 47.4, 0.0])


def _flat(side: str) -> Make:
    return lambda pair: change(
        pair, side, positions=getattr(pair, side).positions * [1.0, 1.0, 0.0]
    )


def _stamped(rate: float) -> Make:
    """Return what multiplies the time since the start by a rate."""

    def make(pair: Pair) -> Pair:
        stamps = pair.estimate.stamps
        since = np.rint((stamps - stamps[0]) * rate).astype(np.int64)
        return change(pair, "estimate", stamps=stamps[0] + since)

    return make


def _row_numbers(pair: Pair) -> Pair:
    rows = 10**9 * np.arange(len(pair.estimate), dtype=np.int64)
    return change(pair, "estimate", stamps=rows)


def _rebased(pair: Pair) -> Pair:
    """Start both clocks near zero, the estimate's 2.7 s later."""
    first = pair.truth.stamps[0]
    estimate = dataclasses.replace(
        pair.estimate, stamps=pair.estimate.stamps - first + 2_700_000_000
    )
    truth = dataclasses.replace(pair.truth, stamps=pair.truth.stamps - first)
    return dataclasses.replace(pair, truth=truth, estimate=estimate)


def _increments(pair: Pair) -> Pair:
    """Write steps in the axes of the body instead of poses."""
    one = pair.estimate
    q, p = quaternions_of(one), one.positions
    back = lie.conjugate(q[:-1])
    steps = np.concatenate([np.zeros((1, 3)), lie.rotate(back, np.diff(p, axis=0))])
    rotated = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], lie.multiply(back, q[1:])])
    return change(pair, "estimate", positions=steps, quaternions=rotated)


def _both_optical(pair: Pair) -> Pair:
    return in_axes(CAMERA, "truth", "estimate")(pair)


def _world_tilted(degrees: float) -> Make:
    rotation = lie.to_matrix(lie.from_rotation_vector(np.radians([degrees, 0.0, 0.0])))
    return in_axes(rotation, "estimate")


def _unreal(pair: Pair) -> Pair:
    return _columns([0, 1, 2], [100.0, -100.0, 100.0], [-1.0, 1.0, -1.0, 1.0])(pair)


_NO_SIGNS = [1.0, 1.0, 1.0, 1.0]
_UNITS = {"cm": 100.0, "inches": 1 / 0.0254, "feet": 1 / 0.3048}
_EYE = np.eye(3)
USERS: dict[str, Mistake] = {
    **{
        f"{side} in {unit}": Mistake(scaled(name, factor), ("unit",))
        for unit, factor in _UNITS.items()
        for side, name in (("estimate", "estimate"), ("groundtruth", "truth"))
    },
    # A monocular estimate may have the same scale.
    "groundtruth in feet": Mistake(scaled("truth", 1 / 0.3048), ("unit", "scale")),
    "radians as degrees": Mistake(_by_angles("ZYX", factor=np.pi / 180.0), _ROTATIONS),
    "degrees as radians": Mistake(_by_angles("ZYX", factor=180.0 / np.pi), _ROTATIONS),
    # In a plane, these are rotations in other axes.
    "Euler order": Mistake(_by_angles("XYZ"), (*_ROTATIONS, "axes_mixed")),
    "roll and pitch swapped": Mistake(_by_angles("ZXY", "ZYX"), _ROTATIONS),
    "compass heading": Mistake(
        _by_angles("ZYX", signs=[-1.0, 1.0, 1.0]), ("rotations", "transposed", "convention_tie")
    ),
    "z and qz flipped": Mistake(
        _columns([0, 1, 2], [1.0, 1.0, -1.0], [1.0, 1.0, -1.0, 1.0]),
        ("conventions", "mirrored", "transposed", "convention_tie", "rotations"),
    ),
    "x and y swapped": Mistake(
        lambda pair: change(
            pair,
            "estimate",
            positions=pair.estimate.positions[:, [1, 0, 2]],
            quaternions=quaternions_of(pair.estimate)[:, [1, 0, 2, 3]] * [-1.0, -1.0, -1.0, 1.0],
        ),
        ("mirrored",),
    ),
    "degrees as x and y": Mistake(_in_degrees, ("degrees",)),
    "groundtruth flat": Mistake(_flat("truth"), ("flat",), "yaw"),
    "10 Hz for 9.64": Mistake(_stamped(0.964), ("clock_drift",)),
    "30 fps for 20": Mistake(_stamped(20.0 / 30.0), ("clock_drift",)),
    "30 fps for 25": Mistake(_stamped(25.0 / 30.0), ("clock_drift",)),
    "row numbers": Mistake(_row_numbers, ("row_numbers",)),
    "increments": Mistake(_increments, ("increments",)),
    "both rebased": Mistake(_rebased, ("clock_offset",)),
    "clock +0.8 s": Mistake(shifted(0.8), ("clock_offset",)),
    "clock +0.35 s": Mistake(shifted(0.35), ("clock_offset",)),
    "Unreal": Mistake(_unreal, ("mirrored", "up_axis_or_mirrored", "unit")),
    "both optical": Mistake(_both_optical, ("groundtruth_up_axis", "tilted"), "yaw"),
    "world tilted by 68 deg": Mistake(_world_tilted(68.0), ("tilted",), "yaw"),
    "camera poses": Mistake(
        _rotated(CAMERA, CAMERA.T, positions=True), ("up_axis", "body"), "yaw"
    ),
    "raw NED and FRD": Mistake(
        _rotated(NED, FRD, positions=True), ("up_axis", "body", "up_axis_or_mirrored")
    ),
    "positions alone converted": Mistake(_rotated(NED, FRD), _HALF),
    "orientations alone converted": Mistake(
        lambda pair: change(pair, "estimate", positions=pair.estimate.positions @ NED.T), _HALF
    ),
    "body left FRD": Mistake(_rotated(_EYE, FRD), ("body",)),
    "attitude of FLU in NED": Mistake(_rotated(NED, _EYE), _HALF),
    "z alone flipped": Mistake(_columns([0, 1, 2], [1.0, 1.0, -1.0], _NO_SIGNS), _HALF),
    "x and y alone swapped": Mistake(_columns([1, 0, 2], [1.0, 1.0, 1.0], _NO_SIGNS), _HALF),
    "NWU for ENU": Mistake(
        _rotated(FRD, FRD, positions=True), ("up_axis", "body", "up_axis_or_mirrored")
    ),
    # In a plane, these are inverse rotations.
    "attitude NWU": Mistake(_rotated(FRD, FRD), (*_HALF, "transposed")),
    "wxyz and millimetres": Mistake(
        lambda pair: scaled("estimate", 1000.0)(w_first("estimate")(pair)),
        ("wxyz", "unit"),
    ),
}  # fmt: skip
